// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/speed/speed_windows.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "core/geometry/trajectory.h"
#include "core/tracking/evidence/health.h"

namespace evpose {
namespace {

absl::StatusOr<std::unique_ptr<const TrackContext>> MakeContext(const SpeedRecording& recording) {
  EVPOSE_ASSIGN_OR_RETURN(auto tables, MakeCameraTables(recording.camera));
  const TrackerOptions options;
  return std::make_unique<const TrackContext>(
      TrackContext{recording.model, recording.camera, std::move(tables), options,
                   std::make_shared<const ModelEdges>(*recording.model, options.visibility, options.elements)});
}

// Tracks the object and stores the predicted state of each window.
class WindowRecorder {
 public:
  WindowRecorder(const SpeedRecording& recording, const TrackContext& context)
      : recording_(recording), context_(context) {}

  void OnWindow(const EventWindow& window) {
    if (track_ == nullptr || track_->state() == TrackState::kLost) Start(window.t_begin_us);
    SpeedWindow met;
    met.t_begin_us = window.t_begin_us;
    met.t_end_us = window.t_end_us;
    met.num_events = window.num_events;
    met.events.assign(window.events.begin(), window.events.end());
    met.events_per_sample = window.events_per_sample;
    met.predicted = Predict(track_->motion(), window.t_mid_us(), context_.options.motion);
    track_->OnWindow(window);
    met.lines.assign(track_->lines().begin(), track_->lines().end());
    if (!met.lines.empty()) windows_.push_back(std::move(met));
  }
  std::vector<SpeedWindow> Take() { return std::move(windows_); }

 private:
  void Start(int64_t t_us) {
    const Trajectory& truth = recording_.truth;
    const int64_t known_us = std::clamp(t_us, truth.front().t_us, truth.back().t_us);
    const double focal_px = recording_.camera.MaxFocalPx();
    // Interpolated; the truth covers the whole recording.
    const RigidTransform pose = *Interpolate(truth, known_us);
    track_ = std::make_unique<PoseTrack>(context_, InitialMotionState(pose, t_us, focal_px, context_.options.initial));
  }

  const SpeedRecording& recording_;
  const TrackContext& context_;
  std::unique_ptr<PoseTrack> track_;
  std::vector<SpeedWindow> windows_;
};

}  // namespace

EventWindow SpeedWindow::AsEventWindow() const {
  EventWindow window;
  window.t_begin_us = t_begin_us;
  window.t_end_us = t_end_us;
  window.events = events;
  window.num_events = num_events;
  window.events_per_sample = events_per_sample;
  return window;
}

absl::StatusOr<SpeedWindows> MakeSpeedWindows(const SpeedRecording& recording) {
  SpeedWindows made;
  EVPOSE_ASSIGN_OR_RETURN(made.context, MakeContext(recording));
  WindowRecorder recorder(recording, *made.context);
  EventWindower windower(made.context->options.windows, recording.geometry);
  const auto on_window = [&recorder](const EventWindow& window) { recorder.OnWindow(window); };
  windower.Add(recording.events, on_window);
  windower.Finish(on_window);
  made.windows = recorder.Take();
  if (made.windows.empty()) {
    return absl::InternalError(absl::StrCat("no line shows in the scene of ", recording.scene, " Mev/s"));
  }
  return made;
}

std::vector<SpeedWindow> WithCutLines(const std::vector<SpeedWindow>& windows, int num_pieces) {
  std::vector<SpeedWindow> cut = windows;
  for (size_t i = 0; i < cut.size(); ++i) {
    cut[i].lines.clear();
    for (const TrackedLine& line : windows[i].lines) {
      const Eigen::Vector3d piece = (line.p2 - line.p1) / num_pieces;
      for (int k = 0; k < num_pieces; ++k) {
        cut[i].lines.push_back({line.curve * num_pieces + k, line.p1 + k * piece, line.p1 + (k + 1) * piece});
      }
    }
  }
  return cut;
}

WindowAssociation::WindowAssociation(const TrackContext& context)
    : context_(context),
      estimator_(context.options.MakeEstimator(context.camera)),
      associator_(context.camera, *context.tables) {}

WindowInput WindowAssociation::Associate(const SpeedWindow& window) {
  WindowInput input;
  input.lines = window.lines;
  ProjectLines(context_.camera, window.predicted, input.lines, image_lines_);
  input.image_lines = image_lines_;
  const double spread_px = PredictedSpreadPx(context_.camera, window.predicted, image_lines_);
  const double reach_px = std::max(estimator_->ReachPx(spread_px, 1.0), TrackHealth::ReachPx(context_.options.health));
  static_cast<AssociatedEvents&>(input) =
      associator_.Associate(window.AsEventWindow(), image_lines_, window.predicted.t_us, reach_px,
                            estimator_->MaxEvents(), [](const Observation&) { return 0.0f; });
  return input;
}

std::vector<EstimationInput> MakeEstimationInputs(const TrackContext& context,
                                                  const std::vector<SpeedWindow>& windows) {
  WindowAssociation association(context);
  std::vector<EstimationInput> inputs(windows.size());
  for (size_t i = 0; i < windows.size(); ++i) {
    EstimationInput& made = inputs[i];
    made.predicted = windows[i].predicted;
    made.input = association.Associate(windows[i]);
    made.events.assign(made.input.events.begin(), made.input.events.end());
    made.image_lines.assign(made.input.image_lines.begin(), made.input.image_lines.end());
    made.cells.assign(made.input.cells.begin(), made.input.cells.end());
    made.sorted.Sort(made.events, made.input.lines.size(), made.image_lines);
    made.input.events = made.events;
    made.input.image_lines = made.image_lines;
    made.input.cells = made.cells;
    made.input.sorted = &made.sorted;
  }
  return inputs;
}

}  // namespace evpose
