// SPDX-License-Identifier: Apache-2.0

// Tests invalid input: exit status 1, one line that names the file and the place, and no incomplete output files.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <filesystem>
#include <functional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/closed_port_testing.h"
#include "tests/integration/cli_fixture.h"
#include "tests/integration/local_server_testing.h"

namespace evpose {
namespace {

using ::testing::AllOf;
using ::testing::ContainsRegex;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

class BadInputTest : public CliTest {
 protected:
  void SetUp() override {
    CliTest::SetUp();
    SimulateCube(0.002);
  }

  // Runs a replay with one invalid argument or file, and returns the error.
  std::string ReplayError(const std::vector<std::string>& more = {}, int status = 1) {
    const CliResult result = Run(ReplayArguments("poses.tum", more));
    EXPECT_EQ(result.status, status) << result.out;
    EXPECT_EQ(result.out, "");
    EXPECT_THAT(FilesBeginning("poses"), IsEmpty());
    if (status == 1) {
      EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
    }
    return result.err;
  }

  void ReplaceInFile(const std::string& name, const std::string& from, const std::string& to) {
    std::string text = ReadText(name);
    const size_t at = text.find(from);
    ASSERT_NE(at, std::string::npos) << from;
    WriteText(name, text.replace(at, from.size(), to));
  }
};

TEST_F(BadInputTest, MissingRecording) {
  std::filesystem::remove(Path("cube/recording.raw"));
  EXPECT_THAT(ReplayError(), HasSubstr(Path("cube/recording.raw")));
  const CliResult info = Run({"info", Path("cube/recording.raw"), "--json"});
  EXPECT_EQ(info.status, 1);
  EXPECT_EQ(info.out, "");
  EXPECT_THAT(info.err, HasSubstr(Path("cube/recording.raw")));
}

TEST_F(BadInputTest, SensorProfiles) {
  EXPECT_THAT(ReplayError({"--sensor", Path("none.yaml")}), HasSubstr(Path("none.yaml")));
  WriteText("sensor.yaml", "blur_px: 99\n");
  EXPECT_THAT(ReplayError({"--sensor", Path("sensor.yaml")}),
              AllOf(HasSubstr(Path("sensor.yaml")), HasSubstr("it must lie in")));
}

TEST_F(BadInputTest, CalibrationThatTheRecordingDoesNotAllow) {
  const std::vector<std::string> known = {"--truth",  Path("cube/truth.tum"),   "--model", Path("cube/model.obj"),
                                          "--camera", Path("cube/camera.yaml"), "--out",   Path("sensor.yaml")};
  const auto calibrate = [&](std::vector<std::string> recordings) {
    recordings.insert(recordings.begin(), "calibrate");
    recordings.insert(recordings.end(), known.begin(), known.end());
    return Run(recordings);
  };
  const CliResult still = calibrate({Path("cube/recording.raw")});
  EXPECT_EQ(still.status, 1);
  EXPECT_THAT(still.err, HasSubstr("record more motion"));
  const CliResult missing = calibrate({Path("none.raw")});
  EXPECT_EQ(missing.status, 1);
  EXPECT_THAT(missing.err, HasSubstr(Path("none.raw")));
  const CliResult unequal = calibrate({Path("cube/recording.raw"), Path("cube/recording.raw")});
  EXPECT_EQ(unequal.status, 2);
  EXPECT_THAT(unequal.err, HasSubstr("--truth"));
  EXPECT_THAT(FilesBeginning("sensor"), IsEmpty());
}

TEST_F(BadInputTest, EmptyRecording) {
  WriteText("cube/recording.raw", "");
  EXPECT_THAT(ReplayError(), AllOf(HasSubstr(Path("cube/recording.raw")), HasSubstr("empty")));
  EXPECT_EQ(Run({"info", Path("cube/recording.raw")}).status, 1);
}

TEST_F(BadInputTest, HeaderOnlyRecording) {
  const std::string whole = ReadText("cube/recording.raw");
  WriteText("cube/recording.raw", whole.substr(0, whole.find("% end\n") + 6));
  EXPECT_THAT(ReplayError(), HasSubstr(Path("cube/recording.raw")));
  EXPECT_EQ(Run({"info", Path("cube/recording.raw")}).status, 1);
}

TEST_F(BadInputTest, UnknownFormat) {
  WriteText("cube/recording.raw", "% format EVT9;height=480;width=640\n% end\nabcdefgh");
  EXPECT_THAT(ReplayError(), AllOf(HasSubstr(Path("cube/recording.raw")), HasSubstr("line 1"), HasSubstr("EVT9")));
}

TEST_F(BadInputTest, DirectoryInsteadOfRecording) {
  std::filesystem::remove(Path("cube/recording.raw"));
  std::filesystem::create_directory(Path("cube/recording.raw"));
  EXPECT_THAT(ReplayError(), HasSubstr(Path("cube/recording.raw")));
}

TEST_F(BadInputTest, MissingModel) {
  std::filesystem::remove(Path("cube/model.obj"));
  EXPECT_THAT(ReplayError(), HasSubstr(Path("cube/model.obj")));
}

TEST_F(BadInputTest, ModelOfAnUnknownKind) {
  std::filesystem::rename(Path("cube/model.obj"), Path("cube/model.step"));
  std::vector<std::string> arguments = ReplayArguments("poses.tum");
  arguments[3] = Path("cube/model.step");
  const CliResult result = Run(arguments);
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr("model.step"));
}

TEST_F(BadInputTest, ModelWithNothingInIt) {
  WriteText("cube/model.obj", "v 0 0 0\nv 1 0 0\n");
  EXPECT_THAT(ReplayError(), HasSubstr(Path("cube/model.obj")));
}

TEST_F(BadInputTest, ModelWithoutALine) {
  WriteText("cube/model.obj", "v 0 0 0\nv 1 0 0\nl 1 1\nl 2 2\n");
  EXPECT_THAT(ReplayError(), AllOf(HasSubstr(Path("cube/model.obj")), HasSubstr("line")));
}

TEST_F(BadInputTest, ModelOfNoSize) {
  WriteText("cube/model.obj", "v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n");
  EXPECT_THAT(ReplayError(), AllOf(HasSubstr(Path("cube/model.obj")), HasSubstr("size is 0 m")));
}

TEST_F(BadInputTest, ModelWithNan) {
  WriteText("cube/model.obj", "v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n");
  EXPECT_THAT(ReplayError(), AllOf(HasSubstr(Path("cube/model.obj")), HasSubstr("3")));
}

TEST_F(BadInputTest, CameraWithoutAField) {
  ReplaceInFile("cube/camera.yaml", "camera_matrix", "matrix");
  EXPECT_THAT(ReplayError(), AllOf(HasSubstr(Path("cube/camera.yaml")), HasSubstr("camera_matrix")));
}

TEST_F(BadInputTest, CameraThatIsMissing) {
  std::filesystem::remove(Path("cube/camera.yaml"));
  EXPECT_THAT(ReplayError(), HasSubstr(Path("cube/camera.yaml")));
}

TEST_F(BadInputTest, CameraOfAnotherSize) {
  ReplaceInFile("cube/camera.yaml", "image_width: 640", "image_width: 600");
  const std::string error = ReplayError();
  EXPECT_THAT(error, AllOf(HasSubstr(Path("cube/camera.yaml") + " is of 600x480"),
                           HasSubstr(Path("cube/recording.raw") + " of 640x480")));
}

TEST_F(BadInputTest, CameraOfAnotherSizeThanTheSensorThatTheHeaderNames) {
  const std::string whole = ReadText("cube/recording.raw");
  WriteText("cube/recording.raw",
            "% evt 3.0\n% plugin_name hal_plugin_imx636_evk4\n% end\n" + whole.substr(whole.find("% end\n") + 6));
  EXPECT_THAT(ReplayError(), HasSubstr(Path("cube/recording.raw") + " of 1280x720"));
}

TEST_F(BadInputTest, PoseWhoseQuaternionIsNotUnit) {
  std::vector<std::string> arguments = ReplayArguments("poses.tum");
  arguments.back() = "0 0 1 0 0 0 0.9";
  const CliResult result = Run(arguments);
  EXPECT_EQ(result.status, 2);
  EXPECT_THAT(result.err, AllOf(HasSubstr("--init-pose"), HasSubstr("0 0 1 0 0 0 0.9")));
  EXPECT_THAT(FilesBeginning("poses"), IsEmpty());
}

TEST_F(BadInputTest, AnEmptyPoseIsAnError) {
  const CliResult result = Run(SearchArguments("poses.tum", {"--init-pose", ""}));
  EXPECT_EQ(result.status, 2);
  EXPECT_THAT(result.err, AllOf(HasSubstr("--init-pose"), HasSubstr("tx is missing")));
  EXPECT_THAT(FilesBeginning("poses"), IsEmpty());
}

TEST_F(BadInputTest, ObjectThatDoesNotDetermineAPose) {
  for (const auto& [model, why] : std::vector<std::pair<std::string, std::string>>{
           {"v 0 0 0\nv 1 0 0\nv 0 1 0\nl 1 2\nl 1 3\n", "at least 3"},
           {"v 0 0 0\nv 1 0 0\nv 0 1 0\nl 1 2\nl 1 3\nl 3 1\n", "at least 3"},
           {"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nv 0 2 1\nv 1 2 1\nl 1 2\nl 3 4\nl 5 6\n", "parallel"},
           {"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nl 1 2\nl 1 3\nl 1 4\n", "one point"}}) {
    WriteText("cube/model.obj", model);
    EXPECT_THAT(ReplayError(), AllOf(HasSubstr(Path("cube/model.obj")), HasSubstr(why))) << model;
    const CliResult search = Run(SearchArguments("poses.tum"));
    EXPECT_EQ(search.status, 1);
    EXPECT_THAT(search.err, AllOf(HasSubstr(Path("cube/model.obj")), HasSubstr(why))) << model;
  }
}

TEST_F(BadInputTest, TheSimulationReportsAnImplausibleSize) {
  WriteText("part.obj", "v 0 0 0\nv 120 0 0\nv 0 90 0\nv 0 0 70\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n");
  std::vector<std::string> arguments = {"simulate",   "--model", Path("part.obj"), "--camera",  "vga",
                                        "--duration", "0.01",    "--out",          Path("part")};
  const std::string hint = "largest side 120 units: taken as metres; if these are millimetres pass --scale 0.001";
  EXPECT_THAT(Run(arguments).out, HasSubstr("model: " + hint + "\n"));
  arguments.back() = Path("part_json");
  arguments.push_back("--json");
  EXPECT_THAT(Run(arguments).Json()["model_notices"].get<std::vector<std::string>>(), ::testing::ElementsAre(hint));
  arguments.insert(arguments.end(), {"--scale", "0.001"});
  arguments[8] = Path("part_in_mm");
  EXPECT_THAT(Run(arguments).Json()["model_notices"].get<std::vector<std::string>>(), ::testing::IsEmpty());
}

TEST_F(BadInputTest, UnusableLinesAreReportedAsSkipped) {
  SimulateCube(0.03);
  // Lines of length zero, repeated, reversed, and a part of an edge.
  WriteText("cube/model.obj", ReadText("cube/model.obj") + "l 1 1\n");
  std::string model = ReadText("cube/model.obj");
  const size_t line = model.find("\nl ") + 1;
  const std::string first = model.substr(line, model.find('\n', line) - line);
  const std::string a = first.substr(2, first.find(' ', 2) - 2), b = first.substr(first.find(' ', 2) + 1);
  model += "l " + b + " " + a + "\n" + first + "\nv 0.05 0.1 0.1\nv -0.02 0.1 0.1\nl -1 -2\n";
  WriteText("cube/model.obj", model);
  const auto notices = ::testing::ElementsAre("1 line of length zero dropped", "2 duplicate lines dropped",
                                              "1 line merged with overlapping ones");
  const CliResult replay = Run(ReplayArguments("poses.tum"));
  ASSERT_EQ(replay.status, 0) << replay.err;
  EXPECT_THAT(replay.Json()["model_notices"].get<std::vector<std::string>>(), notices);
  std::vector<std::string> arguments = ReplayArguments("poses.tum");
  std::erase(arguments, "--json");
  EXPECT_THAT(Run(arguments).out, HasSubstr("model: 2 duplicate lines dropped\n"));

  const LocalServer server = StartLocalServer();
  const CliResult upload = Run({"models", "upload", Path("cube/model.obj"), "--server", server.address});
  ASSERT_EQ(upload.status, 0) << upload.err;
  EXPECT_THAT(upload.out, HasSubstr("\nnotice: 1 line merged with overlapping ones\n"));
  const nlohmann::json list = Run({"models", "list", "--server", server.address, "--json"}).Json();
  ASSERT_EQ(list.size(), 1u);
  EXPECT_THAT(list[0]["notices"].get<std::vector<std::string>>(), notices);
  EXPECT_EQ(list[0]["lines"], 12);
}

TEST_F(BadInputTest, PipesAreNoFiles) {
  for (const char* name : {"pipe.obj", "pipe.glb", "pipe.yaml", "pipe.tum"}) {
    ASSERT_EQ(mkfifo(Path(name).c_str(), 0600), 0);
  }
  const auto expect_refused = [](const CliResult& result) {
    EXPECT_EQ(result.status, 1);
    EXPECT_THAT(result.err, HasSubstr("is a pipe or device, not a file"));
  };
  for (const char* name : {"pipe.obj", "pipe.glb"}) expect_refused(Run({"models", "inspect", Path(name)}));
  expect_refused(Run({"models", "inspect", Path("cube/model.obj"), "--camera", Path("pipe.yaml")}));
  expect_refused(Run({"evaluate", "--truth", Path("pipe.tum"), "--estimate", Path("cube/truth.tum")}));
}

TEST_F(BadInputTest, TrajectoryWithABadLine) {
  ReplaceInFile("cube/truth.tum", "\n", "\n1 2 3\n");
  const CliResult result = Run({"evaluate", "--truth", Path("cube/truth.tum"), "--estimate", Path("cube/truth.tum")});
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr(Path("cube/truth.tum") + ":2: "));
}

