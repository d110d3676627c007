// One hypothesis about where the object is, followed from window to window (method.md 2.4 to 2.9).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "core/geometry/camera.h"
#include "core/models/visibility.h"
#include "core/tracking/association.h"
#include "core/tracking/background.h"
#include "core/tracking/estimator.h"
#include "core/tracking/health.h"
#include "core/tracking/motion_prior.h"
#include "core/tracking/tracker.h"
#include "core/tracking/tracker_options.h"
#include "core/tracking/visible_lines.h"
#include "core/windows/event_window.h"

namespace evpose {

// What all hypotheses of a tracker look with.
struct TrackContext {
  std::shared_ptr<const ObjectModel> model;
  CameraModel camera;
  std::shared_ptr<const UndistortionTable> undistortion;  // shared by the objects of a stream
  TrackerOptions options;
  VisibilityTester visibility;
};

// An event as an observation at `t_us`; nullopt when it lies outside the sensor.
std::optional<Observation> Observe(const TrackContext& context, const WindowEvent& event, int64_t t_us);

class PoseTrack {
 public:
  // INITIALIZING until the events have spoken for the state. `context` must outlive it.
  PoseTrack(const TrackContext& context, const MotionState& start);

  // Predicts, associates, estimates, judges. The estimate is there while the state is TRACKING or DEGRADED.
  std::optional<PoseEstimate> OnWindow(const EventWindow& window);

  // LOST is final.
  TrackState state() const { return state_; }
  // At the middle of the last window.
  const MotionState& motion() const { return motion_; }
  // The next window is predicted from this instead: for experiments that start every window elsewhere.
  void set_motion(const MotionState& motion) { motion_ = motion; }
  // How much the lines say about an event of the last window, [-0.5, 1]: high on a line, negative beside one, so that
  // clutter has no say on average; 0 where no line is near.
  double Explains(Observation observation) const;

 private:
  // Turns the window's events near the lines at `predicted` into observations.
  WindowInput Gather(const EventWindow& window, const MotionState& predicted, double gate_factor);
  // The state that the estimator starts from.
  MotionState Predicted(int64_t t_us, double noise_factor) const;
  WindowFit FitWindow(const EventWindow& window, WindowInput& input);
  // More events near the lines than come anywhere on the sensor.
  bool HasSignal(const WindowFit& fit) const;
  // The same over the last windows together, this one counted; its answer is to be asked for once per window.
  bool IsSilent(const WindowFit& fit);
  void UpdateState(const HealthVerdict& verdict, int64_t t_us);
  Matrix6d PublishedCovariance(const MotionState& state) const;
  PoseEstimate MakeEstimate(const WindowFit& fit, const WindowInput& input) const;

  const TrackContext& context_;
  VisibleLines visible_lines_;
  std::vector<TrackedLine> all_lines_;
  TileGrid grid_;
  BackgroundRate background_;
  std::unique_ptr<WindowEstimator> estimator_;
  TrackHealth health_;

  TrackState state_ = TrackState::kInitializing;
  MotionState motion_;
  double usual_explained_ratio_ = 0.0;  // running mean
  double recent_signal_ = 0.0;          // events, fading
  double recent_background_ = 0.0;
  int unconfirmed_verdicts_ = 0;
  int64_t followed_since_us_ = -1;
  bool on_trial_ = true;         // too few of its lines have had the time to answer
  int64_t supported_at_us_ = 0;  // the last verdict for the pose
  int64_t unsupported_since_us_ = 0;
  bool unsupported_ = false;  // by events that there are
  bool in_doubt_ = false;     // too little of it is supported to be sure

  std::vector<ImageLine> image_lines_;
  std::vector<Observation> observations_;
};

}  // namespace evpose
