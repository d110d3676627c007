// SPDX-License-Identifier: Apache-2.0

// Events to a RAW stream.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/events/decoder.h"
#include "core/events/event.h"

namespace evpose {

class EventEncoder {
 public:
  virtual ~EventEncoder() = default;

  // Appends the words for `events` to `out`. Times must not decrease, also across calls, and must not be negative;
  // the clock wraps as the sensor's does. Errors: INVALID_ARGUMENT naming the first event that breaks this or lies
  // outside the sensor; nothing is appended then.
  virtual absl::Status Encode(absl::Span<const Event> events, std::vector<uint8_t>& out) = 0;

  // Appends the time words that a camera sends without events, so that readers see time pass up to `t_us`.
  virtual absl::Status EncodeTime(int64_t t_us, std::vector<uint8_t>& out) = 0;
};

// EVT3, EVT2.1 and EVT2 (and FLAT64); UNIMPLEMENTED for DAT.
absl::StatusOr<std::unique_ptr<EventEncoder>> MakeEventEncoder(Encoding encoding, SensorGeometry geometry);

}  // namespace evpose
