// SPDX-License-Identifier: Apache-2.0

// The latest poses of one session, in memory: what streams and watchers read. Poses wait here for the store, too.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <mutex>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/types/span.h"
#include "core/tracking/tracker.h"

namespace evpose::server {

// A pose as a session made it.
struct StoredPose {
  uint64_t pose_seq = 0;      // 1, 2, 3, ... in the session
  uint32_t object_index = 0;  // in the session's configuration
  PoseEstimate estimate;
  int64_t latency_us = 0;  // from the receipt of the chunk that completed the window
};

// Thread-safe.
class PoseLog {
 public:
  // Keeps the last `capacity` poses, at least 1. The first that is appended is number `next_pose_seq`.
  explicit PoseLog(size_t capacity, uint64_t next_pose_seq = 1);
  ~PoseLog();

  // `poses` continue the log without a gap. Those that it has had already are left out: a session that starts again
  // from an earlier state makes the same ones again. Poses numbered `kept_from` and higher are kept beyond the
  // capacity.
  void Append(absl::Span<const StoredPose> poses, uint64_t kept_from = UINT64_MAX);

  // At most `max_poses` of those numbered above `after_pose_seq`, from the oldest that is still kept. Empty: no such
  // pose yet. The first one's number tells whether poses between were forgotten.
  std::vector<StoredPose> Read(uint64_t after_pose_seq, size_t max_poses) const;

  // The number of the oldest pose that Read can give; one above the last when there is none.
  uint64_t first_pose_seq() const;
  // That of the newest, 0 before the first.
  uint64_t last_pose_seq() const;
  size_t capacity() const { return capacity_; }

 private:
  uint64_t FirstSeq() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) { return next_seq_ - poses_.size(); }

  const size_t capacity_;
  mutable std::mutex mutex_;
  uint64_t next_seq_ ABSL_GUARDED_BY(mutex_);
  std::deque<StoredPose> poses_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
