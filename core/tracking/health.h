// SPDX-License-Identifier: Apache-2.0

// Tests whether the events support a pose (core/tracking/README.md, section 1). The test statistic is the number of
// events near the projected lines minus the number that uniform clutter would put there.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "core/association/association.h"
#include "core/estimation/estimator.h"

namespace evpose {

// Thresholds of the tests of core/tracking/README.md, section 1. All tests use the same event counts and have stated
// false alarm rates; they were validated on simulated recordings with truth (core/experiments/RESULTS.md) and on the
// tests of this folder.
struct HealthOptions {
  // Pixels. An event within near_px of its line counts as an event of that line; events beyond gate_px are not counted.
  // Under uniform clutter the share of near events among the gated ones equals the ratio of the areas.
  double near_px = 2.0;
  double gate_px = 8.0;
  // Standard deviations by which the near events must exceed chance: 1e-3 one-sided under the normal.
  double significance_sigma = 3.1;
  // Variance of event counts relative to independent events, which is above 1 because one edge passage triggers several
  // events (see events_per_information).
  double dispersion = 5.0;
  // Background events per second and pixel. An EVK4 in dim light produces 1 to 3, with sensitive biases 10. Events near
  // the lines at up to this rate, and no denser than elsewhere on the sensor, do not contradict an object at rest.
  double max_noise_hz_per_px = 10.0;
  // Gated events that a test result requires.
  int min_events = 150;
  // Microseconds that a test covers at least.
  int64_t min_span_us = 2000;
  // Share of the testable length of lines that must be supported. A wrong pose can be fitted to about three lines of
  // clutter (6 unknowns, 2 per line); at the right pose nearly all lines that are not occluded are supported.
  double confirm_support_ratio = 0.6;
  double keep_support_ratio = 0.35;
  // Lines that must be supported to confirm a tentative pose and to keep a confirmed one. Three lines determine the six
  // unknowns of a pose, and two restrict all but a small part of its motion.
  int confirm_lines = 3;
  int keep_lines = 2;
  // Events per window, above the background, that a decision about the window requires: a second try of the estimate,
  // and the update of the running means. The relative fluctuation of fewer events exceeds the effects that are tested.
  double min_signal_events = 50.0;
  // Microseconds over which the counts of a short or slow line are summed.
  int64_t memory_us = 100'000;
  // Share of the length of the visible lines that must have been testable before the first support confirms a tentative
  // track: a part of one object can equal the whole of another.
  double min_tested_ratio = 0.9;
  // Microseconds after which the first confirmation no longer waits for min_tested_ratio: a line that moves along
  // itself produces no events and never becomes testable.
  int64_t max_hold_us = 15'000;
  // Microseconds after which a confirmed pose without support counts as unsupported: ten poses at 1 kHz.
  int64_t patience_us = 10'000;
  // Microseconds from the first unsupported test result on after which the pose is LOST. Together with patience_us, a
  // loss is reported within 50 ms.
  int64_t lost_after_us = 25'000;
  // Contradicting test results after which a tentative pose is rejected.
  int max_contradictions = 3;
  // Pixels. A pose whose projected uncertainty exceeds this is wider than the gate and cannot be distinguished from a
  // wrong one.
  double max_uncertainty_px = 12.0;

  absl::Status Validate() const;
};

// The counts of one straight line or curve since the last test result.
struct LineStatistics {
  double gated = 0.0;  // events within gate_px of the line for which no other line is nearer
  // Equation (1) of the README: the gated events within near_px minus their expected number under clutter, and the
  // variance of this difference. Each polarity of a window is weighted down as its share of far events grows: while a
  // lamp brightens, ON events occur everywhere and would mask the OFF events of the lines.
  double excess = 0.0;
  double variance = 0.0;
  double noise = 0.0;     // gated events that the background rate explains
  double expected = 0.0;  // lower bound of the number of events that the line's motion should have produced
  // Histogram of the gated events along the line: the line's own events are spread along it, those of an edge that
  // crosses it are concentrated at one place.
  Eigen::Matrix<double, 8, 1> along = Eigen::Matrix<double, 8, 1>::Zero();
  double length_px = 0.0;  // mean projected length, weighted by time
  // Number of straight lines that constrain a pose as much: of a curve, its arcs of 45 degrees that are long enough.
  int lines = 1;

  // Multiplies the counts by `kept_ratio`, then adds `other`.
  void Add(const LineStatistics& other, double kept_ratio = 1.0);

  static constexpr int kMaxLines = 8;  // of a circle

