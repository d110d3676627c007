// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/durability/checkpoint_policy.h"

#include <algorithm>

namespace evpose::server {

bool CheckpointPolicy::HasProgress(const Counters& now) const {
  return now.processed_seq != last_.processed_seq || now.has_ended != last_.has_ended;
}

bool CheckpointPolicy::IsDue(const Counters& now, const Progress& store) const {
  if (!writes_checkpoints_ || store.has_waiting) return false;
  const uint64_t new_poses = now.poses - std::min(now.poses, last_pose_seq_);
  // One item may produce more poses than may wait: these poses are then written without a state.
  if (now.is_working) return new_poses >= kMaxUncommittedPoses;
  if (!HasProgress(now)) return false;
  if (now.has_ended || is_flushing_ || (!now.may_receive && !now.has_waiting)) return true;
  if (new_poses >= kMaxUncommittedPoses) return true;
  const int64_t work_us = now.processing_us - last_.processing_us;
  if (work_us < kCheckpointCostFactor * last_.cost_us) return false;
  return work_us >= kCheckpointWorkUs || new_poses >= kCheckpointPoses;
}

bool CheckpointPolicy::MustWait(uint64_t poses, const Progress& store) const {
  return writes_checkpoints_ && poses >= store.last_pose_seq + kMaxUncommittedPoses;
}

uint64_t CheckpointPolicy::LastPoseSeqToSend(uint64_t poses, const Progress& store) const {
  return writes_checkpoints_ ? std::min(poses, store.last_pose_seq + kMaxPosesBeyondStore) : poses;
}

uint64_t CheckpointPolicy::PersistedSeq(uint64_t processed_seq, const Progress& store) const {
  return writes_checkpoints_ ? store.seq : processed_seq;
}

bool CheckpointPolicy::IsEndPersisted(bool has_ended, const Progress& store) const {
  return has_ended && (!writes_checkpoints_ || store.has_ended);
}

bool CheckpointPolicy::IsFlushed(const Counters& now, const Progress& store) const {
  if (now.is_working) return false;
  return !writes_checkpoints_ || (!HasProgress(now) && !store.has_waiting);
}

}  // namespace evpose::server
