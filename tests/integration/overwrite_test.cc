// SPDX-License-Identifier: Apache-2.0

// Tests that no command replaces a file that it reads, or a file of the user beside its output.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/closed_port_testing.h"
#include "core/base/output_file.h"
#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::StartsWith;

namespace fs = std::filesystem;

class OverwriteTest : public CliTest {
 protected:
  void SetUp() override {
    CliTest::SetUp();
    SimulateCube(0.002);
    for (const auto& entry : fs::directory_iterator(Path("cube"))) before_[entry.path()] = ReadAll(entry.path());
  }

  static std::string ReadAll(const fs::path& path) { return *ReadFile(path.string(), size_t{1} << 30); }

  // Runs a command that must not begin, because `option` names a file that `other` names, too.
  void ExpectRefused(const std::vector<std::string>& arguments, const std::string& other, const std::string& option) {
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, 2) << option << ": " << result.out << result.err;
    EXPECT_THAT(result.err,
                AllOf(HasSubstr(absl::StrCat(other, " and ", option, " are the same file, ")),
                      HasSubstr(absl::StrCat(", which would be overwritten: give ", option, " another name; "))));
    for (const auto& [path, content] : before_) EXPECT_TRUE(ReadAll(path) == content) << option << ": " << path;
  }

  std::vector<std::string> WithModelAndCamera(std::vector<std::string> arguments,
                                              const std::vector<std::string>& more) {
    arguments.insert(arguments.end(), {"--model", Path("cube/model.obj"), "--camera", Path("cube/camera.yaml")});
    arguments.insert(arguments.end(), more.begin(), more.end());
    return arguments;
  }

  std::map<fs::path, std::string> before_;  // contents by path
};

TEST_F(OverwriteTest, NoOutputIsAFileNamedMinus) {
  const std::string recording = Path("cube/recording.raw"), truth = Path("cube/truth.tum");
  for (const std::vector<std::string>& arguments :
       {WithModelAndCamera({"calibrate", recording, "--truth", truth}, {"-o", "-"}),
        WithModelAndCamera({"replay", recording}, {"--clock-log", "-"}),
        WithModelAndCamera({"replay", recording}, {"--out", "-"}),
        {"target", "--out", "-"},
        {"camera", Path("cube/camera.yaml"), "--picture", "-"}}) {
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, 2) << arguments.front() << ": " << result.err;
    EXPECT_THAT(result.err, HasSubstr("give the name of a file")) << arguments.front();
    EXPECT_FALSE(fs::exists("-")) << arguments.front();
  }
}

TEST_F(OverwriteTest, InputsAreNoOutputs) {
  const std::string recording = Path("cube/recording.raw"), truth = Path("cube/truth.tum");
  const std::string model = Path("cube/model.obj"), camera = Path("cube/camera.yaml");
  for (const auto& [name, path] : std::vector<std::pair<std::string, std::string>>{
           {"RECORDINGS", recording}, {"--model", model}, {"--camera", camera}, {"--truth", truth}}) {
    ExpectRefused(WithModelAndCamera({"calibrate", recording}, {"--truth", truth, "--out", path}), name, "--out");
  }
  ExpectRefused({"calibrate", recording, "--model", model, "--camera-out", model}, "--model", "--camera-out");
  ExpectRefused({"calibrate", truth, "--hand-eye", truth, "--out", truth}, "RECORDINGS", "--out");
  for (const auto& [name, path] : {std::pair("RECORDING", recording), {"--model", model}, {"--camera", camera}}) {
    ExpectRefused(WithModelAndCamera({"doctor", recording}, {"--bundle", path}), name, "--bundle");
    ExpectRefused(WithModelAndCamera({"replay", recording}, {"--out", path}), name, "--out");
    ExpectRefused(WithModelAndCamera({"replay", recording}, {"--clock-log", path}), name, "--clock-log");
    ExpectRefused(WithModelAndCamera({"render", recording, "--poses", truth}, {"--out", path}), name, "--out");
  }
  ExpectRefused(WithModelAndCamera({"replay", recording}, {"--sensor", truth, "--out", truth}), "--sensor", "--out");
  ExpectRefused(WithModelAndCamera({"replay", recording}, {"--world-from-camera", truth, "--out", truth}),
                "--world-from-camera", "--out");
  ExpectRefused(
      {"replay", recording, "--camera", camera, "--object", "a=" + model, "--object", "b=" + truth, "--out", model},
      "--object", "--out");
  ExpectRefused({"convert", recording, Path("cube/../cube/recording.raw")}, "RECORDING", "OUT");
  ExpectRefused({"camera", camera, "--out", camera}, "FILE", "--out");
  ExpectRefused({"camera", camera + "#cam1", "--out", camera}, "FILE", "--out");
  ExpectRefused({"simulate", "--model", model, "--duration", "0.01", "--out", Path("cube")}, "--model", "--out");
  ExpectRefused({"simulate", "--camera", camera, "--duration", "0.01", "--out", Path("cube")}, "--camera", "--out");
}

