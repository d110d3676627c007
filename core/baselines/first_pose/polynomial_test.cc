// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/polynomial.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace evpose {
namespace {

using ::testing::DoubleNear;
using ::testing::ElementsAre;
using ::testing::IsEmpty;

Eigen::VectorXd FromRoots(const std::vector<double>& roots) {
  Eigen::VectorXd product = Eigen::VectorXd::Ones(1);
  for (const double root : roots) product = PolynomialProduct(product, Eigen::Vector2d(-root, 1.0));
  return product;
}

TEST(Polynomial, RootsComeBack) {
  EXPECT_THAT(RealRoots(FromRoots({3.0, -1.0, 0.5, 20.0, -7.0})),
              ElementsAre(DoubleNear(-7.0, 1e-12), DoubleNear(-1.0, 1e-12), DoubleNear(0.5, 1e-12),
                          DoubleNear(3.0, 1e-12), DoubleNear(20.0, 1e-11)));
}

TEST(Polynomial, ComplexRootsAreLeftOutAndPartedDoubleRootsMayCount) {
  const Eigen::VectorXd circle = Eigen::Vector3d(1.0, 0.0, 1.0);
  EXPECT_THAT(RealRoots(circle), IsEmpty());
  EXPECT_THAT(RealRoots(PolynomialProduct(circle, FromRoots({2.0}))), ElementsAre(DoubleNear(2.0, 1e-12)));
  // (x - 1)^2 + 1e-8: two roots 1e-4 from the real axis.
  const Eigen::VectorXd parted = Eigen::Vector3d(1.0 + 1e-8, -2.0, 1.0);
  EXPECT_THAT(RealRoots(parted), IsEmpty());
  EXPECT_THAT(RealRoots(parted, 1e-3), ElementsAre(DoubleNear(1.0, 1e-6)));
}

TEST(Polynomial, VanishingLeadingCoefficientsLowerTheDegree) {
  Eigen::VectorXd a(4);
  a << 2.0, -1.0, 1e-20, 0.0;
  EXPECT_THAT(RealRoots(a), ElementsAre(DoubleNear(2.0, 1e-12)));
  EXPECT_THAT(RealRoots(Eigen::VectorXd::Constant(1, 3.0)), IsEmpty());
  EXPECT_THAT(RealRoots(Eigen::VectorXd::Zero(4)), IsEmpty());
}

TEST(Polynomial, DerivativeAndValue) {
  const Eigen::VectorXd a = Eigen::Vector4d(1.0, -2.0, 3.0, 4.0);
  EXPECT_DOUBLE_EQ(PolynomialValue(a, 2.0), 1.0 - 4.0 + 12.0 + 32.0);
  EXPECT_EQ(PolynomialDerivative(a), Eigen::Vector3d(-2.0, 6.0, 12.0));
}

}  // namespace
}  // namespace evpose
