// SPDX-License-Identifier: Apache-2.0

// The windows of a recording with what the tracker knew before each: association and estimation can be run on them by
// themselves.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "core/association/window_associator.h"
#include "core/estimation/estimator.h"
#include "core/experiments/speed/speed_recordings.h"
#include "core/tracking/pose_track.h"
#include "core/windows/event_window.h"

namespace evpose {

struct SpeedWindow {
  int64_t t_begin_us = 0;
  int64_t t_end_us = 0;
  uint64_t num_events = 0;  // before sampling
  std::vector<WindowEvent> events;
  MotionState predicted;           // for mid-window
  std::vector<TrackedLine> lines;  // visible there

  // Valid as long as this is.
  EventWindow AsEventWindow() const;
};

// Windows of a millisecond, of a tracker that begins at the truth, and again there when it is lost. `context` is what
// it tracks with. Errors: those of TrackContext's parts; INTERNAL when no window has a visible line.
struct SpeedWindows {
  std::unique_ptr<const TrackContext> context;
  std::vector<SpeedWindow> windows;
};
absl::StatusOr<SpeedWindows> MakeSpeedWindows(const SpeedRecording& recording);

// The same windows with each line cut into `num_pieces` lines of the same length: as many times the lines for the same
// events.
std::vector<SpeedWindow> WithCutLines(const std::vector<SpeedWindow>& windows, int num_pieces);

// The association of a single object's window with the reach that PoseTrack uses.
class WindowAssociation {
 public:
  // `context` must outlive it.
  explicit WindowAssociation(const TrackContext& context);
  // The result refers to `window` and is valid until the next call.
  WindowInput Associate(const SpeedWindow& window);

 private:
  const TrackContext& context_;
  const std::unique_ptr<WindowEstimator> estimator_;  // determines the reach and the number of events
  WindowAssociator associator_;
  std::vector<ImageLine> image_lines_;
};

// What an estimator is given of one window.
struct EstimationInput {
  MotionState predicted;
  std::vector<Observation> events;
  LineEvents sorted;
  WindowInput input;  // of `events`, and of the lines of its SpeedWindow
};
// One for each window, which must be there as long.
std::vector<EstimationInput> MakeEstimationInputs(const TrackContext& context, const std::vector<SpeedWindow>& windows);

}  // namespace evpose
