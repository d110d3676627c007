// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/wrong_time.h"

#include <gtest/gtest.h>

namespace evpose {
namespace {

TEST(WrongTimeTest, ASinglePoseIsWrongUntilTheNextOne) {
  WrongTime wrong;
  wrong.Add(1000, true);
  wrong.Add(3000, false);
  wrong.Add(4000, true);
  wrong.Add(5000, true);
  wrong.Finish(9000);
  EXPECT_EQ(wrong.total_us(), 7000);
  EXPECT_EQ(wrong.longest_us(), 5000);
}

TEST(WrongTimeTest, AGapEndsAWrongTime) {
  WrongTime wrong;
  wrong.Add(0, true);
  wrong.Add(10'000, true);
  wrong.Add(60'000, true);
  wrong.Finish(65'000);
  EXPECT_EQ(wrong.total_us(), 35'000) << "the pose before the gap is valid for 20 ms";
  EXPECT_EQ(wrong.longest_us(), 30'000);
}

TEST(WrongTimeTest, RightPosesCountNothing) {
  WrongTime wrong;
  wrong.Finish(1000);
  wrong.Add(2000, false);
  wrong.Finish(3000);
  EXPECT_EQ(wrong.total_us(), 0);
  EXPECT_EQ(wrong.longest_us(), 0);
}

}  // namespace
}  // namespace evpose
