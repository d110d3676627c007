// SPDX-License-Identifier: Apache-2.0

// Event rate, speed of the edges and extent of the moving region over the time of a recording
// (core/diagnosis/README.md, section 5).
#pragma once

#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/detection/event_stretch.h"
#include "core/events/event.h"

namespace evpose {

class MotionSamples {
 public:
  explicit MotionSamples(SensorGeometry geometry);

  // Events in the order of the stream, inside the geometry.
  void Add(absl::Span<const Event> events);

  struct Result {
    // Median over the times that were examined; 0 without events.
    double speed_px_per_s = 0.0;
    double extent_px = 0.0;  // larger side of the region in which something moves
    int num_samples = 0;
    double median_events_in_20_ms = 0.0;
    double busy_events_in_20_ms = 0.0;  // 90 % quantile
    int64_t busiest_us = 0;             // time of the largest rate
    double largest_events_in_20_ms = 0.0;
  };
  Result Measure() const;

  // Microseconds of a slice of the event rate: the maximum duration of a window (WindowOptions::max_duration_us), which
  // decides whether anything seems to move.
  static constexpr int64_t kSliceUs = 20'000;

 private:
  static constexpr size_t kMaxEvents = 50'000;  // those that the speed is measured from
  // Microseconds of events from which the speed is measured, as in a search (StretchOptions::max_slow_duration_us). The
  // two limits below bound memory and time: when a list is full, every other value is removed, and later ones are taken
  // half as often.
  static constexpr int64_t kMemoryUs = 1'000'000;
  static constexpr size_t kMaxSamples = 64;
  static constexpr size_t kMaxSlices = 8192;

  // Measures speed and extent in the latest events.
  void Sample();
  void CloseSlice();

  const SensorGeometry geometry_;
  StretchSelector selector_;
  std::vector<PixelEvent> latest_;  // at most twice kMaxEvents
  bool has_event_ = false;
  int64_t last_us_ = 0;
  int64_t next_sample_us_ = 0;
  int64_t sample_period_us_ = 100'000;
  std::vector<double> speeds_px_per_s_;
  std::vector<double> extents_px_;
  int64_t slice_end_us_ = 0;
  double slice_events_ = 0.0;
  uint64_t num_slices_ = 0;
  uint64_t slice_stride_ = 1;
  std::vector<double> slices_;  // events of every slice_stride_-th slice
  double largest_ = 0.0;
  int64_t busiest_us_ = 0;
};

}  // namespace evpose
