// SPDX-License-Identifier: Apache-2.0
#include "core/calibration/hand_eye.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "core/calibration/time_offset.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

RigidTransform Pose6(double x, double y, double z, double rx, double ry, double rz) {
  return {ExpSo3({rx, ry, rz}), {x, y, z}};
}

// A robot that moves its tool, and evpose's poses of an object, each on its own clock.
struct RobotCell {
  HandEyeMount mount = HandEyeMount::kBeside;
  Eigen::Vector3d axes = {1.0, 1.0, 1.0};  // amplitudes of the rotations, relative to 0.4 rad
  double rotation_rad = 0.4;
  double offset_s = 1.7e9;  // the robot has Unix time
  double duration_s = 20.0;
  double noise_m = 0.0;
  double noise_rad = 0.0;
  double noise_memory = 0.0;                        // correlation of the errors of successive poses
  double flipped_from_s = 0.0, flipped_to_s = 0.0;  // a symmetric object: the poses are a quarter turn off
  uint64_t seed = 1;

  RigidTransform left = Pose6(0.1, -0.3, 1.2, 2.0, 0.3, -0.4);
  RigidTransform right = Pose6(0.05, 0.02, 0.1, -0.3, 1.0, 0.2);

  RigidTransform Tool(double t_s) const {
    const auto wave = [t_s](double hz, double phase) { return std::sin(2.0 * M_PI * hz * t_s + phase); };
    const Eigen::Vector3d turn(wave(0.31, 0.0) + 0.5 * wave(0.77, 1.0), wave(0.23, 2.0) + 0.5 * wave(0.59, 3.0),
                               wave(0.41, 4.0) + 0.5 * wave(0.87, 5.0));
    return {ExpSo3(rotation_rad * axes.cwiseProduct(turn)),
            {0.4 + 0.1 * wave(0.37, 1.0), 0.1 * wave(0.29, 2.0), 0.3 + 0.1 * wave(0.53, 3.0)}};
  }
  RigidTransform CameraFromObject(double t_s) const {
    return left * (mount == HandEyeMount::kInHand ? Tool(t_s).Inverse() : Tool(t_s)) * right;
  }
  Trajectory Robot() const {
    Trajectory robot;
    for (double t_s = -2.0; t_s < duration_s + 3.0; t_s += 0.008) {
      robot.push_back({std::llround((t_s + offset_s) * 1e6), Tool(t_s)});
    }
    return robot;
  }
  Trajectory Poses() const {
    Random random(seed);
    Vector6d error = Vector6d::Zero();
    Vector6d size;
    size << Eigen::Vector3d::Constant(noise_m), Eigen::Vector3d::Constant(noise_rad);
    Trajectory poses;
    for (double t_s = 0.0; t_s < duration_s; t_s += 0.004) {
      Vector6d fresh;
      for (double& value : fresh) value = random.Normal();
      error = noise_memory * error + std::sqrt(1.0 - noise_memory * noise_memory) * fresh;
      RigidTransform pose = Perturb(CameraFromObject(t_s), size.cwiseProduct(error));
      if (t_s >= flipped_from_s && t_s < flipped_to_s) pose = pose * Pose6(0.0, 0.0, 0.0, 0.0, 0.0, M_PI / 2);
      poses.push_back({std::llround(t_s * 1e6), pose});
    }
    return poses;
  }
};

double ErrorOf(const RigidTransform& estimate, const RigidTransform& truth) {
  return Difference(estimate, truth).norm();
}

TEST(HandEyeTest, FindsBothTransformsAndTheOffset) {
  for (const HandEyeMount mount : {HandEyeMount::kBeside, HandEyeMount::kInHand}) {
    const RobotCell cell{.mount = mount, .noise_m = 1e-4, .noise_rad = 3e-4};
    const auto result = SolveHandEye(cell.Poses(), cell.Robot());
    ASSERT_TRUE(result.ok()) << result.status();
    EXPECT_EQ(result->mount, mount);
    EXPECT_LT(ErrorOf(result->left, cell.left), 2e-4);
    EXPECT_LT(ErrorOf(result->right, cell.right), 2e-4);
    EXPECT_NEAR(result->time_offset_s, cell.offset_s, 5e-5);
    EXPECT_GT(*result->other_mount_ratio, 10.0);
    EXPECT_THAT(result->warnings, IsEmpty());
    // The reference, aligned, is the trajectory of the poses.
    const Trajectory aligned = result->Aligned(cell.Robot());
    const auto at = Interpolate(aligned, 5'000'000);
    ASSERT_TRUE(at.ok()) << at.status();
    EXPECT_LT(ErrorOf(*at, cell.CameraFromObject(5.0)), 5e-4);
  }
}

