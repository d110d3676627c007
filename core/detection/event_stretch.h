// SPDX-License-Identifier: Apache-2.0

// Selects the stretch: the latest events, over a time span in which the object moves far enough for the detection of
// its lines, and no farther.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "core/detection/flicker_filter.h"
#include "core/detection/line_detector.h"

namespace evpose {

// motion_px and max_events are validated by simulated_lines_test, and max_duration_us by event_stretch_test (a fast
// object after a slow one). max_slow_duration_us is validated by the recording phone_shake of `evpose bench real`: the
// phone hardly moves within 50 ms at some start times, and is found from all (core/experiments/RESULTS.md, Tracking).
struct StretchOptions {
  // Motion of the edges within the stretch, pixels: enough to distinguish a plane in space and time from a line at
  // rest, and less than the distance between parallel lines of dense objects.
  double motion_px = 6.0;
  // Duration of the latest events in which the speed is measured first, microseconds: earlier events of a fast object
  // contribute little information on its present speed.
  int64_t max_duration_us = 50'000;
  // Maximum duration of the stretch of an object that moves by less than motion_px in max_duration_us, microseconds;
  // not below max_duration_us. An object on a turntable at 12 deg/s moves by 6 px in a second on a sensor with 128
  // pixels.
  int64_t max_slow_duration_us = 1'000'000;
  // Maximum number of events, which bounds the work. More events are downsampled uniformly; if there are more than
  // twice as many, isolated events (without neighbours in space and time) are removed first.
  int max_events = 20'000;

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

struct StretchEvent {
  float u_px = 0.0f;
  float v_px = 0.0f;
  float tau_s = 0.0f;  // time since the middle of the stretch
  uint8_t polarity = 0;
};

struct EventStretch {
  int64_t t_begin_us = 0;
  int64_t t_end_us = 0;
  double speed_px_per_s = 0.0;  // median normal speed of the edges; 0 if nothing moves
  // The factor c of (u, v, c t): motion_px per duration of the stretch. With it a stretch has the length motion_px.
  double time_scale_px_per_s = 1.0;
  std::vector<StretchEvent> events;

  double half_duration_s() const { return 0.5e-6 * static_cast<double>(t_end_us - t_begin_us); }
};

// The time of the last event of each pixel and polarity, in ticks: a hash table (Knuth, TAOCP 3, 6.4, linear probing),
// because few pixels of a large sensor have an event among the latest ones.
class LastTimes {
 public:
  static constexpr uint16_t kNever = 0xffff;
  static constexpr size_t kMaxKeys = 60'000;  // pixels with an event; at most half of the slots are then occupied

  LastTimes() : slots_(kSlots) {}
  void Clear() { std::fill(slots_.begin(), slots_.end(), Slot()); }
  // `key` is less than 2^32 - 1 and stands for a pixel and a polarity.
  void Set(uint32_t key, uint16_t ticks) { slots_[Find(key)] = {key + 1, ticks}; }
  // Returns kNever without an event.
  uint16_t Get(uint32_t key) const { return slots_[Find(key)].ticks; }

 private:
  // Slots of the table: 1 MB. They are more than twice kMaxKeys, so that linear probing finds a slot after few steps.
  static constexpr int kSlotBits = 17;
  static constexpr size_t kSlots = size_t{1} << kSlotBits;
  struct Slot {
    uint32_t key_plus_1 = 0;  // 0: the slot is free
    uint16_t ticks = kNever;
  };
  // Returns the index of the slot with this key, or of the free one in which it belongs.
  size_t Find(uint32_t key) const {
    size_t index = (key * 0x9e3779b1u) >> (32 - kSlotBits);
    while (slots_[index].key_plus_1 != 0 && slots_[index].key_plus_1 != key + 1) index = (index + 1) % kSlots;
    return index;
  }

  std::vector<Slot> slots_;
};

// Deterministic. Reuses memory, but keeps no state between calls.
class StretchSelector {
 public:
  // Undistorted pixels may lie outside the sensor by up to a quarter of its width and height; events farther outside,
  // or with coordinates that are not finite, are ignored. `options` must be valid.
  StretchSelector(const StretchOptions& options, int width_px, int height_px);

  // Selects from `events`, which must be in order of time. Without events the stretch is empty.
  EventStretch Select(absl::Span<const PixelEvent> events);

 private:
  // Returns the latest events from which the stretch is taken, and sets the speed of the edges in them.
  absl::Span<const PixelEvent> SelectSpan(absl::Span<const PixelEvent> events, double& speed_px_per_s);
  int PixelIndex(const PixelEvent& event) const;  // -1 outside the map
  // Returns the median normal speed of the edges, px/s, from the times of the last events of neighbouring pixels; 0 if
  // nothing moves.
  double MedianSpeed(absl::Span<const PixelEvent> events);
  // Returns the time in which the edge that produced the event swept 2 px before it, microseconds; -1 if unknown.
  double SweepTime(const PixelEvent& event, int pixel, int64_t t_origin_us);
  uint16_t Ticks(const PixelEvent& event, int64_t t_origin_us) const;
  void RemoveIsolated(std::vector<StretchEvent>& events, double px_per_s);

  StretchOptions options_;
  FlickerFilter flicker_;
  int margin_x_;
  int margin_y_;
  int map_width_;
  int map_height_;
  int64_t tick_us_ = 1;  // unit of last_, so that the measured events fit into 16 bits
  LastTimes last_;
  std::vector<uint16_t> ages_;
  std::vector<uint8_t> cell_counts_;  // hash table of the number of events in each cell of space and time
};

}  // namespace evpose
