// SPDX-License-Identifier: Apache-2.0

// The stretch of the latest events in which an object moves far enough to show its lines, and no farther.
#pragma once

#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "core/detection/flicker_filter.h"
#include "core/detection/line_detector.h"

namespace evpose {

struct StretchOptions {
  // Pixels that edges move in the stretch: enough to tell a plane in space and time from a line that stands, less than
  // the distance between parallel lines of dense objects.
  double motion_px = 6.0;
  // Microseconds. A slower object moves by less than motion_px: later events than these say little of where it is now.
  int64_t max_duration_us = 50'000;
  // Events that are used: bounds the work. More are evenly thinned; when there are more than twice as many, those that
  // have no other near them in space and time go first.
  int max_events = 20'000;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

struct StretchEvent {
  float u_px = 0.0f;
  float v_px = 0.0f;
  float tau_s = 0.0f;  // since the middle of the stretch
  uint8_t polarity = 0;
};

struct EventStretch {
  int64_t t_begin_us = 0;
  int64_t t_end_us = 0;
  double speed_px_per_s = 0.0;       // of the edges that made the events, a median
  double time_scale_px_per_s = 1.0;  // c of (u, v, c t): the stretch is as long as edges move in it, or longer
  std::vector<StretchEvent> events;

  double half_duration_s() const { return 0.5e-6 * static_cast<double>(t_end_us - t_begin_us); }
};

// Keeps memory between calls, but no state.
class StretchSelector {
 public:
  // Undistorted pixels may lie beyond the sensor's width and height, by up to a quarter of them; events farther out (or
  // not finite) are ignored. `options` must be valid.
  StretchSelector(const StretchOptions& options, int width_px, int height_px);

  // `events` in order of time.
  EventStretch Select(absl::Span<const PixelEvent> events);

 private:
  int PixelIndex(const PixelEvent& event) const;  // -1: outside
  // Median normal speed of edges, pixels per second, from the times at which neighbouring pixels last fired; 0 when
  // nothing moves.
  double MedianSpeed(absl::Span<const PixelEvent> events);
  double SweepTime(const PixelEvent& event, int pixel, int64_t t_origin_us);
  uint16_t Ticks(const PixelEvent& event, int64_t t_origin_us) const;
  void DropLonely(std::vector<StretchEvent>& events, double px_per_s);

  StretchOptions options_;
  FlickerFilter flicker_;
  int margin_x_;
  int margin_y_;
  int map_width_;
  int map_height_;
  static constexpr uint16_t kNever = 0xffff;
  int64_t tick_us_;                // 1 unless more than kNever of them are looked at
  std::vector<uint16_t> last_[2];  // by polarity: ticks from the origin when each pixel last fired, or kNever
  std::vector<uint16_t> ages_;
  std::vector<uint8_t> crowds_;  // events in each cell of space and time, hashed
};

}  // namespace evpose
