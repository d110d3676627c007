// SPDX-License-Identifier: Apache-2.0

// Encoders of event streams (core/events/README.md, section 4).
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

  // Appends the words of `events` to `out`. Times must not be negative. They must not decrease, also across calls,
  // except in FLAT64 and DAT, whose words have whole times. The clock wraps like the sensor's. Errors: INVALID_ARGUMENT
  // with the index of the first event with an invalid time, address or polarity; nothing is appended then.
  virtual absl::Status Encode(absl::Span<const Event> events, std::vector<uint8_t>& out) = 0;

  // Appends the time words that a camera sends while there are no events, up to `t_us`. FLAT64 and DAT have none: the
  // call does nothing.
  virtual absl::Status EncodeTime(int64_t t_us, std::vector<uint8_t>& out) = 0;

  // Appends an edge of a trigger input; its time obeys the rules for times of events. Errors: as for Encode(), also for
  // an input that the encoding has no number for; UNIMPLEMENTED for DAT, which has no triggers.
  virtual absl::Status EncodeTrigger(const Trigger& trigger, std::vector<uint8_t>& out) = 0;
};

// Errors: those of ValidateGeometry().
absl::StatusOr<std::unique_ptr<EventEncoder>> MakeEventEncoder(Encoding encoding, SensorGeometry geometry);

}  // namespace evpose
