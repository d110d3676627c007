// SPDX-License-Identifier: Apache-2.0

// Windows of a recording with the predicted states of the tracker, on which association and estimation are measured
// separately.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "core/association/window_associator.h"
#include "core/estimation/estimator.h"
#include "core/experiments/speed/speed_recordings.h"
#include "core/tracking/object/pose_track.h"
#include "core/windows/event_window.h"

namespace evpose {

struct SpeedWindow {
  int64_t t_begin_us = 0;
  int64_t t_end_us = 0;
  uint64_t num_events = 0;  // number of events before downsampling
  std::vector<WindowEvent> events;
  ByPolarity events_per_sample = {1.0, 1.0};  // as in EventWindow
  MotionState predicted;                      // predicted state for mid-window
  std::vector<TrackedLine> lines;             // lines that are visible at the predicted pose

  // Returns a view, valid as long as this object.
  EventWindow AsEventWindow() const;
};

// Windows of 1 ms of a tracker that starts at the true pose, and again after a loss. `context` is that of the tracker.
// Errors: those of the parts of TrackContext; INTERNAL if no window has a visible line.
struct SpeedWindows {
  std::unique_ptr<const TrackContext> context;
  std::vector<SpeedWindow> windows;
};
absl::StatusOr<SpeedWindows> MakeSpeedWindows(const SpeedRecording& recording);

// Returns the same windows with each line cut into `num_pieces` lines of equal length: more lines for the same events.
std::vector<SpeedWindow> WithCutLines(const std::vector<SpeedWindow>& windows, int num_pieces);

// Associates the window of a single object with the reach that PoseTrack uses.
class WindowAssociation {
 public:
  // `context` must outlive this object.
  explicit WindowAssociation(const TrackContext& context);
  // The result is valid until the next call, and as long as `window` and this object.
  WindowInput Associate(const SpeedWindow& window);

 private:
  const TrackContext& context_;
  const std::unique_ptr<WindowEstimator> estimator_;  // determines the reach and the number of events
  WindowAssociator associator_;
  std::vector<ImageLine> image_lines_;
};

// Input of an estimator for one window, with copies of what WindowAssociation overwrites in the next one.
struct EstimationInput {
  MotionState predicted;
  std::vector<Observation> events;
  std::vector<ImageLine> image_lines;
  std::vector<LineCell> cells;
  LineEvents sorted;
  WindowInput input;  // refers to the members above and to the lines of the SpeedWindow
};
// Returns one input for each window; `windows` must outlive the result.
std::vector<EstimationInput> MakeEstimationInputs(const TrackContext& context, const std::vector<SpeedWindow>& windows);

}  // namespace evpose
