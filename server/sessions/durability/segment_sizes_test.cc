// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/durability/segment_sizes.h"

#include <gtest/gtest.h>

#include <string>

namespace evpose::server {
namespace {

PoseSegment Segment(uint64_t first, uint64_t last, size_t bytes) { return {first, last, std::string(bytes, 'p')}; }

TEST(SegmentSizesTest, KeepsAllThatFits) {
  SegmentSizes sizes(100, {});
  EXPECT_EQ(sizes.FirstPoseSeqToKeep(), 0u);
  sizes.Add(Segment(1, 5000, 60));
  sizes.Add(Segment(5001, 10'000, 40));
  EXPECT_EQ(sizes.FirstPoseSeqToKeep(), 1u);
}

TEST(SegmentSizesTest, RemovesTheOldestSegmentsBeyondTheLimit) {
  const PoseSegment stored[] = {Segment(101, 5000, 60), Segment(5001, 10'000, 30)};
  SegmentSizes sizes(100, stored);
  EXPECT_EQ(sizes.FirstPoseSeqToKeep(), 101u);
  sizes.Add(Segment(10'001, 15'000, 40));
  EXPECT_EQ(sizes.FirstPoseSeqToKeep(), 5001u);
  sizes.RemoveBefore(5001);
  sizes.Add(Segment(15'001, 20'000, 30));
  EXPECT_EQ(sizes.FirstPoseSeqToKeep(), 5001u) << "the bytes of the deleted segment do not count";
  sizes.Add(Segment(20'001, 25'000, 70));
  EXPECT_EQ(sizes.FirstPoseSeqToKeep(), 15'001u);
}

TEST(SegmentSizesTest, KeepsTheLastPosesBeyondTheLimit) {
  SegmentSizes sizes(100, {});
  sizes.Add(Segment(1, 100, 500));
  sizes.Add(Segment(101, 200, 500));
  sizes.Add(Segment(201, 201 + SegmentSizes::kMinPoses - 3, 500));
  EXPECT_EQ(sizes.FirstPoseSeqToKeep(), 101u) << "pose 200 is among the last poses";
}

}  // namespace
}  // namespace evpose::server
