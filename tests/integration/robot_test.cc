// SPDX-License-Identifier: Apache-2.0

// Poses in the frame and on the clock of a robot, from end to end.
#include <gmock/gmock.h>

#include <cmath>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "core/geometry/trajectory.h"
#include "core/geometry/transform_file.h"
#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::StartsWith;

class RobotTest : public CliTest {
 protected:
  static constexpr double kOffsetS = 1234.5;

  RigidTransform BaseFromTool(double t_s) const {
    const auto wave = [t_s](double hz, double phase) { return std::sin(2.0 * M_PI * hz * t_s + phase); };
    return {ExpSo3({0.4 * wave(0.31, 0.0) + 0.2 * wave(0.77, 1.0), 0.4 * wave(0.23, 2.0), 0.4 * wave(0.41, 4.0)}),
            {0.4 + 0.1 * wave(0.37, 1.0), 0.1 * wave(0.29, 2.0), 0.3 + 0.1 * wave(0.53, 3.0)}};
  }
  // poses.tum of evpose and robot.tum, on its own clock. With `is_flat` the robot turns about one axis only.
  void WriteCell(bool is_flat = false) const {
    Trajectory poses, robot;
    for (int i = 0; i < 3000; ++i) {
      const int64_t t_us = int64_t{5000} * i;
      const auto base_from_tool = [this, is_flat](double t_s) {
        RigidTransform tool = BaseFromTool(t_s);
        if (is_flat) tool.rotation = ExpSo3({0.0, 0.0, LogSo3(tool.rotation).z()});
        return tool;
      };
      const RigidTransform tool = base_from_tool(1e-6 * static_cast<double>(t_us));
      robot.push_back({t_us + std::llround(kOffsetS * 1e6), tool});
      if (i >= 200 && i < 2800)
        poses.push_back({t_us + 1700, camera_from_base_ * base_from_tool(t_us * 1e-6 + 1.7e-3) * tool_from_object_});
    }
    ASSERT_TRUE(WriteTumTrajectory(Path("poses.tum"), poses).ok());
    ASSERT_TRUE(WriteTumTrajectory(Path("robot.tum"), robot).ok());
  }

  const RigidTransform camera_from_base_{ExpSo3({2.0, 0.3, -0.4}), {0.1, -0.3, 1.2}};
  const RigidTransform tool_from_object_{ExpSo3({-0.3, 1.0, 0.2}), {0.05, 0.02, 0.1}};
};

TEST_F(RobotTest, HandEyeCalibrationIsAWorldFromCamera) {
  WriteCell();
  const CliResult result =
      Run({"calibrate", Path("poses.tum"), "--hand-eye", Path("robot.tum"), "-o", Path("mount.yaml"), "--json"});
  ASSERT_EQ(result.status, 0) << result.err;
  const nlohmann::json json = result.Json();
  EXPECT_EQ(json["mount"], "beside");
  EXPECT_NEAR(json["time_offset_s"].get<double>(), kOffsetS, 1e-4);
  EXPECT_TRUE(json.contains("tool_from_object"));
  EXPECT_TRUE(json["warnings"].empty()) << json["warnings"];
  const auto mount = ReadTransformFile(Path("mount.yaml"));
  ASSERT_TRUE(mount.ok()) << mount.status();
  EXPECT_EQ(mount->target, "base");
  EXPECT_LT(Difference(mount->target_from_source, camera_from_base_.Inverse()).norm(), 5e-4);
  EXPECT_THAT(ReadText("mount.yaml"), AllOf(StartsWith("# base_from_camera by evpose calibrate --hand-eye"),
                                            HasSubstr("# standard errors: "), HasSubstr("clock of the robot")));

  const CliResult text = Run({"calibrate", Path("poses.tum"), "--hand-eye", Path("robot.tum"), "-o", Path("mount.yaml"),
                              "--mount", "beside", "--time-offset", "1234.5"});
  ASSERT_EQ(text.status, 0) << text.err;
  EXPECT_THAT(text.out, AllOf(HasSubstr("base_from_camera\n"), HasSubstr("1234.500000 s\n"), HasSubstr("spread by ")));
}

