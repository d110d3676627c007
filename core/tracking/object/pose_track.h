// SPDX-License-Identifier: Apache-2.0

// One hypothesis about the pose of an object, tracked from window to window (core/tracking/README.md).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "core/association/association.h"
#include "core/association/camera_tables.h"
#include "core/association/other_objects.h"
#include "core/association/visible_edges.h"
#include "core/association/window_associator.h"
#include "core/estimation/estimator.h"
#include "core/geometry/camera.h"
#include "core/geometry/motion_prior.h"
#include "core/tracking/evidence/curve_activity.h"
#include "core/tracking/evidence/determination.h"
#include "core/tracking/evidence/flash.h"
#include "core/tracking/evidence/health.h"
#include "core/tracking/object/motion_adaptation.h"
#include "core/tracking/object/pose_estimate.h"
#include "core/tracking/object/track_phase.h"
#include "core/tracking/object/tracker_options.h"
#include "core/windows/event_window.h"

namespace evpose {

// Data that all hypotheses of an object share.
struct TrackContext {
  std::shared_ptr<const ObjectModel> model;
  CameraModel camera;
  std::shared_ptr<const CameraTables> tables;
  TrackerOptions options;
  std::shared_ptr<const ModelEdges> edges;  // edges of `model`
  std::shared_ptr<PhaseReporter> phase_reporter = std::make_shared<PhaseReporter>();
  BoundingSphere sphere = BoundingSphereOf(*model);  // object frame
  std::shared_ptr<const NearProbability> near_probability = std::make_shared<const NearProbability>(options.health);
};

// Tracks one pose with its twist and covariance. Not thread-safe; deterministic.
class PoseTrack {
 public:
  // Tentative until the events support the pose. `context` must outlive it.
  PoseTrack(const TrackContext& context, const MotionState& start);

  // Processes a window: prediction, association, estimation, test. Returns an estimate while the state is TRACKING or
  // DEGRADED. `others` are the other objects at mid-window; null or empty: none.
  std::optional<PoseEstimate> OnWindow(const EventWindow& window, const OtherObjects* others = nullptr);

  // No event was processed for `gap_us` before the next window: the timeouts of the phases are extended by it.
  void OnGap(int64_t gap_us);

  // Enters the phase lost for this cause, unless the hypothesis is lost already.
  void Reject(LossCause cause, int64_t t_us);

  TrackState state() const { return ReportedState(phase_); }
  // Why the state is LOST.
  LossCause loss_cause() const { return loss_cause_; }
  // Tentative, and contradicted by `times` times HealthOptions::max_contradictions test results.
  bool is_rejected(int times) const {
    return phase_ == TrackPhase::kTentative &&
           num_contradictions_ >= times * context_.options.health.max_contradictions;
  }
  // Clears the count of contradictions of a tentative track.
  void ClearContradictions() { num_contradictions_ = 0; }
  // State at the middle of the last window.
  const MotionState& motion() const { return motion_; }
  // Replaces the state from which the next window is predicted. Used for rivals that start with the statistics of
  // another hypothesis, and by experiments that perturb every start.
  void set_motion(const MotionState& motion) { motion_ = motion; }
  // The lines that were associated in the last window; valid until the next one.
  absl::Span<const TrackedLine> lines() const { return last_.lines; }
  // Where an event of the last window lies relative to the lines.
  struct Nearness {
    float distance_px = kScoredPx;      // from the nearest line in view; kScoredPx where none is nearer
    float share = 1.0f;                 // probability that the event is not that of another object
    EdgeKind kind = EdgeKind::kCrease;  // of the nearest line
  };
  // Twice the half-width of the widest triangle by which hypotheses are compared (README, section 2): events farther
  // away have a score of 0. Validated by half_turns_test: a contour 2 px beside its place must not count against the
  // right pose.
  static constexpr float kScoredPx = 6.0f;
  Nearness NearestLine(Observation observation, const OtherObjects* others = nullptr) const;
  // Root mean square of the residuals of the last window, pixels.
  double spread_px() const { return last_.fit.residual_rms_px; }

  // To be called between windows; lines(), NearestLine() and spread_px() are not restored. LoadState() requires the
  // same context.
  void SaveState(StateWriter& writer) const;
  void LoadState(StateReader& reader);

 private:
  // The visible lines that the other objects hide in the last window; kAll: none is left.
  enum class Occlusion { kNone, kSome, kAll };

