// SPDX-License-Identifier: Apache-2.0
#include "core/numerics/sampling.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <vector>

namespace evpose {
namespace {

std::vector<uint64_t> NumbersFrom(uint64_t first, size_t count) {
  std::vector<uint64_t> numbers(count);
  std::iota(numbers.begin(), numbers.end(), first);
  return numbers;
}

TEST(HashSampleTest, OneByOneAsTogether) {
  // Lengths that are no multiple of the lanes; numbers above 32 bits, and the last ones before 64 bits overflow.
  for (const uint64_t first : {uint64_t{0}, uint64_t{1} << 40, ~uint64_t{0} - 7}) {
    for (const HashSampleMasks& masks :
         {HashSampleMasks{0, 0}, HashSampleMasks{0, 1}, HashSampleMasks{7, 0}, HashSampleMasks{0xff, 3}}) {
      for (const size_t count : {1u, 9u, 100u, 1001u}) {
        const std::vector<uint64_t> numbers = NumbersFrom(first, count);
        std::vector<uint8_t> expected;
        for (const uint64_t number : numbers) {
          expected.push_back((IsInHashSample(number, masks[0]) ? 1 : 0) + (IsInHashSample(number, masks[1]) ? 2 : 0));
        }
        std::vector<uint8_t> marks(count, 4);
        MarkHashSample(first, masks, absl::MakeSpan(marks));
        EXPECT_EQ(marks, expected) << first << " " << masks[0] << " " << masks[1];
        marks.assign(count, 4);
        MarkHashSample(numbers, masks, absl::MakeSpan(marks));
        EXPECT_EQ(marks, expected) << first << " " << masks[0] << " " << masks[1];
      }
    }
  }
}

TEST(HashSampleTest, IsTheSameOnEveryMachine) {
  std::vector<uint64_t> sample;
  for (uint64_t number = 0; number < 64; ++number) {
    if (IsInHashSample(number, 7)) sample.push_back(number);
  }
  EXPECT_THAT(sample, ::testing::ElementsAre(6, 29, 33, 38, 43, 49, 51));
}

TEST(HashSampleTest, EveryBitOfTheMaskHalvesIt) {
  std::vector<uint8_t> marks(1 << 16);
  double share = 1.0;
  for (uint64_t mask = 0; mask < 64; mask = 2 * mask + 1, share /= 2.0) {
    MarkHashSample(12345, {0, mask}, absl::MakeSpan(marks));
    const double count = static_cast<double>(std::count(marks.begin(), marks.end(), 3));
    EXPECT_NEAR(count / static_cast<double>(marks.size()), share, 0.01) << mask;
  }
}

struct Item {
  double position = 0.0;
  uint8_t kind = 0;
};

TEST(DownsampleByClassTest, KeepsAnEvenShare) {
  std::vector<Item> items(10'000);
  for (size_t i = 0; i < items.size(); ++i) items[i].position = static_cast<double>(i);
  const auto class_of = [](const Item& item) { return item.kind; };
  DownsampleByClass(1000, {0.5, 0.5}, absl::MakeConstSpan(items), class_of, items);
  ASSERT_LE(items.size(), 1000u);
  ASSERT_GE(items.size(), 990u);
  int odd = 0;
  int first_half = 0;
  for (const Item& item : items) {
    odd += static_cast<int>(item.position) % 2;
    first_half += item.position < 5000.0 ? 1 : 0;
  }
  EXPECT_NEAR(odd, 500, 50);
  EXPECT_NEAR(first_half, 500, 10);
  DownsampleByClass(2000, {0.5, 0.5}, absl::MakeConstSpan(items), class_of, items);
  EXPECT_GE(items.size(), 990u);
}

TEST(DownsampleByClassTest, KeepsTheRarerClass) {
  const auto downsample = [](size_t num_0, size_t num_1, double share_0 = 0.5) {
    std::vector<Item> all(num_0 + num_1);
    for (size_t i = 0; i < num_1; ++i) all[i].kind = 1;
    std::vector<Item> items;
    const std::array<double, 2> per_kept = DownsampleByClass(
        1000, {share_0, 1.0 - share_0}, absl::MakeConstSpan(all), [](const Item& item) { return item.kind; }, items);
    const auto kept_1 =
        static_cast<double>(std::count_if(items.begin(), items.end(), [](const Item& item) { return item.kind == 1; }));
    const auto kept_0 = static_cast<double>(items.size()) - kept_1;
    EXPECT_LE(items.size(), 1000u);
    EXPECT_NEAR(per_kept[0] * kept_0, static_cast<double>(num_0), 1e-9);
    EXPECT_NEAR(per_kept[1] * kept_1, static_cast<double>(num_1), 1e-9);
    return std::array<double, 2>{kept_0, kept_1};
  };
  EXPECT_EQ(downsample(100, 900), (std::array<double, 2>{100, 900}));
  EXPECT_NEAR(downsample(100, 9900)[0], 100.0, 2.0);
  EXPECT_NEAR(downsample(100, 9900)[1], 900.0, 2.0);
  EXPECT_NEAR(downsample(2000, 50'000)[0], 500.0, 2.0);
  EXPECT_NEAR(downsample(50'000, 2000)[0], 500.0, 2.0);
  EXPECT_EQ(downsample(0, 5000)[0], 0.0);
  EXPECT_NEAR(downsample(2000, 8000, 0.2)[0], 200.0, 2.0);
  EXPECT_NEAR(downsample(2000, 50'000, 0.2)[0], 200.0, 2.0);
  EXPECT_NEAR(downsample(50'000, 2000, 0.2)[1], 800.0, 2.0);
}

TEST(SelectionSamplerTest, TakesExactlyAsManyAsWanted) {
  for (const size_t total : {1u, 10u, 1000u}) {
    for (const size_t wanted : {0u, 1u, 7u, 999u, 2000u}) {
      SelectionSampler sampler(total, wanted);
      size_t taken = 0;
      for (size_t i = 0; i < total; ++i) taken += sampler.TakesNext() ? 1 : 0;
      EXPECT_EQ(taken, std::min(total, wanted));
    }
  }
}

}  // namespace
}  // namespace evpose
