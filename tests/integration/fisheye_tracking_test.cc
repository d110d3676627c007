// SPDX-License-Identifier: Apache-2.0

// Tracks simulated objects behind a fisheye lens of 150 degrees, at the centre of the image and far from it, and
// compares the errors with those of a pinhole camera with the same number of pixels per radian.
#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <vector>

#include "core/evaluation/evaluate.h"
#include "core/numerics/math.h"
#include "core/simulation/simulator.h"
#include "core/tracking/object/tracker_options.h"
#include "core/tracking/tracker.h"

namespace evpose {
namespace {

struct Scene {
  CameraModel camera;
  std::vector<Event> events;
  Trajectory truth;
  std::shared_ptr<const ObjectModel> model;
};

CameraModel LensOf150Degrees() {
  const double focal_px = 640.0 / (75.0 / kDegreesPerRadian);
  return {1280, 720, focal_px, focal_px, 639.5, 359.5, {}, LensModel::kFisheye};
}

SimulationOptions CubeBefore(const CameraModel& camera, double view_angle_deg, uint64_t seed) {
  SimulationOptions options = SimulationPreset("cube").value();
  UseCamera(camera, options);
  options.scene.motion.depth_m = 0.6;
  options.scene.motion.view_angle_rad = view_angle_deg / kDegreesPerRadian;
  options.sensor.noise_ratio = 0.05;
  options.seed = seed;
  options.duration_us = 400'000;
  return options;
}

Scene Record(const SimulationOptions& options) {
  Scene scene;
  const auto report = Simulate(options, [&](absl::Span<const Event> events) {
    scene.events.insert(scene.events.end(), events.begin(), events.end());
    return absl::OkStatus();
  });
  EXPECT_TRUE(report.ok()) << report.status();
  scene.camera = options.camera;
  scene.truth = SimulatedTruth(options);
  scene.model = std::make_shared<ObjectModel>(SimulatedModel(options).value());
  return scene;
}

std::unique_ptr<Tracker> MakeTracker(const Scene& scene, bool is_pose_given) {
  std::optional<RigidTransform> pose;
  if (is_pose_given) pose = scene.truth.front().camera_from_object;
  return Tracker::Create(scene.model, scene.camera, TrackerOptions(), pose).value();
}

struct Outcome {
  std::vector<PoseEstimate> estimates;
  uint32_t losses = 0;
  Evaluation evaluation;
};

Outcome Track(const Scene& scene, bool is_pose_given) {
  const auto tracker = MakeTracker(scene, is_pose_given);
  Outcome outcome;
  tracker->AddEvents(scene.events, outcome.estimates);
  outcome.losses = tracker->losses();
  Trajectory poses;
  for (const PoseEstimate& estimate : outcome.estimates) poses.push_back({estimate.t_us, estimate.camera_from_object});
  const auto evaluation = Evaluate(scene.truth, poses, {});
  EXPECT_TRUE(evaluation.ok()) << evaluation.status();
  if (evaluation.ok()) outcome.evaluation = *evaluation;
  return outcome;
}

TEST(FisheyeTracking, AnObjectIsKeptAtTheCentreAndFarFromItAsBehindAPinhole) {
  CameraModel pinhole = LensOf150Degrees();
  pinhole.lens_model = LensModel::kBrown;
  for (const uint64_t seed : {1, 2, 3}) {
    const Outcome reference = Track(Record(CubeBefore(pinhole, 0.0, seed)), true);
    ASSERT_EQ(reference.losses, 0u);
    for (const double angle_deg : {0.0, 30.0, 55.0}) {
      const Outcome outcome = Track(Record(CubeBefore(LensOf150Degrees(), angle_deg, seed)), true);
      const double ratio = outcome.evaluation.position_rmse_of_depth / reference.evaluation.position_rmse_of_depth;
      std::printf("seed %d, %g degrees: coverage %.3f, losses %u, position %.2e of the depth, %.2f of a pinhole's\n",
                  static_cast<int>(seed), angle_deg, outcome.evaluation.coverage_ratio, outcome.losses,
                  outcome.evaluation.position_rmse_of_depth, ratio);
      EXPECT_EQ(outcome.losses, 0u) << seed << " " << angle_deg;
      EXPECT_GT(outcome.evaluation.coverage_ratio, 0.9) << seed << " " << angle_deg;
      EXPECT_LT(ratio, 3.0) << seed << " " << angle_deg;
    }
  }
}

TEST(FisheyeTracking, AnObjectIsFoundFarFromTheCentre) {
  for (const uint64_t seed : {1, 2}) {
    const Outcome outcome = Track(Record(CubeBefore(LensOf150Degrees(), 55.0, seed)), false);
    ASSERT_FALSE(outcome.estimates.empty());
    std::printf("seed %d: found after %.3f s, position %.2e of the depth\n", static_cast<int>(seed),
                static_cast<double>(outcome.estimates.front().t_us - 16'000'000) * 1e-6,
                outcome.evaluation.position_rmse_of_depth);
    EXPECT_LT(outcome.evaluation.position_rmse_of_depth, 0.02);
  }
}

// The cube moves from one side of the image to the other, through all views.
Scene Crossing() {
  SimulationOptions options = CubeBefore(LensOf150Degrees(), 0.0, 1);
  options.scene.motion.profile = MotionProfile::kHalfOut;
  options.scene.motion.speed_m_per_s = 1.2;
  options.duration_us = 1'000'000;
  return Record(options);
}

TEST(FisheyeTracking, AnObjectThatCrossesTheImageIsKept) {
  const Scene scene = Crossing();
  const Outcome outcome = Track(scene, true);
  double leftmost = 0.0, rightmost = 0.0;
  for (const StampedPose& pose : scene.truth) {
    const Eigen::Vector3d& t = pose.camera_from_object.translation_m;
    leftmost = std::min(leftmost, t.x() / t.z());
    rightmost = std::max(rightmost, t.x() / t.z());
  }
  std::printf("from %.2f to %.2f: coverage %.3f, losses %u, position %.2e of the depth\n", leftmost, rightmost,
              outcome.evaluation.coverage_ratio, outcome.losses, outcome.evaluation.position_rmse_of_depth);
  EXPECT_GT(rightmost - leftmost, 1.0);
  EXPECT_EQ(outcome.losses, 0u);
  EXPECT_GT(outcome.evaluation.coverage_ratio, 0.9);
  EXPECT_LT(outcome.evaluation.position_rmse_of_depth, 0.01);
}

std::string Bits(const std::vector<PoseEstimate>& estimates) {
  StateWriter writer;
  writer(estimates);
  return writer.Take();
}

TEST(FisheyeTracking, ThePosesDoNotDependOnTheChunksNorOnARestart) {
  const Scene scene = Crossing();
  const absl::Span<const Event> events = scene.events;
  const std::string expected = Bits(Track(scene, true).estimates);
  std::vector<PoseEstimate> estimates;
  auto tracker = MakeTracker(scene, true);
  for (size_t begin = 0; begin < events.size(); begin += 777) {
    tracker->AddEvents(events.subspan(begin, 777), estimates);
    if (begin % (size_t{777} * 100) != 0) continue;
    StateWriter writer;
    tracker->SaveState(writer);
    const std::string bytes = writer.Take();
    tracker = MakeTracker(scene, true);
    StateReader reader(bytes);
    tracker->LoadState(reader);
    ASSERT_TRUE(reader.Finish().ok());
  }
  EXPECT_EQ(Bits(estimates), expected);
}

}  // namespace
}  // namespace evpose
