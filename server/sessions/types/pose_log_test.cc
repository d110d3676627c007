// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/types/pose_log.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace evpose::server {
namespace {

std::vector<StoredPose> Poses(uint64_t first, uint64_t last) {
  std::vector<StoredPose> poses;
  for (uint64_t seq = first; seq <= last; ++seq) {
    StoredPose pose;
    pose.pose_seq = seq;
    pose.estimate.t_us = static_cast<int64_t>(1000 * seq);
    poses.push_back(pose);
  }
  return poses;
}

std::vector<uint64_t> Numbers(const std::vector<StoredPose>& poses) {
  std::vector<uint64_t> numbers;
  for (const StoredPose& pose : poses) numbers.push_back(pose.pose_seq);
  return numbers;
}

TEST(PoseLogTest, GivesPosesAfterANumberInPages) {
  PoseLog log(100);
  EXPECT_EQ(log.first_pose_seq(), 1u);
  EXPECT_EQ(log.last_pose_seq(), 0u);
  EXPECT_TRUE(log.Read(0, 10).empty());
  log.Append(Poses(1, 3));
  log.Append(Poses(4, 5));
  EXPECT_EQ(log.last_pose_seq(), 5u);
  EXPECT_THAT(Numbers(log.Read(0, 2)), testing::ElementsAre(1, 2));
  EXPECT_THAT(Numbers(log.Read(2, 10)), testing::ElementsAre(3, 4, 5));
  EXPECT_TRUE(log.Read(5, 10).empty());
  EXPECT_TRUE(log.Read(99, 10).empty());
  EXPECT_EQ(log.Read(3, 1).front().estimate.t_us, 4000);
}

TEST(PoseLogTest, RemovesTheOldestBeyondItsCapacity) {
  PoseLog log(3);
  log.Append(Poses(1, 5));
  EXPECT_EQ(log.first_pose_seq(), 3u);
  EXPECT_THAT(Numbers(log.Read(0, 10)), testing::ElementsAre(3, 4, 5));
  EXPECT_THAT(Numbers(log.Read(4, 10)), testing::ElementsAre(5));
}

TEST(PoseLogTest, KeepsNeededPosesBeyondItsCapacity) {
  PoseLog log(3);
  log.Append(Poses(1, 8), 4);
  EXPECT_THAT(Numbers(log.Read(0, 10)), testing::ElementsAre(4, 5, 6, 7, 8));
  log.Append(Poses(9, 9), 9);
  EXPECT_THAT(Numbers(log.Read(0, 10)), testing::ElementsAre(7, 8, 9));
}

TEST(PoseLogTest, RemovesThePosesBeforeANumber) {
  PoseLog log(100);
  log.Append(Poses(1, 5));
  log.RemoveBefore(4);
  EXPECT_EQ(log.first_pose_seq(), 4u);
  EXPECT_THAT(Numbers(log.Read(0, 10)), testing::ElementsAre(4, 5));
  log.RemoveBefore(2);
  EXPECT_EQ(log.first_pose_seq(), 4u);
  log.RemoveBefore(100);
  EXPECT_EQ(log.first_pose_seq(), 6u);
  EXPECT_EQ(log.last_pose_seq(), 5u);
}

TEST(PoseLogTest, IgnoresRepeatedPoses) {
  PoseLog log(3);
  log.Append(Poses(1, 4));
  std::vector<StoredPose> again = Poses(3, 5);
  again[1].estimate.t_us = -1;
  log.Append(again);
  EXPECT_THAT(Numbers(log.Read(0, 10)), testing::ElementsAre(3, 4, 5));
  EXPECT_EQ(log.Read(3, 1).front().estimate.t_us, 4000);
}

TEST(PoseLogTest, ContinuesTheNumbersOfAnEarlierLog) {
  PoseLog log(3, 100);
  EXPECT_EQ(log.first_pose_seq(), 100u);
  EXPECT_EQ(log.last_pose_seq(), 99u);
  EXPECT_TRUE(log.Read(0, 10).empty());
  log.Append(Poses(100, 101));
  EXPECT_THAT(Numbers(log.Read(0, 10)), testing::ElementsAre(100, 101));
}

}  // namespace
}  // namespace evpose::server
