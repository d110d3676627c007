// SPDX-License-Identifier: Apache-2.0

// Tests the evidence for poses on recordings of real sensors with reference poses (EVPOSE_SHARED_DATA): poses are
// found, stay right from a given first pose, and an object that is absent, or a flashing board, is not tracked. Poses
// are compared with the references as by `evpose bench real` (core/experiments/README.md, section 4).
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/camera_files/camera_file.h"
#include "core/experiments/tracking/real_score.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"
#include "core/recordings/recordings_testing.h"
#include "core/tracking/object/tracker_options.h"
#include "core/tracking/tracker.h"
#include "tests/data/test_data.h"

namespace evpose {
namespace {

// Pixels: half of the distance of the densest parallel lines of these models, 5 px, and twice the references' errors.
constexpr double kWrongPx = 5.0;

struct Scene {
  std::vector<Event> events;
  Trajectory reference;
  CameraModel camera;
  std::shared_ptr<const ObjectModel> model;
};

// GoogleTest allows letters, digits and underscores.
std::string TestName(std::string name) {
  std::replace_if(
      name.begin(), name.end(), [](char c) { return c == '/' || c == '.'; }, '_');
  return name;
}

std::string PathOf(const std::string& name) { return FindTestData("real/" + name); }

// Nullopt without the data.
std::optional<Scene> Load(const std::string& recording, const std::string& reference, const std::string& folder) {
  if (PathOf(recording).empty() || PathOf(reference).empty()) return std::nullopt;
  Scene scene;
  scene.events = EventsOf(PathOf(recording));
  scene.reference = ReadTumTrajectory(PathOf(reference)).value();
  scene.camera = LoadCameraModel(PathOf(folder + "/camera.yaml")).value();
  scene.model = std::make_shared<ObjectModel>(LoadObjectModel(PathOf(folder + "/model.obj")).value());
  return scene;
}
std::optional<Scene> Load(const std::string& folder) {
  return Load(folder + "/recording.raw", folder + "/reference.tum", folder);
}

std::vector<PoseEstimate> Track(const Scene& scene, const std::optional<RigidTransform>& given, RealRun& run) {
  auto tracker = Tracker::Create(scene.model, scene.camera, TrackerOptions(), given).value();
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(scene.events, estimates);
  tracker->Finish(estimates);
  run.losses = tracker->losses();
  return estimates;
}

// The run has the time span of the reference.
RealRun CompareWithReference(const Scene& scene, const std::optional<RigidTransform>& given) {
  RealRun run;
  run.start_us = scene.reference.front().t_us;
  run.duration_s = 1e-6 * static_cast<double>(scene.reference.back().t_us - run.start_us);
  const ReprojectionError error(*scene.model, scene.camera);
  ScoreRealPoses(Track(scene, given, run), &scene.reference, &error, kWrongPx, run);
  return run;
}

RealRun FromTheGivenPose(const Scene& scene) {
  return CompareWithReference(scene, scene.reference.front().camera_from_object);
}

struct GivenPoseCase {
  const char* folder;
  double max_median_px;
  double min_right_ratio;
  double max_wrong_s;  // longest time with wrong poses while TRACKING
};

class GivenPoseTest : public ::testing::TestWithParam<GivenPoseCase> {};

TEST_P(GivenPoseTest, StaysRight) {
  const std::optional<Scene> scene = Load(GetParam().folder);
  if (!scene) GTEST_SKIP() << "real/" << GetParam().folder << " is not in EVPOSE_SHARED_DATA";
  const RealRun run = FromTheGivenPose(*scene);
  EXPECT_LE(run.median_error_px, GetParam().max_median_px);
  EXPECT_GE(run.right_ratio, GetParam().min_right_ratio);
  EXPECT_LE(run.longest_wrong_s, GetParam().max_wrong_s);
  EXPECT_EQ(run.losses, 0u);
}

INSTANTIATE_TEST_SUITE_P(RealRecordings, GivenPoseTest,
                         ::testing::Values(GivenPoseCase{"cube_turntable", 1.5, 0.9, 0},
                                           GivenPoseCase{"phone_shake", 0.6, 0.95, 0},
                                           GivenPoseCase{"shapes_rotation", 0.4, 0.95, 0},
                                           GivenPoseCase{"shapes_rotation_fast", 0.3, 0.9, 0}),
                         [](const auto& test) { return TestName(test.param.folder); });

struct FoundCase {
  const char* folder;
  double min_tracking_ratio;  // of the duration of the reference
};

class FoundTest : public ::testing::TestWithParam<FoundCase> {};

TEST_P(FoundTest, IsTrackedWithoutAPrior) {
  const std::optional<Scene> scene = Load(GetParam().folder);
  if (!scene) GTEST_SKIP() << "real/" << GetParam().folder << " is not in EVPOSE_SHARED_DATA";
  const RealRun run = CompareWithReference(*scene, std::nullopt);
  EXPECT_GE(run.tracking_s / run.duration_s, GetParam().min_tracking_ratio);
  EXPECT_EQ(run.longest_wrong_s, 0.0);
}

// The rest of the time the pose is searched for, or DEGRADED while there are few events.
INSTANTIATE_TEST_SUITE_P(RealRecordings, FoundTest,
                         ::testing::Values(FoundCase{"phone_shake", 0.5}, FoundCase{"shapes_rotation", 0.8},
                                           FoundCase{"shapes_rotation_fast", 0.8}),
                         [](const auto& test) { return TestName(test.param.folder); });

class FlashingBoardTest : public ::testing::TestWithParam<const char*> {};

TEST_P(FlashingBoardTest, IsNeverWrongWhileTracking) {
  const std::string path = std::string("checkerboard_flash/") + GetParam();
  const std::optional<Scene> scene = Load(path + ".raw", path + ".tum", "checkerboard_flash");
  if (!scene) GTEST_SKIP() << "real/" << path << " is not in EVPOSE_SHARED_DATA";
  EXPECT_EQ(FromTheGivenPose(*scene).longest_wrong_s, 0.0);
}

INSTANTIATE_TEST_SUITE_P(RealRecordings, FlashingBoardTest, ::testing::Values("09", "20"));

struct AbsentCase {
  const char* recording;
  const char* folder;  // of camera and model
  double longest_tracking_s = 0.0;
};

class AbsentObjectTest : public ::testing::TestWithParam<AbsentCase> {};

TEST_P(AbsentObjectTest, IsNeverTracked) {
  const std::string recording = PathOf(GetParam().recording);
  const std::string model = PathOf(std::string(GetParam().folder) + "/model.obj");
  if (recording.empty() || model.empty()) GTEST_SKIP() << "real/ is not in EVPOSE_SHARED_DATA";
  Scene scene;
  scene.events = EventsOf(recording);
  scene.camera = LoadCameraModel(PathOf(std::string(GetParam().folder) + "/camera.yaml")).value();
  scene.model = std::make_shared<ObjectModel>(LoadObjectModel(model).value());
  RealRun run;
  const std::vector<PoseEstimate> poses = Track(scene, std::nullopt, run);
  ScoreRealPoses(poses, nullptr, nullptr, kWrongPx, run);
  EXPECT_LE(run.tracking_s, GetParam().longest_tracking_s) << poses.size() << " poses";
}

// Cameras of the same resolution. The outline of a phone is that of a box: the cube is DEGRADED on it, and from some
// start times TRACKING for up to 46 ms (the limits in the README).
INSTANTIATE_TEST_SUITE_P(RealRecordings, AbsentObjectTest,
                         ::testing::Values(AbsentCase{"negatives/screwdriver.raw", "phone_shake"},
                                           AbsentCase{"negatives/screwdriver.raw", "cube_turntable"},
                                           AbsentCase{"negatives/screwdriver.raw", "checkerboard_flash"},
                                           AbsentCase{"phone_shake/recording.raw", "cube_turntable", 0.05},
                                           AbsentCase{"phone_shake/recording.raw", "checkerboard_flash"},
                                           AbsentCase{"cube_turntable/recording.raw", "phone_shake"},
                                           AbsentCase{"checkerboard_flash/09.raw", "phone_shake"},
                                           AbsentCase{"checkerboard_flash/20.raw", "cube_turntable"}),
                         [](const auto& test) {
                           return TestName(std::string(test.param.folder) + "_in_" + test.param.recording);
                         });

}  // namespace
}  // namespace evpose
