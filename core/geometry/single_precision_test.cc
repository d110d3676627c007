// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/single_precision.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

namespace evpose {
namespace {

// A covariance with standard deviations between 1e-4 and `largest` in random directions.
Matrix6d RandomCovariance(double largest, std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  const Matrix6d directions =
      Eigen::HouseholderQR<Matrix6d>(Matrix6d::NullaryExpr([&] { return normal(random); })).householderQ();
  std::uniform_real_distribution<double> exponent(-4.0, std::log10(largest));
  const Vector6d sigmas = Vector6d::NullaryExpr([&] { return std::pow(10.0, exponent(random)); });
  const Matrix6d root = directions * sigmas.asDiagonal();
  return root * root.transpose();
}

TEST(SinglePrecisionTest, KeepsTheCovarianceToSixDigitsAndFindsItsRoot) {
  std::mt19937_64 random(1);
  for (int i = 0; i < 1000; ++i) {
    const Matrix6d covariance = RandomCovariance(1e-2, random);
    const Matrix6d rounded = InSinglePrecision(covariance);
    // The metric is that of the covariance, so that every direction counts by its own accuracy.
    const Eigen::GeneralizedSelfAdjointEigenSolver<Matrix6d> ratios(rounded, covariance);
    EXPECT_NEAR(ratios.eigenvalues().minCoeff(), 1.0, 1e-4);
    EXPECT_NEAR(ratios.eigenvalues().maxCoeff(), 1.0, 1e-4);
    EXPECT_EQ(rounded, rounded.transpose());
    const std::optional<CovarianceRoot> root = FindCovarianceRoot(rounded);
    ASSERT_TRUE(root.has_value()) << i;
    EXPECT_EQ(CovarianceOf(*root), rounded);
    EXPECT_EQ(InSinglePrecision(rounded), rounded) << "rounding again changes nothing";
  }
}

// The free direction of a symmetric object has a variance of 1e6 times the others: rounded elements would not be
// positive definite.
TEST(SinglePrecisionTest, StaysPositiveDefiniteBesideAFreeDirection) {
  std::mt19937_64 random(2);
  int with_root = 0;
  for (int i = 0; i < 1000; ++i) {
    const Matrix6d rounded = InSinglePrecision(RandomCovariance(3.0, random));
    EXPECT_EQ(Eigen::LLT<Matrix6d>(rounded).info(), Eigen::Success) << i;
    with_root += FindCovarianceRoot(rounded).has_value();
  }
  EXPECT_GE(with_root, 990);
}

TEST(SinglePrecisionTest, LeavesOtherMatricesAsTheyAre) {
  const Matrix6d zero = Matrix6d::Zero();
  EXPECT_EQ(InSinglePrecision(zero), zero);
  EXPECT_FALSE(FindCovarianceRoot(zero).has_value());
  Matrix6d indefinite = Matrix6d::Identity();
  indefinite(3, 3) = -1.0;
  EXPECT_EQ(InSinglePrecision(indefinite), indefinite);
  const Matrix6d huge = Matrix6d::Identity() * 1e90;
  EXPECT_EQ(InSinglePrecision(huge), huge);
  Matrix6d undefined = Matrix6d::Identity();
  undefined(2, 1) = undefined(1, 2) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(FindCovarianceRoot(undefined).has_value());
}

TEST(SinglePrecisionTest, ACovarianceOfOtherBitsHasNoRoot) {
  Matrix6d covariance = Matrix6d::Identity();
  EXPECT_TRUE(FindCovarianceRoot(covariance).has_value());
  covariance(0, 0) = std::nextafter(1.0, 2.0);
  EXPECT_FALSE(FindCovarianceRoot(covariance).has_value());
}

TEST(SinglePrecisionTest, EveryElementOfATwistIsRounded) {
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  for (int i = 0; i < 100; ++i) {
    const Vector6d twist = Vector6d::NullaryExpr([&] { return normal(random); });
    const Vector6d rounded = InSinglePrecision(twist);
    for (int k = 0; k < 6; ++k) {
      volatile float expected = static_cast<float>(twist[k]);  // volatile: the compiler must convert
      EXPECT_EQ(rounded[k], static_cast<double>(expected)) << k;
    }
  }
}

}  // namespace
}  // namespace evpose