TEST(HandEyeTest, QuarterTurnsOfASymmetricObjectAreOutliers) {
  const RobotCell cell{.noise_m = 5e-4, .noise_rad = 2e-3, .flipped_from_s = 5.0, .flipped_to_s = 9.0};
  const auto result = SolveHandEye(cell.Poses(), cell.Robot());
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_LT(ErrorOf(result->left, cell.left), 2e-3);
  EXPECT_NEAR(result->num_outliers, 0.2 * result->num_poses, 0.01 * result->num_poses);
  EXPECT_NEAR(result->position_rms_m, 5e-4 * std::sqrt(3.0), 1e-4);
  EXPECT_THAT(result->warnings, ::testing::Contains(HasSubstr("are outliers")));
}

// Normalised errors over seeds, with errors that are correlated over 0.1 s.
TEST(HandEyeTest, StandardErrorsAreThoseOfTheErrors) {
  double sum = 0.0;
  int count = 0, beyond = 0;
  for (uint64_t seed = 1; seed <= 8; ++seed) {
    RobotCell cell{.offset_s = 3.0, .noise_m = 5e-4, .noise_rad = 2e-3, .noise_memory = 0.96, .seed = seed};
    const auto result = SolveHandEye(cell.Poses(), cell.Robot(), {.mount = HandEyeMount::kBeside});
    ASSERT_TRUE(result.ok()) << result.status();
    const Vector6d left = Difference(result->left, cell.left).cwiseQuotient(result->left_errors);
    const Vector6d right = Difference(result->right, cell.right).cwiseQuotient(result->right_errors);
    std::vector<double> ratios(left.begin(), left.end());
    ratios.insert(ratios.end(), right.begin(), right.end());
    ratios.push_back((result->time_offset_s - cell.offset_s) / *result->time_offset_error_s);
    for (const double ratio : ratios) {
      sum += ratio * ratio;
      beyond += std::abs(ratio) > 3.0 ? 1 : 0;
      ++count;
    }
    EXPECT_GT(result->correlated_poses, 5.0);
  }
  EXPECT_GT(sum / count, 0.5);
  EXPECT_LT(sum / count, 2.0);
  EXPECT_LE(beyond, count / 40);
}

TEST(HandEyeTest, OneAxisIsReported) {
  RobotCell cell{.axes = {0.0, 0.0, 1.0}, .noise_m = 1e-4, .noise_rad = 5e-4};
  const auto result = SolveHandEye(cell.Poses(), cell.Robot(), {.mount = HandEyeMount::kBeside});
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_THAT(result->warnings, ::testing::Contains(HasSubstr("fewer than two axes")));
  EXPECT_FALSE(result->has_second_axis);
  EXPECT_LT(result->axes_rad[1], 0.01);
  EXPECT_GT(result->axes_rad[0], 0.2);
  // The alignment is determined although its parts are not.
  EXPECT_LT(ErrorOf(result->Predict(cell.Tool(4.0)), cell.CameraFromObject(4.0)), 2e-3);
}

// The same numbers in millimetres, and quaternions w x y z that were read as x y z w.
TEST(HandEyeTest, AReferenceOfAnotherUnitOrAnotherMotionIsReported) {
  for (const HandEyeMount mount : {HandEyeMount::kBeside, HandEyeMount::kInHand}) {
    const RobotCell cell{.mount = mount, .duration_s = 8.0, .noise_m = 1e-3, .noise_rad = 3e-3};
    Trajectory millimetres = cell.Robot(), permuted = cell.Robot();
    for (StampedPose& pose : millimetres) pose.camera_from_object.translation_m *= 1000.0;
    for (StampedPose& pose : permuted) {
      const Eigen::Quaterniond q = pose.camera_from_object.Quaternion();
      pose.camera_from_object.rotation = Eigen::Quaterniond(q.z(), q.w(), q.x(), q.y()).toRotationMatrix();
    }
    const HandEyeOptions options{.mount = mount, .time_offset_s = cell.offset_s, .max_poses = 300};
    const auto unit = SolveHandEye(cell.Poses(), millimetres, options);
    ASSERT_TRUE(unit.ok()) << unit.status();
    EXPECT_FALSE(unit->explains_motion);
    EXPECT_THAT(unit->warnings, ::testing::Contains(HasSubstr("the poses move 0.001 times as far as the reference")));
    const auto order = SolveHandEye(cell.Poses(), permuted, options);
    ASSERT_TRUE(order.ok()) << order.status();
    EXPECT_FALSE(order->explains_motion);
    EXPECT_THAT(order->warnings, ::testing::Contains(HasSubstr("with quaternions in the order x y z w, and")));
    EXPECT_TRUE(SolveHandEye(cell.Poses(), cell.Robot(), options)->explains_motion);
  }
}

