// SPDX-License-Identifier: Apache-2.0

// Which events of a stream are an even sample of it: a hash of an event's number decides for it by itself.
#pragma once

#include <array>
#include <cstdint>

#include "absl/types/span.h"

namespace evpose {

// An event stays when its hash has none of the bits of `mask`.
bool IsInSample(uint64_t number, uint64_t mask);

// One for OFF and one for ON events.
using SampleMasks = std::array<uint64_t, 2>;
// In `marks`, for each number from `first` on, as many as there is room for: 1 if an OFF event of it stays, and 2 if an
// ON event does.
void MarkSample(uint64_t first, const SampleMasks& masks, absl::Span<uint8_t> marks);
// Of these. `marks` has room for them.
void MarkSample(absl::Span<const uint64_t> numbers, const SampleMasks& masks, absl::Span<uint8_t> marks);

}  // namespace evpose
