// SPDX-License-Identifier: Apache-2.0
#include "core/numerics/sampling.h"

#include <algorithm>

#include "core/numerics/target_clones.h"

namespace evpose {
namespace {

inline uint8_t Mark(uint64_t number, uint64_t mask0, uint64_t mask1) {
  const uint64_t hash = HashNumber(number);
  return static_cast<uint8_t>(((hash & mask0) == 0 ? 1 : 0) | ((hash & mask1) == 0 ? 2 : 0));
}

EVPOSE_CLONES void MarkFrom(uint64_t first, uint64_t mask0, uint64_t mask1, uint8_t* marks, size_t count) {
  for (size_t i = 0; i < count; ++i) marks[i] = Mark(first + i, mask0, mask1);
}

EVPOSE_CLONES void MarkEach(const uint64_t* numbers, uint64_t mask0, uint64_t mask1, uint8_t* marks, size_t count) {
  for (size_t i = 0; i < count; ++i) marks[i] = Mark(numbers[i], mask0, mask1);
}

}  // namespace

bool IsInHashSample(uint64_t number, uint64_t mask) { return (HashNumber(number) & mask) == 0; }

void MarkHashSample(uint64_t first, const HashSampleMasks& masks, absl::Span<uint8_t> marks) {
  if (masks[0] == 0 && masks[1] == 0) {
    std::fill(marks.begin(), marks.end(), 3);  // without a mask every item stays
  } else {
    MarkFrom(first, masks[0], masks[1], marks.data(), marks.size());
  }
}

void MarkHashSample(absl::Span<const uint64_t> numbers, const HashSampleMasks& masks, absl::Span<uint8_t> marks) {
  MarkEach(numbers.data(), masks[0], masks[1], marks.data(), numbers.size());
}

}  // namespace evpose
