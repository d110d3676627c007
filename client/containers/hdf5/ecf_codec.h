// SPDX-License-Identifier: Apache-2.0

// Prophesee's codec ECF for chunks of events in HDF5 files (client/containers/hdf5/README.md, section 1).
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "core/events/event.h"

namespace evpose::client {

inline constexpr unsigned kEcfFilter = 0x8ECF;         // its number among the filters of HDF5
inline constexpr size_t kEcfMaxEvents = 65535;         // number of events in a chunk
inline constexpr uint16_t kEcfMaxCoordinatePx = 2047;  // x and y have 11 bits

// Appends the events of a chunk. Errors: DATA_LOSS with the byte at which a chunk is damaged; nothing is appended then.
absl::Status DecodeEcfChunk(absl::Span<const uint8_t> chunk, EventVector& events);

// Appends the chunk of `events`, in the smallest of the format's three layouts. Errors: INVALID_ARGUMENT for no events
// or more than kEcfMaxEvents, or with the index of an event that the format cannot hold; nothing is appended then.
absl::Status EncodeEcfChunk(absl::Span<const Event> events, std::vector<uint8_t>& chunk);

}  // namespace evpose::client
