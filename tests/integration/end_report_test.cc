// SPDX-License-Identifier: Apache-2.0

// The end of a replay: what happened to the object, the exit status, and AMBIGUOUS poses from the tracker to
// `evaluate`. The recordings are ideal events of the tracker's model.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "core/camera_files/camera_file.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/geometry/camera.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"
#include "core/recordings/recording_writer.h"
#include "tests/integration/cli_fixture.h"
#include "tests/integration/local_server_testing.h"

namespace evpose {
namespace {

using testing::ConstantTwist;
using ::testing::ContainsRegex;
using ::testing::HasSubstr;
using testing::IdealEventOptions;
using testing::MakeCamera;
using testing::MakeCube;
using testing::MakeIdealEvents;
using testing::MakePose;
using testing::Motion;

const CameraModel kVga = MakeCamera(640, 480, 600.0);

// MakeCube(0.15) with its faces.
constexpr char kCubeObj[] =
    "v -0.075 -0.075 -0.075\nv 0.075 -0.075 -0.075\nv -0.075 0.075 -0.075\nv 0.075 0.075 -0.075\n"
    "v -0.075 -0.075 0.075\nv 0.075 -0.075 0.075\nv -0.075 0.075 0.075\nv 0.075 0.075 0.075\n"
    "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n";

class EndReportTest : public CliTest {
 protected:
  // Writes recording.raw, model.obj (a model without faces or the cube), camera.yaml and truth.tum.
  void Record(const ObjectModel& model, const CameraModel& camera, const Motion& motion,
              const IdealEventOptions& options) {
    auto writer = RecordingWriter::Create(Path("recording.raw"), Encoding::kEvt3, {camera.width_px, camera.height_px});
    ASSERT_TRUE(writer.ok()) << writer.status();
    ASSERT_TRUE((*writer)->Write(MakeIdealEvents(model, camera, motion, options)).ok());
    ASSERT_TRUE((*writer)->Close().ok());
    WriteText("model.obj", model.vertices.size() == 8 ? kCubeObj : ObjectModelToObj(model));
    WriteText("camera.yaml", CameraModelToYaml(camera));
    std::string truth;
    for (int64_t t_us = 0; t_us <= options.duration_us; t_us += 10'000) {
      truth += TumLine({t_us, motion(static_cast<double>(t_us) * 1e-6)}) + "\n";
    }
    WriteText("truth.tum", truth);
  }

  // The pose of the first line of a TUM file, as an argument.
  std::string FirstPoseOf(const std::string& file) const {
    const std::string text = ReadText(file);
    const size_t begin = text.find(' ') + 1;
    return text.substr(begin, text.find('\n') - begin);
  }

