// SPDX-License-Identifier: Apache-2.0

// Tests the program: its results, signals, and rendered images.
#include "client/cli/cli.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <csignal>
#include <filesystem>
#include <future>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <sstream>
#include <string>

#include "absl/strings/str_cat.h"
#include "core/base/closed_port_testing.h"
#include "core/base/poll_testing.h"
#include "tests/integration/cli_fixture.h"
#include "tests/integration/local_server_testing.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

TEST_F(CliTest, StandardOutputHasOnlyTheResult) {
  SimulateCube(0.02);
  const CliResult result = RunShell(
      "evpose replay cube/recording.raw --model cube/model.obj --camera cube/camera.yaml "
      "--json --init-pose '" +
      FirstPose() + "'");
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_GT(result.Json()["poses"], 0);
  EXPECT_EQ(result.err, "");
}

TEST_F(CliTest, ProgramFailsWithOneLine) {
  const CliResult result = RunShell("evpose info missing.raw");
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr("evpose info: "));
  EXPECT_THAT(result.err, HasSubstr("missing.raw"));
}

TEST_F(CliTest, InterruptEndsAFollowedRecordingCleanly) {
  SimulateCube(0.02);
  // The signal may arrive before the first event is sent or after the last one, and must always be handled. A run
  // without a pose fails.
  const CliResult result = RunShell(
      "evpose replay cube/recording.raw --follow --model cube/model.obj --camera cube/camera.yaml --out poses.tum "
      "--json --init-pose '" +
      FirstPose() +
      "' & pid=$!\n"
      "await 'ls | grep -q poses.tum.partial'\n"
      "kill -TERM $pid\n"
      "wait $pid");
  const nlohmann::json report = result.Json();
  EXPECT_EQ(result.status, report["poses"] > 0 ? 0 : 1) << result.err;
  EXPECT_EQ(report["interrupted"], true);
  EXPECT_TRUE(std::filesystem::exists(Path("poses.tum")));
}

// Interrupts a command as soon as it states for what it waits.
class InterruptingBuffer : public std::stringbuf {
 public:
  std::atomic<bool> is_interrupted = false;

 protected:
  int sync() override {
    is_interrupted = true;
    return 0;
  }
};

TEST_F(CliTest, AWaitForAServerIsStated) {
  InterruptingBuffer buffer;
  std::ostream err(&buffer);
  std::ostringstream out;
  client::CliContext context{out, err};
  context.is_interrupted = [&] { return buffer.is_interrupted.load(); };
  const ClosedPort closed;
  EXPECT_EQ(client::RunCli({"sessions", "list", "--server", closed.address(), "--connect-timeout", "86400"}, context),
            1);
  EXPECT_THAT(buffer.str(),
              ::testing::StartsWith("waiting for a server at " + closed.address() + " ...\nevpose sessions list: "));
}

TEST_F(CliTest, AWaitForARecordingIsStated) {
  const std::string pipe = Path("camera.raw");
  ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  const int writer = open(pipe.c_str(), O_RDWR | O_CLOEXEC);
  ASSERT_GE(writer, 0);
  for (const std::vector<std::string>& command :
       {std::vector<std::string>{"doctor", pipe}, {"info", pipe}, {"convert", pipe, Path("events.raw")}}) {
    InterruptingBuffer buffer;
    std::ostream err(&buffer);
    std::ostringstream out;
    client::CliContext context{out, err};
    context.is_interrupted = [&] { return buffer.is_interrupted.load(); };
    EXPECT_EQ(client::RunCli(command, context), 1);
    EXPECT_THAT(buffer.str(), ::testing::StartsWith("waiting for a recording in the pipe " + pipe + " ...\n"))
        << command[0];
  }
  close(writer);
}

