// SPDX-License-Identifier: Apache-2.0

// The digest of events that evpose info prints.
#pragma once

#include <string>

#include "absl/types/span.h"
#include "core/events/event.h"
#include "core/numerics/hash.h"

namespace evpose {

// SHA-256 over the events as packed records of t u64 (microseconds), x u16, y u16, p u8, little-endian.
class EventDigest {
 public:
  void Add(absl::Span<const Event> events);
  std::string FinishHex() { return digest_.FinishHex(); }

 private:
  Sha256 digest_;
};

}  // namespace evpose
