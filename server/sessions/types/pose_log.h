// SPDX-License-Identifier: Apache-2.0

// The latest poses of one session, in memory, for streams and watchers. Poses that wait for the store are here, too.
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

// A pose with its number in the session.
struct StoredPose {
  uint64_t pose_seq = 0;      // 1, 2, 3, ... in the session
  uint32_t object_index = 0;  // in the session's configuration
  PoseEstimate estimate;
  int64_t latency_us = 0;  // since the receipt of the chunk that completed the window
};

// Thread-safe.
class PoseLog {
 public:
  // Keeps the last `capacity` poses, at least 1. The first pose to be appended has the number `next_pose_seq`.
  explicit PoseLog(size_t capacity, uint64_t next_pose_seq = 1);
  ~PoseLog();

  // `poses` continue the log without a gap. Poses that have been appended before are ignored, because a session that is
  // resumed from an earlier state produces the same poses again. Poses numbered `kept_from` and higher are kept beyond
  // the capacity.
  void Append(absl::Span<const StoredPose> poses, uint64_t kept_from = UINT64_MAX);

  // Removes the poses before this one.
  void RemoveBefore(uint64_t pose_seq);

  // Returns at most `max_poses` poses numbered above `after_pose_seq`, beginning with the oldest one in the log; none
  // if there is no such pose yet. If the first one is not `after_pose_seq + 1`, the poses in between have been removed.
  std::vector<StoredPose> Read(uint64_t after_pose_seq, size_t max_poses) const;

  // Number of the oldest pose in the log; one above the last number when the log is empty.
  uint64_t first_pose_seq() const;
  // Number of the newest pose; 0 before the first.
  uint64_t last_pose_seq() const;

 private:
  uint64_t FirstSeq() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) { return next_seq_ - poses_.size(); }

  const size_t capacity_;
  mutable std::mutex mutex_;
  uint64_t next_seq_ ABSL_GUARDED_BY(mutex_);
  std::deque<StoredPose> poses_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
