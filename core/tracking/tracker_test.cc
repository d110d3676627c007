// SPDX-License-Identifier: Apache-2.0

// Tracking on ideal events of a cube: each event lies on a line at its own time, with noise.
#include "core/tracking/tracker.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/baselines/estimators/estimator_factory.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/numerics/random.h"
#include "core/numerics/statistics.h"
#include "core/tracking/object/tracker_options.h"
#include "core/tracking/tracking_testing.h"

namespace evpose {
namespace {

using testing::ConstantTwist;
using testing::IdealEventOptions;
using testing::MakeCube;
using testing::MakeIdealEvents;
using testing::MakePose;
using testing::Motion;

struct TrackRun {
  std::vector<PoseEstimate> estimates;
  std::unique_ptr<Tracker> tracker;
};

TrackRun Track(const std::vector<Event>& events, const std::optional<RigidTransform>& pose,
               const TrackerOptions& options = WithoutInitialization(), bool finish = true) {
  TrackRun run;
  run.tracker = Tracker::Create(MakeCube(0.15), kCamera, options, pose).value();
  run.tracker->AddEvents(events, run.estimates);
  if (finish) run.tracker->Finish(run.estimates);
  return run;
}

struct Errors {
  double position_rmse_of_depth = 0.0;
  double rotation_median_rad = 0.0;
  double rotation_max_rad = 0.0;
};

Errors Compare(const std::vector<PoseEstimate>& estimates, const Motion& motion) {
  Errors errors;
  std::vector<double> rotation;
  for (const PoseEstimate& estimate : estimates) {
    const RigidTransform truth = motion(estimate.t_us * 1e-6);
    const double ratio =
        (estimate.camera_from_object.translation_m - truth.translation_m).norm() / truth.translation_m.norm();
    errors.position_rmse_of_depth += ratio * ratio / static_cast<double>(estimates.size());
    rotation.push_back(RotationAngle(truth.rotation, estimate.camera_from_object.rotation));
  }
  errors.position_rmse_of_depth = std::sqrt(errors.position_rmse_of_depth);
  if (!rotation.empty()) {
    errors.rotation_max_rad = *std::max_element(rotation.begin(), rotation.end());
    errors.rotation_median_rad = UpperMedian(rotation);
  }
  return errors;
}

Motion Tumble(double speed) {
  return [speed](double t) {
    const double s = speed * t;
    return MakePose({0.05 * std::sin(4 * s), 0.04 * std::sin(5 * s + 1), 0.6 + 0.05 * std::sin(3 * s)},
                    {0.6 + 0.3 * std::sin(2 * s), 0.5 + 0.4 * std::sin(3 * s), 0.2 + 0.3 * std::sin(s)});
  };
}

// Moves for 100 ms, stops within 20 ms, rests, and moves on 420 ms after the beginning of the stop.
Motion StopAndGo() {
  const auto path = [](double t) {
    if (t < 0.1) return t;
    if (t < 0.12) return 0.1 + (t - 0.1) - 25.0 * (t - 0.1) * (t - 0.1);
    if (t < 0.52) return 0.11;
    if (t < 0.54) return 0.11 + 25.0 * (t - 0.52) * (t - 0.52);
    return 0.12 + (t - 0.54);
  };
  return [path](double t) { return Perturb(kStart, path(t) * Twist(0.25, 0.15, 0.0, 0.3, 0.2, 0.8)); };
}

struct MotionCase {
  const char* name;
  Vector6d twist;
  int64_t duration_us;
};

class TracksConstantTwist : public ::testing::TestWithParam<MotionCase> {};

TEST_P(TracksConstantTwist, ToTheEnd) {
  const Motion motion = ConstantTwist(kStart, GetParam().twist);
  IdealEventOptions options;
  options.duration_us = GetParam().duration_us;
  const std::vector<Event> events = MakeIdealEvents(*MakeCube(0.15), kCamera, motion, options);
  const TrackRun run = Track(events, kStart);
  EXPECT_EQ(run.tracker->state(), TrackState::kTracking);
  EXPECT_EQ(run.tracker->losses(), 0u);
  ASSERT_GT(run.estimates.size(), 10u);
  EXPECT_LT(run.estimates.front().t_us, GetParam().duration_us / 4);
  const Errors errors = Compare(run.estimates, motion);
  EXPECT_LT(errors.position_rmse_of_depth, 1e-3);
  EXPECT_LT(errors.rotation_median_rad, 2.5e-3);
  EXPECT_LT(errors.rotation_max_rad, 0.02);
  for (size_t k = 1; k < run.estimates.size(); ++k) {
    EXPECT_GT(run.estimates[k].t_us, run.estimates[k - 1].t_us);
    EXPECT_GT(run.estimates[k].explained_ratio, 0.7f);
    EXPECT_LT(run.estimates[k].residual_rms_px, 1.5f);
    EXPECT_GT(run.estimates[k].num_events, 0u);
  }
}

INSTANTIATE_TEST_SUITE_P(Motions, TracksConstantTwist,
                         ::testing::Values(MotionCase{"Slow", Twist(0.02, 0.01, 0.0, 0.05, 0.0, 0.05), 600'000},
                                           MotionCase{"Sideways", Twist(0.3, 0.1, 0.0, 0.0, 0.0, 0.0), 200'000},
                                           MotionCase{"Fast", Twist(1.2, -0.8, 0.3, 0.0, 0.0, 0.0), 80'000},
                                           MotionCase{"Approaching", Twist(0.02, 0.0, -0.5, 0.1, 0.1, 0.0), 200'000},
                                           MotionCase{"Rotating", Twist(0.0, 0.0, 0.0, 1.0, -2.0, 1.5), 200'000},
                                           MotionCase{"Spinning", Twist(0.1, 0.0, 0.0, 0.0, 0.0, 12.0), 100'000}),
                         [](const auto& motion) { return motion.param.name; });

TEST(Tracker, TumblingCubeAndTheStaticFitBesideIt) {
  const Motion motion = Tumble(2.0);
  IdealEventOptions options;
  options.duration_us = 500'000;
  options.clutter_per_s = 200'000;
  const std::vector<Event> events = MakeIdealEvents(*MakeCube(0.15), kCamera, motion, options);
  const TrackRun run = Track(events, motion(0.0));
  EXPECT_EQ(run.tracker->state(), TrackState::kTracking);
  const Errors mixture = Compare(run.estimates, motion);
  EXPECT_LT(mixture.position_rmse_of_depth, 1e-3);
  EXPECT_LT(mixture.rotation_median_rad, 1.5e-3);

  TrackerOptions published = WithoutInitialization();
  published.estimator_factory = EstimatorFactoryOf(Estimator::kStaticMm);
  const TrackRun baseline = Track(events, motion(0.0), published);
  EXPECT_GT(baseline.estimates.size(), run.estimates.size() / 2);
  const Errors static_mm = Compare(baseline.estimates, motion);
  EXPECT_LT(static_mm.rotation_median_rad, 0.01);
  EXPECT_LT(mixture.rotation_median_rad, static_mm.rotation_median_rad);
}

TEST(Tracker, PublishedCovarianceIsConsistentForIndependentEvents) {
  // The events of this test are independent, so that each one carries its full information.
  TrackerOptions options = WithoutInitialization();
  options.mixture.events_per_information = 1.0;
  const Motion motion = Tumble(1.0);
  IdealEventOptions ideal;
  ideal.duration_us = 500'000;
  const TrackRun run = Track(MakeIdealEvents(*MakeCube(0.15), kCamera, motion, ideal), motion(0.0), options);
  double nees = 0.0;
  for (const PoseEstimate& estimate : run.estimates) {
    const Vector6d error = Difference(motion(estimate.t_us * 1e-6), estimate.camera_from_object);
    nees += error.dot(estimate.covariance.ldlt().solve(error)) / static_cast<double>(run.estimates.size());
  }
  EXPECT_GT(nees, 2.0);  // 6 when exact
  EXPECT_LT(nees, 18.0);
}

TEST(Tracker, TheCovarianceContainsAnUnknownLatency) {
  constexpr int64_t kLatencyUs = 1000;
  const Motion motion = Tumble(3.0);
  std::vector<Event> events = MakeIdealEvents(*MakeCube(0.15), kCamera, motion, {.duration_us = 100'000});
  for (Event& event : events) event.t_us += kLatencyUs;
  const auto median_nees = [&](double uncertainty) {
    TrackerOptions options = WithoutInitialization();
    options.sensor.uncertainty = uncertainty;
    options.systematic = {.edge_bias_ratio = 0.0, .lag_px = 0.0, .latency_us = kLatencyUs};
    std::vector<double> nees;
    for (const PoseEstimate& estimate : Track(events, motion(0.0), options).estimates) {
      const Vector6d error = Difference(motion(estimate.t_us * 1e-6), estimate.camera_from_object);
      nees.push_back(error.dot(estimate.covariance.ldlt().solve(error)));
    }
    if (nees.size() < 50) return std::nan("");
    return UpperMedian(nees);
  };
  EXPECT_GT(median_nees(0.0), 25.0);
  EXPECT_LT(median_nees(1.0), 12.0);
}

TEST(Tracker, EstimatesDoNotDependOnTheCutOfCalls) {
  const Motion motion = Tumble(3.0);
  IdealEventOptions options;
  options.duration_us = 60'000;
  const std::vector<Event> events = MakeIdealEvents(*MakeCube(0.15), kCamera, motion, options);
  for (const Estimator estimator : {Estimator::kMixture, Estimator::kStaticMm, Estimator::kErrorStateFilter}) {
    TrackerOptions tracker_options = WithoutInitialization();
    tracker_options.estimator_factory = EstimatorFactoryOf(estimator);
    const TrackRun whole = Track(events, kStart, tracker_options);
    for (const size_t step : {1u, 13u, 4096u}) {
      auto tracker = Tracker::Create(MakeCube(0.15), kCamera, tracker_options, kStart).value();
      std::vector<PoseEstimate> estimates;
      for (size_t i = 0; i < events.size(); i += step) {
        tracker->AddEvents(absl::MakeConstSpan(events).subspan(i, step), estimates);
      }
      tracker->Finish(estimates);
      ASSERT_EQ(estimates.size(), whole.estimates.size());
      for (size_t k = 0; k < estimates.size(); ++k) {
        const PoseEstimate& a = estimates[k];
        const PoseEstimate& b = whole.estimates[k];
        EXPECT_EQ(a.t_us, b.t_us);
        EXPECT_EQ(a.camera_from_object.translation_m, b.camera_from_object.translation_m);
        EXPECT_EQ(a.camera_from_object.rotation, b.camera_from_object.rotation);
        EXPECT_EQ(a.covariance, b.covariance);
        EXPECT_EQ(a.twist, b.twist);
        EXPECT_EQ(a.state, b.state);
      }
    }
  }
}

TEST(Tracker, AStillObjectHoldsItsPoseWithGrowingUncertainty) {
  const Motion motion = StopAndGo();
  IdealEventOptions options;
  options.duration_us = 640'000;
  options.clutter_per_s = 30'000;
  const TrackRun run = Track(MakeIdealEvents(*MakeCube(0.15), kCamera, motion, options), kStart);
  EXPECT_EQ(run.tracker->losses(), 0u);
  EXPECT_EQ(run.tracker->state(), TrackState::kTracking);
  double early = 0.0;
  double late = 0.0;
  int degraded = 0;
  for (const PoseEstimate& estimate : run.estimates) {
    if (estimate.state == TrackState::kDegraded) ++degraded;
    if (estimate.t_us > 130'000 && estimate.t_us < 160'000) early = estimate.covariance.trace();
    if (estimate.t_us > 480'000 && estimate.t_us < 519'000) late = estimate.covariance.trace();
  }
  EXPECT_GT(degraded, 5);
  EXPECT_GT(late, 1.5 * early);
  const Errors errors = Compare(run.estimates, motion);
  EXPECT_LT(errors.position_rmse_of_depth, 3e-3);
  EXPECT_LT(errors.rotation_max_rad, 0.03);
}

TEST(Tracker, AStillObjectIsHeldInDenseNoise) {
  // 6 events per second and pixel, and ten times as many for 50 ms of the rest.
  IdealEventOptions options;
  options.duration_us = 640'000;
  options.clutter_per_s = 6.0 * 640 * 480;
  const Motion motion = StopAndGo();
  std::vector<Event> events = MakeIdealEvents(*MakeCube(0.15), kCamera, motion, options);
  const std::vector<Event> noise = Noise(60.0 * 640 * 480, 300'000, 50'000, 3);
  events.insert(events.end(), noise.begin(), noise.end());
  std::stable_sort(events.begin(), events.end(), [](const Event& a, const Event& b) { return a.t_us < b.t_us; });
  const TrackRun run = Track(events, kStart);
  EXPECT_EQ(run.tracker->losses(), 0u);
  EXPECT_EQ(run.tracker->state(), TrackState::kTracking);
  int degraded = 0;
  double early = 0.0;
  double late = 0.0;
  for (const PoseEstimate& estimate : run.estimates) {
    if (estimate.t_us > 160'000 && estimate.t_us < 519'000 && estimate.state == TrackState::kDegraded) ++degraded;
    if (estimate.t_us > 140'000 && estimate.t_us < 170'000) early = estimate.covariance.trace();
    if (estimate.t_us > 480'000 && estimate.t_us < 519'000) late = estimate.covariance.trace();
  }
  EXPECT_GT(degraded, 300);
  // Noise must not change the pose.
  EXPECT_GT(late, 1.5 * early);
  const Errors errors = Compare(run.estimates, motion);
  EXPECT_LT(errors.position_rmse_of_depth, 3e-3);
  EXPECT_LT(errors.rotation_max_rad, 0.02);
}

// Events of a straight vertical edge over the whole height of the image that moves to the right, 2 per square pixel.
std::vector<Event> SweepingEdge(double speed_px_per_s, double tilt_ratio, int64_t t_begin_us, int64_t t_end_us) {
  Random random(8);
  std::vector<Event> events;
  const double per_us = 2e-6 * speed_px_per_s * kCamera.height_px;
  for (double t_us = static_cast<double>(t_begin_us); t_us < static_cast<double>(t_end_us); t_us += 1.0 / per_us) {
    const double y = random.Uniform(0.0, kCamera.height_px);
    const double x = 1e-6 * (t_us - static_cast<double>(t_begin_us)) * speed_px_per_s +
                     tilt_ratio * (y - 0.5 * kCamera.height_px) + 0.4 * random.Normal();
    if (x < 0.0 || x >= kCamera.width_px) continue;
    events.push_back({static_cast<int64_t>(t_us), static_cast<uint16_t>(x), static_cast<uint16_t>(y), 1});
  }
  return events;
}

TEST(Tracker, AnObjectAtRestDoesNotFollowAnEdgeThatPasses) {
  const Motion motion = StopAndGo();
  IdealEventOptions options;
  options.duration_us = 700'000;
  const std::vector<Event> own = MakeIdealEvents(*MakeCube(0.15), kCamera, motion, options);
  for (const double tilt_ratio : {-0.5, 0.0, 0.25}) {
    // The edge crosses the whole image while the object is at rest, from 120 ms to 520 ms.
    const std::vector<Event> events =
        testing::MergeEvents({own, SweepingEdge(kCamera.width_px / 0.36, tilt_ratio, 130'000, 490'000)});
    const TrackRun run = Track(events, kStart);
    EXPECT_EQ(run.tracker->losses(), 0u) << tilt_ratio;
    EXPECT_EQ(run.tracker->state(), TrackState::kTracking) << tilt_ratio;
    const Errors errors = Compare(run.estimates, motion);
    EXPECT_LT(errors.rotation_max_rad, 0.02) << tilt_ratio;
    EXPECT_LT(errors.position_rmse_of_depth, 2e-3) << tilt_ratio;
  }
}

TEST(Tracker, AFaintObjectThatTurnsBackSlowlyIsFollowed) {
  // Near the turning point each line produces less than one event per millisecond, among as many of noise.
  const Motion motion = [](double t) {
    return Perturb(kStart, 0.4 * (t - 0.3) * (t - 0.3) * Twist(0.25, 0.15, 0.0, 0.3, 0.2, 0.8));
  };
  constexpr int kRuns = 4;
  double mean_rmse = 0.0;
  for (uint64_t seed = 1; seed <= kRuns; ++seed) {
    IdealEventOptions options;
    options.duration_us = 600'000;
    options.events_per_px2 = 0.5;
    options.clutter_per_s = 250'000.0;
    options.seed = seed;
    const TrackRun run = Track(MakeIdealEvents(*MakeCube(0.15), kCamera, motion, options), motion(0.0));
    EXPECT_EQ(run.tracker->losses(), 0u);
    mean_rmse += Compare(run.estimates, motion).position_rmse_of_depth / kRuns;
  }
  EXPECT_LT(mean_rmse, 8e-4);
}

TEST(Tracker, AHighEventRateIsDownsampledAndTracked) {
  const Motion motion = ConstantTwist(kStart, Twist(0.4, 0.2, 0.0, 0.5, 0.5, 0.5));
  IdealEventOptions options;
  options.duration_us = 60'000;
  options.events_per_px2 = 20.0;
  options.clutter_per_s = 10e6;
  const std::vector<Event> events = MakeIdealEvents(*MakeCube(0.15), kCamera, motion, options);
  ASSERT_GT(events.size(), 800'000u);
  const TrackRun run = Track(events, kStart);
  EXPECT_EQ(run.tracker->state(), TrackState::kTracking);
  EXPECT_LE(run.estimates.size(), 60u);
  EXPECT_GT(run.estimates.size(), 40u);
  EXPECT_LT(Compare(run.estimates, motion).position_rmse_of_depth, 1e-3);
}

TEST(Tracker, NoPoseIsReportedOnNoise) {
  for (const double rate_hz : {50e3, 1e6, 10e6}) {
    const TrackRun run = Track(Noise(rate_hz, 0, 60'000, 5), kStart);
    EXPECT_TRUE(run.estimates.empty()) << rate_hz;
    EXPECT_EQ(run.tracker->state(), TrackState::kLost) << rate_hz;
    EXPECT_EQ(run.tracker->losses(), 1u) << rate_hz;
  }
}

TEST(Tracker, DenseNoiseLosesTheTrackSoon) {
  const Motion motion = ConstantTwist(kStart, Twist(0.3, 0.1, 0.0, 0.5, 0.5, 0.5));
  IdealEventOptions options;
  options.duration_us = 50'000;
  std::vector<Event> events = MakeIdealEvents(*MakeCube(0.15), kCamera, motion, options);
  const std::vector<Event> noise = Noise(5e6, 50'000, 60'000, 6);
  events.insert(events.end(), noise.begin(), noise.end());
  const TrackRun run = Track(events, kStart);
  EXPECT_EQ(run.tracker->state(), TrackState::kLost);
  ASSERT_FALSE(run.estimates.empty());
  EXPECT_LT(run.estimates.back().t_us, 100'000);
}

TEST(Tracker, LosesAnObjectThatLeavesTheImage) {
  const Motion motion = ConstantTwist(kStart, Twist(3.0, 0.0, 0.0, 0.0, 0.0, 0.0));
  IdealEventOptions options;
  options.duration_us = 250'000;  // out of view after about 0.16 s
  const TrackRun run =
      Track(MakeIdealEvents(*MakeCube(0.15), kCamera, motion, options), kStart, WithoutInitialization(), false);
  EXPECT_EQ(run.tracker->state(), TrackState::kLost);
  EXPECT_EQ(run.tracker->losses(), 1u);
  ASSERT_FALSE(run.estimates.empty());
  EXPECT_GT(run.estimates.back().t_us, 80'000);
  EXPECT_LT(run.estimates.back().t_us, 210'000);
}

TEST(Tracker, WrongFirstPosesAreNeverReported) {
  const Motion motion = Tumble(1.0);
  IdealEventOptions options;
  options.duration_us = 40'000;
  options.clutter_per_s = 200'000;
  const std::vector<Event> events = MakeIdealEvents(*MakeCube(0.15), kCamera, motion, options);
  Random random(9);
  for (int k = 0; k < 30; ++k) {
    const Eigen::Vector3d rotation{random.Uniform(-1.5, 1.5), random.Uniform(-1.5, 1.5), random.Uniform(-1.5, 1.5)};
    const RigidTransform wrong =
        MakePose({random.Uniform(-0.15, 0.15), random.Uniform(-0.1, 0.1), random.Uniform(0.4, 1.0)}, rotation);
    const TrackRun run = Track(events, wrong);
    EXPECT_EQ(run.tracker->state(), TrackState::kLost) << k;
    EXPECT_TRUE(run.estimates.empty()) << k;
  }
}

TEST(Tracker, AnInaccurateFirstPoseIsCorrected) {
  const Motion motion = ConstantTwist(kStart, Twist(0.3, 0.2, 0.0, 0.5, 0.5, 0.5));
  IdealEventOptions options;
  options.duration_us = 80'000;
  const std::vector<Event> events = MakeIdealEvents(*MakeCube(0.15), kCamera, motion, options);
  const RigidTransform near = Perturb(kStart, Twist(0.002, -0.002, 0.004, 0.01, -0.01, 0.01));
  const TrackRun run = Track(events, near);
  EXPECT_EQ(run.tracker->state(), TrackState::kTracking);
  ASSERT_GT(run.estimates.size(), 20u);
  EXPECT_LT(run.estimates.front().t_us, 15'000);
  const std::vector<PoseEstimate> last(run.estimates.end() - 10, run.estimates.end());
  EXPECT_LT(Compare(last, motion).position_rmse_of_depth, 2e-3);
}

TEST(Tracker, ResetPoseStartsAgain) {
  const Motion motion = ConstantTwist(kStart, Twist(0.3, 0.1, 0.0, 0.5, 0.0, 0.5));
  IdealEventOptions options;
  options.duration_us = 120'000;
  const std::vector<Event> events = MakeIdealEvents(*MakeCube(0.15), kCamera, motion, options);
  const auto middle = static_cast<size_t>(
      std::lower_bound(events.begin(), events.end(), 60'000, [](const Event& e, int64_t t) { return e.t_us < t; }) -
      events.begin());
  TrackRun run = Track({events.begin(), events.begin() + static_cast<std::ptrdiff_t>(middle)},
                       MakePose({0.03, -0.02, 0.6}, {0.1, 0.1, 1.2}), WithoutInitialization(), false);
  EXPECT_EQ(run.tracker->state(), TrackState::kLost);
  EXPECT_TRUE(run.estimates.empty());

  run.tracker->ResetPose(motion(events[middle - 1].t_us * 1e-6));
  EXPECT_EQ(run.tracker->state(), TrackState::kInitializing);
  run.tracker->AddEvents(absl::MakeConstSpan(events).subspan(middle), run.estimates);
  run.tracker->Finish(run.estimates);
  EXPECT_EQ(run.tracker->state(), TrackState::kTracking);
  EXPECT_EQ(run.tracker->losses(), 1u);
  EXPECT_GT(run.estimates.size(), 20u);
  EXPECT_LT(Compare(run.estimates, motion).position_rmse_of_depth, 2e-3);
}

TEST(Tracker, WithoutAPoseItStaysInitializing) {
  const TrackRun run = Track(Noise(1e6, 0, 30'000, 7), std::nullopt);
  EXPECT_EQ(run.tracker->state(), TrackState::kInitializing);
  EXPECT_TRUE(run.estimates.empty());
  EXPECT_EQ(run.tracker->losses(), 0u);
}

TEST(Tracker, APoseOutsideTheImageIsLostAtOnce) {
  const TrackRun run =
      Track(Noise(1e6, 0, 5'000, 8), MakePose({5.0, 0.0, 0.6}, {0.0, 0.0, 0.0}), WithoutInitialization(), false);
  EXPECT_EQ(run.tracker->state(), TrackState::kLost);
  EXPECT_TRUE(run.estimates.empty());
}

TEST(Tracker, TimeMarksCloseWindowsWithoutEvents) {
  const Motion motion = ConstantTwist(kStart, Twist(0.3, 0.1, 0.0, 0.5, 0.0, 0.5));
  IdealEventOptions options;
  options.duration_us = 50'000;
  TrackRun run =
      Track(MakeIdealEvents(*MakeCube(0.15), kCamera, motion, options), kStart, WithoutInitialization(), false);
  const size_t before = run.estimates.size();
  run.tracker->AdvanceTime(150'000, run.estimates);
  ASSERT_GT(run.estimates.size(), before + 3);
  EXPECT_EQ(run.estimates.back().state, TrackState::kDegraded);
  EXPECT_LT(run.estimates.back().t_us, 150'000);
}

// The detectors of the search index their tables by the time since the first event.
TEST(Tracker, EventsThatStepBackInTimeAreSearched) {
  testing::IdealEventOptions options;
  options.duration_us = 40'000;
  options.clutter_per_s = 2'000'000;
  const Motion motion = testing::ConstantTwist(kStart, Twist(0.3, 0.2, 0.1, 1.0, -0.8, 0.6));
  std::vector<Event> events = testing::MakeIdealEvents(*Cube(), kCamera, motion, options);
  constexpr size_t kBlock = 500;
  for (size_t i = 0; i + kBlock <= events.size(); i += kBlock) {
    const auto begin = events.begin() + static_cast<std::ptrdiff_t>(i);
    std::reverse(begin, begin + kBlock);
  }
  auto tracker = Tracker::Create(Cube(), kCamera, IdealSensor(), std::nullopt).value();
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(events, estimates);
  EXPECT_GE(tracker->initialization().attempts, 1u);
}

TEST(Tracker, TheNumberOfEventsLimitsTheMotionOfASlowObject) {
  // 10 px/s: the windows hold 150 events each, in which the cube moves by less than a tenth of a pixel.
  const Vector6d twist = Twist(0.008, 0.004, 0.0, 0.02, 0.03, 0.02);
  testing::IdealEventOptions events;
  events.duration_us = 500'000;
  events.clutter_per_s = 3000;
  auto tracker = Tracker::Create(Cube(), kCamera, WithoutInitialization(), kStart).value();
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(testing::MakeIdealEvents(*Cube(), kCamera, testing::ConstantTwist(kStart, twist), events),
                     estimates);
  ASSERT_GT(estimates.size(), 20u);
  for (const PoseEstimate& estimate : estimates) {
    EXPECT_LT((estimate.twist - twist).tail<3>().norm(), 0.2) << estimate.t_us;
    EXPECT_EQ(estimate.state, TrackState::kTracking);
  }
}

}  // namespace
}  // namespace evpose
