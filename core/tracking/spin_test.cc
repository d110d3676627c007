// SPDX-License-Identifier: Apache-2.0

// Tracking of an object with an axis of symmetry on ideal events: no event measures its spin.
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <limits>
#include <memory>
#include <vector>

#include "core/models/continuous_symmetry.h"
#include "core/models/cube_files_testing.h"
#include "core/numerics/math.h"
#include "core/tracking/tracker.h"
#include "core/tracking/tracking_testing.h"

namespace evpose {
namespace {

// A can whose rims are polygons, which spin with it: its events contain the spin, unlike those of a true circle.
std::shared_ptr<const ObjectModel> Can(bool is_round) {
  auto can = std::make_shared<ObjectModel>(MustParse(Prism(60), ModelFormat::kObj, {.metres_per_unit = 0.08}));
  can->symmetries.clear();
  can->continuous_symmetry.reset();
  if (is_round) {
    can->continuous_symmetry = ContinuousSymmetry{ContinuousSymmetry::Kind::kAxis, Eigen::Vector3d(0, 0, 0.04),
                                                  Eigen::Vector3d::UnitZ(), true};
  }
  return can;
}

const RigidTransform kCanStart = testing::MakePose({0.0, 0.0, 0.6}, {2.2, 0.3, 0.0});

// Swings sideways, tilts by `tilt_rad` there and back, and spins.
testing::Motion Swing(double tilt_rad, double spin_rad_per_s) {
  return [=](double t_s) {
    const double phase = 2.0 * M_PI * t_s / 0.2;
    RigidTransform pose = kCanStart;
    pose.rotation = ExpSo3({0, tilt_rad * std::sin(phase), 0}) * pose.rotation * ExpSo3({0, 0, spin_rad_per_s * t_s});
    pose.translation_m +=
        Eigen::Vector3d(0.03 * std::sin(phase), 0.02 * std::sin(phase + 1.0) - 0.02 * std::sin(1.0), 0);
    return pose;
  };
}

std::vector<PoseEstimate> TrackCan(bool is_round, const testing::Motion& motion) {
  testing::IdealEventOptions options;
  options.duration_us = 400'000;
  const std::shared_ptr<const ObjectModel> can = Can(is_round);
  const std::vector<Event> events = testing::MakeIdealEvents(*can, kCamera, motion, options);
  std::unique_ptr<Tracker> tracker = Tracker::Create(can, kCamera, WithoutInitialization(), kCanStart).value();
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(events, estimates);
  tracker->Finish(estimates);
  return estimates;
}

// Spin about the axis from one pose to the other, degrees: the rest of their difference is the least rotation that
// moves the axis.
double SpinDeg(const RigidTransform& from, const RigidTransform& to) {
  const ContinuousSymmetry symmetry = *Can(true)->continuous_symmetry;
  return kDegreesPerRadian * RotationAngle(NearestWithoutFlip(to, symmetry, from).rotation, to.rotation);
}

TEST(SpinTest, TheReportedAngleDoesNotDriftAtAConstantView) {
  const testing::Motion motion = Swing(0.0, 0.5);
  const std::vector<PoseEstimate> estimates = TrackCan(true, motion);
  ASSERT_GT(estimates.size(), 50u);
  const double duration_s = 1e-6 * static_cast<double>(estimates.back().t_us);
  EXPECT_LT(SpinDeg(kCanStart, estimates.back().camera_from_object), 0.1 * duration_s);
  const std::vector<PoseEstimate> spinning = TrackCan(false, motion);
  ASSERT_FALSE(spinning.empty());
  EXPECT_GT(SpinDeg(kCanStart, spinning.back().camera_from_object), 1.0 * duration_s) << "the events contain the spin";
}

TEST(SpinTest, TheAngleFollowsTheMinimalMotionAndTheAxisIsRight) {
  const testing::Motion motion = Swing(0.15, 0.5);
  const std::vector<PoseEstimate> estimates = TrackCan(true, motion);
  ASSERT_GT(estimates.size(), 50u);
  for (size_t i = 0; i < estimates.size(); ++i) {
    const PoseEstimate& estimate = estimates[i];
    const RigidTransform& pose = estimate.camera_from_object;
    EXPECT_LT(SpinDeg(estimates[i > 0 ? i - 1 : 0].camera_from_object, pose), 1e-6);
    const Eigen::Vector3d axis = pose.rotation.col(2);
    // Zero but for the rounding of the three components to single precision.
    const Eigen::Vector3d spin_rad_per_s = estimate.twist.tail<3>();
    EXPECT_LE(std::abs(axis.dot(spin_rad_per_s)), std::numeric_limits<float>::epsilon() * spin_rad_per_s.norm());
    const RigidTransform truth = motion(1e-6 * static_cast<double>(estimate.t_us));
    EXPECT_LT(kDegreesPerRadian * std::asin(std::min(1.0, axis.cross(truth.rotation.col(2)).norm())), 1.5);
    const Eigen::Vector3d centre(0, 0, 0.04);
    EXPECT_LT((pose * centre - truth * centre).norm(), 0.01 * 0.6);
  }
}

TEST(SpinTest, TheCovarianceStatesThatTheAngleIsUnknown) {
  for (const PoseEstimate& estimate : TrackCan(true, Swing(0.15, 0.5))) {
    ASSERT_EQ(Eigen::LLT<Matrix6d>(estimate.covariance).info(), Eigen::Success);
    const Eigen::Vector3d axis = estimate.camera_from_object.rotation.col(2);
    EXPECT_NEAR(axis.dot(estimate.covariance.bottomRightCorner<3, 3>() * axis), M_PI * M_PI / 3.0, 1e-6);
    const Eigen::Vector3d across = axis.unitOrthogonal();
    EXPECT_LT(across.dot(estimate.covariance.bottomRightCorner<3, 3>() * across), 0.1);
  }
}

}  // namespace
}  // namespace evpose
