// SPDX-License-Identifier: Apache-2.0

// For tests: lines found in the events of a simulated object, against what the model should show.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/detection/line_detector.h"
#include "core/geometry/camera.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"

namespace evpose::testing {

// What a camera saw of an object for a short while.
struct ObjectRecording {
  CameraModel camera;
  ObjectModel model;
  Trajectory truth;                // every millisecond
  std::vector<PixelEvent> events;  // undistorted, with 5 % of noise
};
ObjectRecording RecordObject(const std::string& object, double speed_scale, int64_t duration_us, uint64_t seed);

// The last `max_events` up to a time.
absl::Span<const PixelEvent> EventsUntil(const ObjectRecording& recording, int64_t t_us, size_t max_events);

struct DetectionScore {
  // Length of visible model lines that moved by 3 px or more since the beginning, and how much of it has a line
  // detected within 1.5 px and 2 deg.
  double visible_px = 0.0;
  double covered_px = 0.0;
  int num_detected = 0;
  int num_right = 0;  // of them within the same limits of visible model lines over 0.7 of their length
  // Of the right ones: signed distance of the detected line's middle from the model line along its motion, and root
  // mean square distance of its two ends from it.
  std::vector<double> offset_px;
  std::vector<double> error_px;
  // Of the right ones: how far each end lies outside (positive) or inside the end of the visible model line.
  std::vector<double> beyond_end_px;

  double recall() const { return visible_px > 0.0 ? covered_px / visible_px : 1.0; }
  double precision() const { return num_detected > 0 ? static_cast<double>(num_right) / num_detected : 1.0; }
  void Add(const DetectionScore& other);
};

// Against the model at the end of the stretch. `t_begin_us`: lines count that have moved since then.
DetectionScore Score(const ObjectRecording& recording, const LineDetection& detection, int64_t t_begin_us);

double Median(std::vector<double> values);

}  // namespace evpose::testing
