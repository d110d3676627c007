// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session_beginning.h"

#include <gtest/gtest.h>

namespace evpose::server {
namespace {

// A checkpoint at item 5 and pose 40.
SessionBeginning WithCheckpoint() {
  SessionBeginning beginning = {.checkpoint = {.processed_seq = 5, .has_ended = true}};
  beginning.checkpoint.health.poses = 40;
  beginning.checkpoint.health.processing_us = 900;
  return beginning;
}
void AddPoses(SessionBeginning& beginning, uint64_t first, uint64_t last) {
  for (uint64_t seq = first; seq <= last; ++seq) beginning.poses.push_back({.pose_seq = seq});
}

TEST(SessionBeginningTest, ANewSessionStartsAtOne) {
  const SessionBeginning beginning;
  EXPECT_EQ(FirstPoseSeq(beginning), 1u);
  EXPECT_EQ(LastPoseSeq(beginning), 0u);
  EXPECT_EQ(PersistedAt(beginning).seq, 0u);
  EXPECT_EQ(LastCheckpoint(beginning).processed_seq, 0u);
  const StreamGate::Start start = GateStart(beginning, "token", absl::UnixEpoch());
  EXPECT_EQ(start.processed_seq, 0u);
  EXPECT_FALSE(start.has_ended);
  EXPECT_EQ(start.max_seen_pose_seq, 0u) << "no client has seen anything";
}

TEST(SessionBeginningTest, AResumedSessionContinuesItsCheckpoint) {
  const SessionBeginning beginning = WithCheckpoint();
  EXPECT_EQ(FirstPoseSeq(beginning), 41u) << "the store has deleted all poses";
  EXPECT_EQ(LastPoseSeq(beginning), 40u);
  EXPECT_EQ(PersistedAt(beginning).seq, 5u);
  EXPECT_TRUE(PersistedAt(beginning).has_ended);
  EXPECT_EQ(PersistedAt(beginning).last_pose_seq, 0u);
  EXPECT_EQ(LastCheckpoint(beginning).processed_seq, 5u);
  EXPECT_TRUE(LastCheckpoint(beginning).has_ended);
  EXPECT_EQ(LastCheckpoint(beginning).processing_us, 900);
  const StreamGate::Start start = GateStart(beginning, "", absl::UnixEpoch());
  EXPECT_EQ(start.processed_seq, 5u);
  EXPECT_TRUE(start.has_ended);
  EXPECT_EQ(start.max_seen_pose_seq, 40 + kMaxPosesBeyondStore);
}

TEST(SessionBeginningTest, ThePosesMayExtendBeyondTheCheckpoint) {
  SessionBeginning beginning = WithCheckpoint();
  AddPoses(beginning, 30, 45);
  EXPECT_EQ(FirstPoseSeq(beginning), 30u);
  EXPECT_EQ(LastPoseSeq(beginning), 45u);
  EXPECT_EQ(PersistedAt(beginning).last_pose_seq, 45u);
  EXPECT_EQ(GateStart(beginning, "", absl::UnixEpoch()).max_seen_pose_seq, 45 + kMaxPosesBeyondStore);
  beginning.checkpoint.health.poses = 50;
  EXPECT_EQ(LastPoseSeq(beginning), 50u);
}

}  // namespace
}  // namespace evpose::server
