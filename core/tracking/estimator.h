// What the tracker asks of an estimator: the state at mid-window from the predicted one and the window's events.
#pragma once

#include <algorithm>
#include <memory>
#include <vector>

#include "absl/types/span.h"
#include "core/base/state_io.h"
#include "core/tracking/association.h"
#include "core/tracking/motion_prior.h"
#include "core/tracking/tracker_options.h"

namespace evpose {

// A window's events near the predicted lines. Everything is valid during the call only.
struct WindowInput {
  absl::Span<const Observation> events;
  double events_per_observation = 1.0;  // > 1 when events were sampled
  double duration_s = 0.0;
  double background_per_px2 = 0.0;  // events that came anywhere, lines or not, in this time
  absl::Span<const TrackedLine> lines;
  const TileGrid* grid = nullptr;  // indices into `lines`
};

struct WindowFit {
  MotionState state;            // at mid-window
  double num_gated = 0.0;       // events in the gate of a line, of those observed
  double num_explained = 0.0;   // of them, expected to be a line's
  double num_background = 0.0;  // of them, expected there as anywhere on the sensor
  double residual_rms_px = 0.0;
  double missing_ratio = 0.0;  // of the events that the lines should have made, by the state's twist
  // Explained, of those observed, by each of the input's lines; empty when the estimator does not say.
  std::vector<double> line_events;

  double explained_ratio() const { return num_gated > 0.0 ? num_explained / num_gated : 0.0; }
  // Events in the gates that something in the scene must have made, and the explained share of these.
  double num_signal() const { return std::max(0.0, num_gated - num_background); }
  double explained_signal_ratio() const { return num_signal() > 0.0 ? num_explained / num_signal() : 0.0; }
};

class WindowEstimator {
 public:
  virtual ~WindowEstimator() = default;

  // Pixels around the predicted lines from which the estimator wants events.
  virtual double ReachPx(double predicted_spread_px, double gate_factor) const = 0;
  // Observations that it wants per window, at most.
  virtual int MaxEvents() const = 0;
  // Whether it is given the lines that are visible at the predicted pose, or all of the model's.
  virtual bool UsesVisibility() const { return true; }
  // Whether it starts from the prediction, or from the last pose, at rest.
  virtual bool UsesPrediction() const { return true; }
  // `predicted` is for mid-window. `gate_factor` widens the gate for a second try (method.md 2.10 (4)). Learns nothing:
  // Fit may be called twice for a window.
  virtual WindowFit Fit(const MotionState& predicted, const WindowInput& input, double gate_factor) = 0;
  // The last fit stands: what it says of spread and clutter is the next window's start.
  virtual void Accept(const WindowFit& fit, const WindowInput& input) = 0;
  // Another object's pose: forgets what Accept learned.
  virtual void Reset() = 0;

  // What it has learned, bit for bit; into an estimator of the same options and camera.
  virtual void SaveState(StateWriter& writer) const = 0;
  virtual void LoadState(StateReader& reader) = 0;
};

// The one that `options.estimator` names. `options` and `camera` must be valid.
std::unique_ptr<WindowEstimator> MakeWindowEstimator(const TrackerOptions& options, const CameraModel& camera);

// What it chooses from: mixture.h, static_estimator.cc (LS, M, S, MM, of both formulas), error_state_filter.h.
std::unique_ptr<WindowEstimator> MakeMixtureEstimator(const TrackerOptions& options, const CameraModel& camera);
std::unique_ptr<WindowEstimator> MakeStaticEstimator(const TrackerOptions& options, const CameraModel& camera);
std::unique_ptr<WindowEstimator> MakeErrorStateFilter(const TrackerOptions& options, const CameraModel& camera);

}  // namespace evpose
