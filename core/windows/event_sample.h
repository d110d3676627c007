// Which events of a stream are an even sample of it: a hash of an event's number decides for it by itself.
#pragma once

#include <cstdint>

#include "absl/types/span.h"

namespace evpose {

// An event stays when its hash has none of the bits of `mask`: 1 in `stays` then, 0 otherwise.
bool IsInSample(uint64_t number, uint64_t mask);
// Of the numbers from `first` on, as many as `stays` has room for.
void MarkSample(uint64_t first, uint64_t mask, absl::Span<uint8_t> stays);
// Of these. `stays` has room for them.
void MarkSample(absl::Span<const uint64_t> numbers, uint64_t mask, absl::Span<uint8_t> stays);

}  // namespace evpose
