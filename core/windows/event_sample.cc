#include "core/windows/event_sample.h"

#include <algorithm>

#include "core/base/clones.h"

namespace evpose {
namespace {

// SplitMix64's finaliser: a bijection whose low bits look random for consecutive inputs.
inline uint64_t HashNumber(uint64_t number) {
  uint64_t z = number + 0x9e3779b97f4a7c15ull;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
  return z ^ (z >> 31);
}

EVPOSE_CLONES void MarkFrom(uint64_t first, uint64_t mask, uint8_t* stays, size_t count) {
  for (size_t i = 0; i < count; ++i) stays[i] = (HashNumber(first + i) & mask) == 0 ? 1 : 0;
}

EVPOSE_CLONES void MarkEach(const uint64_t* numbers, uint64_t mask, uint8_t* stays, size_t count) {
  for (size_t i = 0; i < count; ++i) stays[i] = (HashNumber(numbers[i]) & mask) == 0 ? 1 : 0;
}

}  // namespace

bool IsInSample(uint64_t number, uint64_t mask) { return (HashNumber(number) & mask) == 0; }

void MarkSample(uint64_t first, uint64_t mask, absl::Span<uint8_t> stays) {
  if (mask == 0) {
    std::fill(stays.begin(), stays.end(), 1);
  } else {
    MarkFrom(first, mask, stays.data(), stays.size());
  }
}

void MarkSample(absl::Span<const uint64_t> numbers, uint64_t mask, absl::Span<uint8_t> stays) {
  MarkEach(numbers.data(), mask, stays.data(), numbers.size());
}

}  // namespace evpose
