// SPDX-License-Identifier: Apache-2.0

// For tests: compares the lines detected in the events of a simulated object with the visible lines of its model.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/detection/line_detector.h"
#include "core/geometry/camera.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"

namespace evpose::testing {

// A short simulated recording of an object.
struct ObjectRecording {
  CameraModel camera;
  ObjectModel model;
  Trajectory truth;                // one pose per millisecond
  std::vector<PixelEvent> events;  // undistorted, with 5 % of noise
};
ObjectRecording RecordObject(const std::string& object, double speed_scale, int64_t duration_us, uint64_t seed);

// Returns the last `max_events` events up to a time.
absl::Span<const PixelEvent> EventsUntil(const ObjectRecording& recording, int64_t t_us, size_t max_events);

struct DetectionScore {
  // Length of the visible model lines that have moved by at least 3 px since the beginning, and the part of this length
  // with a detected line within 1.5 px and 2 degrees.
  double visible_px = 0.0;
  double covered_px = 0.0;
  int num_detected = 0;
  int num_right = 0;  // detected lines within the same limits of visible model lines over 0.7 of their length
  // Signed distance of the middle of each of these lines from the model line along its motion, and root mean square
  // distance of its two ends from the model line.
  std::vector<double> offset_px;
  std::vector<double> error_px;
  // Distance of each end of these lines beyond the end of the visible model line (negative: inside).
  std::vector<double> beyond_end_px;

  double recall() const { return visible_px > 0.0 ? covered_px / visible_px : 1.0; }
  double precision() const { return num_detected > 0 ? static_cast<double>(num_right) / num_detected : 1.0; }
  void Add(const DetectionScore& other);
};

// Compares the lines at the end of the stretch with the model. Motion counts from `t_begin_us` on.
DetectionScore Score(const ObjectRecording& recording, const LineDetection& detection, int64_t t_begin_us);

}  // namespace evpose::testing
