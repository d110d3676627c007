// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/durability/pose_columns.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "core/base/yields_testing.h"
#include "core/geometry/single_precision.h"
#include "server/sessions/durability/pose_codec.h"

namespace evpose::server {
namespace {

bool HaveEqualBits(const auto& a, const auto& b) {
  return std::memcmp(a.data(), b.data(), sizeof(double) * static_cast<size_t>(a.size())) == 0;
}

void ExpectEqualBits(const StoredPose& a, const StoredPose& b) {
  EXPECT_EQ(a.pose_seq, b.pose_seq);
  EXPECT_EQ(a.object_index, b.object_index);
  EXPECT_EQ(a.latency_us, b.latency_us);
  EXPECT_EQ(a.estimate.object_index, b.estimate.object_index);
  EXPECT_EQ(a.estimate.t_us, b.estimate.t_us);
  EXPECT_EQ(a.estimate.state, b.estimate.state);
  EXPECT_EQ(a.estimate.num_events, b.estimate.num_events);
  EXPECT_EQ(a.estimate.loss_cause, b.estimate.loss_cause);
  EXPECT_EQ(a.estimate.lost_at_us, b.estimate.lost_at_us);
  EXPECT_EQ(std::bit_cast<uint32_t>(a.estimate.explained_ratio), std::bit_cast<uint32_t>(b.estimate.explained_ratio));
  EXPECT_EQ(std::bit_cast<uint32_t>(a.estimate.residual_rms_px), std::bit_cast<uint32_t>(b.estimate.residual_rms_px));
  const RigidTransform &pose_a = a.estimate.camera_from_object, &pose_b = b.estimate.camera_from_object;
  EXPECT_TRUE(HaveEqualBits(pose_a.rotation, pose_b.rotation)) << pose_a.rotation << "\n\n" << pose_b.rotation;
  EXPECT_TRUE(HaveEqualBits(pose_a.translation_m, pose_b.translation_m));
  EXPECT_TRUE(HaveEqualBits(a.estimate.covariance, b.estimate.covariance));
  EXPECT_TRUE(HaveEqualBits(a.estimate.twist, b.estimate.twist));
}

bool FitsColumns(const StoredPose& pose) {
  bool fits = true;
  EncodeColumns({&pose, 1}, [&fits](const StoredPose&) { fits = false; });
  return fits;
}

class PoseColumnsTest : public testing::Test {
 protected:
  Eigen::MatrixXd Normal(int rows, int columns) {
    return Eigen::MatrixXd::NullaryExpr(rows, columns, [this] { return normal_(random_); });
  }
  // A published pose near the one of the number before.
  StoredPose Next() {
    StoredPose pose;
    pose.pose_seq = ++seq_;
    pose.object_index = pose.estimate.object_index = static_cast<uint32_t>(seq_ % 2);
    pose.latency_us = static_cast<int64_t>(seq_ * 7919 % 3000);
    PoseEstimate& estimate = pose.estimate;
    estimate.t_us = 5'000'000 + static_cast<int64_t>(seq_) * 500;
    angle_ += 1e-3 * normal_(random_);
    const Eigen::Quaterniond turn(Eigen::AngleAxisd(angle_, Eigen::Vector3d(0.2, 0.9, 0.4).normalized()));
    estimate.camera_from_object.rotation = turn.toRotationMatrix() * (1.0 + 1e-15 * normal_(random_));
    estimate.camera_from_object.translation_m = Eigen::Vector3d(0.1, -0.2, 1.0) + 1e-3 * Normal(3, 1);
    const Matrix6d root = 1e-4 * (Matrix6d::Identity() + 0.2 * Matrix6d(Normal(6, 6)));
    estimate.covariance = InSinglePrecision(Matrix6d(root * root.transpose()));
    estimate.twist = InSinglePrecision(Vector6d(Normal(6, 1)));
    estimate.state = seq_ % 5 == 0 ? TrackState::kDegraded : TrackState::kTracking;
    estimate.num_events = static_cast<uint32_t>(600 + seq_ % 50);
    estimate.loss_cause = seq_ > 20 ? LossCause::kOutOfView : LossCause::kNone;
    estimate.lost_at_us = seq_ > 20 ? 5'004'000 : 0;
    estimate.explained_ratio = 0.95f;
    estimate.residual_rms_px = 0.5f + 1e-3f * static_cast<float>(normal_(random_));
    return pose;
  }
  std::vector<StoredPose> Make(size_t count) {
    std::vector<StoredPose> poses;
    while (poses.size() < count) poses.push_back(Next());
    return poses;
  }

