// SPDX-License-Identifier: Apache-2.0

// Interface of the estimators, and their input and output: the state at mid-window, computed from the predicted state
// and the events of the window (core/estimation/README.md).
#pragma once

#include <algorithm>
#include <array>
#include <functional>
#include <memory>
#include <utility>
#include <vector>

#include "absl/types/span.h"
#include "core/association/association.h"
#include "core/association/line_events.h"
#include "core/association/near_events.h"
#include "core/association/window_associator.h"
#include "core/base/state_io.h"
#include "core/geometry/motion_prior.h"

namespace evpose {

// Counts of one line for the event deficit (core/estimation/README.md, section 4), for its first and its second half:
// the least number of events that the motion should have produced, and the number of observed events beyond those of
// the background.
struct DeficitCounts {
  std::array<double, 2> expected = {};
  std::array<double, 2> observed = {};

  // Adds the counts of the next window. The sums are scaled down to kMemoryEvents expected events, so that older
  // windows fade out. An excess of observed over expected events is cut off: it does not compensate for a later
  // deficit.
  void Add(const DeficitCounts& window);
  // Expected events that are remembered, at the lower bound of the event rate (MixtureOptions::min_events_per_px2).
  // Sensors produce about ten times as many, so that half a line in motion seldom remains without an event over this
  // memory.
  static constexpr double kMemoryEvents = 0.5;

  // Most lines of a large model have no counts; one flag is stored for each of these.
  static void VisitState(auto& archive, auto& self) {
    auto& [expected, observed] = self;
    bool is_empty = expected == std::array<double, 2>() && observed == std::array<double, 2>();
    archive(is_empty);
    if (is_empty) return;
    for (auto& events : expected) archive(AtMost(events, kMemoryEvents));
    for (auto& events : observed) archive(InRange(events, -kMemoryEvents, kMemoryEvents));
  }
};

// The conclusion from the absence of events near a line that moves across itself.
enum class Expectation : uint8_t {
  // A straight line, or a curve that has shown events or has a high contrast: missing events contradict the estimate.
  kEvents,
  // A contour against a background that may be as bright as the object: missing events are no evidence about the motion
  // yet.
  kPerhaps,
  // A curve that has moved without events while the pose was confirmed: missing events are no evidence.
  kNothing,
};

// The events of a window near the predicted lines. All pointers and spans are valid during the call only.
struct WindowInput : AssociatedEvents {
  // The hypothesis is no longer tentative, and most of its lines have been tested (TestCoverage::kMost). Otherwise no
  // correction for flicker is applied.
  bool is_mostly_tested = false;
  absl::Span<const TrackedLine> lines;
  absl::Span<const ImageLine> image_lines;  // image of `lines` at the predicted state; empty: not computed yet
  absl::Span<const DeficitCounts> past_deficit_counts;  // counts of `lines`, from earlier windows; empty: none
  absl::Span<const Expectation> expectations;           // expectation of each of `lines`; empty: kEvents for all

  Expectation ExpectationOf(size_t line) const {
    return expectations.empty() ? Expectation::kEvents : expectations[line];
  }
};

struct WindowFit {
  MotionState state;            // pose, twist and covariance at mid-window
  double num_gated = 0.0;       // observations in the gate of at least one line
  double num_explained = 0.0;   // expected number of gated observations that the lines produced
  double num_background = 0.0;  // expected number of gated observations from the background
  double residual_rms_px = 0.0;
  double gate_px = 0.0;  // the gate of the last pass; 0 for the published estimators
  // Share of the expected events that is missing, in [0, 1], for the estimated twist and including the counts of
  // earlier windows (core/estimation/README.md, section 4).
  double deficit_ratio = 0.0;
  // Covariance of the errors of the pose that the covariance of `state` does not contain, because they have the same
  // cause in many windows (systematic_error.h); zero for an estimator that does not compute it.
  Matrix6d systematic_covariance = Matrix6d::Zero();
  // Expected number of observations that each line of the input produced; empty if the estimator does not compute it.
  std::vector<double> line_events;
  // Counts of the input's lines in this window, for the estimated twist; empty likewise.
  std::vector<DeficitCounts> deficit_counts;

  double explained_ratio() const { return num_gated > 0.0 ? num_explained / num_gated : 0.0; }
  // Gated observations beyond those of the background, and the explained share of these.
  double num_signal() const { return std::max(0.0, num_gated - num_background); }
  double explained_signal_ratio() const { return num_signal() > 0.0 ? num_explained / num_signal() : 0.0; }

  // Resets all members; the capacity of the vectors is kept.
  void Clear() {
    line_events.clear();
    deficit_counts.clear();
    *this = {.line_events = std::move(line_events), .deficit_counts = std::move(deficit_counts)};
  }
};

class WindowEstimator {
 public:
  virtual ~WindowEstimator() = default;

  // Distance from the predicted lines, in pixels, within which the estimator needs the events. `predicted_spread_px` is
  // the standard deviation of the predicted position of the least certain line.
  virtual double ReachPx(double predicted_spread_px, double gate_factor) const = 0;
  // Largest number of observations per window that the estimator uses.
  virtual int MaxEvents() const = 0;
  // True: WindowInput::lines has the lines that are visible at the predicted pose; false: all lines of the model.
  virtual bool UsesVisibility() const { return true; }
  // True: `predicted` is the prediction of the motion prior; false: it is the last pose, at rest.
  virtual bool UsesPrediction() const { return true; }
  // True: the covariance of a fit is that of the prediction, updated with the events.
  virtual bool UpdatesCovariance() const { return false; }
  // Estimates the state of a window. `predicted` is the state predicted for mid-window, with covariance. `gate_factor`
  // (>= 1) widens the gate for a second try (core/estimation/README.md, section 5). `fit` is overwritten and its memory
  // is reused. Does not change what Accept() has learned, so that Fit() may be called twice for a window.
  virtual void Fit(const MotionState& predicted, const WindowInput& input, double gate_factor, WindowFit& fit) = 0;
  // Accepts the last fit: updates the running estimates, such as spread and clutter, with which the next window starts.
  virtual void Accept(const WindowFit& fit, const WindowInput& input) = 0;

  // Writes and reads all that Accept() has learned, bit for bit. LoadState() requires an estimator with the same
  // options and camera; its failure is in reader.status().
  virtual void SaveState(StateWriter& writer) const = 0;
  virtual void LoadState(StateReader& reader) = 0;
};

struct EstimatorOptions;  // mixture_estimator.h

// Makes an estimator. Its arguments must be valid.
using EstimatorFactory =
    std::function<std::unique_ptr<WindowEstimator>(const EstimatorOptions& options, const CameraModel& camera)>;

}  // namespace evpose
