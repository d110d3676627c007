// SPDX-License-Identifier: Apache-2.0
#include "core/windows/event_sample.h"

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

TEST(EventSample, MarksOfBatchesEqualThoseOfSingleNumbers) {
  // Lengths that are no multiple of a vector's lanes; numbers above 32 bits, and the last ones before the wrap.
  for (const uint64_t first : {uint64_t{0}, uint64_t{1} << 40, ~uint64_t{0} - 7}) {
    for (const SampleMasks& masks : {SampleMasks{0, 0}, SampleMasks{0, 1}, SampleMasks{7, 0}, SampleMasks{0xff, 3}}) {
      for (const size_t count : {1u, 9u, 100u, 1001u}) {
        const std::vector<uint64_t> numbers = NumbersFrom(first, count);
        std::vector<uint8_t> expected;
        for (const uint64_t number : numbers) {
          expected.push_back((IsInSample(number, masks[0]) ? 1 : 0) + (IsInSample(number, masks[1]) ? 2 : 0));
        }
        std::vector<uint8_t> marks(count, 4);
        MarkSample(first, masks, absl::MakeSpan(marks));
        EXPECT_EQ(marks, expected) << first << " " << masks[0] << " " << masks[1];
        marks.assign(count, 4);
        MarkSample(numbers, masks, absl::MakeSpan(marks));
        EXPECT_EQ(marks, expected) << first << " " << masks[0] << " " << masks[1];
      }
    }
  }
}

TEST(EventSample, IsTheSameOnEveryMachine) {
  std::vector<uint64_t> sample;
  for (uint64_t number = 0; number < 64; ++number) {
    if (IsInSample(number, 7)) sample.push_back(number);
  }
  EXPECT_THAT(sample, ::testing::ElementsAre(6, 29, 33, 38, 43, 49, 51));
}

TEST(EventSample, EveryBitOfTheMaskHalvesIt) {
  std::vector<uint8_t> marks(1 << 16);
  double share = 1.0;
  for (uint64_t mask = 0; mask < 64; mask = 2 * mask + 1, share /= 2.0) {
    MarkSample(12345, {0, mask}, absl::MakeSpan(marks));
    const double count = static_cast<double>(std::count(marks.begin(), marks.end(), 3));
    EXPECT_NEAR(count / static_cast<double>(marks.size()), share, 0.01) << mask;
  }
}

}  // namespace
}  // namespace evpose