TEST_F(OverwriteTest, FilesOfADirectoryOfInputsAreNoOutputs) {
  const std::string models = Path("cube"), list = Path("cube/models.json");
  WriteText("cube/models.json", "[]");
  WriteText("cube/result.json", "{}");
  for (const std::string& name : {Path("cube/../cube/model.obj"), list}) {
    const CliResult result = Run({"bench", "models", "--models", models, "--duration", "0.01", "--out", name});
    EXPECT_EQ(result.status, 2);
    EXPECT_THAT(result.err, HasSubstr(absl::StrCat("evpose bench models: ", name, " is a file of --models ", models,
                                                   ", which would be overwritten: give --out another name; ")));
  }
  EXPECT_EQ(Run({"bench", "real", Path("."), "--out", Path("cube/truth.tum")}).status, 2);
  for (const auto& [path, content] : before_) EXPECT_TRUE(ReadAll(path) == content) << path;
  const CliResult earlier = Run({"bench", "models", "--models", models, "--out", Path("cube/result.json")});
  EXPECT_THAT(earlier.err, ::testing::Not(HasSubstr("overwritten")));
}

TEST_F(OverwriteTest, LinksAreTheSameFile) {
  fs::create_symlink(Path("cube/camera.yaml"), Path("symbolic.tum"));
  fs::create_hard_link(Path("cube/model.obj"), Path("hard.tum"));
  fs::create_directory_symlink(Path("cube"), Path("directory"));
  const std::vector<std::string> replay = WithModelAndCamera({"replay", Path("cube/recording.raw")}, {"--out"});
  for (const auto& [name, path] : {std::pair("--camera", "symbolic.tum"), {"--model", "hard.tum"}}) {
    std::vector<std::string> arguments = replay;
    arguments.push_back(Path(path));
    ExpectRefused(arguments, name, "--out");
  }
  ExpectRefused({"replay", Path("directory/recording.raw"), "--object", "truth=" + Path("cube/model.obj"), "--camera",
                 Path("cube/camera.yaml"), "--sensor", Path("cube/truth.tum"), "--out", Path("directory/{object}.tum")},
                "--sensor", "--out");
}

TEST_F(OverwriteTest, OutputsAreDifferentFiles) {
  const auto replay = [&](const std::string& clock_log) {
    return WithModelAndCamera({"replay", Path("cube/recording.raw")},
                              {"--out", Path("a.csv"), "--clock-log", Path(clock_log)});
  };
  ExpectRefused(replay("a.csv"), "--out", "--clock-log");
  ExpectRefused(replay("cube/../a.csv"), "--out", "--clock-log");
  ExpectRefused({"calibrate", Path("cube/recording.raw"), "--model", Path("cube/model.obj"), "-o", Path("a.yaml"),
                 "--camera-out", Path("a.yaml")},
                "--camera-out", "--out");
  EXPECT_THAT(FilesBeginning("a"), IsEmpty());
}

TEST_F(OverwriteTest, ASimulationReplacesOnlyASimulation) {
  const std::vector<std::string> arguments = {"simulate", "--duration", "0.01", "--out", Path("cube")};
  EXPECT_THAT(ReadText("cube/simulation.txt"), HasSubstr("duration_us 2000\n"));
  EXPECT_EQ(Run(arguments).status, 0);
  EXPECT_THAT(ReadText("cube/simulation.txt"), HasSubstr("duration_us 10000\n"));
  for (const char* name : {"recording.raw", "truth.tum", "model.obj", "camera.yaml"}) {
    fs::create_directory(Path("user"));
    WriteText(absl::StrCat("user/", name), "of the user");
    const CliResult result = Run({"simulate", "--duration", "0.01", "--out", Path("user")});
    EXPECT_EQ(result.status, 1);
    EXPECT_THAT(result.err, AllOf(HasSubstr(Path("user/") + name + " exists"), HasSubstr("another directory")));
    EXPECT_EQ(ReadText(absl::StrCat("user/", name)), "of the user");
    EXPECT_EQ(fs::remove_all(Path("user")), 2u);
  }
}

TEST_F(OverwriteTest, ATargetReplacesOnlyTheModelOfATarget) {
  WriteText("part.obj", "v 0 0 0\n");
  for (const std::vector<std::string>& how :
       {std::vector<std::string>{"target", "-o", Path("part.pdf")},
        {"target", "-o", Path("part.png"), "--screen", "640x480", "--screen-mm", "300"}}) {
    const CliResult result = Run(how);
    EXPECT_EQ(result.status, 1);
    EXPECT_THAT(result.err, HasSubstr(Path("part.obj") + " exists and is not the model of a target: "));
    EXPECT_EQ(FilesBeginning("part").size(), 1u);
  }
  EXPECT_EQ(ReadText("part.obj"), "v 0 0 0\n");
  EXPECT_EQ(Run({"target", "-o", Path("sheet.pdf")}).status, 0);
  EXPECT_EQ(Run({"target", "-o", Path("sheet.pdf"), "--page", "A3"}).status, 0);
  EXPECT_THAT(ReadText("sheet.obj"), StartsWith("# evpose target 420 x 297 mm"));
  EXPECT_THAT(Run({"target", "-o", Path("sheet.png")}).err,
              HasSubstr("the name must end in .pdf; for .png give --screen and --screen-mm"));
}

TEST_F(OverwriteTest, AFileOfTheUserIsNoFileOfResume) {
  const ClosedPort closed;
  const CliResult result =
      Run(WithModelAndCamera({"replay", Path("cube/recording.raw")}, {"--server", closed.address(), "--connect-timeout",
                                                                      "0.2", "--resume", Path("cube/truth.tum")}));
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr("cube/truth.tum: is not a file of --resume: give --resume the name of another"));
  EXPECT_FALSE(fs::exists(Path("cube/truth.tum.lock")));
}

}  // namespace
}  // namespace evpose
