// SPDX-License-Identifier: Apache-2.0

// Time stamps: gaps, steps back and forward, and the values that they take (core/diagnosis/README.md, section 8).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/events/event.h"

namespace evpose {

class ClockWatch {
 public:
  // Events in the order of the stream.
  void Add(absl::Span<const Event> events);

  // A time without events, although at the event rates before and after it there would certainly be some.
  struct Gap {
    int64_t begin_us = 0;
    int64_t duration_us = 0;
    double expected_events = 0.0;
  };
  struct Result {
    std::vector<Gap> gaps;  // the longest first; at most kMaxListed
    uint64_t num_gaps = 0;
    int64_t largest_step_back_us = 0;
    int64_t largest_step_back_at_us = 0;
    // Nearly all differences between time stamps are multiples of this step. 1 for a clock of microseconds; 0 with too
    // few events.
    int64_t time_step_us = 0;
  };
  static constexpr size_t kMaxListed = 5;  // gaps that a report can show
  Result Measure() const;

  // Shortest time without events that is examined, microseconds: the time over which the rates before and after it are
  // measured.
  static constexpr int64_t kMinGapUs = 10'000;

 private:
  static constexpr int kSlots = 10;  // milliseconds before and after a gap
  static constexpr int64_t kSlotUs = 1000;
  // Bounds memory: when the list is full, every other step is removed, and half as many are added from then on.
  static constexpr size_t kMaxSteps = 8192;

  void AddStep(int64_t step_us);
  void AddGap();
  int64_t TimeStepUs() const;

  bool has_event_ = false;
  int64_t t_us_ = 0;
  std::array<uint32_t, kSlots> recent_ = {};  // events of the latest milliseconds, a ring
  int64_t slot_ = 0;                          // number of the latest of them
  Gap open_;                                  // a gap whose following events are being counted
  bool has_open_ = false;
  double before_ = 0.0;  // events in the kSlots milliseconds before it
  double after_ = 0.0;
  Result result_;
  std::vector<int64_t> steps_;  // between different time stamps: a sample of every stride_-th
  uint64_t stride_ = 1;
  uint64_t num_steps_ = 0;
};

}  // namespace evpose
