// SPDX-License-Identifier: Apache-2.0

// Downsampling of an event stream: the hash of an event's number in the stream decides whether the event is kept. The
// decision does not depend on other events, so the sample is the same however the stream is cut into calls.
#pragma once

#include <array>
#include <cstdint>

#include "absl/types/span.h"

namespace evpose {

// Returns whether an event of this number is kept: its hash has none of the bits of `mask`. A mask of k bits keeps one
// event in 2^k.
bool IsInSample(uint64_t number, uint64_t mask);

// The masks of OFF (0) and ON (1) events.
using SampleMasks = std::array<uint64_t, 2>;
// Writes one mark for each of the consecutive numbers `first`, `first` + 1, ...: bit 0 is set if an OFF event of this
// number is kept, bit 1 if an ON event is.
void MarkSample(uint64_t first, const SampleMasks& masks, absl::Span<uint8_t> marks);
// Does the same for the given numbers. `marks` must have at least as many elements as `numbers`.
void MarkSample(absl::Span<const uint64_t> numbers, const SampleMasks& masks, absl::Span<uint8_t> marks);

}  // namespace evpose
