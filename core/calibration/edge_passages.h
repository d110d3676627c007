// SPDX-License-Identifier: Apache-2.0

// Where the events of moving edges lie when the pose is known: what a sensor's profile is fitted to
// (core/estimation/README.md, section 3).
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

// A line that swept some pixels in one direction.
struct EdgePassage {
  int model_line = 0;
  double direction = 1.0;       // of its normal velocity: 1 or -1
  double speed_px_per_s = 0.0;  // of that velocity, positive; mean over the swept area
  EdgeRates rates;              // of all the area swept; recent turns: those of the passage
  double residual_px = 0.0;     // where its events lie, robust mean, along the motion: positive ahead of the line
  double spread_px = 0.0;       // of them about that, one standard deviation
  double num_events = 0.0;      // that it is the mean of, clutter left out
  bool IsBrighter() const { return rates.kappa * direction > 0.0; }
};

// Events of lines that stand alone, at least this far from any other's.
inline constexpr double kAlonePx = 12.0;

class EdgePassageCollector {
 public:
  // `truth`: camera_from_object on the clock of the events. Errors: INVALID_ARGUMENT for a model without lines, a
  // truth without poses, an invalid camera.
  static absl::StatusOr<std::unique_ptr<EdgePassageCollector>> Create(std::shared_ptr<const ObjectModel> model,
                                                                      const CameraModel& camera, Trajectory truth);
  virtual ~EdgePassageCollector() = default;

  // In order of time. Those without truth, before and after it and in its gaps of more than 20 ms, are left out.
  virtual void AddEvents(absl::Span<const Event> events) = 0;
  // Once, after the last event.
  virtual std::vector<EdgePassage> Finish() = 0;
  virtual uint64_t num_events_with_truth() const = 0;
};

}  // namespace evpose