TEST_F(BadInputTest, EstimateOfAnotherRecording) {
  WriteText("other.tum", "100.0 0 0 1 0 0 0 1\n");
  const CliResult result = Run({"evaluate", "--truth", Path("cube/truth.tum"), "--estimate", Path("other.tum")});
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, AllOf(HasSubstr(Path("other.tum")), HasSubstr("lies outside the truth's time span")));
}

TEST_F(BadInputTest, OutputThatCannotBeWritten) {
  std::vector<std::string> arguments = ReplayArguments("no/such/directory/poses.tum");
  const CliResult result = Run(arguments);
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr("no/such/directory/poses.tum"));
}

TEST_F(BadInputTest, AbsentServer) {
  const ClosedPort closed;
  const std::string error = ReplayError({"--server", closed.address(), "--connect-timeout", "0.2"});
  EXPECT_THAT(error, AllOf(HasSubstr("no server at " + closed.address()), HasSubstr("for 0.2 s")));
  const CliResult stream = Run({"stream", Path("cube/recording.raw"), "--model", Path("cube/model.obj"), "--camera",
                                Path("cube/camera.yaml"), "--server", closed.address(), "--connect-timeout", "0.2"});
  EXPECT_EQ(stream.status, 1);
  EXPECT_THAT(stream.err, AllOf(HasSubstr("no server at " + closed.address()), HasSubstr("for 0.2 s")));
  for (const char* command : {"sessions", "models"}) {
    const CliResult result = Run({command, "list", "--server", closed.address(), "--connect-timeout", "0.2"});
    EXPECT_EQ(result.status, 1);
    EXPECT_THAT(result.err, HasSubstr("no server at " + closed.address()));
  }
}

