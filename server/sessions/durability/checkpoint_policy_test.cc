// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/durability/checkpoint_policy.h"

#include <gtest/gtest.h>

namespace evpose::server {
namespace {

using Counters = CheckpointPolicy::Counters;
using Progress = CheckpointPolicy::Progress;

// A policy with a checkpoint at item 10, pose 500 and 1 s of processing time; serializing it took 2 ms.
CheckpointPolicy SomePolicy() {
  return CheckpointPolicy(true, {.processed_seq = 10, .processing_us = 1'000'000, .cost_us = 2000}, 500);
}
// One item later, with a stream, and more items waiting.
Counters OneItemLater() {
  return {.processed_seq = 11, .poses = 501, .processing_us = 1'000'100, .has_waiting = true, .may_receive = true};
}

TEST(CheckpointPolicyTest, IsDueAfterEnoughWorkOrPoses) {
  const CheckpointPolicy policy = SomePolicy();
  EXPECT_FALSE(policy.IsDue(OneItemLater(), Progress()));
  Counters work = OneItemLater();
  work.processing_us = 1'000'000 + kCheckpointWorkUs - 1;
  EXPECT_FALSE(policy.IsDue(work, Progress()));
  ++work.processing_us;
  EXPECT_TRUE(policy.IsDue(work, Progress()));
  Counters poses = OneItemLater();
  poses.processing_us = 1'000'000 + kCheckpointCostFactor * 2000;
  poses.poses = 500 + kCheckpointPoses - 1;
  EXPECT_FALSE(policy.IsDue(poses, Progress()));
  ++poses.poses;
  EXPECT_TRUE(policy.IsDue(poses, Progress()));
}

TEST(CheckpointPolicyTest, CostsAtMostATwentiethOfTheTime) {
  CheckpointPolicy policy = SomePolicy();
  policy.RecordCheckpoint({.processed_seq = 10, .processing_us = 1'000'000, .cost_us = 50'000});
  Counters now = OneItemLater();
  now.processing_us = 1'000'000 + kCheckpointCostFactor * 50'000 - 1;
  now.poses = 500 + kMaxUncommittedPoses - 1;
  EXPECT_FALSE(policy.IsDue(now, Progress())) << "the last one was expensive";
  ++now.processing_us;
  EXPECT_TRUE(policy.IsDue(now, Progress()));
  --now.processing_us;
  ++now.poses;
  EXPECT_TRUE(policy.IsDue(now, Progress())) << "the session would have to wait for the store";
}

TEST(CheckpointPolicyTest, IsDueWhenTheSessionRests) {
  const CheckpointPolicy policy = SomePolicy();
  Counters idle = OneItemLater();
  idle.has_waiting = false;
  EXPECT_FALSE(policy.IsDue(idle, Progress())) << "the stream may send more";
  idle.may_receive = false;
  EXPECT_TRUE(policy.IsDue(idle, Progress()));
  idle.has_waiting = true;
  EXPECT_FALSE(policy.IsDue(idle, Progress()));
  idle.processed_seq = 10;
  idle.has_waiting = false;
  EXPECT_FALSE(policy.IsDue(idle, Progress())) << "nothing is new";
}

TEST(CheckpointPolicyTest, IsDueAtTheEndAndOnRequest) {
  CheckpointPolicy policy = SomePolicy();
  Counters ended = OneItemLater();
  ended.processed_seq = 10;
  ended.has_ended = true;
  EXPECT_TRUE(policy.IsDue(ended, Progress())) << "the end has no number";
  policy.RecordCheckpoint({.processed_seq = 10, .has_ended = true});
  EXPECT_FALSE(policy.IsDue(ended, Progress()));

  CheckpointPolicy flushed = SomePolicy();
  EXPECT_FALSE(flushed.is_flushing());
  flushed.RequestFlush();
  EXPECT_TRUE(flushed.is_flushing());
  EXPECT_TRUE(flushed.IsDue(OneItemLater(), Progress()));
}

TEST(CheckpointPolicyTest, OneAtATimeAndBetweenItems) {
  const CheckpointPolicy policy = SomePolicy();
  Counters now = OneItemLater();
  now.may_receive = false;
  now.has_waiting = false;
  ASSERT_TRUE(policy.IsDue(now, Progress()));
  EXPECT_FALSE(policy.IsDue(now, {.has_waiting = true}));
  now.is_working = true;
  EXPECT_FALSE(policy.IsDue(now, Progress()));
  now.poses = 500 + kMaxUncommittedPoses;
  EXPECT_TRUE(policy.IsDue(now, Progress())) << "the poses of a long item are written without a state";
  --now.poses;
  EXPECT_FALSE(policy.IsDue(now, Progress()));
}

TEST(CheckpointPolicyTest, StoredPosesAheadOfTheSessionAreNotNew) {
  CheckpointPolicy policy = SomePolicy();
  policy.RecordPoses(9000);
  Counters now = OneItemLater();
  now.poses = 501;
  EXPECT_FALSE(policy.IsDue(now, Progress())) << "poses before the stored ones must not count as many";
}

TEST(CheckpointPolicyTest, WaitsForTheStore) {
  const CheckpointPolicy policy = SomePolicy();
  EXPECT_FALSE(policy.MustWait(100 + kMaxUncommittedPoses - 1, {.last_pose_seq = 100}));
  EXPECT_TRUE(policy.MustWait(100 + kMaxUncommittedPoses, {.last_pose_seq = 100}));
  EXPECT_EQ(policy.LastPoseSeqToSend(150, {.last_pose_seq = 100}), 150u);
  EXPECT_EQ(policy.LastPoseSeqToSend(UINT64_MAX, {.last_pose_seq = 100}), 100 + kMaxPosesBeyondStore);
}

TEST(CheckpointPolicyTest, KeepsThePosesThatTheStoreDoesNotHave) {
  CheckpointPolicy policy = SomePolicy();
  EXPECT_EQ(policy.FirstPoseSeqToKeep(), 501u);
  policy.RecordPoses(600);
  EXPECT_EQ(policy.last_pose_seq(), 600u);
  EXPECT_EQ(policy.FirstPoseSeqToKeep(), 601u);
}

TEST(CheckpointPolicyTest, PersistedIsWhatTheStoreHas) {
  const CheckpointPolicy policy = SomePolicy();
  EXPECT_EQ(policy.PersistedSeq(11, {.seq = 9}), 9u);
  EXPECT_FALSE(policy.IsEndPersisted(true, Progress()));
  EXPECT_TRUE(policy.IsEndPersisted(true, {.has_ended = true}));
  EXPECT_FALSE(policy.IsEndPersisted(false, {.has_ended = true}));
}

TEST(CheckpointPolicyTest, IsFlushedWhenNothingIsLeft) {
  const CheckpointPolicy policy = SomePolicy();
  Counters now = OneItemLater();
  EXPECT_FALSE(policy.IsFlushed(now, Progress()));
  now.processed_seq = 10;
  EXPECT_TRUE(policy.IsFlushed(now, Progress())) << "waiting items are not processed";
  EXPECT_FALSE(policy.IsFlushed(now, {.has_waiting = true}));
  now.is_working = true;
  EXPECT_FALSE(policy.IsFlushed(now, Progress()));
}

TEST(CheckpointPolicyTest, WithoutCheckpointsProcessedIsPersisted) {
  CheckpointPolicy policy(false, {}, 0);
  policy.RequestFlush();
  Counters now = OneItemLater();
  now.has_ended = true;
  EXPECT_FALSE(policy.IsDue(now, Progress()));
  EXPECT_FALSE(policy.MustWait(UINT64_MAX / 2, Progress()));
  EXPECT_EQ(policy.LastPoseSeqToSend(77, Progress()), 77u);
  EXPECT_EQ(policy.FirstPoseSeqToKeep(), UINT64_MAX);
  EXPECT_EQ(policy.PersistedSeq(11, Progress()), 11u);
  EXPECT_TRUE(policy.IsEndPersisted(true, Progress()));
  EXPECT_FALSE(policy.IsEndPersisted(false, Progress()));
  EXPECT_TRUE(policy.IsFlushed(now, Progress()));
  now.is_working = true;
  EXPECT_FALSE(policy.IsFlushed(now, Progress()));
}

}  // namespace
}  // namespace evpose::server
