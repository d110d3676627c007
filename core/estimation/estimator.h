// SPDX-License-Identifier: Apache-2.0

// What the tracker asks of an estimator: the state at mid-window from the predicted one and the window's events.
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

// Whether a line answers to its motion: events that each half of it should have made at the least, and those that it
// made beyond the background's.
struct LineAnswer {
  std::array<double, 2> expected = {};
  std::array<double, 2> observed = {};

  // Adds the next window's. What was before counts on for as long as kEnough events should have taken: a shorter
  // silence of a slow line says nothing, and a longer one is not needed. What was made beyond the expected is
  // forgotten: it does not make up for a later silence.
  void Add(const LineAnswer& window);
  // Events at the least rate (MixtureOptions.min_events_per_px2). Sensors make some ten times as many, so that a half
  // that moves is hardly ever silent for so long.
  static constexpr double kEnough = 0.5;

  // Of most lines of a large model there is nothing to be kept.
  static void VisitState(auto& archive, auto& self) {
    auto& [expected, observed] = self;
    bool is_empty = expected == std::array<double, 2>() && observed == std::array<double, 2>();
    archive(is_empty);
    if (is_empty) return;
    for (auto& events : expected) archive(AtMost(events, kEnough));
    for (auto& events : observed) archive(InRange(events, -kEnough, kEnough));
  }
};

// A window's events near the predicted lines. Everything is valid during the call only.
struct WindowInput : AssociatedEvents {
  bool is_believed = false;  // the pose before it; one that is not has to explain the events as they are
  absl::Span<const TrackedLine> lines;
  absl::Span<const LineAnswer> past_answers;  // of the lines, before this window; empty: nothing is known
};

struct WindowFit {
  MotionState state;            // at mid-window
  double num_gated = 0.0;       // events in the gate of a line, of those observed
  double num_explained = 0.0;   // of them, expected to be a line's
  double num_background = 0.0;  // of them, expected there as anywhere on the sensor
  double residual_rms_px = 0.0;
  // Of the events that the lines should have made, by the state's twist, those before the window counted.
  double missing_ratio = 0.0;
  // Explained, of those observed, by each of the input's lines; empty when the estimator does not say.
  std::vector<double> line_events;
  std::vector<LineAnswer> answers;  // of the input's lines in this window, by the state's twist; empty likewise

  double explained_ratio() const { return num_gated > 0.0 ? num_explained / num_gated : 0.0; }
  // Events in the gates that something in the scene must have made, and the explained share of these.
  double num_signal() const { return std::max(0.0, num_gated - num_background); }
  double explained_signal_ratio() const { return num_signal() > 0.0 ? num_explained / num_signal() : 0.0; }

  // As it was made, but for the memory that its lists have.
  void Clear() {
    line_events.clear();
    answers.clear();
    *this = {.line_events = std::move(line_events), .answers = std::move(answers)};
  }
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
  // `predicted` is for mid-window. `gate_factor` widens the gate for a second try (core/estimation/README.md, section
  // 5). `fit` is overwritten, its memory used again. Learns nothing: Fit may be called twice for a window.
  virtual void Fit(const MotionState& predicted, const WindowInput& input, double gate_factor, WindowFit& fit) = 0;
  // The last fit stands: what it says of spread and clutter is the next window's start.
  virtual void Accept(const WindowFit& fit, const WindowInput& input) = 0;
  // Another object's pose: forgets what Accept learned.
  virtual void Reset() = 0;

  // What it has learned, bit for bit; into an estimator of the same options and camera.
  virtual void SaveState(StateWriter& writer) const = 0;
  virtual void LoadState(StateReader& reader) = 0;
};

struct EstimatorOptions;  // mixture_estimator.h

// Makes an estimator; its arguments are valid.
using EstimatorFactory =
    std::function<std::unique_ptr<WindowEstimator>(const EstimatorOptions& options, const CameraModel& camera)>;

}  // namespace evpose
