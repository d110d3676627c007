// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/estimators/error_state_filter.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <vector>

#include "core/estimation/ideal_events_testing.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

MotionState Prior(Random& random) {
  MotionState state;
  state.camera_from_object = testing::MakePose({0.1, 0.0, 0.8}, {0.3, -0.2, 0.5});
  Matrix12d root;
  for (int i = 0; i < 144; ++i) root(i) = random.Normal();
  state.covariance = root * root.transpose() + 0.1 * Matrix12d::Identity();
  return state;
}

Vector12d Row(Random& random) {
  Vector12d row;
  for (int k = 0; k < 12; ++k) row[k] = random.Normal();
  return row;
}

// Sequential updates give the same result as the batch: the minimum of the squares under the prior, and its covariance.
TEST(ErrorState, UpdatesEqualTheBatch) {
  constexpr double kNoisePx2 = 0.64;
  Random random(1);
  const MotionState prior = Prior(random);
  ErrorState error(prior);
  Matrix12d information = prior.covariance.inverse();
  Vector12d gradient = Vector12d::Zero();
  for (int i = 0; i < 40; ++i) {
    const Vector12d row = Row(random);
    const double distance_px = random.Normal();
    error.Update(distance_px, row, kNoisePx2);
    information += row * row.transpose() / kNoisePx2;
    gradient += row * distance_px / kNoisePx2;
  }
  const Vector12d expected = -information.ldlt().solve(gradient);
  const Vector12d row = Row(random);
  EXPECT_NEAR(error.ExpectedPx(2.0, row), 2.0 + row.dot(expected), 1e-9);
  EXPECT_NEAR(error.VariancePx2(row), row.dot(information.ldlt().solve(row)), 1e-9);

  error.Inject();
  EXPECT_LT((Minus(error.state(), prior) - expected).norm(), 1e-9);
  EXPECT_LT((error.state().covariance - information.inverse()).norm(), 1e-9);
  EXPECT_EQ(error.state().covariance, error.state().covariance.transpose());
  EXPECT_EQ(error.ExpectedPx(2.0, row), 2.0) << "the error is in the state now";
}

}  // namespace
}  // namespace evpose
