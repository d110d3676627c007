// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/covariance_inverse.h"

#include <gtest/gtest.h>

#include <cmath>

#include "core/numerics/random.h"

namespace evpose {
namespace {

// A matrix with variances from 1 down to `least`, as those of a velocity and of a position.
Matrix12d RandomCovariance(Random& random, double least) {
  Matrix12d root;
  for (int j = 0; j < 12; ++j) {
    for (int i = 0; i < 12; ++i) root(i, j) = random.Normal();
  }
  Vector12d scale;
  for (int i = 0; i < 12; ++i) scale[i] = i < 6 ? std::sqrt(least) : 1.0;
  return scale.asDiagonal() * (root * root.transpose()) * scale.asDiagonal();
}

TEST(CovarianceInverse, IsTheInverse) {
  Random random(3);
  for (int trial = 0; trial < 100; ++trial) {
    const Matrix12d covariance = RandomCovariance(random, trial % 2 == 0 ? 1.0 : 1e-8);
    const Matrix12d inverse = CovarianceInverse(covariance);
    EXPECT_EQ(inverse, inverse.transpose());
    const Matrix12d product = inverse * covariance;
    EXPECT_TRUE(product.isApprox(Matrix12d::Identity(), 1e-6)) << product;
  }
}

TEST(CovarianceInverse, ReadsTheLowerTriangle) {
  Random random(4);
  const Matrix12d covariance = RandomCovariance(random, 1.0);
  Matrix12d lower = covariance;
  lower.triangularView<Eigen::StrictlyUpper>().setConstant(7.0);
  EXPECT_EQ(CovarianceInverse(lower), CovarianceInverse(covariance));
}

TEST(CovarianceInverse, ADirectionWithoutVarianceStaysWithoutInformation) {
  Matrix12d covariance = 4.0 * Matrix12d::Identity();
  covariance(5, 5) = 0.0;
  Matrix12d expected = 0.25 * Matrix12d::Identity();
  expected(5, 5) = 0.0;
  EXPECT_EQ(CovarianceInverse(covariance), expected);
}

}  // namespace
}  // namespace evpose
