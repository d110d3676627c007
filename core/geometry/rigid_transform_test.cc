// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/rigid_transform.h"

#include <ceres/jet.h>
#include <ceres/rotation.h>
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>
#include <string>

namespace evpose {
namespace {

constexpr double kPi = std::numbers::pi;

class RandomTransforms {
 public:
  Eigen::Vector3d Axis() { return Eigen::Vector3d(normal_(engine_), normal_(engine_), normal_(engine_)).normalized(); }
  double Uniform(double low, double high) { return std::uniform_real_distribution<double>(low, high)(engine_); }
  Vector6d Tangent(double angle_rad) {
    Vector6d tangent;
    tangent << Uniform(-2, 2), Uniform(-2, 2), Uniform(-2, 2), angle_rad * Axis();
    return tangent;
  }

 private:
  std::mt19937_64 engine_{1};
  std::normal_distribution<double> normal_;
};

// Angles from far below the limit of the series to the neighbourhood of pi.
const double kAngles[] = {0.0,  1e-200, 1e-12, 1e-8,       1e-4,       0.1,        0.2499999,  0.25,
                          0.26, 1.0,    3.0,   kPi - 1e-3, kPi - 1e-6, kPi - 1e-9, kPi - 1e-14};

TEST(RigidTransformTest, ExpSo3EqualsCeres) {
  RandomTransforms random;
  for (const double angle : kAngles) {
    const Eigen::Vector3d rotation = angle * random.Axis();
    Eigen::Matrix3d expected;
    ceres::AngleAxisToRotationMatrix(rotation.data(), expected.data());
    EXPECT_LT((ExpSo3(rotation) - expected).norm(), 1e-14) << angle;
  }
}

TEST(RigidTransformTest, LogSo3InvertsExpSo3) {
  RandomTransforms random;
  for (const double angle : kAngles) {
    for (int i = 0; i < 50; ++i) {
      const Eigen::Vector3d rotation = angle * random.Axis();
      const Eigen::Vector3d back = LogSo3(ExpSo3(rotation));
      // Within rounding of pi the axis may have the other sign: the same rotation.
      const double error = std::min((back - rotation).norm(), kPi - angle < 1e-12 ? (back + rotation).norm() : 1.0);
      EXPECT_LT(error, 4e-15 * std::max(1.0, angle) + 1e-15) << angle;
    }
  }
}

TEST(RigidTransformTest, LogSo3KeepsRelativePrecisionOfSmallAngles) {
  for (const double angle : {1e-3, 1e-9, 1e-100, 1e-200}) {
    const Eigen::Vector3d rotation(0.6 * angle, 0.0, -0.8 * angle);
    EXPECT_LT((LogSo3(ExpSo3(rotation)) / angle - rotation / angle).norm(), 1e-15);
  }
}

TEST(RigidTransformTest, LogSo3AtExactlyPi) {
  for (int axis = 0; axis < 3; ++axis) {
    Eigen::Matrix3d rotation = -Eigen::Matrix3d::Identity();
    rotation(axis, axis) = 1.0;
    const Eigen::Vector3d log = LogSo3(rotation);
    EXPECT_NEAR(std::abs(log[axis]), kPi, 1e-15);
    EXPECT_NEAR(log.norm(), kPi, 1e-15);
  }
}

TEST(RigidTransformTest, LeftJacobianIsTheDerivativeOfExp) {
  using RotationJet = ceres::Jet<double, 3>;
  RandomTransforms random;
  for (const double angle : {1e-9, 1e-3, 0.2, 0.25, 0.26, 1.0, 3.0}) {
    const Eigen::Vector3d rotation = angle * random.Axis();
    RotationJet angle_axis[3] = {RotationJet(rotation.x(), 0), RotationJet(rotation.y(), 1),
                                 RotationJet(rotation.z(), 2)};
    RotationJet matrix[9];  // column by column
    ceres::AngleAxisToRotationMatrix(angle_axis, matrix);
    for (int i = 0; i < 3; ++i) {
      Eigen::Matrix3d derivative;
      for (int entry = 0; entry < 9; ++entry) derivative(entry % 3, entry / 3) = matrix[entry].v[i];
      // dR R^T = [J e_i]x.
      const Eigen::Matrix3d expected = Hat(LeftJacobianSo3(rotation).col(i));
      EXPECT_LT((derivative * ExpSo3(rotation).transpose() - expected).norm(), 1e-8 * std::max(1.0, 1e-3 / angle));
    }
  }
}

TEST(RigidTransformTest, LeftJacobianInverse) {
  RandomTransforms random;
  for (const double angle : kAngles) {
    const Eigen::Vector3d rotation = angle * random.Axis();
    const Eigen::Matrix3d product = LeftJacobianSo3(rotation) * LeftJacobianInverseSo3(rotation);
    EXPECT_LT((product - Eigen::Matrix3d::Identity()).norm(), 1e-13) << angle;
  }
}

TEST(RigidTransformTest, ExpSe3EqualsTheMatrixExponential) {
  RandomTransforms random;
  for (const double angle : kAngles) {
    const Vector6d tangent = random.Tangent(angle);
    Eigen::Matrix4d generator = Eigen::Matrix4d::Zero();
    generator.topLeftCorner<3, 3>() = Hat(tangent.tail<3>());
    generator.topRightCorner<3, 1>() = tangent.head<3>();
    Eigen::Matrix4d expected = Eigen::Matrix4d::Identity();
    Eigen::Matrix4d term = Eigen::Matrix4d::Identity();
    for (int n = 1; n < 60; ++n) {
      term = term * generator / n;
      expected += term;
    }
    const RigidTransform transform = ExpSe3(tangent);
    EXPECT_LT((transform.rotation - expected.topLeftCorner<3, 3>()).norm(), 1e-13) << angle;
    EXPECT_LT((transform.translation_m - expected.topRightCorner<3, 1>()).norm(), 1e-13) << angle;
  }
}

TEST(RigidTransformTest, LogSe3InvertsExpSe3) {
  RandomTransforms random;
  for (const double angle : kAngles) {
    if (kPi - angle < 1e-12) continue;  // two logarithms, the same transform
    const Vector6d tangent = random.Tangent(angle);
    EXPECT_LT((LogSe3(ExpSe3(tangent)) - tangent).norm(), 1e-13) << angle;
  }
}

TEST(RigidTransformTest, DifferenceInvertsPerturb) {
  RandomTransforms random;
  for (const double angle : {0.0, 1e-6, 0.3, 3.0}) {
    const RigidTransform from = ExpSe3(random.Tangent(1.2));
    const Vector6d xi = random.Tangent(angle);
    const RigidTransform to = Perturb(from, xi);
    EXPECT_LT((Difference(to, from) - xi).norm(), 1e-14);
    EXPECT_LT((to.rotation - ExpSo3(xi.tail<3>()) * from.rotation).norm(), 1e-15);
    EXPECT_LT((to.translation_m - from.translation_m - xi.head<3>()).norm(), 1e-15);
  }
}

// The derivative of the perturbation of `derive(X)` with respect to that of X, by central differences.
template <typename Derive>
Matrix6d NumericalJacobian(const RigidTransform& transform, const Derive& derive) {
  constexpr double kStep = 1e-6;
  Matrix6d jacobian;
  for (int i = 0; i < 6; ++i) {
    const Vector6d xi = kStep * Vector6d::Unit(i);
    jacobian.col(i) = Difference(derive(Perturb(transform, xi)), derive(Perturb(transform, -xi))) / (2.0 * kStep);
  }
  return jacobian;
}

TEST(RigidTransformTest, JacobiansOfDerivedTransforms) {
  RandomTransforms random;
  for (int i = 0; i < 20; ++i) {
    const RigidTransform transform = ExpSe3(random.Tangent(random.Uniform(0.0, 3.0)));
    const RigidTransform left = ExpSe3(random.Tangent(random.Uniform(0.0, 3.0)));
    const auto product = [&left](const RigidTransform& x) { return left * x; };
    const auto inverse = [](const RigidTransform& x) { return x.Inverse(); };
    EXPECT_LT((JacobianOfProduct(left.rotation) - NumericalJacobian(transform, product)).norm(), 1e-8);
    EXPECT_LT((JacobianOfInverse(transform) - NumericalJacobian(transform, inverse)).norm(), 1e-8);
    // The inverse of the inverse is the transform.
    EXPECT_LT((JacobianOfInverse(transform.Inverse()) * JacobianOfInverse(transform) - Matrix6d::Identity()).norm(),
              1e-13);
  }
}

TEST(RigidTransformTest, PerturbKeepsTheRotationOrthonormalOverAMillionSteps) {
  RigidTransform transform;
  Vector6d xi;
  xi << 0, 0, 0, 0.01, -0.02, 0.015;
  for (int i = 0; i < 1'000'000; ++i) transform = Perturb(transform, xi);
  EXPECT_LT((transform.rotation.transpose() * transform.rotation - Eigen::Matrix3d::Identity()).norm(), 1e-15);
  EXPECT_NEAR(transform.rotation.determinant(), 1.0, 1e-15);
}

TEST(RigidTransformTest, ComposesLikeMatrices) {
  RandomTransforms random;
  const RigidTransform a = ExpSe3(random.Tangent(1.0)), b = ExpSe3(random.Tangent(2.0));
  const Eigen::Vector3d point(0.3, -2.0, 5.0);
  EXPECT_LT(((a * b) * point - a * (b * point)).norm(), 1e-14);
  EXPECT_LT((a.Inverse() * (a * point) - point).norm(), 1e-14);
}

TEST(RigidTransformTest, QuaternionHasUnitNormAndPositiveW) {
  RandomTransforms random;
  for (int i = 0; i < 200; ++i) {
    const RigidTransform transform{ExpSo3(random.Uniform(0, kPi) * random.Axis()), {1, 2, 3}};
    const Eigen::Quaterniond quaternion = transform.Quaternion();
    EXPECT_GE(quaternion.w(), 0.0);
    EXPECT_NEAR(quaternion.norm(), 1.0, 1e-15);
    const auto back = MakeRigidTransform(transform.translation_m, quaternion);
    ASSERT_TRUE(back.ok());
    EXPECT_LT((back->rotation - transform.rotation).norm(), 2e-15);
    EXPECT_EQ(back->translation_m, transform.translation_m);
  }
}

TEST(RigidTransformTest, MakeRigidTransformNormalisesWithinItsTolerance) {
  const auto transform = MakeRigidTransform({0, 0, 1}, Eigen::Quaterniond(1.0009, 0, 0, 0));
  ASSERT_TRUE(transform.ok());
  EXPECT_EQ(transform->rotation, Eigen::Matrix3d::Identity());
}

TEST(RigidTransformTest, MakeRigidTransformRefusesNonUnitQuaternions) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double infinity = std::numeric_limits<double>::infinity();
  const Eigen::Quaterniond unit = Eigen::Quaterniond::Identity();
  const auto code = [](const Eigen::Vector3d& t, const Eigen::Quaterniond& q) {
    return MakeRigidTransform(t, q).status().code();
  };
  EXPECT_EQ(code({0, 0, 0}, {1.0011, 0, 0, 0}), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(code({0, 0, 0}, {0, 0, 0, 0}), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(code({0, 0, 0}, {nan, 0, 0, 1}), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(code({0, 0, 0}, {0, infinity, 0, 1}), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(code({nan, 0, 0}, unit), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(code({0, infinity, 0}, unit), absl::StatusCode::kInvalidArgument);
}

TEST(RigidTransformTest, InvalidStatesAreRefused) {
  const auto status_of = [](const RigidTransform& transform) {
    StateWriter writer;
    writer(transform);
    const std::string state = writer.Take();
    StateReader reader(state);
    RigidTransform loaded;
    reader(loaded);
    return reader.Finish();
  };
  RigidTransform transform;
  EXPECT_TRUE(status_of(transform).ok());
  transform.rotation(1, 2) = 1.9;
  EXPECT_NE(status_of(transform).message().find("a matrix is not a rotation"), absl::string_view::npos);
  transform.rotation(1, 2) = -1e200;
  EXPECT_NE(status_of(transform).message().find("a matrix is not a rotation"), absl::string_view::npos);
  transform.rotation(1, 2) = std::numeric_limits<double>::infinity();
  EXPECT_NE(status_of(transform).message().find("a number is infinite or NaN"), absl::string_view::npos);
}

TEST(RigidTransformTest, RotationAngle) {
  RandomTransforms random;
  for (const double angle : kAngles) {
    const Eigen::Matrix3d a = ExpSo3(2.0 * random.Axis());
    EXPECT_NEAR(RotationAngle(a, a * ExpSo3(angle * random.Axis())), angle, 2e-15) << angle;
  }
}

}  // namespace
}  // namespace evpose