TEST_F(RobotTest, OneAxisDeterminesNoTransform) {
  WriteCell(/*is_flat=*/true);
  const CliResult result =
      Run({"calibrate", Path("poses.tum"), "--hand-eye", Path("robot.tum"), "-o", Path("mount.yaml")});
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, AllOf(HasSubstr("turn about a second axis, too"), HasSubstr("nothing was written")));
  EXPECT_THAT(FilesBeginning("mount"), ::testing::IsEmpty());
}

TEST_F(RobotTest, AReferenceThatDoesNotExplainThePosesIsAnError) {
  WriteCell();
  Trajectory millimetres = *ReadTumTrajectory(Path("robot.tum"));
  for (StampedPose& pose : millimetres) pose.camera_from_object.translation_m *= 1000.0;
  ASSERT_TRUE(WriteTumTrajectory(Path("millimetres.tum"), millimetres).ok());
  Trajectory few = *ReadTumTrajectory(Path("poses.tum"));
  few.resize(5);
  ASSERT_TRUE(WriteTumTrajectory(Path("few.tum"), few).ok());
  const auto error = [this](const std::string& poses, const std::string& robot, const std::string& mount) {
    const CliResult result = Run({"calibrate", Path(poses), "--hand-eye", Path(robot), "--mount", mount,
                                  "--time-offset", "1234.5", "-o", Path("mount.yaml")});
    EXPECT_EQ(result.status, 1) << result.err;
    EXPECT_THAT(FilesBeginning("mount"), ::testing::IsEmpty());
    return result.err;
  };
  const std::string files = Path("poses.tum") + " and " + Path("millimetres.tum");
  EXPECT_THAT(error("poses.tum", "millimetres.tum", "auto"),
              AllOf(HasSubstr(files + ": the poses move 0.001 times as far as the reference: both must be in metres"),
                    HasSubstr("nothing was written")));
  EXPECT_THAT(error("poses.tum", "robot.tum", "in-hand"), HasSubstr("and is the mount right?"));
  EXPECT_THAT(error("few.tum", "robot.tum", "auto"),
              HasSubstr("at least 12 poses and 2 of the reference are needed; there are 5 and 3000"));
}

// The object is in front of the camera, so that the poses can be compared with themselves in other units.
TEST_F(RobotTest, EvaluateNamesUnitsAndOffsetsThatDoNotFit) {
  WriteCell();
  Trajectory millimetres = *ReadTumTrajectory(Path("poses.tum"));
  for (StampedPose& pose : millimetres) pose.camera_from_object.translation_m *= 1000.0;
  ASSERT_TRUE(WriteTumTrajectory(Path("millimetres.tum"), millimetres).ok());
  const auto evaluate = [this](const std::vector<std::string>& options) {
    std::vector<std::string> arguments = {"evaluate", "--truth", Path("millimetres.tum"), "--estimate",
                                          Path("poses.tum")};
    arguments.insert(arguments.end(), options.begin(), options.end());
    return Run(arguments);
  };
  const CliResult unit = evaluate({});
  EXPECT_EQ(unit.status, 0);
  EXPECT_EQ(unit.err, "evpose evaluate: " + Path("poses.tum") +
                          ": its object is 0.001 times as far from the camera as that of the truth; are both in "
                          "metres?\n");
  const CliResult offset = evaluate({"--time-offset", "-1000"});
  EXPECT_EQ(offset.status, 1);
  EXPECT_THAT(offset.err, AllOf(HasSubstr("lies outside the truth's time span"),
                                HasSubstr("minus the time offset of -1000.000000 s")));
  const CliResult aligned = evaluate({"--align", "rigid"});
  EXPECT_THAT(aligned.err + aligned.out, HasSubstr("the poses move 0.001 times as far as the reference"));
}

