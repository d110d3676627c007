// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/stream/work_queue.h"

#include <gtest/gtest.h>

#include <string>

namespace evpose::server {
namespace {

SteadyTime At(int us) { return SteadyTime(std::chrono::microseconds(us)); }

WorkItem Chunk(uint64_t seq, size_t bytes, int received_at_us) {
  return {1, At(received_at_us), EventChunk{.seq = seq, .payload = std::string(bytes, 'x')}};
}

TEST(WorkItemTest, HasBytesAndNumber) {
  EXPECT_EQ(Chunk(3, 7, 0).bytes(), 7u);
  EXPECT_EQ(Chunk(3, 7, 0).seq(), 3u);
  const WorkItem reset = {1, At(0), PoseReset{.seq = 4}};
  EXPECT_EQ(reset.bytes(), 0u);
  EXPECT_EQ(reset.seq(), 4u);
  EXPECT_FALSE(reset.is_end());
  const WorkItem end = {1, At(0), EndOfInput{}};
  EXPECT_EQ(end.bytes(), 0u);
  EXPECT_EQ(end.seq(), 0u);
  EXPECT_TRUE(end.is_end());
}

TEST(WorkQueueTest, CountsTheItemInWorkUntilItIsFinished) {
  WorkQueue queue;
  EXPECT_FALSE(queue.has_items());
  EXPECT_FALSE(queue.oldest_received_at().has_value());
  queue.Push(Chunk(1, 10, 100));
  queue.Push(Chunk(2, 5, 200));
  EXPECT_EQ(queue.bytes(), 15u);
  EXPECT_EQ(queue.num_items(), 2u);
  EXPECT_EQ(queue.oldest_received_at(), At(100));

  EXPECT_EQ(queue.StartNext().seq(), 1u) << "in the order of Push";
  EXPECT_TRUE(queue.is_working());
  EXPECT_EQ(queue.num_items(), 1u);
  EXPECT_EQ(queue.bytes(), 15u);
  EXPECT_EQ(queue.oldest_received_at(), At(100));

  queue.FinishCurrent();
  EXPECT_FALSE(queue.is_working());
  EXPECT_EQ(queue.bytes(), 5u);
  EXPECT_EQ(queue.oldest_received_at(), At(200));
}

TEST(WorkQueueTest, ClearKeepsTheItemInWork) {
  WorkQueue queue;
  queue.Push(Chunk(1, 10, 100));
  queue.Push(Chunk(2, 5, 200));
  queue.StartNext();
  queue.Clear();
  EXPECT_FALSE(queue.has_items());
  EXPECT_TRUE(queue.is_working());
  EXPECT_EQ(queue.bytes(), 10u);
  queue.FinishCurrent();
  EXPECT_EQ(queue.bytes(), 0u);
  queue.Push(Chunk(3, 5, 300));
  queue.Clear();
  EXPECT_EQ(queue.bytes(), 0u);
  EXPECT_FALSE(queue.oldest_received_at().has_value());
}

}  // namespace
}  // namespace evpose::server