  std::mt19937_64 random_{1};
  std::normal_distribution<double> normal_;
  uint64_t seq_ = 0;
  double angle_ = 0.0;
};

TEST_F(PoseColumnsTest, AllNumbersComeBackToTheBit) {
  const std::vector<StoredPose> poses = Make(1000);
  const PoseSegment segment = EncodePoses(poses);
  const auto decoded = DecodePoses(segment, 2);
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  ASSERT_EQ(decoded->size(), poses.size());
  for (size_t i = 0; i < poses.size(); ++i) ExpectEqualBits(poses[i], (*decoded)[i]);
  EXPECT_EQ(EncodePoses(*decoded).bytes, segment.bytes);
  EXPECT_LT(segment.bytes.size(), 160 * poses.size());
}

TEST_F(PoseColumnsTest, ManyPosesHaveYieldPoints) {
  const std::vector<StoredPose> poses = Make(1000);
  DeflatedColumns columns;
  const size_t num_yields = CountYields([&] { columns = EncodeColumns(poses, [](const StoredPose&) {}); });
  EXPECT_GT(num_yields, poses.size() + columns.inflated_bytes / (64 * 1024)) << "also while they are deflated";
  EXPECT_EQ(DecodeColumns(columns.bytes, columns.inflated_bytes, poses.size())->size(), poses.size());
}

// Each component of the quaternion is the largest one for some of them.
TEST_F(PoseColumnsTest, EveryRotationFits) {
  std::vector<StoredPose> poses = Make(500);
  for (StoredPose& pose : poses) {
    const Eigen::Vector4d coefficients = Normal(4, 1);
    pose.estimate.camera_from_object.rotation = Eigen::Quaterniond(coefficients.normalized()).toRotationMatrix();
  }
  const Eigen::Vector3d axes[] = {Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitY(), Eigen::Vector3d::UnitZ()};
  for (size_t i = 0; i < 3; ++i) {
    poses[i].estimate.camera_from_object.rotation = Eigen::AngleAxisd(M_PI, axes[i]).toRotationMatrix();
    poses[3 + i].estimate.camera_from_object.rotation = Eigen::AngleAxisd(0.5 * M_PI, axes[i]).toRotationMatrix();
  }
  poses[6].estimate.camera_from_object.rotation =
      -0.0 * Eigen::Matrix3d::Ones() + Eigen::Matrix3d(Eigen::Matrix3d::Identity());
  for (const StoredPose& pose : poses) EXPECT_TRUE(FitsColumns(pose));
  const auto decoded = DecodePoses(EncodePoses(poses), 2);
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  for (size_t i = 0; i < poses.size(); ++i) ExpectEqualBits(poses[i], (*decoded)[i]);
}

TEST_F(PoseColumnsTest, OtherPosesAreStoredBesideTheColumnsInTheirOrder) {
  std::vector<StoredPose> poses = Make(10);
  poses[0].estimate.covariance.setRandom();
  poses[3].estimate.twist[2] = 0.1;
  poses[4].estimate.state = TrackState::kAmbiguous;
  poses[4].estimate.alternatives.Add({poses[0].estimate.camera_from_object, -1.0});
  poses[7].estimate.camera_from_object.rotation *= 2.0;
  poses[8].estimate.camera_from_object.rotation(1, 2) = std::numeric_limits<double>::quiet_NaN();
  poses[9].estimate.covariance.setZero();
  for (const size_t i : {0, 3, 4, 7, 8, 9}) EXPECT_FALSE(FitsColumns(poses[i])) << i;
  const auto decoded = DecodePoses(EncodePoses(poses), 2);
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  ASSERT_EQ(decoded->size(), poses.size());
  for (size_t i = 0; i < poses.size(); ++i) ExpectEqualBits(poses[i], (*decoded)[i]);
  EXPECT_EQ((*decoded)[4].estimate.alternatives.size(), 1u);
}

TEST_F(PoseColumnsTest, ContradictionsAreDamage) {
  const std::vector<StoredPose> poses = Make(10);
  const DeflatedColumns columns = EncodeColumns(poses, [](const StoredPose&) { FAIL(); });
  ASSERT_TRUE(DecodeColumns(columns.bytes, columns.inflated_bytes, 10).ok());
  const auto error = [&](const std::string& bytes, uint32_t inflated_bytes, size_t max_poses) {
    const absl::Status status = DecodeColumns(bytes, inflated_bytes, max_poses).status();
    EXPECT_TRUE(absl::IsDataLoss(status)) << status;
    return std::string(status.message());
  };
  using ::testing::HasSubstr;
  EXPECT_THAT(error(columns.bytes, columns.inflated_bytes, 9), HasSubstr("number of poses"));
  EXPECT_THAT(error(columns.bytes, columns.inflated_bytes - 1, 10), HasSubstr("cannot be inflated"));
  EXPECT_THAT(error(columns.bytes, columns.inflated_bytes + 1, 10), HasSubstr("cannot be inflated"));
  EXPECT_THAT(error(columns.bytes, 4'000'000'000, 10), HasSubstr("longer than they can be"));
  EXPECT_THAT(error("no zlib", 10, 10), HasSubstr("cannot be inflated"));
  EXPECT_THAT(error("", 0, 10), HasSubstr("cannot be inflated"));

  // The segment has more or fewer poses than its numbers state.
  PoseSegment segment = EncodePoses(poses);
  for (const uint64_t last : {9, 11}) {
    segment.last_pose_seq = last;
    EXPECT_TRUE(absl::IsDataLoss(DecodePoses(segment, 2).status())) << last;
  }
}

}  // namespace
}  // namespace evpose::server