TEST_F(RobotTest, EvaluateAlignsAReferenceOfTheRobot) {
  WriteCell();
  const std::vector<std::string> evaluate = {"evaluate", "--truth", Path("robot.tum"), "--estimate", Path("poses.tum"),
                                             "--align",  "rigid",   "--time-offset",   "auto"};
  std::vector<std::string> with_json = evaluate;
  with_json.push_back("--json");
  const CliResult result = Run(with_json);
  ASSERT_EQ(result.status, 0) << result.err;
  const nlohmann::json row = result.Json()["estimates"][0];
  EXPECT_LT(row["position_rmse_m"].get<double>(), 2e-4);
  EXPECT_LT(row["rotation_mean_deg"].get<double>(), 0.02);
  EXPECT_EQ(row["alignment"]["truth_of"], "object");
  EXPECT_NEAR(row["alignment"]["time_offset_s"].get<double>(), kOffsetS, 1e-4);
  const CliResult table = Run(evaluate);
  EXPECT_THAT(table.out, AllOf(HasSubstr("clock of the truth - clock of the sensor 1234."), HasSubstr(" +- "),
                               HasSubstr("constant errors of the pose are not in the errors above")));
  // Without alignment, the estimate lies outside the truth's time span.
  const CliResult without = Run({"evaluate", "--truth", Path("robot.tum"), "--estimate", Path("poses.tum")});
  EXPECT_EQ(without.status, 1);
  EXPECT_THAT(without.err, HasSubstr("lies outside the truth's time span"));
  // The offset alone, which is wrong for poses in other frames, but known.
  const CliResult shifted = Run(
      {"evaluate", "--truth", Path("poses.tum"), "--estimate", Path("poses.tum"), "--time-offset", "0.001", "--json"});
  ASSERT_EQ(shifted.status, 0) << shifted.err;
  EXPECT_GT(shifted.Json()["estimates"][0]["position_rmse_m"].get<double>(), 1e-5);
  EXPECT_EQ(shifted.Json()["estimates"][0]["alignment"]["time_offset_s"], 0.001);
}

TEST_F(RobotTest, WrongUsageIsNamed) {
  WriteCell();
  const auto error = [&](const std::vector<std::string>& arguments, int status) {
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, status) << result.err;
    return result.err;
  };
  const std::string poses = Path("poses.tum"), robot = Path("robot.tum"), out = Path("mount.yaml");
  EXPECT_THAT(error({"calibrate", poses, "-o", out}, 2), HasSubstr("--model is required, except with --hand-eye"));
  EXPECT_THAT(error({"calibrate", poses, "--hand-eye", robot}, 2), HasSubstr("-o is required"));
  EXPECT_THAT(error({"calibrate", poses, poses, "--hand-eye", robot, "-o", out}, 2), HasSubstr("one file"));
  EXPECT_THAT(error({"calibrate", poses, "--mount", "beside", "-o", out}, 2), HasSubstr("--hand-eye"));
  for (const char* option : {"--model", "--camera", "--lens"}) {
    EXPECT_THAT(error({"calibrate", poses, "--hand-eye", robot, "-o", out, option, "brown"}, 2),
                HasSubstr(absl::StrCat(option, " and --hand-eye exclude each other")));
  }
  EXPECT_THAT(error({"calibrate", poses, "--hand-eye", robot, "--time-offset", "soon", "-o", out}, 2),
              HasSubstr("\"soon\" is neither auto nor a number"));
  EXPECT_THAT(error({"calibrate", poses, "--hand-eye", robot, "--time-offset", "0", "-o", out}, 1),
              AllOf(HasSubstr(poses + " and " + robot), HasSubstr("fewer than 12 poses")));
  EXPECT_THAT(error({"calibrate", poses, "--hand-eye", Path("robot.mcap"), "-o", out}, 1),
              HasSubstr("robot.mcap: poses are not read from .mcap files, but from .tum"));
  EXPECT_FALSE(std::filesystem::exists(out));
  EXPECT_THAT(error({"evaluate", "--truth", robot, "--estimate", poses, "--time-offset", "x"}, 2), HasSubstr("\"x\""));
  WriteText("other.tum", "# world_from_object, timestamp tx ty tz qx qy qz qw\n1 0 0 1 0 0 0 1\n");
  EXPECT_THAT(error({"evaluate", "--truth", robot, "--estimate", Path("other.tum")}, 1),
              HasSubstr("its poses are world_from_object"));
  EXPECT_THAT(error({"evaluate", "--truth", Path("other.tum"), "--estimate", poses}, 1),
              HasSubstr(Path("other.tum") + ": its poses are world_from_object; give"));
}

