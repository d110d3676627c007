// SPDX-License-Identifier: Apache-2.0

// The events of an interval.
#pragma once

#include <algorithm>
#include <cstdint>

#include "absl/types/span.h"
#include "core/events/event.h"

namespace evpose {

// Returns the events of [begin_us, end_us). `events` must be in order of time.
inline absl::Span<const Event> EventsBetween(absl::Span<const Event> events, int64_t begin_us, int64_t end_us) {
  const auto earlier = [](const Event& event, int64_t t_us) { return event.t_us < t_us; };
  const auto begin = std::lower_bound(events.begin(), events.end(), begin_us, earlier);
  const auto end = std::lower_bound(begin, events.end(), end_us, earlier);
  return events.subspan(begin - events.begin(), end - begin);
}

}  // namespace evpose
