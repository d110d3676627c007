// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/real_score.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace evpose {
namespace {

// A square with a side of 0.2 m, one metre in front of a camera with f = 100 px: 20 px wide in the image.
class RealScoreTest : public testing::Test {
 protected:
  RealScoreTest() {
    camera_ = {128, 128, 100.0, 100.0, 64.0, 64.0, {}};
    const Eigen::Vector3d corners[4] = {{-0.1, -0.1, 0.0}, {0.1, -0.1, 0.0}, {0.1, 0.1, 0.0}, {-0.1, 0.1, 0.0}};
    for (int i = 0; i < 4; ++i) {
      ModelLine line;
      line.p1 = corners[i];
      line.p2 = corners[(i + 1) % 4];
      model_.lines.push_back(line);
    }
    reference_ = {{0, Pose(0.0)}, {1'000'000, Pose(0.0)}};
    run_.duration_s = 0.1;
  }

  // The square displaced by `px` in the image.
  static RigidTransform Pose(double px) { return {Eigen::Matrix3d::Identity(), {0.01 * px, 0.0, 1.0}}; }
  static PoseEstimate At(int64_t t_us, double px, TrackState state = TrackState::kTracking) {
    PoseEstimate pose;
    pose.t_us = t_us;
    pose.camera_from_object = Pose(px);
    pose.state = state;
    return pose;
  }
  void Score(const std::vector<PoseEstimate>& poses) {
    const ReprojectionError error(model_, camera_);
    ScoreRealPoses(poses, &reference_, &error, 3.0, run_);
  }

  ObjectModel model_;
  CameraModel camera_;
  Trajectory reference_;
  RealRun run_;
};

TEST_F(RealScoreTest, ErrorIsTheDistanceInTheImage) {
  const ReprojectionError error(model_, camera_);
  EXPECT_NEAR(*error.Px(Pose(0.0), Pose(2.5)), 2.5, 1e-9);
  // Scaled by 1 / 1.1 about the principal point: corners 10 sqrt(2) px away from it move by 1 / 11 of that.
  EXPECT_NEAR(*error.Px(Pose(0.0), {Eigen::Matrix3d::Identity(), {0.0, 0.0, 1.1}}), 10.0 * std::numbers::sqrt2 / 11.0,
              1e-9);
  EXPECT_NEAR(*error.Px(Pose(0.0), {Eigen::Matrix3d::Identity(), {0.0, 0.0, -1.0}}), std::hypot(128.0, 128.0), 1e-9)
      << "behind the camera";
}

TEST_F(RealScoreTest, OnlyPointsThatTheReferenceShowsInTheImageCount) {
  const ReprojectionError error(model_, camera_);
  EXPECT_FALSE(error.Px(Pose(200.0), Pose(0.0)).has_value());
  EXPECT_FALSE(error.Px({Eigen::Matrix3d::Identity(), {0.0, 0.0, -1.0}}, Pose(0.0)).has_value());
  // At 60 px the right corners are at 134 px, outside; those on the left, inside, are displaced by 1 px.
  EXPECT_NEAR(*error.Px(Pose(60.0), Pose(61.0)), 1.0, 1e-9);
}

TEST_F(RealScoreTest, SymmetricPosesAreEqual) {
  RigidTransform quarter;
  quarter.rotation << 0, -1, 0, 1, 0, 0, 0, 0, 1;
  quarter.translation_m.setZero();
  const RigidTransform turned = Pose(1.0) * quarter;
  EXPECT_GT(*ReprojectionError(model_, camera_).Px(Pose(0.0), turned), 10.0);
  model_.symmetries = {RigidTransform{Eigen::Matrix3d::Identity(), Eigen::Vector3d::Zero()}, quarter, quarter * quarter,
                       quarter * quarter * quarter};
  EXPECT_NEAR(*ReprojectionError(model_, camera_).Px(Pose(0.0), turned), 1.0, 1e-9);
}

TEST_F(RealScoreTest, TimesAreCountedByStateAndError) {
  Score({At(10'000, 1.0), At(20'000, 5.0), At(30'000, 6.0), At(40'000, 1.0, TrackState::kDegraded), At(50'000, 9.0)});
  EXPECT_NEAR(run_.first_error_px, 1.0, 1e-9);
  EXPECT_FALSE(run_.is_first_wrong);
  EXPECT_NEAR(run_.right_ratio, 0.2, 1e-9);
  EXPECT_NEAR(run_.doubtful_ratio, 0.1, 1e-9);
  EXPECT_NEAR(run_.tracking_s, 0.05, 1e-9) << "the last pose is valid for 20 ms";
  EXPECT_NEAR(run_.wrong_s, 0.04, 1e-9);
  EXPECT_NEAR(run_.longest_wrong_s, 0.02, 1e-9);
  EXPECT_NEAR(run_.median_error_px, 5.0, 1e-9);
}

TEST_F(RealScoreTest, AmbiguousPosesArePartOfTheDoubtfulOnes) {
  Score({At(10'000, 1.0, TrackState::kAmbiguous), At(25'000, 1.0, TrackState::kDegraded), At(35'000, 1.0)});
  EXPECT_NEAR(run_.ambiguous_ratio, 0.15, 1e-9);
  EXPECT_NEAR(run_.doubtful_ratio, 0.25, 1e-9);
}

TEST_F(RealScoreTest, MotionIsThatOfTheReferenceWithinTheRun) {
  reference_ = {{-10'000, Pose(20.0)}, {0, Pose(0.0)}, {50'000, Pose(4.0)}, {90'000, Pose(1.0)}, {200'000, Pose(30.0)}};
  Score({});
  EXPECT_NEAR(run_.motion_px, 4.0, 1e-9);
}

TEST_F(RealScoreTest, GapEndsAWrongTime) {
  Score({At(0, 5.0), At(40'000, 5.0), At(50'000, 5.0)});
  EXPECT_TRUE(run_.is_first_wrong);
  EXPECT_NEAR(run_.wrong_s, 0.05, 1e-9);
  EXPECT_NEAR(run_.longest_wrong_s, 0.03, 1e-9);
}

TEST_F(RealScoreTest, WithoutAReferenceEveryTrackingPoseIsWrong) {
  ScoreRealPoses({{At(0, 0.0), At(10'000, 0.0, TrackState::kDegraded)}}, nullptr, nullptr, 3.0, run_);
  EXPECT_NEAR(run_.tracking_s, 0.01, 1e-9);
  EXPECT_NEAR(run_.wrong_s, 0.01, 1e-9);
  EXPECT_EQ(run_.right_ratio, 0.0);
  EXPECT_NEAR(run_.doubtful_ratio, 0.2, 1e-9);
}

TEST_F(RealScoreTest, PosesOutsideTheReferenceAreIgnored) {
  Score({At(-5000, 9.0), At(1'000'001, 9.0)});
  EXPECT_EQ(run_.tracking_s, 0.0);
  EXPECT_TRUE(std::isnan(run_.first_error_px));
}

}  // namespace
}  // namespace evpose