TEST_F(BadInputTest, RenderReportsInvalidArguments) {
  const auto render = [&](const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {"render",  Path("cube/recording.raw"), "--poses",  Path("cube/truth.tum"),
                                          "--model", Path("cube/model.obj"),     "--camera", Path("cube/camera.yaml"),
                                          "--out"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return Run(arguments);
  };
  const CliResult late = render({Path("picture.png"), "--at", "100"});
  EXPECT_EQ(late.status, 1);
  EXPECT_THAT(late.err, AllOf(HasSubstr(Path("cube/recording.raw")), HasSubstr("no event within")));
  EXPECT_EQ(render({Path("picture.jpeg2000")}).status, 2);
  EXPECT_EQ(render({Path("picture.mp4"), "--at", "16.001"}).status, 2);
  EXPECT_THAT(render({Path("picture.png"), "--at", "nan"}).err, HasSubstr("--at: \"nan\" is not a number; "));
  EXPECT_EQ(render({Path("picture.mp4"), "--window-ms", "50"}).status, 2);
  WriteText("empty.tum", "");
  const CliResult empty =
      Run({"render", Path("cube/recording.raw"), "--poses", Path("empty.tum"), "--model", Path("cube/model.obj"),
           "--camera", Path("cube/camera.yaml"), "--out", Path("picture.png")});
  EXPECT_EQ(empty.status, 1);
  EXPECT_THAT(empty.err, HasSubstr("--at"));
  WriteText("wrong.csv", "a,b\n1,2\n");
  const CliResult wrong =
      Run({"render", Path("cube/recording.raw"), "--poses", Path("wrong.csv"), "--model", Path("cube/model.obj"),
           "--camera", Path("cube/camera.yaml"), "--out", Path("picture.png")});
  EXPECT_EQ(wrong.status, 1);
  EXPECT_THAT(wrong.err, HasSubstr(Path("wrong.csv")));
  EXPECT_EQ(render({Path("no/such/picture.png")}).status, 1);
  EXPECT_EQ(render({Path("no/such/picture.mp4")}).status, 1);
  EXPECT_THAT(FilesBeginning("picture"), IsEmpty());
}

// A limit on the size of files has the same effect as a full disk.
TEST_F(BadInputTest, AFilmOnAFullDiskIsAnErrorWithoutAFile) {
  SimulateCube(0.1);
  std::signal(SIGXFSZ, SIG_IGN);
  rlimit before;
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  for (const std::string name : {"film.mp4", "film.avi"}) {
    for (const rlim_t bytes : {1'000, 20'000}) {
      const rlimit limit = {.rlim_cur = bytes, .rlim_max = before.rlim_max};
      ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &limit), 0);
      const CliResult result = Run({"render", Path("cube/recording.raw"), "--poses", Path("cube/truth.tum"), "--model",
                                    Path("cube/model.obj"), "--camera", Path("cube/camera.yaml"), "-o", Path(name)});
      setrlimit(RLIMIT_FSIZE, &before);
      EXPECT_EQ(result.status, 1) << name << " in " << bytes << " bytes";
      EXPECT_THAT(result.err, HasSubstr(Path(name) + ": ")) << bytes;
      EXPECT_THAT(FilesBeginning("film"), IsEmpty());
    }
  }
}