  // What the last window was processed with. It is not saved; the buffers keep their memory.
  struct LastWindow {
    absl::Span<const TrackedLine> lines;  // those that were associated
    std::vector<TrackedLine> unoccluded_lines;
    bool is_flash = false;  // IsFlash()
    Occlusion occlusion = Occlusion::kNone;
    std::vector<ImageLine> image_lines;
    std::vector<double> rates;                       // RelativeEventRate of image_lines; empty without others
    std::vector<DeficitCounts> past_deficit_counts;  // deficit_counts_ of the lines of the window
    std::vector<Expectation> expectations;           // expectation of each line; empty without elements
    WindowFit fit;                                   // the estimate
    WindowFit second_fit;                            // another one, with wider gates or without events
  };
  // Means and sums over past windows of the events near the lines.
  struct SignalHistory {
    double usual_explained_ratio = 0.0;  // running mean of the explained ratio of the signal
    double recent_signal = 0.0;          // running sums of the gated events, above the background and of the background
    double recent_background = 0.0;
    static void VisitState(auto& archive, auto& self) {
      auto& [usual_explained_ratio, recent_signal, recent_background] = self;
      archive(Finite(usual_explained_ratio), Finite(recent_signal), Finite(recent_background));
    }
  };

  static void VisitState(auto& archive, auto& self);
  // Turns the window's events near the lines at `predicted` into observations.
  WindowInput Gather(const EventWindow& window, const OtherObjects* others, const MotionState& predicted,
                     double gate_factor);
  // Expected density of the other objects' events at `event`, relative to that of the nearest own line.
  double OthersDensityPerPx(const Observation& event, const OtherObjects& others, absl::Span<const double> rates) const;
  // The state that the estimator starts from.
  MotionState Predicted(int64_t t_us, const MotionPriorOptions& motion, double noise_factor) const;
  // Limits the densities of the motion, and the velocity of a track that has just started, by the speed that the number
  // of events permits (README, equation (8)). Returns whether the prediction is thereby another one.
  bool LimitMotion(const WindowInput& input);
  // Fits the window with the adapted densities of the motion prior, and again with the full densities if the innovation
  // is significant.
  void FitAdapted(const EventWindow& window, const WindowInput& input, MotionState& predicted);
  // Whether the brightness changes and the events are not concentrated near the lines of last_.fit.
  bool IsFlash(const EventWindow& window, const WindowInput& input);
  // Replaces the state of last_.fit by that of a fit without events.
  void FitNoEvents(const WindowInput& input, const MotionState& predicted);
  // Sets last_.fit and the input of the fit.
  void FitWindow(const EventWindow& window, const OtherObjects* others, WindowInput& input);
  // Whether the predicted motion is so slow that an event deficit is not significant.
  bool IsSlow(const WindowInput& input) const;
  // Whether there are significantly more events near the lines than the background rate explains.
  bool HasSignal(const WindowFit& fit) const;
  // Returns the weight of one window in a running mean in which a window of 1 ms or more has the weight `per_ms`.
  double PerWindow(double per_ms) const {
    return per_ms / static_cast<double>(context_.options.windows.intervals_per_usual());
  }
  // Returns whether the sums over the last windows, to which it adds this window, show no such excess either. To be
  // called once per window.
  bool IsOnlyBackground(const WindowFit& fit);
  // Handles a window in which the other objects occlude all lines: the estimate is the prediction with its covariance.
  std::optional<PoseEstimate> PredictOccluded(const EventWindow& window);
  // Whether the curves that the last test found supported determine every motion of the object, as the phase requires.
  bool IsDetermined(absl::Span<const TrackedLine> lines, double support_ratio);
  void UpdatePhase(const HealthResult& result, bool is_determined, int64_t t_us);
  // Applies the transition function, stores the time of the transition and reports it. No other function changes the
  // phase.
  void Enter(TrackInput input, int64_t t_us);
  // The cause of the loss by `input`.
  LossCause CauseOf(TrackInput input) const;
  Matrix6d PublishedCovariance(const WindowFit& fit) const;
  PoseEstimate MakeEstimate(const WindowFit& fit, const WindowInput& input) const;

  // Sets the counts and expectations of earlier windows for the lines of the window.
  void SetPastCounts(WindowInput& input);
  // Adds the counts of the curves in an accepted window.
  void AddCounts(const WindowInput& input, const WindowFit& fit);

  const TrackContext& context_;
  VisibleEdges visible_edges_;
  std::vector<TrackedLine> all_lines_;
  WindowAssociator associator_;
  std::unique_ptr<WindowEstimator> estimator_;
  TrackHealth health_;
  Determination determination_;
  CurveActivity activity_;
  FlashDetector flash_;
  MotionAdaptation adaptation_;

  TrackPhase phase_ = TrackPhase::kTentative;
  MotionState motion_;
  SignalHistory signal_;
  std::vector<DeficitCounts> deficit_counts_;  // counts of earlier windows, by TrackedLine::curve
  int num_contradictions_ = 0;                 // test results that contradicted the tentative pose
  int64_t followed_since_us_ = -1;             // begin of the first window, microseconds; -1 before it
  TestCoverage coverage_ = TestCoverage::kPart;
  int64_t supported_at_us_ = 0;       // time of the latest kSupport
  int64_t unsupported_since_us_ = 0;  // time at which kUnsupported was entered

  LossCause loss_cause_ = LossCause::kNone;  // not saved: a lost track is removed before the next window

  LastWindow last_;
};

}  // namespace evpose
