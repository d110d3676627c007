// SPDX-License-Identifier: Apache-2.0
#include "core/evaluation/consistency.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <limits>

#include "core/models/continuous_symmetry.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

const RigidTransform kTruth = {ExpSo3({0.3, -0.5, 0.2}), {0.1, -0.2, 1.4}};

// A covariance like that of a tracker: millimetres and milliradians, with correlated depth and tilt.
Matrix6d Covariance() {
  Matrix6d factor = Matrix6d::Zero();
  factor.diagonal() << 2e-4, 3e-4, 2e-3, 4e-3, 1e-3, 5e-4;
  factor(2, 0) = 1e-3;
  factor(3, 2) = -2e-3;
  factor(5, 1) = 3e-4;
  return factor * factor.transpose();
}

RigidTransform Draw(const Matrix6d& covariance, Random& random) {
  Vector6d normal;
  for (double& value : normal) value = random.Normal();
  // Perturb(estimate, e) = truth.
  const Vector6d error = covariance.llt().matrixL() * normal;
  RigidTransform estimate = Perturb(kTruth, -error);
  return estimate;
}

TEST(ConsistencyTest, AConsistentCovarianceHasTheQuantilesOfChiSquare) {
  Random random(3);
  std::vector<double> values;
  for (int i = 0; i < 40'000; ++i) {
    values.push_back(NormalisedErrorSquared(kTruth, Draw(Covariance(), random), Covariance()));
  }
  const Consistency consistency = SummariseConsistency(values);
  EXPECT_EQ(consistency.num_poses, 40'000u);
  EXPECT_EQ(consistency.num_without, 0u);
  EXPECT_NEAR(consistency.median, kNeesMedian, 0.08);
  EXPECT_NEAR(consistency.p5, 1.635, 0.05);
  EXPECT_NEAR(consistency.p95, 12.592, 0.2);
  EXPECT_NEAR(consistency.inside_95_ratio, 0.95, 0.004);
}

TEST(ConsistencyTest, DetectsACovarianceThatIsTooSmall) {
  Random random(3);
  std::vector<double> values;
  for (int i = 0; i < 10'000; ++i) {
    values.push_back(NormalisedErrorSquared(kTruth, Draw(Covariance(), random), 0.25 * Covariance()));
  }
  EXPECT_NEAR(SummariseConsistency(values).median, 4.0 * kNeesMedian, 0.5);
}

TEST(ConsistencyTest, ByHand) {
  Matrix6d covariance = Matrix6d::Identity();
  covariance(0, 0) = 1e-4;  // 10 mm
  covariance(5, 5) = 4e-4;  // 20 mrad
  RigidTransform estimate = kTruth;
  estimate.translation_m.x() -= 0.02;
  EXPECT_NEAR(NormalisedErrorSquared(kTruth, estimate, covariance), 4.0, 1e-9);
  estimate.rotation = ExpSo3({0.0, 0.0, -0.06}) * kTruth.rotation;
  EXPECT_NEAR(NormalisedErrorSquared(kTruth, estimate, covariance), 4.0 + 9.0, 1e-6);
}

TEST(ConsistencyTest, OfASymmetricObjectTheFreeDirectionsDoNotCount) {
  const ContinuousSymmetry axis = {ContinuousSymmetry::Kind::kAxis, {0.1, -0.2, 0.3}, Eigen::Vector3d::UnitY(), false};
  const ContinuousSymmetry ball = {ContinuousSymmetry::Kind::kSphere, {0.1, -0.2, 0.3}, Eigen::Vector3d::Zero(), false};
  EXPECT_EQ(NumObservable(std::nullopt), 6);
  EXPECT_EQ(NumObservable(axis), 5);
  EXPECT_EQ(NumObservable(ball), 3);
  Random random(7);
  // Medians of chi-square distributions with five and three degrees of freedom.
  for (const auto& [symmetry, median] : {std::pair{axis, 4.351}, {ball, 2.366}}) {
    for (const double free_variance : {0.0, 3.29}) {
      std::vector<double> values;
      for (int i = 0; i < 20'000; ++i) {
        const RigidTransform estimate = Draw(Covariance(), random);
        const FreeDirections free = FreeDirectionsAt(symmetry, estimate);
        const Matrix6d covariance = Covariance() + free_variance * free * free.transpose();
        values.push_back(NormalisedErrorSquared(kTruth, estimate, covariance, symmetry));
      }
      const Consistency consistency = SummariseConsistency(values, NumObservable(symmetry));
      EXPECT_NEAR(consistency.median, median, 0.1) << free_variance;
      EXPECT_NEAR(consistency.inside_95_ratio, 0.95, 0.005) << free_variance;
    }
  }
}

TEST(ConsistencyTest, CountsPosesWithoutCovariance) {
  Matrix6d singular = Matrix6d::Identity();
  singular(2, 2) = 0.0;
  Matrix6d infinite = Matrix6d::Identity();
  infinite(1, 1) = std::numeric_limits<double>::infinity();
  EXPECT_TRUE(std::isnan(NormalisedErrorSquared(kTruth, kTruth, singular)));
  EXPECT_TRUE(std::isnan(NormalisedErrorSquared(kTruth, kTruth, infinite)));
  const Consistency consistency = SummariseConsistency({std::numeric_limits<double>::quiet_NaN(), 1.0, 2.0, 3.0});
  EXPECT_EQ(consistency.num_poses, 3u);
  EXPECT_EQ(consistency.num_without, 1u);
  EXPECT_EQ(consistency.median, 2.0);
  EXPECT_EQ(consistency.inside_95_ratio, 1.0);
  EXPECT_TRUE(std::isnan(SummariseConsistency({}).median));
}

}  // namespace
}  // namespace evpose
