// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/memory/session_memory.h"

#include <gtest/gtest.h>

#include "core/estimation/ideal_events_testing.h"

namespace evpose::server {
namespace {

class SessionMemoryTest : public ::testing::Test {
 protected:
  SessionMemoryTest() { config_.camera = evpose::testing::MakeCamera(640, 480, 500.0); }
  SessionMemory Estimate() const { return MaxSessionMemory(config_, {evpose::testing::MakeCube(0.2)}, limits_); }

  SessionConfig config_;
  SessionMemoryLimits limits_ = {
      .credit_bytes = 4'000'000, .max_chunk_bytes = 1'000'000, .pose_log_capacity = 1000, .writes_checkpoints = false};
};

TEST_F(SessionMemoryTest, CountsQueuePosesAndCheckpoints) {
  const SessionMemory before = Estimate();
  limits_.credit_bytes += 1'000'000;
  EXPECT_EQ(Estimate().other_bytes, before.other_bytes + 1'000'000);
  limits_.pose_log_capacity += 1000;
  EXPECT_GT(Estimate().other_bytes, before.other_bytes + 1'300'000);
  EXPECT_EQ(Estimate().tracking_bytes, before.tracking_bytes);
  limits_.writes_checkpoints = true;
  EXPECT_GT(Estimate().tracking_bytes, before.tracking_bytes);
}

TEST_F(SessionMemoryTest, AnOverloadedQueueMayTakeTwiceItsCredit) {
  const SessionMemory block = Estimate();
  config_.overload_policy = OverloadPolicy::kLatest;
  EXPECT_EQ(Estimate().other_bytes, block.other_bytes + limits_.credit_bytes);
}

TEST_F(SessionMemoryTest, ALargerCameraNeedsMore) {
  const SessionMemory vga = Estimate();
  config_.camera = evpose::testing::MakeCamera(4096, 4096, 3000.0);
  EXPECT_GT(Estimate().tracking_bytes, vga.tracking_bytes);
  EXPECT_EQ(Estimate().other_bytes, vga.other_bytes);
}

TEST_F(SessionMemoryTest, AWatcherOfEventsNeedsMoreForMoreCellsAndObjects) {
  config_.camera = evpose::testing::MakeCamera(1280, 720, 1000.0);
  config_.objects.resize(1);
  const uint64_t small = EventWatcherMemory(config_, 4);
  EXPECT_EQ(EventWatcherMemory(config_, 1), small + uint64_t{5} * (1280 * 720 / 4 - 1280 * 720 / 64));
  EXPECT_LT(EventWatcherMemory(config_, 2), 600'000u);
  config_.objects.resize(3);
  EXPECT_GT(EventWatcherMemory(config_, 4), small + 200'000);
}

}  // namespace
}  // namespace evpose::server
