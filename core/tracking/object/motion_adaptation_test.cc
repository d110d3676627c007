// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/motion_adaptation.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>

#include "core/numerics/random.h"

namespace evpose {
namespace {

// A filter that measures the pose, with white noise of `noise` radians and metres, every 10 ms while the twist performs
// a random walk with `factor` times the densities of the options. Returns the ratio after 30 s.
double RatioAfter(double factor, double noise) {
  Random random(5);
  MotionPriorOptions options;
  options.turn_time_s = 1e6;
  MotionAdaptation adaptation;
  MotionState truth, state;
  truth.camera_from_object.translation_m.z() = state.camera_from_object.translation_m.z() = 1.0;
  state.covariance = 1e-4 * Matrix12d::Identity();
  for (int i = 1; i <= 3000; ++i) {
    const int64_t t_us = int64_t{10'000} * i;
    truth = Predict(truth, t_us, options);
    for (int k = 0; k < 6; ++k) {
      const double density = k < 3 ? options.linear_acceleration_density : options.angular_acceleration_density;
      truth.twist[k] = 0.99 * truth.twist[k] + factor * density * 0.1 * random.Normal();
    }
    const MotionState predicted = Predict(state, t_us, adaptation.Adapted(options));
    Vector6d measured = Difference(truth.camera_from_object, predicted.camera_from_object);
    for (int k = 0; k < 6; ++k) measured[k] += noise * random.Normal();
    Matrix12d information = predicted.covariance.inverse();
    information.topLeftCorner<6, 6>() += Matrix6d::Identity() / (noise * noise);
    const Matrix12d covariance = information.inverse();
    state = Plus(predicted, covariance.leftCols<6>() * measured / (noise * noise));
    state.covariance = covariance;
    adaptation.Add(MotionAdaptation::Compare(predicted, state));
  }
  return adaptation.ratio();
}

TEST(MotionAdaptationTest, KeepsTheDensitiesOfAnAgileObject) { EXPECT_GT(RatioAfter(1.0, 1e-3), 0.4); }

TEST(MotionAdaptationTest, ReducesThemForASteadyOne) {
  EXPECT_LT(RatioAfter(0.1, 1e-3), 0.1);
  EXPECT_LT(RatioAfter(0.0, 1e-3), 0.01);
}

TEST(MotionAdaptationTest, OnlyASignificantInnovationExceedsTheReducedDensities) {
  MotionAdaptation adaptation;
  EXPECT_FALSE(adaptation.IsSignificant({1000.0, 6.0})) << "the densities are not reduced";
  while (adaptation.ratio() > 0.1) adaptation.Add({1.0, 6.0});
  EXPECT_FALSE(adaptation.IsSignificant({12.0, 6.0}));
  EXPECT_TRUE(adaptation.IsSignificant({40.0, 6.0}));
  EXPECT_TRUE(adaptation.IsSignificant({std::nan(""), 6.0}));
}

// Adds the innovations of `count` windows. Each measures two directions, and the variance of the innovations is
// `variance` times the expected variance. Returns the number of times at which the full densities were restored.
int CountResets(double variance, int count, Random& random, MotionAdaptation& adaptation) {
  int resets = 0;
  for (int i = 0; i < count; ++i) {
    const double before = adaptation.ratio();
    const double x = random.Normal(), y = random.Normal();
    adaptation.Add({variance * (x * x + y * y), 2.0});
    resets += before < 0.5 && adaptation.ratio() == 1.0 ? 1 : 0;
  }
  return resets;
}

TEST(MotionAdaptationTest, AnAccelerationRestoresTheDensitiesWithinTenWindows) {
  // The variance of the innovations is 0.4 times the expected one at first, as where events are less uncertain than
  // assumed, and then five times as large.
  for (const uint64_t seed : {1, 2, 3, 4, 5}) {
    Random random(seed);
    MotionAdaptation adaptation;
    CountResets(0.4, 2000, random, adaptation);
    ASSERT_EQ(adaptation.ratio(), MotionAdaptation::kMinRatio);
    EXPECT_EQ(CountResets(2.0, 10, random, adaptation), 1) << "seed " << seed;
  }
}

TEST(MotionAdaptationTest, ASteadyMotionKeepsTheReducedDensities) {
  for (const double variance : {0.1, 0.4, 0.8}) {
    Random random(1);
    MotionAdaptation adaptation;
    CountResets(variance, 1000, random, adaptation);
    EXPECT_LE(CountResets(variance, 100'000, random, adaptation), 4) << "variance " << variance;
  }
}

TEST(MotionAdaptationTest, ALimitAppliesInPlaceOfTheLearnedRatio) {
  const MotionPriorOptions options;
  MotionAdaptation adaptation;
  while (adaptation.ratio() > 0.5) adaptation.Add({1.0, 6.0});
  const double learned = adaptation.ratio();
  adaptation.Limit(0.01);
  EXPECT_EQ(adaptation.ratio(), 0.01);
  EXPECT_DOUBLE_EQ(adaptation.Adapted(options).angular_acceleration_density,
                   0.1 * options.angular_acceleration_density);
  EXPECT_DOUBLE_EQ(adaptation.Adapted(options).linear_acceleration_density, 0.1 * options.linear_acceleration_density);
  adaptation.Add({1.0, 6.0});
  EXPECT_FALSE(adaptation.IsSignificant({1000.0, 6.0}));
  adaptation.Limit(0.0);
  EXPECT_EQ(adaptation.ratio(), MotionAdaptation::kMinRatio);
  adaptation.Limit(2.0);
  EXPECT_EQ(adaptation.ratio(), learned);
}

}  // namespace
}  // namespace evpose