TEST_F(BadInputTest, AnEmptyNameIsNoFile) {
  const CliResult result = Run({"replay", Path("cube/recording.raw"), "--model", Path("cube/model.obj"), "--camera",
                                Path("cube/camera.yaml"), "--out", ""});
  EXPECT_EQ(result.status, 2);
  EXPECT_THAT(result.err, HasSubstr("--out: the name is empty"));
  EXPECT_THAT(Run({"camera", ""}).err, HasSubstr("evpose camera: FILE: the name is empty"));
}

// The log of the clock is the second of the two files.
TEST_F(BadInputTest, AClockLogOnAFullDiskLosesNoPose) {
  SimulateCube(0.1);
  ASSERT_EQ(symlink("/dev/full", Path("full.csv").c_str()), 0);
  const CliResult result = Run(ReplayArguments("poses.tum", {"--clock-log", Path("full.csv")}));
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr("full"));
  EXPECT_NE(ReadText("poses.tum"), "");
}

TEST_F(BadInputTest, WrongUsageIsStatusTwo) {
  EXPECT_EQ(Run({}).status, 2);
  EXPECT_EQ(Run({"reply"}).status, 2);
  EXPECT_EQ(Run({"replay"}).status, 2);
  EXPECT_EQ(Run({"models"}).status, 2);
  EXPECT_EQ(Run({"watch", "sessions/1"}).status, 2);
  EXPECT_THAT(ReplayError({"--rate", "fast"}, 2), HasSubstr("--rate"));
  EXPECT_THAT(ReplayError({"--rate", "0"}, 2), HasSubstr("--rate"));
  EXPECT_THAT(ReplayError({"--estimator", "best"}, 2), HasSubstr("best"));
  EXPECT_THAT(ReplayError({"--chunk-bytes", "12"}, 2), HasSubstr("multiple of 8"));
  EXPECT_THAT(ReplayError({"--epoch", "1"}, 2), HasSubstr("--epoch: is for an --out whose name ends in .mcap"));
  EXPECT_THAT(ReplayError({"--event-images", "2"}, 2), HasSubstr("--event-images: is for an --out"));
  for (const char* name : {"poses.dat", "poses.txt"}) {
    const CliResult result = Run(ReplayArguments(name));
    EXPECT_EQ(result.status, 2);
    EXPECT_THAT(result.err, HasSubstr(": the name of a file of poses ends in .tum, .csv, .jsonl or .mcap"));
  }
  EXPECT_EQ(Run({"evaluate", "--truth", "a", "--estimate", "b", "--model", "c"}).status, 2);
  EXPECT_EQ(Run({"evaluate", "--truth", "a", "--estimate", "b", "--symmetric"}).status, 2);
  EXPECT_EQ(Run({"simulate", "--object", "teapot", "--out", Path("teapot")}).status, 2);
  EXPECT_FALSE(std::filesystem::exists(Path("teapot")));
}

