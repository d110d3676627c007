// SPDX-License-Identifier: Apache-2.0

// What the commands say about names of servers, models and files that they cannot use.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "tests/integration/cli_fixture.h"
#include "tests/integration/local_server_testing.h"

namespace evpose {
namespace {

using ::testing::EndsWith;
using ::testing::HasSubstr;
using ::testing::Not;

class WrongNamesTest : public CliTest {};

TEST_F(WrongNamesTest, HelpOfStreamHasOnlyTheFormatsThatItReads) {
  const std::string help = Run({"stream", "--help"}).out;
  EXPECT_THAT(help, HasSubstr("Recording: RAW or DAT, a file that grows"));
  for (const char* const format : {"rosbag2", "HDF5", "AEDAT", "NumPy"}) EXPECT_THAT(help, Not(HasSubstr(format)));
  EXPECT_THAT(Run({"replay", "--help"}).out, HasSubstr("rosbag2"));
}

TEST_F(WrongNamesTest, AUrlIsNoAddressOfAServer) {
  const auto error = [this](const std::string& address) {
    const CliResult result = Run({"sessions", "list", "--server", address});
    EXPECT_EQ(result.status, 2) << address;
    return result.err;
  };
  EXPECT_THAT(
      error("http://localhost:50051/v1"),
      HasSubstr("--server: \"http://localhost:50051/v1\" is a URL, but the address of a server is HOST:PORT: give "
                "localhost:50051; "));
  EXPECT_THAT(error("a:1,HTTPS://pose.example.org:443"),
              HasSubstr("HOST:PORT: give pose.example.org:443; an encrypted connection needs TLS; "));
  EXPECT_THAT(error("http://localhost"), HasSubstr("HOST:PORT: give localhost:PORT; "));
  EXPECT_THAT(error("http://[::1]/v1"), HasSubstr("HOST:PORT: give [::1]:PORT; "));
  EXPECT_THAT(error("http://"), HasSubstr("HOST:PORT: give HOST:PORT; "));
}

TEST_F(WrongNamesTest, AHostThatDoesNotExist) {
  const CliResult result = Run({"sessions", "list", "--server", "nowhere.invalid:50051", "--connect-timeout", "0.3"});
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr("no server at nowhere.invalid:50051: the name nowhere.invalid has no address: "));
  EXPECT_THAT(result.err, HasSubstr(": check the spelling of the name"));
}

TEST_F(WrongNamesTest, HelpIsAlsoACommand) {
  EXPECT_EQ(Run({"help"}).out, Run({"--help"}).out);
  EXPECT_EQ(Run({"help", "models", "inspect"}).out, Run({"models", "inspect", "--help"}).out);
  const CliResult wrong = Run({"help", "replai"});
  EXPECT_EQ(wrong.status, 2);
  EXPECT_THAT(wrong.err, HasSubstr("there is no command \"replai\"; did you mean replay?"));
}

TEST_F(WrongNamesTest, FilesOfAnotherKind) {
  SimulateCube(0.02);
  EXPECT_THAT(Run({"models", "inspect", Path("cube")}).err, HasSubstr("cube: is a directory"));
  EXPECT_THAT(Run({"models", "inspect", Path("none")}).err, HasSubstr("none: cannot be read: No such file"));
  WriteText("large.raw", std::string(2 << 20, 'x'));
  EXPECT_THAT(Run({"camera", Path("large.raw")}).err, HasSubstr("is larger than 1048576 bytes; not a camera file"));
  EXPECT_THAT(Run({"evaluate", "--truth", Path("truth.csv"), "--estimate", Path("cube/truth.tum")}).err,
              HasSubstr("truth.csv: the true poses (--truth) are a TUM file"));
  const CliResult page = Run({"view", "--listen", "foo"});
  EXPECT_EQ(page.status, 2);
  EXPECT_THAT(page.err, HasSubstr("--listen: address \"foo\" has no port; give HOST:PORT, such as 127.0.0.1:50051"));
}

TEST_F(WrongNamesTest, AReaderThatEndsIsNoFullDisk) {
  SimulateCube(0.02);
  const CliResult result = RunShell("mkfifo pipe\nexec 3<>pipe 4>pipe 3<&-\nevpose camera cube/camera.yaml --json >&4");
  EXPECT_EQ(result.status, 1);
  EXPECT_EQ(result.err, "");
}

TEST_F(WrongNamesTest, ModelsThatDoNotExist) {
  const LocalServer server = StartLocalServer();
  for (const std::string command : {"get", "delete"}) {
    const CliResult result = Run({"models", command, "models/none", "--server", server.address});
    EXPECT_EQ(result.status, 1);
    EXPECT_THAT(result.err, EndsWith(": models/none does not exist; `evpose models list` prints the models that do\n"));
  }
}

TEST_F(WrongNamesTest, PosesAreNotReadFromMcap) {
  SimulateCube(0.02);
  ASSERT_EQ(Run(ReplayArguments("poses.mcap")).status, 0);
  const std::string mcap = Path("poses.mcap"), tum = Path("cube/truth.tum");
  const std::string advice = ": run evpose replay again with the name of such a file as --out\n";
  const std::string expected = mcap + ": poses are not read from .mcap files, but from .tum, .csv or .jsonl" + advice;
  const std::vector<std::string> scene = {"--model", Path("cube/model.obj"), "--camera", Path("cube/camera.yaml")};
  for (std::vector<std::string> arguments : std::vector<std::vector<std::string>>{
           {"evaluate", "--truth", tum, "--estimate", mcap},
           {"render", Path("cube/recording.raw"), "--poses", mcap, "--out", Path("a.png")},
           {"view", Path("cube/recording.raw"), "--poses", mcap}}) {
    arguments.insert(arguments.end(), scene.begin(), scene.end());
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, 1);
    EXPECT_THAT(result.err, HasSubstr(expected)) << arguments[0];
  }
  EXPECT_THAT(Run({"evaluate", "--truth", mcap, "--estimate", tum}).err,
              HasSubstr(mcap + ": poses are not read from .mcap files, but from .tum" + advice));
}

}  // namespace
}  // namespace evpose
