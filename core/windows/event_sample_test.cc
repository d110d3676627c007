#include "core/windows/event_sample.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <numeric>
#include <vector>

namespace evpose {
namespace {

std::vector<uint64_t> NumbersFrom(uint64_t first, size_t count) {
  std::vector<uint64_t> numbers(count);
  std::iota(numbers.begin(), numbers.end(), first);
  return numbers;
}

TEST(EventSample, TheSameWhetherAskedForOneByOneOrTogether) {
  // Lengths that no number of lanes divides; numbers that 32 bits do not hold, and the last before they begin anew.
  for (const uint64_t first : {uint64_t{0}, uint64_t{1} << 40, ~uint64_t{0} - 7}) {
    for (const uint64_t mask : {0x0ull, 0x1ull, 0x7ull, 0xffull}) {
      for (const size_t count : {1u, 9u, 100u, 1001u}) {
        const std::vector<uint64_t> numbers = NumbersFrom(first, count);
        std::vector<uint8_t> expected;
        for (const uint64_t number : numbers) expected.push_back(IsInSample(number, mask) ? 1 : 0);
        std::vector<uint8_t> stays(count, 2);
        MarkSample(first, mask, absl::MakeSpan(stays));
        EXPECT_EQ(stays, expected) << first << " " << mask;
        stays.assign(count, 2);
        MarkSample(numbers, mask, absl::MakeSpan(stays));
        EXPECT_EQ(stays, expected) << first << " " << mask;
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
  std::vector<uint8_t> stays(1 << 16);
  double share = 1.0;
  for (uint64_t mask = 0; mask < 64; mask = 2 * mask + 1, share /= 2.0) {
    MarkSample(12345, mask, absl::MakeSpan(stays));
    const double count = std::accumulate(stays.begin(), stays.end(), 0.0);
    EXPECT_NEAR(count / static_cast<double>(stays.size()), share, 0.01) << mask;
  }
}

}  // namespace
}  // namespace evpose