TEST(HandEyeTest, AGivenOffsetIsKept) {
  const RobotCell cell{.offset_s = -0.25};
  const auto result = SolveHandEye(cell.Poses(), cell.Robot(), {.time_offset_s = -0.25});
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->time_offset_s, -0.25);
  EXPECT_FALSE(result->time_offset_error_s.has_value());
  EXPECT_LT(ErrorOf(result->left, cell.left), 2e-4);
}

TEST(HandEyeTest, SameFramesGiveTheOffsetAlone) {
  RobotCell cell{.offset_s = 12.5, .left = {}, .right = {}};
  const auto result = SolveHandEye(cell.Poses(), cell.Robot(), {.has_same_frames = true});
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->left.translation_m, Eigen::Vector3d::Zero());
  EXPECT_NEAR(result->time_offset_s, 12.5, 5e-5);
}

TEST(HandEyeTest, TranslationsAloneGiveTheOffset) {
  const RobotCell cell{.axes = {0.0, 0.0, 0.0}, .offset_s = 7.0, .noise_m = 1e-4};
  const std::vector<OffsetCandidate> offsets = FindTimeOffsets(cell.Poses(), cell.Robot(), 3);
  ASSERT_FALSE(offsets.empty());
  EXPECT_NEAR(offsets[0].offset_s, 7.0, 0.01);
}

TEST(HandEyeTest, AStrayTimeHasBoundedSamples) {
  const RobotCell cell{.offset_s = 3.0};
  Trajectory robot = cell.Robot();
  robot.insert(robot.begin(), {-(int64_t{1} << 60), cell.Tool(0.0)});
  // With steps for the product of both lengths alone, the samples would need 50 GB.
  EXPECT_THAT(FindTimeOffsets(cell.Poses(), robot, 3), IsEmpty());
}

TEST(HandEyeTest, GapsAreNotInterpolated) {
  const RobotCell cell{.offset_s = 3.0, .noise_m = 1e-4, .noise_rad = 3e-4};
  Trajectory robot = cell.Robot();
  // Two seconds of the robot's log are lost, in which it moved.
  std::erase_if(robot, [](const StampedPose& pose) { return pose.t_us > 8'000'000 && pose.t_us < 10'000'000; });
  const auto result = SolveHandEye(cell.Poses(), robot);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_LT(result->num_outliers, 5);
  EXPECT_LT(ErrorOf(result->left, cell.left), 3e-4);
}

TEST(HandEyeTest, ErrorsSayWhatIsMissing) {
  const RobotCell cell{};
  EXPECT_THAT(SolveHandEye({}, cell.Robot()).status().message(), HasSubstr("there are 0 and 31"));
  EXPECT_THAT(SolveHandEye(cell.Poses(), cell.Robot(), {.time_offset_s = 0.0}).status().message(),
              HasSubstr("fewer than 12 poses have a reference"));
  const RobotCell other{.axes = {0.1, 2.0, 0.3}, .duration_s = 20.0};
  Trajectory unrelated = cell.Robot();
  Random random(3);
  for (StampedPose& pose : unrelated) {
    pose.camera_from_object.rotation = ExpSo3({0.3 * random.Normal(), 0.3 * random.Normal(), 0.3 * random.Normal()});
  }
  const auto none = SolveHandEye(other.Poses(), unrelated);
  EXPECT_EQ(none.status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(none.status().message(), HasSubstr("no time offset was found"));
  EXPECT_THAT(SolveHandEye(cell.Poses(), cell.Robot(), {.max_poses = 1}).status().message(), HasSubstr("max_poses"));
}

}  // namespace
}  // namespace evpose
