// SPDX-License-Identifier: Apache-2.0

// Measures the displacement of the events from moving edges at known poses; a sensor profile is fitted to it
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

// A line that swept a few pixels in one direction.
struct EdgePassage {
  int model_line = 0;
  double direction = 1.0;       // sign of its normal velocity: 1 or -1
  double speed_px_per_s = 0.0;  // magnitude of the normal velocity; mean over the swept area
  EdgeRates rates;              // over the swept area; turns are those of the passage
  double residual_px = 0.0;     // robust mean of the events' distances along the motion: positive ahead of the line
  double spread_px = 0.0;       // standard deviation of the distances about that mean
  double num_events = 0.0;      // number of events of the mean, without clutter
  bool IsBrighter() const { return rates.kappa * direction > 0.0; }
};

// Collects the events of lines whose distance from every other line is at least this.
inline constexpr double kAlonePx = 12.0;

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
  // To be called once, after the last event.
  virtual std::vector<EdgePassage> Finish() = 0;
  virtual uint64_t num_events_with_truth() const = 0;
};

}  // namespace evpose
