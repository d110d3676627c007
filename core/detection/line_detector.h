// SPDX-License-Identifier: Apache-2.0

// Lines of moving edges from events (core/detection/README.md, section 1).
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/events/event.h"
#include "core/geometry/image_segment.h"

namespace evpose {

// An event after undistortion.
struct PixelEvent {
  int64_t t_us = 0;
  float u_px = 0.0f;  // undistorted pixel
  float v_px = 0.0f;
  uint8_t polarity = 0;
};

// An edge that moved during the stretch. The end points are the extent of its events and move with the line: p1 of
// at_begin and of at_end are the same end. Undistorted pixels.
struct DetectedLine {
  ImageSegment at_begin;
  ImageSegment at_end;
  // Normal velocity of the middle of the line, positive along (-dy, dx) of the direction (dx, dy) from p1 to p2.
  double normal_velocity_px_per_s = 0.0;
  int num_events = 0;   // number of events of the line
  double rms_px = 0.0;  // root mean square of their distances from the line
};

struct LineDetection {
  int64_t t_begin_us = 0;  // the stretch; it ends with the last event
  int64_t t_end_us = 0;
  std::vector<DetectedLine> lines;  // in descending order of the number of events
};

// Deterministic; keeps no state between calls. Not thread-safe.
class LineDetector {
 public:
  virtual ~LineDetector() = default;

  // Detects the lines in the latest of `events`, which must be in order of time; the detector chooses the time span
  // from the speed of the object. The work is bounded for any content of the events. If there is no line, the list is
  // empty.
  virtual LineDetection Detect(absl::Span<const PixelEvent> events) = 0;
};

// Error: INVALID_ARGUMENT for a sensor without pixels.
absl::Status CheckSensor(SensorGeometry geometry);

// Makes a detector for a sensor. Errors: INVALID_ARGUMENT.
using LineDetectorFactory = std::function<absl::StatusOr<std::unique_ptr<LineDetector>>(SensorGeometry geometry)>;

}  // namespace evpose
