// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/flash.h"

#include <gtest/gtest.h>

namespace evpose {
namespace {

class FlashTest : public ::testing::Test {
 protected:
  void Add(double off, double on, int64_t duration_us = 1000) {
    detector_.Add({off, on}, t_us_, t_us_ + duration_us);
    t_us_ += duration_us;
  }
  const FlashOptions options_{};
  FlashDetector detector_{options_};
  int64_t t_us_ = 0;
};

TEST_F(FlashTest, MovingEdgesCauseBothPolarities) {
  for (int i = 0; i < 100; ++i) {
    Add(60.0, 200.0);
    EXPECT_FALSE(detector_.is_changing()) << i;
  }
}

TEST_F(FlashTest, AFlashCausesOneAndLastsOn) {
  for (int i = 0; i < 4; ++i) Add(5.0, 500.0);
  EXPECT_TRUE(detector_.is_changing());
  int64_t windows = 0;
  while (detector_.is_changing() && windows < 1000) {
    Add(500.0, 500.0);
    ++windows;
  }
  // The last window with the flash, and those after it.
  EXPECT_GE(windows * 1000, options_.hold_us);
  EXPECT_LE(windows * 1000, options_.hold_us + options_.memory_us);
}

TEST_F(FlashTest, AFewEventsShowNothing) {
  for (int i = 0; i < 100; ++i) {
    Add(0.0, 10.0);
    EXPECT_FALSE(detector_.is_changing()) << i;
  }
}

}  // namespace
}  // namespace evpose