  // Most lines of a large model have no counts; one flag is stored for each of these.
  static void VisitState(auto& archive, auto& self) {
    auto& [gated, excess, variance, noise, expected, along, length_px, lines] = self;
    bool is_empty =
        gated == 0 && excess == 0 && variance == 0 && noise == 0 && expected == 0 && length_px == 0 && lines == 1;
    archive(is_empty);
    if (is_empty) return;
    archive(Finite(gated), Finite(excess), Finite(variance), Finite(noise), Finite(expected), Finite(along),
            Finite(length_px), InRange(lines, 1, kMaxLines));
  }
};

// Result of a test, with the statistics that led to it.
struct HealthResult {
  enum class Kind {
    kOpen,         // too few events for a result; counting continues
    kFewEvents,    // no more events than the background rate explains, as for an object at rest
    kSupported,    // the events support the pose
    kDoubtful,     // they support a part of it: the rest is occluded, or the part belongs to another object
    kUnsupported,  // there are enough events, and they do not support the pose
  };
  Kind kind = Kind::kOpen;
  double sigma = 0.0;  // standard deviations by which near events exceed chance
  // Share of the length of the visible lines on which events were expected or observed since the last test result.
  double present_ratio = 0.0;
  // Share of the length of the visible lines that was testable, with the counts of the last memory_us.
  double testable_ratio = 0.0;
  double support_ratio = 0.0;  // share of the length of the testable lines that is supported
  int supported_lines = 0;
  int testable_lines = 0;
};

// Accumulates the event counts of the lines of one hypothesis and tests them.
class TrackHealth {
 public:
  // Distance in pixels from the lines up to which AddWindow() needs the events.
  static double ReachPx(const HealthOptions& options) { return options.gate_px + 2.0; }

  TrackHealth(const HealthOptions& options, double min_events_per_px2, int num_curves);

  // Adds the counts of a window. `lines` are the images of `input.lines` at the estimated state, in the same order;
  // `twist` is the estimated one (m/s, rad/s).
  void AddWindow(const CameraModel& camera, const WindowInput& input, absl::Span<const ImageLine> lines,
                 const Vector6d& twist);
  // Tests the counts since the last result.
  //
  //   kSupported     supported length / testable length >= sure_support_ratio, with min_supported_lines supported lines
  //   kDoubtful      the same with min_support_ratio
  //   kUnsupported   enough events near the lines, but neither of the above
  //   kFewEvents     no more events than the background explains, as for an object at rest
  //   kOpen          too few events so far; counting continues
  //
  // kSupported is returned as soon as the counts reach it, kDoubtful and kUnsupported only after `patience_us`, because
  // flicker and clutter dilute the events of the object. Every result but kOpen resets the counts. The ratios and the
  // number of lines are stricter for confirming a pose than for keeping one (HealthOptions).
  HealthResult Test(double min_support_ratio, double sure_support_ratio, int min_supported_lines, int64_t patience_us);

  static void VisitState(auto& archive, auto& self) {
    auto& [options, min_events_per_px2, evidence, memory, span_s, gated, gate_px2_s, was_quiet, window_lines, places,
           distance_px, is_nearest] = self;
    for (auto& line : evidence) archive(line);
    for (auto& line : memory) archive(line);
    archive(Finite(span_s), Finite(gated), Finite(gate_px2_s), was_quiet);
  }

 private:
  void Reset();
  void AddEvents(const LineEvents& events, absl::Span<const ImageLine> lines);
  // For each event that lies in the gates of several lines, finds the nearest of these lines.
  void FindNearest(const LineEvents& events, absl::Span<const ImageLine> lines);
  HealthResult Evaluate(double min_support_ratio, double sure_support_ratio, int min_supported_lines) const;
  // Whether the line would be supported at the right pose: it has, or should have produced, significantly more events
  // than the background.
  bool IsTestable(const LineStatistics& line) const;
  // Share of the line's length on which events were expected or observed.
  double PresentRatio(const LineStatistics& line, double noise) const;
  // Whether the line's motion should have produced significantly more events than `noise`.
  bool IsExpected(const LineStatistics& line, double noise) const;
  // The share of the background events that the test accepts as an explanation (see max_noise_hz_per_px).
  double CreditedNoiseRatio() const;
  bool IsQuiet() const;
  void AddExcess(double gated, double near, LineStatistics& evidence) const;
  double ExcessSigma(const LineStatistics& line) const;

  const HealthOptions options_;
  const double min_events_per_px2_;
  std::vector<LineStatistics> statistics_;  // since the last test result
  // The same from earlier test results, fading out over memory_us: the event deficit of a line becomes significant
  // only over many windows, each of which expects too few events.
  std::vector<LineStatistics> memory_;
  double span_s_ = 0.0;
  double gated_ = 0.0;
  double gate_px2_s_ = 0.0;  // area of the gates times time
  bool was_quiet_ = false;   // the last test result was kFewEvents
  struct WindowLine {        // a straight line or a curve
    LineStatistics* evidence;
    double places_per_px;                               // of LineStatistics::along
    std::array<double, 2> gated_of = {}, near_of = {};  // events in the gate and near the line, by polarity
  };
  void AddEvent(double distance_px, double along_px, double competing, uint8_t polarity, WindowLine& line);
  // Enters the lines of the window into window_lines_ and places_.
  void EnterLines(const WindowInput& input, absl::Span<const ImageLine> lines);
  std::vector<WindowLine> window_lines_;
  struct Place {
    size_t window_line = 0;  // index into window_lines_
    double begin_px = 0.0;   // length of the elements before this one in their curve
  };
  std::vector<Place> places_;         // of each line of the window
  std::vector<Lanes> distance_px_;    // of events in several gates; infinite beyond the gates
  std::vector<LaneMask> is_nearest_;  // the line is the nearest one of the event; indexed like distance_px_
};

}  // namespace evpose
