// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/free_motion.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>

#include "core/models/continuous_symmetry.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

const ContinuousSymmetry kFreeAxis = {
    ContinuousSymmetry::Kind::kAxis, {0.1, -0.2, 0.3}, Eigen::Vector3d(1, 2, -2).normalized(), false};
const ContinuousSymmetry kFreeSphere = {
    ContinuousSymmetry::Kind::kSphere, {0.1, -0.2, 0.3}, Eigen::Vector3d::Zero(), false};

// A state with a covariance like that of a tracker.
MotionState TurningState() {
  MotionState state;
  state.camera_from_object = {ExpSo3({0.4, 1.2, -0.6}), {0.1, 0.2, 1.5}};
  state.twist << 0.1, -0.3, 0.2, 1.0, -2.0, 3.0;
  Random random(5);
  Matrix12d factor;
  for (int i = 0; i < 144; ++i) factor(i / 12, i % 12) = 2e-4 * random.Normal();
  state.covariance = factor * factor.transpose();
  state.covariance.diagonal().array() += 1e-6;
  state.covariance.bottomRightCorner<6, 6>() *= 100.0;
  state.covariance.topRightCorner<6, 6>().setZero();
  state.covariance.bottomLeftCorner<6, 6>().setZero();
  return state;
}

TEST(FreeMotionTest, WithoutASymmetryNothingChanges) {
  const MotionState state = TurningState();
  MotionState same = state;
  RemoveFreeMotion(std::nullopt, MotionState(), same);
  EXPECT_EQ(same.camera_from_object, state.camera_from_object);
  EXPECT_EQ(same.twist, state.twist);
  EXPECT_EQ(same.covariance, state.covariance);
  const Matrix6d covariance = state.covariance.topLeftCorner<6, 6>();
  EXPECT_EQ(WithFreeAngle(std::nullopt, state.camera_from_object, covariance), covariance);
}

TEST(FreeMotionTest, TheSpinIsRemovedAndTheMotionOfTheAxisIsKept) {
  const MotionState before = TurningState();
  for (const ContinuousSymmetry& symmetry : {kFreeAxis, kFreeSphere}) {
    MotionState after = before;
    RemoveFreeMotion(symmetry, after);
    const Eigen::Matrix3d& rotation = before.camera_from_object.rotation;
    EXPECT_NEAR((rotation * symmetry.axis).dot(after.twist.tail<3>()), 0.0, 1e-12);
    // Velocity of a point of the axis: dT/dt + w x R X.
    const auto velocity = [&](const MotionState& state, const Eigen::Vector3d& point) {
      return Eigen::Vector3d(state.twist.head<3>() + Eigen::Vector3d(state.twist.tail<3>()).cross(rotation * point));
    };
    for (const double along : {0.0, 0.7}) {
      const Eigen::Vector3d point = symmetry.centre + along * symmetry.axis;
      EXPECT_LT((velocity(after, point) - velocity(before, point)).norm(), 1e-12);
    }
  }
}

TEST(FreeMotionTest, ThePriorIsStiffAndPositiveDefinite) {
  for (const ContinuousSymmetry& symmetry : {kFreeAxis, kFreeSphere}) {
    MotionState state = TurningState();
    RemoveFreeMotion(symmetry, state);
    EXPECT_EQ(state.covariance, state.covariance.transpose());
    EXPECT_EQ(Eigen::LLT<Matrix12d>(state.covariance).info(), Eigen::Success);
    const FreeDirections free = FreeDirectionsAt(symmetry, state.camera_from_object);
    for (int i = 0; i < free.cols(); ++i) {
      const Eigen::Vector3d axis = free.col(i).tail<3>();
      EXPECT_NEAR(axis.dot(state.covariance.block<3, 3>(3, 3) * axis), 1e-8, 1e-12);
      EXPECT_NEAR(axis.dot(state.covariance.block<3, 3>(9, 9) * axis), 1e-6, 1e-10);
    }
  }
}

TEST(FreeMotionTest, TheReportedAngleIsUnknown) {
  const MotionState state = TurningState();
  const Matrix6d covariance = state.covariance.topLeftCorner<6, 6>();
  for (const ContinuousSymmetry& symmetry : {kFreeAxis, kFreeSphere}) {
    const Matrix6d reported = WithFreeAngle(symmetry, state.camera_from_object, covariance);
    const Eigen::LLT<Matrix6d> cholesky(reported);
    ASSERT_EQ(cholesky.info(), Eigen::Success);
    EXPECT_TRUE((reported * reported.inverse()).isIdentity(1e-6));
    const FreeDirections free = FreeDirectionsAt(symmetry, state.camera_from_object);
    for (int i = 0; i < free.cols(); ++i) {
      const Eigen::Vector3d axis = free.col(i).tail<3>();
      EXPECT_NEAR(axis.dot(reported.block<3, 3>(3, 3) * axis), M_PI * M_PI / 3.0, 1e-9);
    }
    // The uncertainty of the centre is not that of the free angle.
    Eigen::Matrix<double, 3, 6> centre;
    centre << Eigen::Matrix3d::Identity(), -Hat(state.camera_from_object.rotation * symmetry.centre);
    EXPECT_LT((centre * reported * centre.transpose() - centre * covariance * centre.transpose()).norm(), 1e-12);
  }
}

TEST(FreeMotionTest, AnEstimateDoesNotSpinRelativeToTheStateBefore) {
  const MotionState before = TurningState();
  MotionState state = before;
  const Eigen::Vector3d tilt = (before.camera_from_object.rotation * kFreeAxis.axis).unitOrthogonal();
  const RigidTransform spun = before.camera_from_object * AboutCentre(kFreeAxis, ExpSo3(0.2 * kFreeAxis.axis));
  state.camera_from_object = {ExpSo3(0.1 * tilt) * spun.rotation, spun.translation_m};
  RemoveFreeMotion(kFreeAxis, before, state);
  EXPECT_LT((state.camera_from_object.rotation - ExpSo3(0.1 * tilt) * before.camera_from_object.rotation).norm(), 1e-9);
}

}  // namespace
}  // namespace evpose