TEST_F(BadInputTest, NotANumberIsWrongUsage) {
  const std::string recording = Path("cube/recording.raw");
  const std::vector<std::string> simulate = {"simulate", "--out", Path("nan")};
  for (const auto& [command, option, value] :
       {std::tuple{std::vector<std::string>{"convert", recording, Path("nan.csv")}, "--start", "nan"},
        {simulate, "--distance", "nan"},
        {simulate, "--duration", "nan"},
        {simulate, "--noise", "NaN"},
        {simulate, "--seed", "-1"},
        {simulate, "--seed", ""},
        {simulate, "--path-seed", "18446744073709551616"},
        {ReplayArguments("nan.tum"), "--pose-rate", "nan"},
        {ReplayArguments("nan.tum", {"--server", "127.0.0.1:1"}), "--connect-timeout", "nan"}}) {
    std::vector<std::string> arguments = command;
    arguments.insert(arguments.end(), {option, value});
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, 2) << option;
    EXPECT_THAT(result.err, ContainsRegex(absl::StrCat(option, ": \"", value, "\" is not a (whole )?number from ")));
  }
  EXPECT_THAT(FilesBeginning("nan"), IsEmpty());
}

TEST_F(BadInputTest, OptionsWithoutEffectAreWrongUsage) {
  const std::string recording = Path("cube/recording.raw"), truth = Path("cube/truth.tum");
  const std::string model = Path("cube/model.obj"), camera = Path("cube/camera.yaml");
  const std::vector<std::string> profile = {"calibrate", recording, "--model", model,
                                            "--camera",  camera,    "--out",   Path("unused.yaml")};
  const auto error = [&](std::vector<std::string> arguments, const std::vector<std::string>& more) {
    arguments.insert(arguments.end(), more.begin(), more.end());
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, 2) << result.err;
    return result.err;
  };
  EXPECT_THAT(error(profile, {"--lens", "fisheye"}), HasSubstr("--camera and --lens exclude each other"));
  EXPECT_THAT(error({"calibrate", recording, "--model", model, "--camera-out", Path("unused.yaml"), "--name", "x"}, {}),
              HasSubstr("--name requires --out"));
  EXPECT_THAT(error({"calibrate", recording, "--model", model, "--camera", camera}, {"--camera-out", "x"}),
              HasSubstr("--camera-out is for a calibration of the camera"));
  EXPECT_THAT(
      error({"render", recording, "--poses", truth, "--model", model, "--camera", camera, "--out", Path("unused.png")},
            {"--fps", "10"}),
      HasSubstr("--fps is for films"));
  for (const char* option : {"--scale", "--crease-angle"}) {
    EXPECT_THAT(error({"evaluate", "--truth", truth, "--estimate", truth}, {option, "2"}),
                HasSubstr(absl::StrCat(option, " requires --model")));
    EXPECT_THAT(error({"view", "--server", "127.0.0.1:1"}, {option, "2"}),
                HasSubstr(absl::StrCat(option, " and --server exclude each other")));
  }
  EXPECT_THAT(error({"simulate", "--out", ""}, {}), HasSubstr("--out: the name is empty"));
  EXPECT_THAT(FilesBeginning("unused"), IsEmpty());
}

TEST_F(BadInputTest, HelpAndVersionAreStatusZero) {
  EXPECT_EQ(Run({"--help"}).status, 0);
  EXPECT_EQ(Run({"--version"}).status, 0);
  EXPECT_THAT(Run({"replay", "--help"}).out, HasSubstr("--init-pose"));
}

}  // namespace
}  // namespace evpose
