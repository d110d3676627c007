// SPDX-License-Identifier: Apache-2.0
#include "core/numerics/random.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

namespace evpose {
namespace {

struct Moments {
  double mean = 0.0;
  double variance = 0.0;
};

template <typename Draw>
Moments MomentsOf(Draw draw) {
  constexpr int kCount = 200'000;
  double sum = 0.0;
  double sum2 = 0.0;
  for (int i = 0; i < kCount; ++i) {
    const double value = draw();
    sum += value;
    sum2 += value * value;
  }
  const double mean = sum / kCount;
  return {mean, sum2 / kCount - mean * mean};
}

TEST(RandomTest, SeedDeterminesTheSequence) {
  Random a(1);
  Random b(1);
  Random c(2);
  for (int i = 0; i < 100; ++i) EXPECT_EQ(a.NextU64(), b.NextU64());
  EXPECT_NE(Random(1).NextU64(), c.NextU64());
}

// The first output of xoshiro256** for the state {1, 2, 3, 4} is rotl(2 * 5, 7) * 9 = 11520; with SplitMix64 seeding
// a change of either algorithm changes this number.
TEST(RandomTest, SequenceIsFixed) { EXPECT_EQ(Random(0).NextU64(), 0x99EC5F36CB75F2B4ull); }

TEST(RandomTest, MomentsOfTheDistributions) {
  Random random(3);
  const Moments uniform = MomentsOf([&] { return random.Uniform(); });
  EXPECT_NEAR(uniform.mean, 0.5, 0.005);
  EXPECT_NEAR(uniform.variance, 1.0 / 12.0, 0.002);
  const Moments normal = MomentsOf([&] { return random.Normal(); });
  EXPECT_NEAR(normal.mean, 0.0, 0.01);
  EXPECT_NEAR(normal.variance, 1.0, 0.02);
  const Moments exponential = MomentsOf([&] { return random.Exponential(4.0); });
  EXPECT_NEAR(exponential.mean, 0.25, 0.003);
  EXPECT_NEAR(exponential.variance, 1.0 / 16.0, 0.002);
  const Moments few = MomentsOf([&] { return double(random.Poisson(0.7)); });
  EXPECT_NEAR(few.mean, 0.7, 0.01);
  EXPECT_NEAR(few.variance, 0.7, 0.02);
}

TEST(RandomTest, PoissonOfALargeMean) {
  Random random(4);
  double sum = 0.0;
  for (int i = 0; i < 2000; ++i) sum += random.Poisson(1234.5);
  EXPECT_NEAR(sum / 2000, 1234.5, 4.0);
  EXPECT_EQ(random.Poisson(0.0), 0u);
}

TEST(RandomTest, UniformIntStaysBelowItsBoundAndReachesAll) {
  Random random(5);
  std::vector<int> counts(7);
  for (int i = 0; i < 70'000; ++i) ++counts.at(random.UniformInt(7));
  for (int count : counts) EXPECT_NEAR(count, 10'000, 500);
}

}  // namespace
}  // namespace evpose