TEST_F(CliTest, MalformedValuesAreWrongUsage) {
  SimulateCube(0.02);
  const std::vector<std::string> replay = {"replay",   Path("cube/recording.raw"), "--model", Path("cube/model.obj"),
                                           "--camera", Path("cube/camera.yaml")};
  const std::vector<std::pair<std::vector<std::string>, std::string>> cases = {
      {{"--init-pose", "1 2 3"}, "--init-pose: "},
      {{"--server", "localhost"}, "--server: \"localhost\" is not a server address; HOST:PORT"},
      {{"--server", "localhost:1,other"}, "--server: \"other\" is not a server address"},
      {{"--scale", "0"}, "--scale: 0 is not a number above 0"},
      {{"--scale", "nan"}, "--scale: nan is not a number above 0"},
      {{"--server", "localhost:1", "--max-outage", "-1"}, "--max-outage: -1 is neither 0 nor a positive number"},
  };
  for (const auto& [more, expected] : cases) {
    std::vector<std::string> arguments = replay;
    arguments.insert(arguments.end(), more.begin(), more.end());
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, 2) << expected;
    EXPECT_THAT(result.err, HasSubstr(expected));
    EXPECT_LT(result.err.size(), 250u) << result.err;
  }
  EXPECT_EQ(Run({"sessions", "list", "--server", "localhost"}).status, 2);
  // According to the help.
  const CliResult for_ever = Run({"stream", "-", "--server", "localhost:1", "--max-outage", "inf", "--camera", "none",
                                  "--model", Path("cube/model.obj")});
  EXPECT_EQ(for_ever.status, 1) << for_ever.err;
}

TEST_F(CliTest, ErrorsOfAModelNameItsFile) {
  SimulateCube(0.02);
  WriteText("prose.obj", "no line of this is one of a model\n");
  WriteText("empty.obj", "");
  const auto replay = [this](const std::string& model) {
    return Run({"replay", Path("cube/recording.raw"), "--model", Path(model), "--camera", Path("cube/camera.yaml")});
  };
  const CliResult prose = replay("prose.obj");
  EXPECT_EQ(prose.status, 1);
  EXPECT_THAT(prose.err, HasSubstr(Path("prose.obj") + ": the model file has no line and no face: export"));
  const CliResult empty = replay("empty.obj");
  EXPECT_EQ(empty.status, 1);
  EXPECT_THAT(empty.err, HasSubstr(Path("empty.obj") + ": the model file is empty\n"));
}

TEST_F(CliTest, AResultThatCannotBeWrittenIsAnError) {
  SimulateCube(0.02);
  const LocalServer server = StartLocalServer();
  const std::string address = " --server 127.0.0.1:" + std::to_string(server.server->port());
  const std::string replay =
      "evpose replay cube/recording.raw --model cube/model.obj --camera cube/camera.yaml --json --init-pose '" +
      FirstPose() + "'";
  ASSERT_EQ(RunShell(replay + address + " --keep-session").status, 0);
  const std::string session = "\"$(evpose sessions list" + address + " | head -n 1 | cut -d ' ' -f 1)\"";
  for (const std::string& command :
       {std::string("evpose info cube/recording.raw"), std::string("evpose --help"), std::string("evpose --version"),
        std::string("evpose evaluate --truth cube/truth.tum --estimate cube/truth.tum"), replay,
        "evpose sessions list" + address, "evpose models list --json" + address,
        absl::StrCat("evpose watch ", session, address)}) {
    ASSERT_EQ(RunShell(command).status, 0) << command;
    const CliResult result = RunShell(command + " > /dev/full");
    EXPECT_EQ(result.status, 1) << command;
    EXPECT_THAT(result.err, HasSubstr("standard output: the disk is full")) << command;
  }
}

TEST_F(CliTest, WatchSaysThatItWaitsForPosesOfAStalledSession) {
  SimulateCube(0.02);
  const LocalServer server = StartLocalServer();
  WriteText("pose", FirstPose());
  const CliResult result = RunShell(absl::StrCat(
      "server='--server 127.0.0.1:", server.server->port(),
      "'\nmkfifo events\nexec 3<>events\n"
      "evpose stream - --model cube/model.obj --camera cube/camera.yaml --init-pose \"$(cat pose)\" $server <&3 "
      ">/dev/null 2>&1 &\nstream=$!\npid=$stream\ncat cube/recording.raw >&3\n"
      "await 'session=$(evpose sessions list $server | head -n 1 | cut -d \" \" -f 1); test \"$session\"'\n"
      "evpose watch $session $server >poses.tum 2>messages &\nwatch=$!\n"
      // On a slow machine, the command may wait for the first pose, too.
      "await 'grep -q \"^[0-9]\" poses.tum'\n"
      "await 'grep -q \"waiting for poses\" messages'\n"
      "grep -m 1 'waiting for poses' messages | sed s,$session,SESSION,\n"
      "kill -TERM $watch $stream\nwait $watch && wait $stream\n"));
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(result.out, "waiting for poses of SESSION ...\n");
  EXPECT_GT(ReadText("poses.tum").size(), 100u);
}

