// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session_beginning.h"

#include <algorithm>
#include <utility>

namespace evpose::server {

uint64_t FirstPoseSeq(const SessionBeginning& beginning) {
  if (!beginning.poses.empty()) return beginning.poses.front().pose_seq;
  return beginning.checkpoint.has_value() ? beginning.checkpoint->health.poses + 1 : 1;
}

uint64_t LastPoseSeq(const SessionBeginning& beginning) {
  const uint64_t made = beginning.checkpoint.has_value() ? beginning.checkpoint->health.poses : 0;
  return beginning.poses.empty() ? made : std::max(made, beginning.poses.back().pose_seq);
}

SessionCommitter::Progress PersistedAt(const SessionBeginning& beginning) {
  SessionCommitter::Progress persisted;
  if (beginning.checkpoint.has_value()) {
    persisted.seq = beginning.checkpoint->processed_seq;
    persisted.ended = beginning.checkpoint->ended;
  }
  if (!beginning.poses.empty()) persisted.last_pose_seq = beginning.poses.back().pose_seq;
  return persisted;
}

StreamGate::Start GateStart(const SessionBeginning& beginning, std::string resume_token, absl::Time now) {
  StreamGate::Start start = {
      .lifecycle = beginning.lifecycle, .detached_at = now, .resume_token = std::move(resume_token)};
  if (beginning.checkpoint.has_value()) {
    start.processed_seq = beginning.checkpoint->processed_seq;
    start.has_ended = beginning.checkpoint->ended;
  }
  const bool is_resumed = start.resume_token.empty();
  if (is_resumed) start.max_seen_pose_seq = LastPoseSeq(beginning) + kMaxPosesBeyondStore;
  return start;
}

CheckpointPolicy::Checkpoint LastCheckpoint(const SessionBeginning& beginning) {
  if (!beginning.checkpoint.has_value()) return {};
  return {.processed_seq = beginning.checkpoint->processed_seq,
          .has_ended = beginning.checkpoint->ended,
          .processing_us = beginning.checkpoint->health.processing_us};
}

SessionHealth HealthAt(const SessionBeginning& beginning) {
  return beginning.checkpoint.has_value() ? beginning.checkpoint->health : SessionHealth();
}

}  // namespace evpose::server
