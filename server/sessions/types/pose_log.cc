// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/types/pose_log.h"

#include <algorithm>

namespace evpose::server {

PoseLog::PoseLog(size_t capacity, uint64_t next_pose_seq)
    : capacity_(std::max<size_t>(capacity, 1)), next_seq_(next_pose_seq) {}

// The last reference may be released on a thread of gRPC: the lock shows to race detectors that the others are done.
PoseLog::~PoseLog() { const std::lock_guard lock(mutex_); }

void PoseLog::Append(absl::Span<const StoredPose> poses, uint64_t kept_from) {
  const std::lock_guard lock(mutex_);
  for (const StoredPose& pose : poses) {
    if (pose.pose_seq < next_seq_) continue;
    poses_.push_back(pose);
    ++next_seq_;
  }
  while (poses_.size() > capacity_ && FirstSeq() < kept_from) poses_.pop_front();
}

void PoseLog::RemoveBefore(uint64_t pose_seq) {
  const std::lock_guard lock(mutex_);
  while (!poses_.empty() && FirstSeq() < pose_seq) poses_.pop_front();
}

std::vector<StoredPose> PoseLog::Read(uint64_t after_pose_seq, size_t max_poses) const {
  const std::lock_guard lock(mutex_);
  if (after_pose_seq >= next_seq_ - 1) return {};
  const uint64_t first = std::max(after_pose_seq + 1, FirstSeq());
  const auto begin = poses_.begin() + static_cast<ptrdiff_t>(first - FirstSeq());
  const size_t count = std::min<size_t>(max_poses, next_seq_ - first);
  return {begin, begin + static_cast<ptrdiff_t>(count)};
}

uint64_t PoseLog::first_pose_seq() const {
  const std::lock_guard lock(mutex_);
  return FirstSeq();
}

uint64_t PoseLog::last_pose_seq() const {
  const std::lock_guard lock(mutex_);
  return next_seq_ - 1;
}

}  // namespace evpose::server