TEST_F(CliTest, TheReportNamesTheFilesOfPoses) {
  SimulateCube(0.02);
  const auto replay = [this](const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {
        "replay",   Path("cube/recording.raw"),       "--camera", Path("cube/camera.yaml"),
        "--object", "left=" + Path("cube/model.obj"), "--object", "right=" + Path("cube/model.obj"),
        "--out",    Path("poses-{object}.tum")};
    arguments.insert(arguments.end(), more.begin(), more.end());
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, 1) << "only one of them is in view: " << result.err;
    return result;
  };
  EXPECT_THAT(replay({}).out,
              ::testing::AllOf(HasSubstr(Path("poses-left.tum") + ": "), HasSubstr(Path("poses-right.tum") + ": ")));
  EXPECT_EQ(replay({"--json"}).Json()["files"], nlohmann::json({Path("poses-left.tum"), Path("poses-right.tum")}));
}

// Shell code that waits until process $pid is evpose and handles SIGINT. Before, the process is a shell, which also
// catches SIGINT.
constexpr char kUntilItCatchesInterrupts[] =
    "await 'grep -qx evpose /proc/$pid/comm && grep -q \"^SigCgt:.*[2367abef]\\$\" /proc/$pid/status'\n";

TEST_F(CliTest, AnInterruptEndsTheWaitForAServer) {
  SimulateCube(0.02);
  const ClosedPort closed;
  for (const std::string& command :
       {std::string("replay cube/recording.raw --model cube/model.obj --camera cube/camera.yaml"),
        std::string("stream cube/recording.raw --model cube/model.obj --camera cube/camera.yaml"),
        std::string("watch sessions/a")}) {
    // The timeout is longer than the test, so that only the interrupt can end the wait.
    const CliResult result =
        RunShell("evpose " + command + " --server " + closed.address() + " --connect-timeout 86400 & pid=$!\n" +
                 kUntilItCatchesInterrupts + "kill -INT $pid\nwait $pid");
    EXPECT_EQ(result.status, 1) << command;
    EXPECT_THAT(result.err, HasSubstr("interrupted before a server")) << command;
  }
}

TEST_F(CliTest, AnInterruptEndsTheWaitForTheFirstByte) {
  SimulateCube(0.02);
  for (const std::string command : {"replay", "stream --server 127.0.0.1:1"}) {
    const CliResult result =
        RunShell("mkfifo pipe; exec 3<>pipe; rm pipe\nevpose " + command +
                 " - --model cube/model.obj --camera cube/camera.yaml <&3 & pid=$!\n" + kUntilItCatchesInterrupts +
                 "await 'grep -q State:.S /proc/$pid/status'\n"
                 "kill -INT $pid\nwait $pid");
    EXPECT_EQ(result.status, 1) << command;
    EXPECT_THAT(result.err, HasSubstr("standard input: stopped before the end of its header")) << command;
  }
}

TEST_F(CliTest, AnInterruptLeavesNoIncompleteVideo) {
  SimulateCube(0.1);
  const CliResult result = RunShell(
      "mkfifo pipe; exec 3<>pipe; rm pipe\n"
      "evpose render - --poses cube/truth.tum --model cube/model.obj --camera cube/camera.yaml -o film.avi <&3 & "
      "pid=$!\n"
      "cat cube/recording.raw >&3\n"
      "await 'ls | grep -q partial'\n"
      "kill -INT $pid\nwait $pid");
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr("evpose render: interrupted: nothing was written"));
  EXPECT_THAT(FilesBeginning("film"), IsEmpty());
}

TEST_F(CliTest, AnInterruptedCommandLeavesNoTemporaryFile) {
  SimulateCube(0.02);
  const auto interrupted = [this](const std::string& command) {
    return RunShell("mkfifo pipe; exec 3<>pipe; rm pipe\nevpose " + command +
                    " <&3 & pid=$!\ncat cube/recording.raw >&3\n"
                    "await 'ls | grep -q partial'\n"
                    "kill -INT $pid\nwait $pid");
  };
  const CliResult convert = interrupted("convert - out.csv");
  EXPECT_EQ(convert.status, 1);
  EXPECT_THAT(convert.err, HasSubstr("evpose convert: interrupted: nothing was written"));
  const CliResult calibrate =
      interrupted("calibrate - --model cube/model.obj --camera cube/camera.yaml --truth cube/truth.tum -o out.yaml");
  EXPECT_EQ(calibrate.status, 128 + SIGINT) << calibrate.err;
  EXPECT_THAT(FilesBeginning("out"), IsEmpty());
}

