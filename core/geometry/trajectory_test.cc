// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/trajectory.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <string>

#include "core/base/output_file.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

constexpr double kHalf = 0.7071067811865476;  // sin 45 deg

StampedPose Pose(int64_t t_us, const Eigen::Vector3d& t, const Eigen::Vector3d& rotation) {
  return {t_us, {ExpSo3(rotation), t}};
}

std::string ErrorOf(const std::string& text) {
  const auto trajectory = ParseTumTrajectory(text, "poses.tum");
  EXPECT_FALSE(trajectory.ok());
  EXPECT_EQ(trajectory.status().code(), absl::StatusCode::kInvalidArgument);
  return std::string(trajectory.status().message());
}

TEST(TumTrajectory, ReadsCommentsBlanksAndCarriageReturns) {
  const auto trajectory = ParseTumTrajectory(
      "# timestamp tx ty tz qx qy qz qw\r\n"
      "\r\n"
      "1.000000 1 2 3 0 0 0 1\r\n"
      "1.000250   -1e-1 0 2.5 0 0 0.7071067811865476 0.7071067811865476\r\n",
      "poses.tum");
  ASSERT_TRUE(trajectory.ok()) << trajectory.status();
  ASSERT_EQ(trajectory->size(), 2u);
  EXPECT_EQ((*trajectory)[0].t_us, 1'000'000);
  EXPECT_EQ((*trajectory)[0].camera_from_object.translation_m, Eigen::Vector3d(1, 2, 3));
  EXPECT_TRUE((*trajectory)[0].camera_from_object.rotation.isIdentity(1e-15));
  EXPECT_EQ((*trajectory)[1].t_us, 1'000'250);
  // A quarter turn about z takes x to y.
  EXPECT_TRUE(((*trajectory)[1].camera_from_object.rotation * Eigen::Vector3d::UnitX())
                  .isApprox(Eigen::Vector3d::UnitY(), 1e-14));
}

TEST(TumTrajectory, FileWithoutAPoseIsEmpty) {
  EXPECT_TRUE(ParseTumTrajectory("", "poses.tum").value().empty());
  EXPECT_TRUE(ParseTumTrajectory("# nothing\n", "poses.tum").value().empty());
}

TEST(TumTrajectory, ErrorsNameFileLineAndCause) {
  EXPECT_THAT(ErrorOf("#\n1 0 0 1 0 0 0\n"), StartsWith("poses.tum:2: 7 numbers instead of the 8"));
  EXPECT_THAT(ErrorOf("1 0 0 1 0 0 0 1\n2 0 zero 1 0 0 0 1\n"), StartsWith("poses.tum:2: ty is not a finite number"));
  EXPECT_THAT(ErrorOf("1 0 0 nan 0 0 0 1\n"), StartsWith("poses.tum:1: tz is not a finite number"));
  EXPECT_LT(ErrorOf("1 0 0 " + std::string(10000, 'x') + " 0 0 0 1\n").size(), 200u);
  EXPECT_THAT(ErrorOf("1 0 0 1 0 0 0 0.99\n"), StartsWith("poses.tum:1: "));
  EXPECT_THAT(ErrorOf("1 0 0 1 0 0 0 1\n1 0 0 1 0 0 0 1\n"), StartsWith("poses.tum:2: time does not increase"));
  EXPECT_THAT(ErrorOf("1e15 0 0 1 0 0 0 1\n"), HasSubstr("give seconds"));
}

