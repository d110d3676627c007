// SPDX-License-Identifier: Apache-2.0

// Changes of brightness over an area, which cause events of one polarity (core/tracking/README.md, section 1). Edges
// that move cause both: one side of a body becomes brighter while the other becomes darker.
#pragma once

#include <cstdint>

#include "absl/status/status.h"
#include "core/base/state_io.h"
#include "core/windows/event_window.h"

namespace evpose {

// The share, memory_us and min_events are validated by flash_test. The other fields are not validated separately.
struct FlashOptions {
  // Share of the rarer polarity, over memory_us, below which the brightness changes. In recordings of moving objects
  // and scenes, by sensors of 128 x 128 to 1280 x 720 pixels, it stays above 0.2 in 99.9 % of the intervals of 4 ms.
  double max_rarer_share = 0.12;
  // Microseconds over which the polarities are counted. A lamp on 60 Hz mains varies at 120 Hz, and half of that period
  // is 4 ms.
  int64_t memory_us = 4000;
  // Microseconds from the last detection of a change of brightness to its assumed end: one period of 50 Hz.
  // Between a rising and a falling flank there are events of both polarities that no motion causes.
  int64_t hold_us = 20'000;
  // Events that the share requires: its standard deviation is then 4 %.
  double min_events = 100.0;
  // During a change, a window counts as one without events if its events near the lines exceed chance by less than
  // `min_sigma` standard deviations, or by less than the share `min_excess_ratio` of the excess at the right pose.
  // Otherwise they may be those of an object that moves under a flickering lamp.
  double min_sigma = 3.1;
  double min_excess_ratio = 0.4;

  absl::Status Validate() const;
};

class FlashDetector {
 public:
  explicit FlashDetector(const FlashOptions& options) : options_(options) {}

  // Adds the events of a window near the lines, by polarity.
  void Add(const ByPolarity& events, int64_t t_begin_us, int64_t t_end_us);

  // Whether the brightness changes in the last window or has changed shortly before it.
  bool is_changing() const { return left_us_ > 0; }

  static void VisitState(auto& archive, auto& self) {
    auto& [options, counts, left_us] = self;
    constexpr double kMax = 1e18;  // events
    archive(InRange(counts[0], 0.0, kMax), InRange(counts[1], 0.0, kMax), InRange(left_us, 0, options.hold_us));
  }

 private:
  const FlashOptions options_;
  ByPolarity counts_ = {};  // fading out over memory_us
  int64_t left_us_ = 0;     // rest of hold_us
};

}  // namespace evpose