TEST_F(CliTest, AnInterruptLeavesNoIncompleteRecording) {
  const CliResult result = RunShell(
      "evpose simulate --object cube --camera vga --duration 600 --out long & pid=$!\n"
      "await 'ls long/.simulation-in-progress 2>ignored | grep -q partial'\n"
      "kill -INT $pid\nwait $pid");
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr("evpose simulate: interrupted"));
  EXPECT_THAT(FilesBeginning("long"), IsEmpty());
}

// Shell code that runs `evpose ...` as process 1 of a process namespace. Its process id outside is $pid; `wait
// $outside` returns its exit status.
std::string AsProcess1(const std::string& evpose) {
  return "unshare --pid --fork --kill-child " + evpose +
         " & outside=$!\npid=$outside\n"
         "await 'read child </proc/$outside/task/$outside/children || test \"$child\"'\npid=$child\n";
}

// For process 1 the default action of signals is disabled.
TEST_F(CliTest, Process1EndsAtASignal) {
  if (RunShell("unshare --pid --fork true").status != 0) GTEST_SKIP() << "this kernel or user makes no process 1";
  const CliResult command = RunShell("mkfifo pipe; exec 3<>pipe; rm pipe\n" + AsProcess1("evpose info - <&3") +
                                     kUntilItCatchesInterrupts + "kill -TERM $pid\nwait $outside");
  EXPECT_EQ(command.status, 128 + SIGTERM) << command.err;
  EXPECT_EQ(command.err, "");

  // One signal requests a clean end. Both signals are pending when the process continues, and it handles the first one
  // last.
  const CliResult twice = RunShell(AsProcess1("evpose simulate --object cube --camera vga --duration 600 --out long") +
                                   "await 'ls long/.simulation-in-progress 2>ignored | grep -q partial'\n"
                                   "kill -STOP $pid; kill -INT $pid; kill -TERM $pid; kill -CONT $pid\nwait $outside");
  EXPECT_EQ(twice.status, 128 + SIGINT) << twice.err;
}

TEST_F(CliTest, AnInterruptEndsAnOutage) {
  SimulateCube(0.02);
  for (const bool resumes : {false, true}) {
    const LocalServer server = StartLocalServer();
    std::vector<std::string> arguments =
        ReplayArguments("poses.tum", {"--follow", "--server", server.address, "--max-outage", "inf"});
    if (resumes) arguments.insert(arguments.end(), {"--resume", Path("state")});
    std::atomic<bool> is_interrupted = false;
    std::ostringstream out, err;
    client::CliContext context{out, err};
    context.is_interrupted = [&] { return is_interrupted.load(); };
    auto status = std::async(std::launch::async, [&] { return client::RunCli(arguments, context); });
    // The program follows a file that does not grow, so that only the signal ends it.
    const auto has_ended = [&] { return status.wait_for(std::chrono::seconds(0)) == std::future_status::ready; };
    EXPECT_TRUE(Poll([&] {
      const nlohmann::json list = Run({"sessions", "list", "--server", server.address, "--json"}).Json();
      return (!list.empty() && list[0]["poses"] > 0) || has_ended();
    }));
    ASSERT_FALSE(has_ended()) << err.str();
    server.server->Shutdown(absl::ZeroDuration());
    is_interrupted = true;
    EXPECT_EQ(status.get(), 1);
    EXPECT_THAT(err.str(), HasSubstr("interrupted while no server responded: "));
    EXPECT_THAT(err.str(), HasSubstr(resumes ? "; the same command continues from there\n"
                                             : "; with --resume FILE, the run could be continued\n"));
    EXPECT_EQ(FilesBeginning("poses.tum.partial").size(), resumes ? 1u : 0u) << "a resumed run needs the existing file";
  }
}

// Counts the pixels with a colour near (b, g, r).
int CountColour(const cv::Mat& image, int b, int g, int r) {
  int count = 0;
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      const cv::Vec3b& pixel = image.at<cv::Vec3b>(y, x);
      if (std::abs(pixel[0] - b) + std::abs(pixel[1] - g) + std::abs(pixel[2] - r) < 90) ++count;
    }
  }
  return count;
}

