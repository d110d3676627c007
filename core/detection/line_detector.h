// SPDX-License-Identifier: Apache-2.0

// Lines of moving edges from events (core/detection/README.md, section 1).
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/events/event.h"
#include "core/geometry/image_segment.h"

namespace evpose {

// An event with the lens's distortion removed.
struct PixelEvent {
  int64_t t_us = 0;
  float u_px = 0.0f;
  float v_px = 0.0f;
  uint8_t polarity = 0;
};

// An edge that moved through a stretch of time. Its end points are the extent of its events, carried along with the
// line, so that at_begin and at_end correspond end by end.
struct DetectedLine {
  ImageSegment at_begin;
  ImageSegment at_end;
  double normal_velocity_px_per_s = 0.0;  // along (-dy, dx) of the direction from p1 to p2 at the middle of the time
  int num_events = 0;                     // on the line
  double rms_px = 0.0;                    // of their distances to it
};

struct LineDetection {
  int64_t t_begin_us = 0;  // the stretch of time that was used, ending with the last event given
  int64_t t_end_us = 0;
  std::vector<DetectedLine> lines;  // by falling number of events
};

// Deterministic; keeps no state between calls. Not thread-safe.
class LineDetector {
 public:
  virtual ~LineDetector() = default;

  // `events` in order of time, of a bounded number (the caller's buffer); the detector takes as many of the latest as
  // the speed of the object asks for. The work is bounded whatever they are. No line is an empty answer, no error.
  virtual LineDetection Detect(absl::Span<const PixelEvent> events) = 0;
};

// Makes a detector for a sensor. Errors: INVALID_ARGUMENT.
using LineDetectorFactory = std::function<absl::StatusOr<std::unique_ptr<LineDetector>>(SensorGeometry geometry)>;

}  // namespace evpose
