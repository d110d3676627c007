// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/motion_prior.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>

#include "core/estimation/ideal_events_testing.h"

namespace evpose {
namespace {

using testing::MakePose;

TEST(MotionPrior, InitialUncertaintyIsThatOfTheOptions) {
  InitialPoseOptions options;
  const MotionState state = InitialMotionState(MakePose({0.0, 0.0, 2.0}, {0.1, 0.2, 0.3}), 7, 1000.0, options);
  EXPECT_EQ(state.t_us, 7);
  EXPECT_NEAR(std::sqrt(state.covariance(0, 0)), options.lateral_px * 2.0 / 1000.0, 1e-12);
  EXPECT_NEAR(std::sqrt(state.covariance(2, 2)), options.depth_ratio * 2.0, 1e-12);
  EXPECT_NEAR(std::sqrt(state.covariance(4, 4)), options.rotation_rad, 1e-12);
  EXPECT_NEAR(std::sqrt(state.covariance(7, 7)), options.velocity_px_per_s * 2.0 / 1000.0, 1e-12);
}

TEST(MotionPrior, PredictionFollowsTheTwist) {
  MotionState state;
  state.camera_from_object = MakePose({0.1, 0.0, 1.0}, {0.0, 0.0, 0.0});
  state.twist << 1.0, 0.0, 0.0, 0.0, 0.0, 2.0;
  const MotionState predicted = Predict(state, 10'000, MotionPriorOptions());
  EXPECT_NEAR(predicted.camera_from_object.translation_m.x(), 0.11, 1e-12);
  EXPECT_NEAR(LogSo3(predicted.camera_from_object.rotation).z(), 0.02, 1e-12);
  EXPECT_EQ(predicted.t_us, 10'000);
}

TEST(MotionPrior, CovarianceIsThatOfWhiteAccelerationInOneStepOrMany) {
  MotionState state = InitialMotionState(MakePose({0.0, 0.0, 1.0}, {0.0, 0.0, 0.0}), 0, 1000.0, InitialPoseOptions());
  const MotionPriorOptions options;
  const MotionState once = Predict(state, 20'000, options);
  MotionState often = state;
  for (int k = 1; k <= 20; ++k) often = Predict(often, int64_t{1000} * k, options);
  EXPECT_LT((once.covariance - often.covariance).norm(), 1e-9 * once.covariance.norm());
  // The covariance without initial uncertainty is q t^3 / 3, q t^2 / 2, q t.
  state.covariance.setZero();
  const MotionState noise = Predict(state, 1'000'000, options, 2.0);
  const double q = 2.0 * options.angular_acceleration_density * options.angular_acceleration_density;
  EXPECT_NEAR(noise.covariance(3, 3), q / 3.0, 1e-9);
  EXPECT_NEAR(noise.covariance(3, 9), q / 2.0, 1e-9);
  EXPECT_NEAR(noise.covariance(9, 9), q, 1e-9);
  EXPECT_GT(noise.covariance.ldlt().vectorD().minCoeff(), 0.0);
}

TEST(MotionPrior, ProcessNoiseGrowsWithTheSpeed) {
  MotionState state = InitialMotionState(MakePose({0.0, 0.0, 1.0}, {0.0, 0.0, 0.0}), 0, 1000.0, InitialPoseOptions());
  state.covariance.setZero();
  const MotionPriorOptions options;
  const double still = Predict(state, 10'000, options).covariance(6, 6);
  state.twist[0] = 3.0;
  const MotionState fast = Predict(state, 10'000, options);
  EXPECT_NEAR(fast.covariance(6, 6) - still, 3.0 * 3.0 / options.turn_time_s * 0.01, 1e-9);
  EXPECT_NEAR(fast.covariance(9, 9), options.angular_acceleration_density * options.angular_acceleration_density * 0.01,
              1e-9);
}

TEST(MotionPrior, MinusIsTheInverseOfPlus) {
  MotionState state;
  state.camera_from_object = MakePose({0.1, -0.2, 1.0}, {0.3, 0.2, -0.5});
  Vector12d dx;
  dx << 0.01, 0.02, -0.03, 0.1, -0.2, 0.05, 1.0, 2.0, 3.0, -1.0, -2.0, -3.0;
  EXPECT_LT((Minus(Plus(state, dx), state) - dx).norm(), 1e-12);
}

}  // namespace
}  // namespace evpose
