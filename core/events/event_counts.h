// SPDX-License-Identifier: Apache-2.0

// Numbers of events over the time of a recording of unknown duration.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/events/event.h"

namespace evpose {

// Counts of events in intervals of equal duration. When a recording becomes longer than kMaxIntervals of them, their
// duration doubles.
class EventCounts {
 public:
  // Bounds the memory at 16 kB. Once the duration has doubled, there are more than 1000 intervals: about one for each
  // pixel of the width of a plot.
  static constexpr size_t kMaxIntervals = 2048;
  // About a millisecond, and a power of two, so that a shift gives the number of an interval.
  static constexpr int64_t kFirstStepUs = 1024;

  // Events whose times step back before the first one are counted in the first interval.
  void Add(absl::Span<const Event> events);

  int64_t from_us() const { return from_us_; }  // begin of the first interval
  int64_t step_us() const { return int64_t{1} << shift_; }
  const std::vector<uint64_t>& counts() const { return counts_; }

 private:
  void Double();

  int64_t from_us_ = 0;
  int shift_ = 10;  // of times, which is faster than a division by the duration
  std::vector<uint64_t> counts_;
};

}  // namespace evpose