TEST_F(CliTest, PictureShowsEventsAndModel) {
  SimulateCube(0.05);
  const CliResult result = Run({"render", Path("cube/recording.raw"), "--poses", Path("cube/truth.tum"), "--model",
                                Path("cube/model.obj"), "--camera", Path("cube/camera.yaml"), "-o", Path("a.png")});
  ASSERT_EQ(result.status, 0) << result.err;
  const cv::Mat image = cv::imread(Path("a.png"));
  ASSERT_EQ(image.cols, 640);
  ASSERT_EQ(image.rows, 480);
  EXPECT_GT(CountColour(image, 255, 190, 90), 300);   // ON
  EXPECT_GT(CountColour(image, 80, 90, 235), 300);    // OFF
  EXPECT_GT(CountColour(image, 110, 240, 110), 300);  // the model
}

TEST_F(CliTest, PictureIsTheSameForEveryFormatOfPoses) {
  SimulateCube(0.1);
  std::vector<cv::Mat> pictures;
  for (const char* const name : {"poses.tum", "poses.csv", "poses.jsonl"}) {
    ASSERT_EQ(Run({"replay", Path("cube/recording.raw"), "--model", Path("cube/model.obj"), "--camera",
                   Path("cube/camera.yaml"), "--out", Path(name)})
                  .status,
              0);
    const CliResult result = Run({"render", Path("cube/recording.raw"), "--poses", Path(name), "--model",
                                  Path("cube/model.obj"), "--camera", Path("cube/camera.yaml"), "-o", Path("a.png")});
    ASSERT_EQ(result.status, 0) << result.err;
    pictures.push_back(cv::imread(Path("a.png")));
    EXPECT_GT(CountColour(pictures.back(), 110, 240, 110), 300) << name;
    EXPECT_EQ(cv::norm(pictures.front(), pictures.back()), 0.0) << name;
  }
}

TEST_F(CliTest, PictureShowsCurvesAndContours) {
  SimulateCylinder("can", 48, "smooth", 0.02);
  const auto count = [&](const std::string& poses, const std::string& picture) {
    const CliResult result =
        Run({"render", Path("can/recording.raw"), "--poses", Path(poses), "--model", Path("can.obj"), "--camera",
             Path("can/camera.yaml"), "--at", "16.01", "-o", Path(picture)});
    EXPECT_EQ(result.status, 0) << result.err;
    return CountColour(cv::imread(Path(picture)), 110, 240, 110);
  };
  WriteText("none.tum", "");
  EXPECT_EQ(count("none.tum", "none.png"), 0);
  // The cylinder is 120 px long and 80 px wide, and has no straight edge: its outline is that of two contours and two
  // rims.
  EXPECT_GT(count("can/truth.tum", "can.png"), 200);
}

TEST_F(CliTest, PicturesOfOtherFormatsAreRefused) {
  SimulateCube(0.002);
  const CliResult result = Run({"models", "inspect", Path("cube/model.obj"), "--picture", Path("cube.jpg")});
  EXPECT_EQ(result.status, 2);
  EXPECT_THAT(result.err, HasSubstr("cube.jpg: pictures are written as PNG; the name must end in .png"));
  EXPECT_FALSE(std::filesystem::exists(Path("cube.jpg")));
}

TEST_F(CliTest, FilmLastsAsLongAsTheRecording) {
  SimulateCube(0.1);
  for (const char* name : {"film.mp4", "film.avi"}) {
    const CliResult result = Run({"render", Path("cube/recording.raw"), "--poses", Path("cube/truth.tum"), "--model",
                                  Path("cube/model.obj"), "--camera", Path("cube/camera.yaml"), "-o", Path(name)});
    ASSERT_EQ(result.status, 0) << result.err;
    cv::VideoCapture film(Path(name));
    int frames = 0;
    for (cv::Mat frame; film.read(frame); ++frames) EXPECT_EQ(frame.cols, 640);
    EXPECT_EQ(frames, 3);  // 100 ms at 30 frames/s
  }
}

TEST_F(CliTest, EvaluateTableHasARowForEachEstimate) {
  SimulateCube(0.02);
  WriteText("none.tum", "");
  const CliResult result = Run({"evaluate", "--truth", Path("cube/truth.tum"), "--estimate",
                                "itself=" + Path("cube/truth.tum"), "--estimate", "lost at once=" + Path("none.tum")});
  EXPECT_EQ(result.status, 1);
  EXPECT_EQ(result.err, "evpose evaluate: lost at once: has no pose to compare\n");
  EXPECT_THAT(result.out, HasSubstr("\nitself "));
  EXPECT_THAT(result.out, HasSubstr("\nlost at once "));
  const nlohmann::json rows = Run({"evaluate", "--truth", Path("cube/truth.tum"), "--estimate", Path("cube/truth.tum"),
                                   "--estimate", Path("none.tum"), "--json"})
                                  .Json()["estimates"];
  EXPECT_EQ(rows[0]["position_rmse_m"], 0.0);
  EXPECT_EQ(rows[0]["coverage_ratio"], 1.0);
  EXPECT_TRUE(rows[0]["surface_distance_mean_m"].is_null()) << "without a model";
  EXPECT_EQ(rows[1]["poses"], 0);
  EXPECT_TRUE(rows[1]["position_rmse_m"].is_null());
}

