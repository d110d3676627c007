// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/durability/segment_sizes.h"

namespace evpose::server {

SegmentSizes::SegmentSizes(uint64_t max_bytes, absl::Span<const PoseSegment> stored) : max_bytes_(max_bytes) {
  for (const PoseSegment& segment : stored) Add(segment);
}

void SegmentSizes::Add(const PoseSegment& segment) {
  sizes_.push_back({segment.first_pose_seq, segment.last_pose_seq, segment.bytes.size()});
  sum_bytes_ += segment.bytes.size();
}

void SegmentSizes::RemoveBefore(uint64_t pose_seq) {
  while (!sizes_.empty() && sizes_.front().last_pose_seq < pose_seq) {
    sum_bytes_ -= sizes_.front().bytes;
    sizes_.pop_front();
  }
}

uint64_t SegmentSizes::FirstPoseSeqToKeep() const {
  uint64_t bytes = sum_bytes_;
  for (const Size& size : sizes_) {
    const bool is_recent = size.last_pose_seq + kMinPoses > sizes_.back().last_pose_seq;
    if (bytes <= max_bytes_ || is_recent) return size.first_pose_seq;
    bytes -= size.bytes;
  }
  return 0;
}

}  // namespace evpose::server
