// SPDX-License-Identifier: Apache-2.0

// One hypothesis about where the object is, followed from window to window (core/tracking/README.md).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "core/association/association.h"
#include "core/association/background.h"
#include "core/association/camera_tables.h"
#include "core/association/competitors.h"
#include "core/association/near_events.h"
#include "core/association/visible_lines.h"
#include "core/estimation/estimator.h"
#include "core/geometry/camera.h"
#include "core/geometry/motion_prior.h"
#include "core/models/visibility.h"
#include "core/tracking/health.h"
#include "core/tracking/pose_estimate.h"
#include "core/tracking/track_phase.h"
#include "core/tracking/tracker_options.h"
#include "core/windows/event_window.h"

namespace evpose {

// What all hypotheses of a tracker look with.
struct TrackContext {
  std::shared_ptr<const ObjectModel> model;
  CameraModel camera;
  std::shared_ptr<const CameraTables> tables;
  TrackerOptions options;
  VisibilityTester visibility;
};

class PoseTrack {
 public:
  // Tentative until the events support the pose. `context` must outlive it.
  PoseTrack(const TrackContext& context, const MotionState& start);

  // Predicts, associates, estimates, judges. The estimate is there while the state is TRACKING or DEGRADED. `others`:
  // the other objects at mid-window, null or empty when there are none.
  std::optional<PoseEstimate> OnWindow(const EventWindow& window, const Competitors* others = nullptr);

  // So long nobody looked before the next window: patience with the pose is no shorter for it.
  void OnGap(int64_t gap_us);

  TrackPhase phase() const { return phase_; }
  TrackState state() const { return ReportedState(phase_); }
  // Tentative, and contradicted by `times` times HealthOptions::max_unconfirmed_verdicts test results.
  bool is_rejected(int times) const {
    return phase_ == TrackPhase::kTentative &&
           num_contradictions_ >= times * context_.options.health.max_unconfirmed_verdicts;
  }
  // Clears the count of contradictions of a tentative track.
  void ClearContradictions() { num_contradictions_ = 0; }
  // At the middle of the last window.
  const MotionState& motion() const { return motion_; }
  // The next window is predicted from this instead: for experiments that start every window elsewhere.
  void set_motion(const MotionState& motion) { motion_ = motion; }
  // That took part in the last window; valid until the next one.
  absl::Span<const TrackedLine> lines() const { return lines_; }
  // How much the lines say about an event of the last window, [-0.5, 1]: high on a line, negative beside one, so that
  // clutter has no say on average; 0 where no line is near.
  double Explains(Observation observation, const Competitors* others = nullptr) const;

  // Between windows: what lines() and Explains() say of the last one is gone. Into a track of the same context.
  void SaveState(StateWriter& writer) const;
  void LoadState(StateReader& reader);

 private:
  static void VisitState(auto& archive, auto& self);
  // Turns the window's events near the lines at `predicted` into observations.
  WindowInput Gather(const EventWindow& window, const Competitors* others, const MotionState& predicted,
                     double gate_factor);
  // What the others claim of the events, by image_lines_ with these event rates.
  double CompetingFor(const Observation& event, const Competitors& others, absl::Span<const double> rates) const;
  // The state that the estimator starts from.
  MotionState Predicted(int64_t t_us, double noise_factor) const;
  // Valid until the next window.
  const WindowFit& FitWindow(const EventWindow& window, const Competitors* others, WindowInput& input);
  // Too slow, as predicted, for its lines' silence to be a surprise.
  bool IsSlow(const WindowInput& input) const;
  // More events near the lines than come anywhere on the sensor.
  bool HasSignal(const WindowFit& fit) const;
  // The same over the last windows together, this one counted; its answer is to be asked for once per window.
  bool IsSilent(const WindowFit& fit);
  // The others hide all of it: it is where it was going to be, as surely as that can be said.
  std::optional<PoseEstimate> Hold(const EventWindow& window);
  void UpdatePhase(const HealthVerdict& verdict, int64_t t_us);
  // The one place where the phase changes; sets what belongs to the new one.
  void Enter(TrackInput input, int64_t t_us);
  Matrix6d PublishedCovariance(const MotionState& state) const;
  PoseEstimate MakeEstimate(const WindowFit& fit, const WindowInput& input) const;

  const TrackContext& context_;
  VisibleLines visible_lines_;
  std::vector<TrackedLine> all_lines_;
  TileGrid grid_;
  BackgroundRate background_;
  std::unique_ptr<WindowEstimator> estimator_;
  TrackHealth health_;

  TrackPhase phase_ = TrackPhase::kTentative;
  MotionState motion_;
  double usual_explained_ratio_ = 0.0;  // running mean
  double recent_signal_ = 0.0;          // events, fading
  double recent_background_ = 0.0;
  std::vector<LineAnswer> answers_;   // of the last windows, by model line
  int num_contradictions_ = 0;        // while tentative
  int64_t followed_since_us_ = -1;    // -1 before the first window
  bool is_fully_tested_ = false;      // once min_tested_ratio of its lines has been testable when it was supported
  int64_t supported_at_us_ = 0;       // the latest kSupport
  int64_t unsupported_since_us_ = 0;  // when kUnsupported was entered

  absl::Span<const TrackedLine> lines_;
  std::vector<TrackedLine> unhidden_lines_;
  bool is_hidden_ = false;         // the others leave nothing of it to be seen
  bool is_partly_hidden_ = false;  // or less than shows otherwise
  std::vector<ImageLine> image_lines_;
  std::vector<double> rates_;  // RelativeEventRate of image_lines_; empty without others
  NearEvents near_events_;
  LineEvents line_events_;
  std::vector<LineAnswer> past_answers_;  // the same, by the window's lines
  WindowFit fit_;
  WindowFit second_fit_;
};

}  // namespace evpose
