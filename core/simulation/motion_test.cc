// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/motion.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <string>

namespace evpose {
namespace {

using ::testing::HasSubstr;

const CameraModel kHdCamera = {1280, 720, 1030.0, 1030.0, 639.5, 359.5, {}};
constexpr double kRadiusM = 0.17;

MotionPath PathOf(const MotionOptions& options, uint64_t seed = 1) {
  return *MotionPath::Create(options, kHdCamera, kRadiusM, Eigen::Matrix3d::Identity(), seed);
}

TEST(MotionPathTest, StaysInViewAndInDepth) {
  MotionOptions options;
  options.extent_ratio = 1.0;
  options.speed_m_per_s = 3.0;
  for (uint64_t seed = 1; seed <= 5; ++seed) {
    const MotionPath path = PathOf(options, seed);
    for (double t = 0.0; t < 20.0; t += 0.01) {
      const Eigen::Vector3d centre = path.CameraFromObject(t).translation_m;
      EXPECT_NEAR(centre.z(), 1.0, 0.15 + 1e-9);
      for (const double dx : {-kRadiusM, kRadiusM}) {
        const Eigen::Vector2d pixel = kHdCamera.Project(centre + Eigen::Vector3d(dx, dx, -kRadiusM));
        EXPECT_GE(pixel.minCoeff(), 0.0);
        EXPECT_LE(pixel.x(), 1279.0);
        EXPECT_LE(pixel.y(), 719.0);
      }
    }
  }
}

TEST(MotionPathTest, MeanSpeedsAreThoseOfTheOptions) {
  for (const MotionProfile profile : {MotionProfile::kSmooth, MotionProfile::kRests}) {
    MotionOptions options;
    options.speed_m_per_s = 0.6;
    options.angular_speed_rad_per_s = 1.5;
    options.profile = profile;
    const MotionPath path = PathOf(options, 3);
    constexpr int kSteps = 60'000;
    constexpr double kDt = 1e-3;
    double length_m = 0.0, angle_rad = 0.0;
    for (int i = 0; i < kSteps; ++i) {
      const RigidTransform a = path.CameraFromObject(i * kDt);
      const RigidTransform b = path.CameraFromObject((i + 1) * kDt);
      length_m += (b.translation_m - a.translation_m).norm();
      angle_rad += RotationAngle(a.rotation, b.rotation);
    }
    EXPECT_NEAR(length_m / (kSteps * kDt), 0.6, 0.06);
    EXPECT_NEAR(angle_rad / (kSteps * kDt), 1.5, 0.2);
  }
}

TEST(MotionPathTest, IsSmooth) {
  for (const MotionProfile profile : {MotionProfile::kSmooth, MotionProfile::kRests, MotionProfile::kBursts}) {
    MotionOptions options;
    options.profile = profile;
    const MotionPath path = PathOf(options);
    constexpr double kDt = 1e-4;
    for (double t = kDt; t < 3.0; t += 0.00137) {
      const Eigen::Vector3d before =
          path.CameraFromObject(t).translation_m - path.CameraFromObject(t - kDt).translation_m;
      const Eigen::Vector3d after =
          path.CameraFromObject(t + kDt).translation_m - path.CameraFromObject(t).translation_m;
      // The acceleration, over a tenth of a millisecond, is below 200 m/s^2.
      EXPECT_LT((after - before).norm() / kDt, 0.02) << t;
    }
  }
}

TEST(MotionPathTest, RestsStandStillAndBurstsAreFast) {
  MotionOptions options;
  options.profile = MotionProfile::kRests;
  const MotionPath resting = PathOf(options);
  EXPECT_EQ(resting.CameraFromObject(1.75).translation_m, resting.CameraFromObject(1.95).translation_m);
  EXPECT_EQ(resting.CameraFromObject(1.75).rotation, resting.CameraFromObject(1.95).rotation);
  EXPECT_NE(resting.CameraFromObject(1.3).translation_m, resting.CameraFromObject(1.4).translation_m);

  options.profile = MotionProfile::kBursts;
  const MotionPath bursting = PathOf(options);
  double burst_m = 0.0, otherwise_m = 0.0;  // over 0.05 s inside bursts, and before them
  for (int second = 0; second < 200; ++second) {
    const auto path_m = [&](double t) {
      const Eigen::Vector3d begin = bursting.CameraFromObject(second + t).translation_m;
      return (bursting.CameraFromObject(second + t + 0.05).translation_m - begin).norm();
    };
    burst_m += path_m(0.65);
    otherwise_m += path_m(0.5);
  }
  EXPECT_NEAR(burst_m / otherwise_m, 4.0, 0.5);
}

TEST(MotionPathTest, HalfOutReachesBothBordersAndNoFarther) {
  MotionOptions options;
  options.profile = MotionProfile::kHalfOut;
  options.speed_m_per_s = 1.0;
  const MotionPath path = PathOf(options, 2);
  double least = 1e9, most = -1e9, length_m = 0.0;
  for (double t = 0.0; t < 20.0; t += 0.001) {
    const Eigen::Vector3d centre = path.CameraFromObject(t).translation_m;
    const Eigen::Vector2d pixel = kHdCamera.Project(centre);
    least = std::min(least, pixel.x());
    most = std::max(most, pixel.x());
    length_m += (path.CameraFromObject(t + 0.001).translation_m - centre).norm();
    EXPECT_GE(pixel.y(), 0.0);
    EXPECT_LE(pixel.y(), 719.0);
  }
  EXPECT_NEAR(least, 0.0, 0.1);
  EXPECT_NEAR(most, 1279.0, 0.1);
  EXPECT_NEAR(length_m / 20.0, 1.0, 0.1);
}

TEST(MotionPathTest, FollowsTheSeed) {
  const MotionOptions options;
  EXPECT_EQ(PathOf(options, 4).CameraFromObject(0.7).translation_m,
            PathOf(options, 4).CameraFromObject(0.7).translation_m);
  EXPECT_NE(PathOf(options, 4).CameraFromObject(0.7).translation_m,
            PathOf(options, 5).CameraFromObject(0.7).translation_m);
}

TEST(MotionPathTest, NoSpeedStandsStill) {
  MotionOptions options;
  options.speed_m_per_s = 0.0;
  options.angular_speed_rad_per_s = 0.0;
  EXPECT_EQ(PathOf(options).CameraFromObject(0.0).translation_m, PathOf(options).CameraFromObject(9.0).translation_m);
}

TEST(MotionPathTest, AnErrorStatesTheLeastDistance) {
  MotionOptions options;
  options.depth_m = 0.3;
  const auto create = [&] {
    return MotionPath::Create(options, kHdCamera, kRadiusM, Eigen::Matrix3d::Identity(), 1).status();
  };
  const std::string error(create().message());
  const size_t number = error.find("more than ");
  ASSERT_NE(number, std::string::npos) << error;
  const double least_m = std::stod(error.substr(number + 10));
  options.depth_m = 1.01 * least_m;  // the error has three digits
  EXPECT_TRUE(create().ok()) << create();
  options.depth_m = 0.99 * least_m;
  EXPECT_FALSE(create().ok());
}

TEST(MotionPathTest, ErrorsNameTheField) {
  MotionOptions options;
  options.depth_m = 0.3;
  const auto path = MotionPath::Create(options, kHdCamera, kRadiusM, Eigen::Matrix3d::Identity(), 1);
  EXPECT_EQ(path.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(path.status().message()), HasSubstr("does not fit in view"));
  options = {};
  options.speed_m_per_s = -1.0;
  EXPECT_THAT(std::string(options.Validate().message()), HasSubstr("speed_m_per_s"));
  options = {};
  options.depth_swing_ratio = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(std::string(options.Validate().message()), HasSubstr("depth_swing_ratio"));
}

}  // namespace
}  // namespace evpose