TEST_F(RobotTest, ReplayWritesTheFrameAndTheClock) {
  SimulateCube(0.05);
  ASSERT_EQ(Run(ReplayArguments("plain.tum")).status, 0);
  WriteText("mount.txt", "0 -1 0 0.5\n1 0 0 -1\n0 0 1 2\n0 0 0 1\n");
  const CliResult result =
      Run(ReplayArguments("world.tum", {"--world-from-camera", Path("mount.txt"), "--clock-log", Path("clock.csv")}));
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(result.Json()["transform"], "world_from_object");
  EXPECT_GT(result.Json()["host_minus_sensor_s"].get<double>(), 1e9);
  EXPECT_THAT(ReadText("world.tum"), StartsWith("# world_from_object, timestamp"));
  const Trajectory plain = *ReadTumTrajectory(Path("plain.tum")), world = *ReadTumTrajectory(Path("world.tum"));
  const RigidTransform mount = ReadTransformFile(Path("mount.txt"))->target_from_source;
  ASSERT_EQ(world.size(), plain.size());
  ASSERT_FALSE(plain.empty());
  for (size_t i = 0; i < plain.size(); ++i) {
    EXPECT_EQ(world[i].t_us, plain[i].t_us);
    EXPECT_LT(Difference(world[i].camera_from_object, mount * plain[i].camera_from_object).norm(), 1e-12);
  }
  const std::string log = ReadText("clock.csv");
  EXPECT_THAT(log, StartsWith("kind,t_us,host_unix_us,input,rising\n"));
  EXPECT_THAT(log, AllOf(HasSubstr("\nchunk,16"), HasSubstr("\npose,16")));

  // The commands that read poses need the same transform to return to the camera.
  const std::vector<std::string> evaluate = {"evaluate", "--truth", Path("cube/truth.tum"), "--estimate",
                                             Path("world.tum")};
  const std::vector<std::string> render = {"render",  Path("cube/recording.raw"), "--poses",  Path("world.tum"),
                                           "--model", Path("cube/model.obj"),     "--camera", Path("cube/camera.yaml"),
                                           "--out",   Path("world.png")};
  for (std::vector<std::string> command : {evaluate, render}) {
    const CliResult refused = Run(command);
    EXPECT_EQ(refused.status, 1);
    EXPECT_THAT(refused.err, HasSubstr(Path("world.tum") + ": its poses are world_from_object; give"));
    command.insert(command.end(), {"--world-from-camera", Path("mount.txt")});
    const CliResult read = Run(command);
    EXPECT_EQ(read.status, 0) << read.err;
    EXPECT_EQ(read.err, "");
  }

  const CliResult wrong = Run(ReplayArguments("world.tum", {"--world-from-camera", Path("cube/truth.tum")}));
  EXPECT_EQ(wrong.status, 1);
  EXPECT_THAT(wrong.err, HasSubstr(Path("cube/truth.tum") + ": has "));
  EXPECT_EQ(
      Run(ReplayArguments("world.tum", {"--world-from-camera", Path("mount.txt"), "--pose", "object-from-camera"}))
          .status,
      2);
}

TEST_F(RobotTest, TriggersHaveTheSensorsTimeAndTheHosts) {
  SimulateCube(0.05);
  // A rising and a falling edge on input 1, after the last event: EXT_TRIGGER of EVT3.
  std::ofstream(Path("cube/recording.raw"), std::ios::binary | std::ios::app) << "\x01\xa1" << '\0' << "\xa1";
  const CliResult result = Run(ReplayArguments("poses.tum", {"--clock-log", Path("clock.csv")}));
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(result.Json()["triggers"], 2);
  EXPECT_THAT(ReadText("clock.csv"), ::testing::ContainsRegex("\ntrigger,160[0-9]{5},[0-9]{16},1,1\n"
                                                              "trigger,160[0-9]{5},[0-9]{16},1,0\n"));
}

}  // namespace
}  // namespace evpose
