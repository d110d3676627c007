// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session_beginning.h"

#include <algorithm>
#include <utility>

namespace evpose::server {

uint64_t FirstPoseSeq(const SessionBeginning& beginning) {
  return beginning.poses.empty() ? beginning.checkpoint.health.poses + 1 : beginning.poses.front().pose_seq;
}

uint64_t LastPoseSeq(const SessionBeginning& beginning) {
  const uint64_t made = beginning.checkpoint.health.poses;
  return beginning.poses.empty() ? made : std::max(made, beginning.poses.back().pose_seq);
}

SessionCommitter::Progress PersistedAt(const SessionBeginning& beginning) {
  return {.seq = beginning.checkpoint.processed_seq,
          .last_pose_seq = beginning.poses.empty() ? 0 : beginning.poses.back().pose_seq,
          .has_ended = beginning.checkpoint.has_ended};
}

StreamGate::Start GateStart(const SessionBeginning& beginning, std::string resume_token, absl::Time now) {
  const bool is_resumed = resume_token.empty();
  return {.lifecycle = beginning.lifecycle,
          .detached_at = now,
          .resume_token = std::move(resume_token),
          .processed_seq = beginning.checkpoint.processed_seq,
          .has_ended = beginning.checkpoint.has_ended,
          .max_seen_pose_seq = is_resumed ? LastPoseSeq(beginning) + kMaxPosesBeyondStore : 0};
}

CheckpointPolicy::Checkpoint LastCheckpoint(const SessionBeginning& beginning) {
  return {.processed_seq = beginning.checkpoint.processed_seq,
          .has_ended = beginning.checkpoint.has_ended,
          .processing_us = beginning.checkpoint.health.processing_us};
}

}  // namespace evpose::server
