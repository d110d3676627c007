// SPDX-License-Identifier: Apache-2.0

// Measures the displacement of events from moving edges at known poses (core/calibration/README.md, section 5). A
// sensor profile is fitted to it (sensor_calibration.h).
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/estimation/edge_bias.h"
#include "core/events/event.h"
#include "core/geometry/camera.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"

namespace evpose {

// A line that swept a few pixels in one direction.
struct EdgePassage {
  int model_line = 0;
  double direction = 1.0;       // sign of its normal velocity: 1 or -1
  double speed_px_per_s = 0.0;  // magnitude of the normal velocity; mean over the swept area
  EdgeRates rates;              // over the swept area; reversals are those of the passage
  double residual_px = 0.0;     // robust mean of the events' distances along the motion: positive ahead of the line
  double spread_px = 0.0;       // standard deviation of the distances about that mean
  double num_events = 0.0;      // number of events of the mean, without clutter
  // Returns whether the passage made its pixels brighter: more ON than OFF events.
  bool IsBrighter() const { return rates.kappa * direction > 0.0; }
};

// Minimum distance between a line and every other line, pixels, for its events to be used: three times the smallest
// gate, so that the events of the other line are outside.
inline constexpr double kAlonePx = 6.0;

// Validated by the calibration of the sensor profiles on simulated recordings with known constants.
struct EdgePassageOptions {
  // Half width of the band about a line with events of its mixture, pixels: their displacement and several standard
  // deviations. It is smaller, down to a third of kAlonePx, for a line with others within three times this distance.
  double gate_px = 4.0;
  // Maximum distance, pixels, of the events that count for the rates of a line.
  double own_px = 3.0;
  // Minimum distance of an event from the ends of its line, gates: nearer ones may belong to another edge.
  double end_gates = 2.0;
  // Minimum normal speed, px/s: a slower line has too few events to be distinguished from noise.
  double min_speed_px_per_s = 20.0;
  // Minimum length of a line in the image, pixels: enough for events away from both ends.
  double min_length_px = 20.0;
  // A passage ends when the line has swept this distance (px) and this area (px^2), which averages over all positions
  // of an edge between two pixels and gives enough events for its rates; it ends earlier when the motion reverses.
  double swept_px = 1.5;
  double swept_px2 = 300.0;
  // Minimum number of events of a passage, for the mean and standard deviation of their distances.
  int min_events = 100;
};

class EdgePassageCollector {
 public:
  // `truth` is camera_from_object on the clock of the events. Errors: INVALID_ARGUMENT for a model without lines, a
  // truth without poses, or an invalid camera.
  static absl::StatusOr<std::unique_ptr<EdgePassageCollector>> Create(std::shared_ptr<const ObjectModel> model,
                                                                      const CameraModel& camera, Trajectory truth);
  virtual ~EdgePassageCollector() = default;

  // Events must be in order of time. Those before and after the truth, and in gaps of the truth of more than 20 ms, are
  // ignored.
  virtual void AddEvents(absl::Span<const Event> events) = 0;
  // Returns all passages. To be called once, after the last event.
  virtual std::vector<EdgePassage> Finish() = 0;
  // Number of events that were not ignored for lack of truth.
  virtual uint64_t num_events_with_truth() const = 0;
};

}  // namespace evpose
