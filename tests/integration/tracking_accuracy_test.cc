// SPDX-License-Identifier: Apache-2.0

// Tests the accuracy of the tracker on simulated recordings with truth, from the true first pose. The limits are well
// above the measured values (core/experiments/RESULTS.md), so that a failure indicates a defect and not a small change
// of accuracy.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <ostream>
#include <string>
#include <vector>

#include "core/base/byte_order.h"
#include "core/baselines/estimators/estimator_factory.h"
#include "core/evaluation/evaluate.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/models/symmetry.h"
#include "core/numerics/statistics.h"
#include "core/simulation/simulator.h"
#include "core/tracking/object/tracker_options.h"
#include "core/tracking/tracker.h"

namespace evpose {
namespace {

struct Recording {
  std::vector<Event> events;
  Trajectory truth;
  std::shared_ptr<const ObjectModel> model;
  CameraModel camera;
};

Recording Record(SimulationOptions options, double noise_ratio = 0.1) {
  options.sensor.noise_ratio = noise_ratio;
  Recording recording;
  const auto report = Simulate(options, [&](absl::Span<const Event> events) {
    recording.events.insert(recording.events.end(), events.begin(), events.end());
    return absl::OkStatus();
  });
  EXPECT_TRUE(report.ok()) << report.status();
  recording.truth = SimulatedTruth(options);
  recording.model = std::make_shared<ObjectModel>(SimulatedModel(options).value());
  recording.camera = options.camera;
  return recording;
}

SimulationOptions VgaScene(const char* object, double speed, uint64_t seed, int64_t duration_us) {
  SimulationOptions options = SimulationPreset(object, "vga", speed).value();
  options.seed = seed;
  options.duration_us = duration_us;
  return options;
}

struct Outcome {
  Trajectory estimates;
  TrackState state = TrackState::kInitializing;
  uint32_t losses = 0;
};

Outcome Track(const Recording& recording, const TrackerOptions& options = {}) {
  auto tracker =
      Tracker::Create(recording.model, recording.camera, options, recording.truth.front().camera_from_object).value();
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(recording.events, estimates);
  Outcome outcome;
  outcome.state = tracker->state();
  outcome.losses = tracker->losses();
  for (const PoseEstimate& estimate : estimates) {
    outcome.estimates.push_back({estimate.t_us, estimate.camera_from_object});
  }
  return outcome;
}

class TracksSimulatedObject : public ::testing::TestWithParam<const char*> {};

TEST_P(TracksSimulatedObject, ToTheEnd) {
  const Recording recording = Record(VgaScene(GetParam(), 2.0, 71, 500'000));
  const Outcome outcome = Track(recording);
  EXPECT_EQ(outcome.state, TrackState::kTracking);
  EXPECT_EQ(outcome.losses, 0u);
  const auto evaluation = Evaluate(recording.truth, outcome.estimates, {});
  ASSERT_TRUE(evaluation.ok()) << evaluation.status();
  EXPECT_GT(evaluation->coverage_ratio, 0.9);
  EXPECT_LT(evaluation->position_rmse_of_depth, 3e-3);
  EXPECT_LT(evaluation->rotation_median_rad,
            0.0087);  // 0.5 deg: at VGA the tilt of a planar object is weakly observable
}

INSTANTIATE_TEST_SUITE_P(Objects, TracksSimulatedObject,
                         ::testing::Values("cube", "cuboid", "planar", "book", "spacecraft"),
                         [](const auto& object) { return std::string(object.param); });

TEST(TrackingAccuracy, TheCubeIsTrackedWithinTheGoalAndBetterThanByTheStaticFit) {
  const Recording recording = Record(VgaScene("cube", 2.0, 72, 1'000'000));
  const auto mixture = Evaluate(recording.truth, Track(recording).estimates, {});
  TrackerOptions static_options;
  static_options.estimator_factory = EstimatorFactoryOf(Estimator::kStaticMm);
  const auto static_mm = Evaluate(recording.truth, Track(recording, static_options).estimates, {});
  ASSERT_TRUE(mixture.ok()) << mixture.status();
  ASSERT_TRUE(static_mm.ok()) << static_mm.status();
  EXPECT_LT(mixture->position_rmse_of_depth, 2e-3);
  EXPECT_LT(mixture->rotation_median_rad, 0.0035);
  EXPECT_EQ(mixture->losses, 0u);
  EXPECT_LT(mixture->position_rmse_of_depth, static_mm->position_rmse_of_depth);
}

// The model as it is read from the file that the simulator writes, in which both sides of the plate are visible.
std::shared_ptr<const ObjectModel> AsFile(const ObjectModel& model) {
  const std::string text = ObjectModelToObj(model);
  return std::make_shared<ObjectModel>(ParseObjectModel(AsBytes(text), ModelFormat::kObj, {}).value());
}

// The plate differs from its flipped and turned poses by one line, and its edges have about ten times as many events of
// the lamp as of the motion.
TEST(TrackingAccuracy, NoFlippedPlateIsTrackedUnderALampThatSwingsByHalf) {
  // With seed 5 the pose stays AMBIGUOUS: the poses differ in less than 2.4 % of what the events explain.
  int tracked = 0;
  for (const uint64_t seed : {5, 11}) {
    SimulationOptions options = SimulationPreset("planar", "evk4", 1.5).value();
    options.seed = seed;
    options.duration_us = 80'000;
    options.scene.light.flicker_depth = 0.5;
    Recording recording = Record(options, 0.0);
    recording.model = AsFile(*recording.model);
    auto tracker = Tracker::Create(recording.model, recording.camera, {}, std::nullopt).value();
    std::vector<PoseEstimate> estimates;
    tracker->AddEvents(recording.events, estimates);
    for (const PoseEstimate& estimate : estimates) {
      if (estimate.state != TrackState::kTracking) continue;
      const auto truth = std::lower_bound(recording.truth.begin(), recording.truth.end(), estimate.t_us,
                                          [](const auto& pose, int64_t t_us) { return pose.t_us < t_us; });
      ASSERT_NE(truth, recording.truth.end());
      ++tracked;
      EXPECT_LT(RotationAngle(estimate.camera_from_object.rotation, truth->camera_from_object.rotation), 0.2)
          << "seed " << seed << ", " << estimate.t_us << " us";
    }
  }
  EXPECT_GT(tracked, 5) << "a tracker that reports nothing would pass otherwise";
}

TEST(TrackingAccuracy, TheCubeIsFoundAndTrackedUnderALampThatSwingsByTwoFifths) {
  // There is no initial pose, and there are about ten events of the surfaces for each event of an edge.
  SimulationOptions options = VgaScene("cube", 2.0, 2, 150'000);
  options.scene.light.flicker_depth = 0.4;
  const Recording recording = Record(options);
  auto tracker = Tracker::Create(recording.model, recording.camera, {}, std::nullopt).value();
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(recording.events, estimates);
  EXPECT_EQ(tracker->losses(), 0u);
  ASSERT_GT(estimates.size(), 100u);  // found within 50 ms
  Trajectory poses;
  for (const PoseEstimate& estimate : estimates) poses.push_back({estimate.t_us, estimate.camera_from_object});
  const auto evaluation = Evaluate(recording.truth, poses, {.symmetries = recording.model->symmetries});
  ASSERT_TRUE(evaluation.ok()) << evaluation.status();
  EXPECT_LT(evaluation->position_rmse_of_depth, 4e-3);
  EXPECT_LT(evaluation->rotation_median_rad, 0.0087);
}

TEST(TrackingAccuracy, ALampThatGrowsDarkerDoesNotMakeTheObjectNearer) {
  // The thresholds are so low that the surfaces produce ten times as many events as the edges. Without flicker_bias.h
  // the error is 0.155 %, nearly all of it in depth.
  SimulationOptions options = VgaScene("cuboid", 1.5, 61, 200'000);
  options.sensor.threshold_on = options.sensor.threshold_off = 0.03;
  options.scene.light.flicker_depth = 0.15;
  const Recording recording = Record(options);
  TrackerOptions tracker_options;
  tracker_options.sensor = {.name = "fine",
                            .pixel_noise_px = 0.7,
                            .blur_px = 0.25,
                            .contrast_threshold = 0.1,
                            .refractory_us = 47.0,
                            .latency_us = 53.0};
  const auto evaluation = Evaluate(recording.truth, Track(recording, tracker_options).estimates, {});
  ASSERT_TRUE(evaluation.ok()) << evaluation.status();
  EXPECT_GT(evaluation->coverage_ratio, 0.9);
  EXPECT_LT(evaluation->position_rmse_of_depth, 1e-3);
}

std::vector<PoseEstimate> EstimatesOf(const Recording& recording, const TrackerOptions& options) {
  auto tracker =
      Tracker::Create(recording.model, recording.camera, options, recording.truth.front().camera_from_object).value();
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(recording.events, estimates);
  return estimates;
}

TEST(TrackingAccuracy, TheConsideredErrorIsThatOfAnotherBlur) {
  // The edge bias is proportional to the blur. A tenth more of it must change the poses by a tenth of the error that
  // the covariance considers for a bias of 100 %.
  const Recording recording = Record(VgaScene("cube", 2.0, 74, 200'000));
  TrackerOptions options;
  options.systematic = {.edge_bias_ratio = 1.0, .lag_px = 0.0, .latency_us = 0.0};
  const std::vector<PoseEstimate> considered = EstimatesOf(recording, options);
  options.sensor.uncertainty = 0.0;
  const std::vector<PoseEstimate> exact = EstimatesOf(recording, options);
  options.sensor.blur_px *= 1.1;
  const std::vector<PoseEstimate> blurred = EstimatesOf(recording, options);
  ASSERT_EQ(considered.size(), exact.size());
  ASSERT_EQ(blurred.size(), exact.size());
  double changed_m = 0.0, predicted_m = 0.0;
  for (size_t k = exact.size() / 2; k < exact.size(); ++k) {
    ASSERT_EQ(considered[k].camera_from_object.translation_m, exact[k].camera_from_object.translation_m);
    changed_m +=
        std::abs(blurred[k].camera_from_object.translation_m.z() - exact[k].camera_from_object.translation_m.z());
    predicted_m += 0.1 * std::sqrt(considered[k].covariance(2, 2) - exact[k].covariance(2, 2));
  }
  EXPECT_NEAR(predicted_m / changed_m, 1.0, 0.35);
}

TEST(TrackingAccuracy, TheCovarianceIsConsistentOnAnotherSensor) {
  SimulationOptions scene = VgaScene("cube", 2.0, 75, 300'000);
  scene.sensor.threshold_on = 0.2;
  scene.sensor.threshold_off = 0.36;
  scene.sensor.bandwidth_hz = 1000.0;
  scene.scene.lens_blur_px = 0.8;
  const Recording recording = Record(scene);
  const auto median_nees = [&](double uncertainty) {
    TrackerOptions options;
    options.sensor.uncertainty = uncertainty;
    std::vector<double> nees;
    for (const PoseEstimate& estimate : EstimatesOf(recording, options)) {
      const Vector6d error =
          Difference(Interpolate(recording.truth, estimate.t_us).value(), estimate.camera_from_object);
      nees.push_back(error.dot(estimate.covariance.ldlt().solve(error)));
    }
    return UpperMedian(nees);
  };
  EXPECT_LT(median_nees(1.0), 8.0);
  EXPECT_GT(median_nees(0.0), 16.0);
}

// A spacecraft that is symmetric under half turns about its axes, except for its mast and the texture of its panels.
// One case of each combination of path and sensor in which a search saw too few of these lines, or the right pose was
// rejected by chance.
struct LookalikeCase {
  uint64_t path, seed;
  int64_t duration_us;

  friend void PrintTo(const LookalikeCase& each, std::ostream* out) {
    *out << "path " << each.path << ", seed " << each.seed;
  }
};
class Lookalikes : public ::testing::TestWithParam<LookalikeCase> {};

TEST_P(Lookalikes, AreNotReported) {
  SimulationOptions options = SimulationPreset("spacecraft", "evk4").value();
  options.scene.light.flicker_depth = 0.15;
  options.scene.occluder.is_present = true;
  options.seed = GetParam().seed;
  options.path_seed = GetParam().path;
  options.duration_us = GetParam().duration_us;
  const Recording recording = Record(options);
  auto tracker = Tracker::Create(recording.model, recording.camera, {}, std::nullopt).value();
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(recording.events, estimates);
  EXPECT_FALSE(estimates.empty());
  for (const PoseEstimate& estimate : estimates) {
    const RigidTransform truth = Interpolate(recording.truth, estimate.t_us).value();
    ASSERT_LT(RotationAngle(truth.rotation, estimate.camera_from_object.rotation), 0.035) << estimate.t_us;
  }
}

INSTANTIATE_TEST_SUITE_P(Spacecraft, Lookalikes,
                         ::testing::Values(LookalikeCase{113, 113, 60'000}, LookalikeCase{115, 115, 30'000},
                                           LookalikeCase{133, 133, 60'000}, LookalikeCase{4, 18, 150'000}),
                         [](const auto& each) {
                           return "Path" + std::to_string(each.param.path) + "Seed" + std::to_string(each.param.seed);
                         });

TEST(TrackingAccuracy, RestsAreHeld) {
  SimulationOptions options = VgaScene("cube", 1.0, 73, 1'100'000);
  options.scene.motion.profile = MotionProfile::kRests;
  const Recording recording = Record(options);
  const Outcome outcome = Track(recording);
  EXPECT_EQ(outcome.losses, 0u);
  EXPECT_EQ(outcome.state, TrackState::kTracking);
  const auto evaluation = Evaluate(recording.truth, outcome.estimates, {});
  ASSERT_TRUE(evaluation.ok()) << evaluation.status();
  EXPECT_LT(evaluation->position_rmse_of_depth, 3e-3);
}

TEST(TrackingAccuracy, AWrongFirstPoseIsNotReported) {
  const Recording recording = Record(VgaScene("cube", 2.0, 74, 100'000));
  Recording wrong = recording;
  Vector6d off = Vector6d::Zero();
  off << 0.05, 0.02, 0.0, 0.3, -0.4, 0.2;
  wrong.truth.front().camera_from_object = Perturb(recording.truth.front().camera_from_object, off);
  // The given pose is rejected, and the object is found in one of its equivalent orientations.
  const Outcome outcome = Track(wrong);
  EXPECT_FALSE(outcome.estimates.empty());
  for (const StampedPose& estimate : outcome.estimates) {
    const RigidTransform truth = Interpolate(recording.truth, estimate.t_us).value();
    const RigidTransform nearest = NearestEquivalent(truth, recording.model->symmetries, estimate.camera_from_object);
    EXPECT_LT(RotationAngle(nearest.rotation, estimate.camera_from_object.rotation), 0.035) << estimate.t_us;
    EXPECT_LT((nearest.translation_m - estimate.camera_from_object.translation_m).norm(),
              0.02 * truth.translation_m.z());
  }
}

}  // namespace
}  // namespace evpose