  CliResult Replay(const std::string& out, const std::vector<std::string>& more = {"--json"}) const {
    std::vector<std::string> arguments = {"replay",   Path("recording.raw"), "--model", Path("model.obj"),
                                          "--camera", Path("camera.yaml"),   "--out",   Path(out)};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return Run(arguments);
  }
};

Vector6d TwistOf(double vx, double vy, double vz, double wx, double wy, double wz) {
  Vector6d twist;
  twist << vx, vy, vz, wx, wy, wz;
  return twist;
}

// At a large distance the two tilts of a plate have the same image, also under translation.
class AmbiguousPlateTest : public EndReportTest {
 protected:
  void SetUp() override {
    EndReportTest::SetUp();
    const std::vector<Eigen::Vector3d> corners = {
        {-0.2, -0.12, 0.0}, {0.2, -0.15, 0.0}, {0.13, 0.12, 0.0}, {-0.1, 0.17, 0.0}};
    ObjectModel plate;
    plate.vertices = corners;
    for (size_t k = 0; k < 4; ++k) plate.lines.push_back({corners[k], corners[(k + 1) % 4], {}});
    const CameraModel camera = MakeCamera(640, 480, 120'000.0);
    Record(plate, camera, ConstantTwist(MakePose({0.0, 0.0, 200.0}, {0.6, 0.3, 0.2}), TwistOf(0.3, 0.2, 0, 0, 0, 0)),
           {.duration_us = 300'000});
  }
};

TEST_F(AmbiguousPlateTest, HasItsAlternativesInEachFormatThatHasStates) {
  const CliResult replay = Replay("poses.csv");
  ASSERT_EQ(replay.status, 0) << replay.err;
  EXPECT_EQ(replay.Json()["state"], "AMBIGUOUS");
  EXPECT_EQ(replay.Json()["initialization"], "AMBIGUOUS");
  EXPECT_GE(replay.Json()["followed_poses"], 2);
  EXPECT_THAT(std::string(replay.Json()["detail"]), ContainsRegex("^[2-9] poses are compatible with the events"));
  EXPECT_GT(replay.Json()["ambiguous_poses"], 20);
  EXPECT_EQ(replay.Json()["ambiguous_poses"], replay.Json()["poses"]);
  EXPECT_THAT(ReadText("poses.csv"), HasSubstr(",AMBIGUOUS,"));

  ASSERT_EQ(Replay("poses.jsonl").status, 0);
  const std::string lines = ReadText("poses.jsonl");
  const nlohmann::json pose = nlohmann::json::parse(lines.substr(0, lines.find('\n')));
  EXPECT_EQ(pose["state"], "AMBIGUOUS");
  ASSERT_GE(pose["alternatives"].size(), 1u);
  EXPECT_GT(pose["alternatives"][0]["log_likelihood_ratio"], -8.0);

  const CliResult tum = Replay("poses.tum", {});
  EXPECT_EQ(tum.status, 1);
  EXPECT_THAT(tum.err, HasSubstr("every pose is AMBIGUOUS, and a .tum file has none of them: write .csv or .jsonl"));
  EXPECT_THAT(tum.out, ContainsRegex("\nAMBIGUOUS: [2-9] poses are compatible with the events"));
  EXPECT_THAT(tum.out, HasSubstr("are AMBIGUOUS: a .tum file does not have them"));
  EXPECT_EQ(ReadText("poses.tum"), "");
  WriteText("poses.tum", "earlier\n");
  EXPECT_THAT(Replay("poses.tum", {}).err, HasSubstr(".jsonl files; earlier pose files stay as they were\n"));
  EXPECT_EQ(ReadText("poses.tum"), "earlier\n");

  const CliResult evaluation =
      Run({"evaluate", "--truth", Path("truth.tum"), "--estimate", Path("poses.csv"), "--json"});
  EXPECT_EQ(evaluation.status, 1);
  EXPECT_THAT(evaluation.err, HasSubstr("(with AMBIGUOUS poses only)"));
  const nlohmann::json row = evaluation.Json()["estimates"][0];
  EXPECT_EQ(row["losses"], 0);
  EXPECT_EQ(row["coverage_ratio"], 0.0);
  EXPECT_GT(row["ambiguous_ratio"], 0.1);
}

TEST_F(AmbiguousPlateTest, WatchingItsPosesAsTumIsAFailure) {
  const LocalServer server = StartLocalServer();
  const CliResult replay = Replay("poses.jsonl", {"--json", "--server", server.address, "--keep-session"});
  ASSERT_EQ(replay.status, 0) << replay.err;
  const std::vector<std::string> arguments = {"watch", replay.Json()["session"], "--server", server.address};
  const auto watch = [&](std::vector<std::string> more) {
    more.insert(more.begin(), arguments.begin(), arguments.end());
    return Run(more);
  };
  const CliResult printed = watch({});
  EXPECT_EQ(printed.status, 1);
  EXPECT_EQ(printed.out, "");
  EXPECT_THAT(printed.err, HasSubstr(": every pose is AMBIGUOUS, and TUM has none of them: use --json\n"));
  const CliResult file = watch({"--out", Path("watched.tum")});
  EXPECT_EQ(file.status, 1);
  EXPECT_THAT(file.err, HasSubstr(": every pose is AMBIGUOUS, and a .tum file has none of them: write .csv or .jsonl"));
  const CliResult json = watch({"--json"});
  EXPECT_EQ(json.status, 0) << json.err;
  EXPECT_EQ(json.out, ReadText("poses.jsonl"));
  EXPECT_EQ(watch({"--out", Path("watched.jsonl")}).status, 0);
  EXPECT_EQ(ReadText("watched.jsonl"), ReadText("poses.jsonl"));
}

TEST_F(EndReportTest, AnObjectThatIsTooSmall) {
  Record(*MakeCube(0.15), kVga,
         ConstantTwist(MakePose({0.1, 0.05, 8.0}, {0.3, 0.2, 0.1}), TwistOf(1.0, 0.5, 0, 0, 0, 0.5)),
         {.events_per_px2 = 5.0, .clutter_per_s = 2000.0, .duration_us = 300'000});
  const CliResult replay = Replay("poses.csv", {});
  EXPECT_EQ(replay.status, 1);
  EXPECT_THAT(replay.out, ContainsRegex("no pose found: the object is too small in the image: the events lie within "
                                        "[0-9]+ px, and an object needs about 40 px"));
  EXPECT_THAT(replay.err, HasSubstr("no pose was found; the report has the reason"));
}

TEST_F(EndReportTest, NoiseAlone) {
  Record(*MakeCube(0.15), kVga, ConstantTwist(MakePose({0.0, 0.0, 0.6}, {0, 0, 0}), Vector6d::Zero()),
         {.events_per_px2 = 0.0, .clutter_per_s = 20'000.0, .duration_us = 300'000});
  const CliResult replay = Replay("poses.csv", {});
  EXPECT_EQ(replay.status, 1);
  EXPECT_THAT(replay.out, HasSubstr("no pose found: no region of the image has more events than the noise"));
}

TEST_F(EndReportTest, AnObjectThatHardlyMoves) {
  Record(*MakeCube(0.15), kVga,
         ConstantTwist(MakePose({0.02, -0.01, 0.6}, {0.6, 0.5, 0.2}), TwistOf(0.001, 0.0007, 0, 0, 0, 0.0007)),
         {.events_per_px2 = 10.0, .clutter_per_s = 1000.0, .duration_us = 300'000});
  const CliResult replay = Replay("poses.csv", {});
  EXPECT_EQ(replay.status, 1);
  EXPECT_THAT(replay.out, HasSubstr("no pose found: not enough motion"));
}

TEST_F(EndReportTest, AModelOfAnotherObject) {
  Record(*MakeCube(0.15), kVga,
         ConstantTwist(MakePose({0.02, -0.01, 0.6}, {0.6, 0.5, 0.2}), TwistOf(0.3, 0.15, 0.05, 0.5, 0.3, 0.6)),
         {.duration_us = 300'000});
  WriteText("model.obj", "v 0 0 0\nv 0.3 0 0\nv 0.3 0.02 0\nv 0 0.02 0\nf 1 2 3 4\n");
  const CliResult replay = Replay("poses.csv", {});
  EXPECT_EQ(replay.status, 1);
  EXPECT_THAT(replay.out, ContainsRegex("no pose found: no pose fits the edges in the events .*; are the model, its "
                                        "scale and the camera the right ones\\?"));
}

TEST_F(EndReportTest, AnObjectThatLeavesTheImage) {
  Record(*MakeCube(0.15), kVga,
         ConstantTwist(MakePose({0.02, -0.01, 0.6}, {0.6, 0.5, 0.2}), TwistOf(3.0, 0, 0, 0, 0, 0)),
         {.duration_us = 300'000});
  const CliResult replay = Replay("poses.csv");
  EXPECT_EQ(replay.status, 0) << "there are poses before the loss";
  EXPECT_EQ(replay.Json()["state"], "LOST");
  EXPECT_EQ(replay.Json()["loss_cause"], "OUT_OF_VIEW");
  EXPECT_GT(replay.Json()["lost_at_us"], 50'000);
  EXPECT_THAT(std::string(replay.Json()["detail"]),
              ContainsRegex("lost at 0\\.[0-9]+ s because the object left the image"));
}

TEST_F(EndReportTest, AGivenPoseThatIsStillTestedAtTheEnd) {
  Record(*MakeCube(0.15), kVga,
         ConstantTwist(MakePose({0.02, -0.01, 0.6}, {0.6, 0.5, 0.2}), TwistOf(0.3, 0.15, 0.05, 0.5, 0.3, 0.6)),
         {.duration_us = 1000});
  const CliResult replay = Replay("poses.csv", {"--json", "--init-pose", FirstPoseOf("truth.tum")});
  EXPECT_EQ(replay.status, 1);
  EXPECT_EQ(replay.Json()["state"], "LOST");
  EXPECT_EQ(replay.Json()["loss_cause"], "UNCONFIRMED");
  EXPECT_THAT(
      std::string(replay.Json()["detail"]),
      ContainsRegex("lost at 0\\.[0-9]+ s because the stream ended before the events confirmed the given pose"));
}

}  // namespace
}  // namespace evpose