TEST(TumTrajectory, MissingFileIsNamed) {
  const auto trajectory = ReadTumTrajectory("/no/such/poses.tum");
  EXPECT_EQ(trajectory.status().code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(trajectory.status().message(), HasSubstr("/no/such/poses.tum"));
}

TEST(TumTrajectory, TimesKeepTheirMicrosecond) {
  for (int64_t t_us : {int64_t{0}, int64_t{1}, int64_t{999'999}, int64_t{1'000'001}, int64_t{16'777'215'999'999},
                       int64_t{-1}, int64_t{-1'000'001}, int64_t{3'999'999'999'999'999}}) {
    const auto read = ParseTumTrajectory(TumLine({t_us, {}}), "x");
    ASSERT_TRUE(read.ok()) << read.status();
    EXPECT_EQ(read->front().t_us, t_us);
  }
  EXPECT_THAT(TumLine({-1, {}}), StartsWith("-0.000001 "));
  EXPECT_THAT(TumLine({12'000'034, {}}), StartsWith("12.000034 0 0 0 0 0 0 1"));
}

TEST(TumTrajectory, WrittenNumbersReadBackWithTheSameBits) {
  const Trajectory trajectory = {Pose(5, {0.1, -1.0 / 3.0, 0.8}, {0.1, 0.2, 0.3}),
                                 Pose(1005, {1e-17, 2e5, 0.7}, {-2.0, 0.2, 1.3})};
  const std::string path = ::testing::TempDir() + "/trajectory_test.tum";
  ASSERT_TRUE(WriteTumTrajectory(path, trajectory).ok());
  const auto read = ReadTumTrajectory(path);
  std::filesystem::remove(path);
  ASSERT_TRUE(read.ok()) << read.status();
  ASSERT_EQ(read->size(), 2u);
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ((*read)[i].t_us, trajectory[i].t_us);
    EXPECT_EQ((*read)[i].camera_from_object.translation_m, trajectory[i].camera_from_object.translation_m);
    EXPECT_TRUE((*read)[i].camera_from_object.rotation.isApprox(trajectory[i].camera_from_object.rotation, 1e-15));
  }
}

TEST(TumTrajectory, WritingIntoAMissingDirectoryFails) {
  EXPECT_EQ(WriteTumTrajectory("/no/such/directory/poses.tum", {}).code(), absl::StatusCode::kNotFound);
}

TEST(ParsePose, ReadsSevenNumbers) {
  const auto pose = ParsePose(" 0.1 -0.2 0.8 0 0 0.70710678 0.70710678 ");
  ASSERT_TRUE(pose.ok()) << pose.status();
  EXPECT_EQ(pose->translation_m, Eigen::Vector3d(0.1, -0.2, 0.8));
  EXPECT_NEAR(RotationAngle(pose->rotation, Eigen::Matrix3d::Identity()), M_PI / 2, 1e-7);
  EXPECT_TRUE(ParsePose("0,0,1, 0,0,0,1").ok());
}

TEST(ParsePose, ErrorsNameTheNumber) {
  EXPECT_THAT(ParsePose("0 0 1 0 0").status().message(), HasSubstr("qz is missing"));
  EXPECT_THAT(ParsePose("").status().message(), HasSubstr("tx is missing"));
  EXPECT_THAT(ParsePose("0 0 1 0 0 0 1 1").status().message(), HasSubstr("8 numbers instead of the 7"));
  EXPECT_THAT(ParsePose("0 0 1 0 0 0 q").status().message(), HasSubstr("qw is not a finite number"));
  EXPECT_EQ(ParsePose("0 0 1 0 0 0 2").status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(Interpolate, FollowsTheScrewBetweenNeighbours) {
  const Trajectory trajectory = {Pose(0, {0, 0, 1}, {0, 0, 0}), Pose(1000, {0.2, 0, 1}, {0, 0, 0}),
                                 Pose(3000, {0, 0.2, 1}, {0, 0, M_PI / 2})};
  EXPECT_TRUE(Interpolate(trajectory, 250)->translation_m.isApprox(Eigen::Vector3d(0.05, 0, 1), 1e-14));
  // The last step is a quarter turn about the optical axis: the object moves on a circle of radius 0.2 m around it.
  const auto half = Interpolate(trajectory, 2000);
  ASSERT_TRUE(half.ok());
  EXPECT_TRUE(half->rotation.isApprox(ExpSo3({0, 0, M_PI / 4}), 1e-14));
  EXPECT_TRUE(half->translation_m.isApprox(Eigen::Vector3d(0.2 * kHalf, 0.2 * kHalf, 1), 1e-14));
}

TEST(Interpolate, SamplesAreExactAndOutsideIsAnError) {
  const Trajectory trajectory = {Pose(10, {0.1, 0, 1}, {0.1, 0, 0}), Pose(20, {0.2, 0, 1}, {0.2, 0, 0})};
  EXPECT_EQ(Interpolate(trajectory, 10)->translation_m, trajectory[0].camera_from_object.translation_m);
  EXPECT_EQ(Interpolate(trajectory, 20)->rotation, trajectory[1].camera_from_object.rotation);
  EXPECT_EQ(Interpolate(trajectory, 9).status().code(), absl::StatusCode::kOutOfRange);
  EXPECT_EQ(Interpolate(trajectory, 21).status().code(), absl::StatusCode::kOutOfRange);
  EXPECT_EQ(Interpolate({}, 0).status().code(), absl::StatusCode::kOutOfRange);
}

TEST(PoseNear, HasNoPoseInGapsAndFarFromTheEnds) {
  const Trajectory trajectory = {Pose(10, {0.1, 0, 1}, {0, 0, 0}), Pose(20, {0.2, 0, 1}, {0, 0, 0}),
                                 Pose(40, {0.4, 0, 1}, {0, 0, 0})};
  const auto x_at = [&](int64_t t_us) {
    const std::optional<RigidTransform> pose = PoseNear(trajectory, t_us, 15);
    return pose ? pose->translation_m.x() : -1.0;
  };
  EXPECT_EQ(x_at(10), 0.1);
  EXPECT_NEAR(x_at(15), 0.15, 1e-14);
  EXPECT_EQ(x_at(21), -1.0) << "the samples are 20 us apart";
  EXPECT_EQ(x_at(40), 0.4) << "a sample behind a gap";
  EXPECT_EQ(x_at(-5), 0.1);
  EXPECT_EQ(x_at(-6), -1.0);
  EXPECT_EQ(x_at(55), 0.4);
  EXPECT_EQ(x_at(56), -1.0);
  EXPECT_FALSE(PoseNear({}, 0, 15));
}

}  // namespace
}  // namespace evpose
