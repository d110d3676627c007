// SPDX-License-Identifier: Apache-2.0
#include "core/numerics/lanes.h"

#include <gtest/gtest.h>

#include <cmath>

namespace evpose {
namespace {

TEST(Lanes, NegativeExpIsCloseToTheLibrary) {
  for (float x = 0.0f; x < 64.0f; x += 0.00317f) {
    const Lanes result = NegativeExp(Lanes{x, 0.5f * x, 0.25f * x, 0.0f});
    EXPECT_NEAR(result[0] / std::exp(-static_cast<double>(x)), 1.0, 8e-6) << x;
    EXPECT_NEAR(result[1] / std::exp(-0.5 * x), 1.0, 8e-6) << x;
    EXPECT_NEAR(result[2] / std::exp(-0.25 * x), 1.0, 8e-6) << x;
    EXPECT_EQ(result[3], 1.0f);
  }
}

TEST(Lanes, NegativeExpOfLargeNumbersIsSmallAndFinite) {
  const Lanes result = NegativeExp(Lanes{64.0f, 1e6f, 1e30f, INFINITY});
  for (int i = 0; i < kNumLanes; ++i) {
    EXPECT_GT(result[i], 0.0f);
    EXPECT_LT(result[i], 2e-28f);
  }
}

TEST(Lanes, MasksChooseByLane) {
  const Lanes a = {1.0f, 2.0f, 3.0f, 4.0f};
  const Lanes b = {-5.0f, -6.0f, -7.0f, -8.0f};
  const LaneMask is_small = a < 2.5f;
  const Lanes chosen = Select(is_small, a, b);
  const Lanes only = Only(is_small, a);
  const Lanes absolute = Abs(b);
  for (int i = 0; i < kNumLanes; ++i) {
    EXPECT_EQ(chosen[i], i < 2 ? a[i] : b[i]);
    EXPECT_EQ(only[i], i < 2 ? a[i] : 0.0f);
    EXPECT_EQ(absolute[i], -b[i]);
  }
  EXPECT_EQ(SumOf(a), 10.0);
}

// The order of the additions is the same as in SumOf(): another one gives other bits for lanes of different sizes.
TEST(Lanes, SumsOfSeveralVectorsHaveTheBitsOfSumOf) {
  std::array<Lanes, 11> all;
  for (size_t i = 0; i < all.size(); ++i) {
    for (int lane = 0; lane < kNumLanes; ++lane) {
      const auto size = static_cast<float>(1 << (7 * ((lane + i) % kNumLanes)));
      all[i][lane] = size * (1.0f + 0.1f * static_cast<float>(i)) / (3.0f + static_cast<float>(lane));
    }
  }
  const std::array<double, 11> sums = SumsOf(all);
  for (size_t i = 0; i < all.size(); ++i) EXPECT_EQ(sums[i], SumOf(all[i])) << i;
}

}  // namespace
}  // namespace evpose