TEST_F(CliTest, EvaluateReportsAnEstimateThatIsFarFromTheTruth) {
  SimulateCube(0.02);
  WriteText("behind.tum", "16.001 0 0 -1.5 0 0 0 1\n16.002 0 0 -1.5 0 0 0 1\n");
  WriteText("unit.tum", "16.001 0 0 1500 0 0 0 1\n16.002 0 0 1500 0 0 0 1\n");
  const auto warning = [this](const std::string& estimate) {
    return Run({"evaluate", "--truth", Path("cube/truth.tum"), "--estimate", estimate}).err;
  };
  EXPECT_EQ(Run({"evaluate", "--truth", Path("cube/truth.tum"), "--estimate", Path("unit.tum")}).status, 0);
  EXPECT_EQ(warning(Path("cube/truth.tum")), "");
  EXPECT_THAT(warning("far=" + Path("behind.tum")), HasSubstr("evpose evaluate: far: the RMSE of its positions is "));
  EXPECT_THAT(warning(Path("unit.tum")),
              HasSubstr(" as far from the camera as that of the truth; are both in metres?"));
}

TEST_F(CliTest, SessionsThatDoNotExist) {
  const LocalServer server = StartLocalServer();
  const std::string missing = "sessions/a does not exist; `evpose sessions list` prints the sessions that do\n";
  for (const std::vector<std::string>& command :
       std::vector<std::vector<std::string>>{{"watch"}, {"watch", "--health"}, {"sessions", "get"}}) {
    std::vector<std::string> arguments = command;
    arguments.insert(arguments.end(), {"sessions/a", "--server", server.address});
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, 1);
    EXPECT_THAT(result.err, ::testing::EndsWith(": " + missing));
    arguments[command.size()] = std::string("nonsense");
    const CliResult malformed = Run(arguments);
    EXPECT_EQ(malformed.status, 2);
    EXPECT_THAT(malformed.err, HasSubstr("the name of a session has the form sessions/ID"));
  }
  const CliResult deleted = Run({"sessions", "delete", "sessions/a", "--server", server.address});
  EXPECT_EQ(deleted.status, 0);
  EXPECT_EQ(deleted.err, "evpose sessions delete: " + missing);
  EXPECT_EQ(Run({"sessions", "delete", "sessions/", "--server", server.address}).status, 2);

  std::ostringstream out, err;
  client::CliContext terminal{out, err};
  terminal.is_err_terminal = true;
  EXPECT_EQ(client::RunCli({"sessions", "list", "--server", server.address}, terminal), 0);
  EXPECT_EQ(out.str(), "");
  EXPECT_EQ(err.str(), "no sessions\n");
  EXPECT_EQ(Run({"sessions", "list", "--server", server.address}).err, "") << "a script";
}

TEST_F(CliTest, MissingFilesHaveOneMessage) {
  SimulateCube(0.002);
  for (const size_t index : {1, 3, 5}) {  // the recording, the model and the camera
    std::vector<std::string> arguments = ReplayArguments("poses.tum");
    arguments[index] = Path("none.obj");
    EXPECT_EQ(Run(arguments).err, "evpose replay: " + Path("none.obj: cannot be read: No such file or directory\n"));
  }
  EXPECT_EQ(Run(ReplayArguments("poses.tum", {"--sensor", Path("none.yaml")})).err,
            "evpose replay: " + Path("none.yaml: cannot be read: No such file or directory\n"));
  EXPECT_EQ(Run({"evaluate", "--truth", Path("cube/truth.tum"), "--estimate", Path("cube/truth.tum"), "--model",
                 Path("none.obj"), "--camera", Path("cube/camera.yaml")})
                .err,
            "evpose evaluate: " + Path("none.obj: cannot be read: No such file or directory\n"));
}

}  // namespace
}  // namespace evpose
