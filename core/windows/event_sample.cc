// SPDX-License-Identifier: Apache-2.0
#include "core/windows/event_sample.h"

#include <algorithm>

#include "core/numerics/clones.h"

namespace evpose {
namespace {

// SplitMix64's finaliser: a bijection whose low bits look random for consecutive inputs.
inline uint64_t HashNumber(uint64_t number) {
  uint64_t z = number + 0x9e3779b97f4a7c15ull;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
  return z ^ (z >> 31);
}

inline uint8_t Mark(uint64_t number, uint64_t off_mask, uint64_t on_mask) {
  const uint64_t hash = HashNumber(number);
  return static_cast<uint8_t>(((hash & off_mask) == 0 ? 1 : 0) | ((hash & on_mask) == 0 ? 2 : 0));
}

EVPOSE_CLONES void MarkFrom(uint64_t first, uint64_t off_mask, uint64_t on_mask, uint8_t* marks, size_t count) {
  for (size_t i = 0; i < count; ++i) marks[i] = Mark(first + i, off_mask, on_mask);
}

EVPOSE_CLONES void MarkEach(const uint64_t* numbers, uint64_t off_mask, uint64_t on_mask, uint8_t* marks,
                            size_t count) {
  for (size_t i = 0; i < count; ++i) marks[i] = Mark(numbers[i], off_mask, on_mask);
}

}  // namespace

bool IsInSample(uint64_t number, uint64_t mask) { return (HashNumber(number) & mask) == 0; }

void MarkSample(uint64_t first, const SampleMasks& masks, absl::Span<uint8_t> marks) {
  if (masks == SampleMasks()) {
    std::fill(marks.begin(), marks.end(), 3);
  } else {
    MarkFrom(first, masks[0], masks[1], marks.data(), marks.size());
  }
}

void MarkSample(absl::Span<const uint64_t> numbers, const SampleMasks& masks, absl::Span<uint8_t> marks) {
  MarkEach(numbers.data(), masks[0], masks[1], marks.data(), numbers.size());
}

}  // namespace evpose
