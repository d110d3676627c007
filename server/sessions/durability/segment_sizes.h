// SPDX-License-Identifier: Apache-2.0

// The bytes of the poses of a session in the store, by segment, and the segments that exceed their limit.
#pragma once

#include <cstdint>
#include <deque>

#include "absl/types/span.h"
#include "server/stores/common/store.h"

namespace evpose::server {

// Not thread-safe.
class SegmentSizes {
 public:
  // The segments with the last poses are kept in any case: a stream may be 1024 poses behind (kMaxUnsentPoses), and the
  // store further ones (kMaxUncommittedPoses). A pose takes at most 1 kB, so that they exceed a limit of 4 MiB by at
  // most one segment.
  static constexpr uint64_t kMinPoses = 4096;

  // `stored` are the segments that the store has.
  SegmentSizes(uint64_t max_bytes, absl::Span<const PoseSegment> stored);

  // The segment follows those before.
  void Add(const PoseSegment& segment);
  // The store deletes the segments that end before this pose.
  void RemoveBefore(uint64_t pose_seq);
  // The first pose of the oldest segment that may stay; 0 without segments.
  uint64_t FirstPoseSeqToKeep() const;

 private:
  struct Size {
    uint64_t first_pose_seq = 0;
    uint64_t last_pose_seq = 0;
    uint64_t bytes = 0;
  };

  const uint64_t max_bytes_;
  std::deque<Size> sizes_;
  uint64_t sum_bytes_ = 0;
};

}  // namespace evpose::server
