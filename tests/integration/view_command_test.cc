// SPDX-License-Identifier: Apache-2.0

// evpose view as a command: its errors, its address and its end. The page itself is tested in tests/view.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <string>

#include "absl/strings/str_cat.h"
#include "client/view/page_files.h"
#include "tests/integration/cli_fixture.h"
#include "tests/integration/local_server_testing.h"

namespace evpose {
namespace {

using ::testing::ContainsRegex;
using ::testing::HasSubstr;

class ViewCommandTest : public CliTest {
 protected:
  void SetUp() override {
    CliTest::SetUp();
    if (client::EmbeddedPage().empty()) GTEST_SKIP() << "built without the page: node or npm was missing";
  }
  // Runs a command that serves a page, reads its address, and interrupts it.
  CliResult ServeAndInterrupt(const std::string& command) const {
    return RunShell("mkfifo address\n" + command +
                    " >address &\nread -r line <address\necho \"$line\"\nkill -TERM $!\nwait $!\n");
  }
};

TEST_F(ViewCommandTest, ARecordingIsServedUntilAnInterrupt) {
  SimulateCube(0.02);
  const CliResult result = ServeAndInterrupt(
      "evpose view cube/recording.raw --poses cube/truth.tum --truth cube/truth.tum --model cube/model.obj --camera "
      "cube/camera.yaml");
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_THAT(result.out, ContainsRegex("^http://127.0.0.1:[0-9]+/#[0-9a-f]{32}\n$"));
}

TEST_F(ViewCommandTest, AWaitForARecordingIsStated) {
  SimulateCube(0.02);
  // The pipe has a writer, and no event comes.
  const CliResult result = RunShell(
      "mkfifo camera.raw messages\nexec 3<>camera.raw\nevpose view camera.raw --poses cube/truth.tum --model "
      "cube/model.obj --camera cube/camera.yaml >address 2>messages &\n"
      "read -r line <messages\ncat address\necho \"$line\"\nkill -TERM $!\nwait $! || true\n");
  EXPECT_THAT(result.out, ContainsRegex("^http://127.0.0.1:[0-9]+/#[0-9a-f]{32}\nwaiting for a recording in the pipe "
                                        "camera.raw \\.\\.\\.\n$"));
}

TEST_F(ViewCommandTest, ARecordingWithoutPosesIsServedWithAWarning) {
  SimulateCube(0.02);
  WriteText("none.tum", "# timestamp tx ty tz qx qy qz qw\n");
  const CliResult result = ServeAndInterrupt(
      "evpose view cube/recording.raw --poses none.tum --model cube/model.obj --camera cube/camera.yaml");
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_THAT(result.out, HasSubstr("http://127.0.0.1:"));
  EXPECT_EQ(result.err, "evpose view: none.tum: has no pose: the events are shown alone\n");
}

TEST_F(ViewCommandTest, PosesInAWorldNeedItsTransform) {
  SimulateCube(0.02);
  WriteText("world.tum", "# base_from_object, timestamp tx ty tz qx qy qz qw\n16.01 0 0 1 0 0 0 1\n");
  WriteText("mount.yaml", "frame_id: base\ntranslation: [1, 2, 3]\nrotation: [0, 0, 0, 1]\n");
  const std::string view =
      "evpose view cube/recording.raw --poses world.tum --model cube/model.obj --camera cube/camera.yaml";
  const CliResult refused = RunShell(view);
  EXPECT_EQ(refused.status, 1);
  EXPECT_THAT(refused.err, HasSubstr("world.tum: its poses are base_from_object; give poses of a run without "));
  const CliResult shown = ServeAndInterrupt(view + " --world-from-camera mount.yaml");
  EXPECT_EQ(shown.status, 0) << shown.err;
  EXPECT_THAT(shown.out, HasSubstr("http://127.0.0.1:"));
  const CliResult missing = Run({"view", "--server", "127.0.0.1:1", "--world-from-camera", Path("none.yaml")});
  EXPECT_EQ(missing.status, 1);
  EXPECT_THAT(missing.err, HasSubstr("none.yaml"));
}

TEST_F(ViewCommandTest, PosesOfAnotherTimeAreReportedWithBothTimes) {
  SimulateCube(0.02);
  WriteText("other.tum", "100 0 0 1 0 0 0 1\n100.1 0 0 1 0 0 0 1\n");
  const CliResult result = RunShell(
      "mkfifo messages\nevpose view cube/recording.raw --poses other.tum --model cube/model.obj --camera "
      "cube/camera.yaml >/dev/null 2>messages &\n"
      "read -r line <messages\necho \"$line\"\nkill -TERM $!\nwait $!\n");
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_THAT(result.out, HasSubstr("evpose view: other.tum: its poses are from 100.000000 s to 100.100000 s, but the "
                                    "events of cube/recording.raw are from 16.0"));
}

TEST_F(ViewCommandTest, AServerIsServedUntilAnInterrupt) {
  const LocalServer server = StartLocalServer();
  const CliResult result = ServeAndInterrupt("evpose view --server " + server.address);
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_THAT(result.out, HasSubstr("http://127.0.0.1:"));
  const CliResult missing = Run({"view", "sessions/none", "--server", server.address});
  EXPECT_EQ(missing.status, 1);
  EXPECT_THAT(missing.err, HasSubstr("sessions/none does not exist"));
}

TEST_F(ViewCommandTest, AnAddressThatOtherMachinesCanReachIsServedWithAWarning) {
  const LocalServer server = StartLocalServer();
  const CliResult published = ServeAndInterrupt("evpose view --listen 0.0.0.0:0 --server " + server.address);
  EXPECT_EQ(published.status, 0) << published.err;
  EXPECT_THAT(published.err, HasSubstr("warning: the link to the page is not encrypted, and other machines can reach "
                                       "0.0.0.0:0: "));
  ASSERT_EQ(unlink(Path("address").c_str()), 0);
  const CliResult own = ServeAndInterrupt("evpose view --listen 127.0.0.1:0 --server " + server.address);
  EXPECT_EQ(own.status, 0) << own.err;
  EXPECT_EQ(own.err, "");
}

TEST_F(ViewCommandTest, AReplayOpensItsPageAndHasTheSamePoses) {
  SimulateCube(0.05);
  const std::string replay = "evpose replay cube/recording.raw --model cube/model.obj --camera cube/camera.yaml --out ";
  const CliResult result = RunShell(
      "mkdir browser\nprintf '#!/bin/sh\\necho \"$1\" >opened\\n' >browser/xdg-open\nchmod +x browser/xdg-open\nmkfifo "
      "opened\n" +
      replay + "poses.csv >/dev/null\nPATH=\"$PWD/browser:$PATH\" " + replay +
      "viewed.csv --view >/dev/null &\nread -r line <opened\necho \"$line\"\nwait $!\n");
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_THAT(result.out, ContainsRegex("^http://127.0.0.1:[0-9]+/#[0-9a-f]{32}\n$"));
  EXPECT_THAT(result.err, HasSubstr(result.out)) << "it is printed, too";
  EXPECT_GT(ReadText("poses.csv").size(), 1000u);
  EXPECT_EQ(ReadText("viewed.csv"), ReadText("poses.csv"));
}

TEST_F(ViewCommandTest, ABrowserThatCannotBeOpenedIsReportedInOneLine) {
  SimulateCube(0.02);
  const CliResult result = RunShell(
      "mkdir browser\nprintf '#!/bin/sh\\necho no browser >&2\\nexit 3\\n' >browser/xdg-open\nchmod +x "
      "browser/xdg-open\n"
      "mkfifo messages\nPATH=\"$PWD/browser:$PATH\" evpose view cube/recording.raw --poses cube/truth.tum --model "
      "cube/model.obj --camera cube/camera.yaml --open >/dev/null 2>messages &\n"
      "read -r line <messages\necho \"$line\"\nkill -TERM $!\nwait $!\n");
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(result.out, "xdg-open has not opened a browser: open the address in one\n");
}

TEST_F(ViewCommandTest, APortThatIsTakenIsNamedBeforeFilesAreRead) {
  const LocalServer server = StartLocalServer();
  const CliResult result = Run({"view", "other.raw", "--poses", "p.csv", "--model", "m.obj", "--camera", "c.yaml",
                                "--port", absl::StrCat(server.server->port())});
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr(absl::StrCat("127.0.0.1:", server.server->port())));
  EXPECT_THAT(result.err, HasSubstr("give another, or 0 for a free one"));
  EXPECT_THAT(
      Run({"view", "other.raw", "--poses", "p.csv", "--model", "m.obj", "--camera", "c.yaml", "--port", "0"}).err,
      HasSubstr("c.yaml: cannot be read"))
      << "0 is accepted, and the files are read";
}

TEST_F(ViewCommandTest, WrongUseNamesTheOption) {
  EXPECT_EQ(Run({"view"}).status, 2);
  EXPECT_THAT(Run({"view"}).err, HasSubstr("give --server HOST:PORT, or a recording"));
  EXPECT_THAT(Run({"view", "a.raw", "--camera", "c.yaml", "--model", "m.obj"}).err, HasSubstr("give --poses, too"));
  EXPECT_THAT(Run({"view", "a.raw", "--poses", "p.csv", "--model", "m.obj"}).err, HasSubstr("give --camera, too"));
  EXPECT_THAT(Run({"view", "a.raw", "--server", "127.0.0.1:1"}).err, HasSubstr("\"a.raw\" is not a session"));
  const CliResult session = Run({"view", "sessions/abc"});
  EXPECT_EQ(session.status, 2);
  EXPECT_THAT(session.err, HasSubstr("evpose view: sessions/abc is a session: give --server HOST:PORT, too; "));
  const CliResult file = Run({"view", "sessions/a.raw", "--poses", "p.csv", "--model", "m.obj"});
  EXPECT_THAT(file.err, HasSubstr("give --camera, too")) << "a recording in a directory of this name";
  EXPECT_EQ(Run({"view", "--server", "127.0.0.1:1", "--poses", "p.csv"}).status, 2);
  EXPECT_EQ(Run({"view", "a.raw", "--port", "1", "--listen", "127.0.0.1:1"}).status, 2);
}

TEST_F(ViewCommandTest, AFileOfOneObjectIsRefusedForSeveral) {
  SimulateCube(0.02);
  const CliResult result = Run({"view", Path("cube/recording.raw"), "--poses", Path("cube/truth.tum"), "--object",
                                "a=" + Path("cube/model.obj"), "--object", "b=" + Path("cube/model.obj"), "--camera",
                                Path("cube/camera.yaml")});
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr("cube/truth.tum: a .tum file has the poses of one object: give the name of one for "
                                    "each object, such as 'poses-{object}.tum', or a .csv or .jsonl file"));
  const CliResult both = Run({"view", "r.raw", "--model", "m.obj", "--object", "a=m.obj"});
  EXPECT_EQ(both.status, 2);
  EXPECT_THAT(both.err, HasSubstr("--model and --object exclude each other: give one of them"));
}

TEST_F(ViewCommandTest, FilesThatCannotBeReadAreNamed) {
  SimulateCube(0.02);
  const auto view = [&](const std::string& recording, const std::string& poses) {
    return Run({"view", Path(recording), "--poses", Path(poses), "--model", Path("cube/model.obj"), "--camera",
                Path("cube/camera.yaml")});
  };
  EXPECT_THAT(view("other.raw", "cube/truth.tum").err, HasSubstr(Path("other.raw")));
  EXPECT_THAT(view("cube/recording.raw", "other.tum").err, HasSubstr(Path("other.tum")));
  WriteText("bad.jsonl", "{}\n");
  EXPECT_THAT(view("cube/recording.raw", "bad.jsonl").err, HasSubstr(Path("bad.jsonl") + ":1: has no t_us"));
}

}  // namespace
}  // namespace evpose
