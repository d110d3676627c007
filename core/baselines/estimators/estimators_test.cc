// SPDX-License-Identifier: Apache-2.0

// Every estimator through the common interface, on ideal events of a cube.
#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <vector>

#include "core/baselines/estimators/estimator_factory.h"
#include "core/estimation/estimator.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/numerics/statistics.h"
#include "core/tracking/object/tracker_options.h"
#include "core/tracking/tracker.h"

namespace evpose {
namespace {

using testing::IdealEventOptions;
using testing::Motion;

const CameraModel kCamera = testing::MakeCamera(640, 480, 600.0);

Motion Drift() {
  Vector6d twist;
  twist << 0.2, -0.1, 0.05, 0.5, 1.0, -0.5;
  return testing::ConstantTwist(testing::MakePose({0.02, -0.01, 0.6}, {0.6, 0.5, 0.2}), twist);
}

TrackerOptions With(Estimator estimator) {
  TrackerOptions options;
  options.estimator_factory = EstimatorFactoryOf(estimator);
  options.initialization.is_automatic = false;
  options.sensor = testing::UnbiasedSensor();
  return options;
}

std::vector<PoseEstimate> Track(Estimator estimator, double clutter_per_s) {
  IdealEventOptions events;
  events.duration_us = 60'000;
  events.clutter_per_s = clutter_per_s;
  const auto cube = testing::MakeCube(0.15);
  auto tracker = Tracker::Create(cube, kCamera, With(estimator), Drift()(0.0)).value();
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(testing::MakeIdealEvents(*cube, kCamera, Drift(), events), estimates);
  tracker->Finish(estimates);
  return estimates;
}

double MedianError(const std::vector<PoseEstimate>& estimates) {
  std::vector<double> errors;
  for (const PoseEstimate& estimate : estimates) {
    const Vector6d error = Difference(estimate.camera_from_object, Drift()(static_cast<double>(estimate.t_us) * 1e-6));
    errors.push_back(error.tail<3>().norm());
  }
  return UpperMedian(errors);
}

class Estimators : public ::testing::TestWithParam<std::pair<Estimator, std::string_view>> {};
INSTANTIATE_TEST_SUITE_P(All, Estimators, ::testing::ValuesIn(kEstimatorNames), [](const auto& named) {
  std::string name(named.param.second);
  name.erase(std::remove(name.begin(), name.end(), '-'), name.end());
  return name;
});

TEST_P(Estimators, FollowsTheCube) {
  const std::vector<PoseEstimate> estimates = Track(GetParam().first, 20'000);
  ASSERT_GT(estimates.size(), 30u);
  EXPECT_GT(estimates.back().t_us, 55'000);
  EXPECT_LT(MedianError(estimates), 0.02);
}

TEST_P(Estimators, IsDeterministic) {
  const std::vector<PoseEstimate> first = Track(GetParam().first, 20'000);
  const std::vector<PoseEstimate> second = Track(GetParam().first, 20'000);
  ASSERT_EQ(first.size(), second.size());
  for (size_t i = 0; i < first.size(); ++i) {
    EXPECT_EQ(first[i].camera_from_object.rotation, second[i].camera_from_object.rotation);
    EXPECT_EQ(first[i].covariance, second[i].covariance);
  }
}

// Without events the predicted state is kept.
TEST_P(Estimators, WithoutEventsThePredictionIsKept) {
  const auto estimator = With(GetParam().first).MakeEstimator(kCamera);
  MotionState predicted;
  predicted.t_us = 1000;
  predicted.camera_from_object = Drift()(0.0);
  predicted.covariance = 1e-6 * Matrix12d::Identity();
  const LineEvents nothing;
  WindowInput input;
  input.sorted = &nothing;
  input.duration_s = 0.001;
  WindowFit fit;
  estimator->Fit(predicted, input, 1.0, fit);
  EXPECT_EQ(fit.num_gated, 0.0);
  EXPECT_LT(Difference(fit.state.camera_from_object, predicted.camera_from_object).norm(), 1e-12);
  EXPECT_LT((fit.state.covariance - predicted.covariance).norm(), 1e-12);
}

TEST(EstimatorsTest, RobustOnesTolerateClutter) {
  constexpr double kClutterPerS = 1'000'000;
  const double least_squares = MedianError(Track(Estimator::kStaticLs, kClutterPerS));
  EXPECT_LT(MedianError(Track(Estimator::kStaticM, kClutterPerS)), 0.8 * least_squares);
  EXPECT_LT(MedianError(Track(Estimator::kStaticMm, kClutterPerS)), 0.8 * least_squares);
  EXPECT_LT(MedianError(Track(Estimator::kMixture, kClutterPerS)), 0.8 * least_squares);
}

TEST(EstimatorsTest, TheReleasedOnesUseHiddenLinesAndNoPrediction) {
  for (const auto& [estimator, name] : kEstimatorNames) {
    const bool is_released = name.substr(0, 8) == "released";
    const auto made = With(estimator).MakeEstimator(kCamera);
    EXPECT_EQ(made->UsesVisibility(), !is_released) << name;
    EXPECT_EQ(made->UsesPrediction(), !is_released) << name;
  }
}

}  // namespace
}  // namespace evpose
