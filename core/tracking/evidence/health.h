// SPDX-License-Identifier: Apache-2.0

// Tests whether the events support a pose (core/tracking/README.md, section 1). The test statistic is the number of
// events near the projected lines minus the number that uniform clutter would put there.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "core/association/association.h"
#include "core/estimation/estimator.h"
#include "core/tracking/evidence/line_statistics.h"

namespace evpose {

// Thresholds of the tests of core/tracking/README.md, section 1. All tests use the same event counts and have stated
// false alarm rates; they were validated on simulated recordings with truth (core/experiments/RESULTS.md) and on the
// tests of this folder.
struct HealthOptions {
  // Pixels. An event within near_px of its line, and nearer to it than half of the width of the line's cell there,
  // counts as an event of that line; events beyond gate_px are not counted. Under uniform clutter the share of near
  // events among those of a cell equals the ratio of the widths.
  double near_px = 2.0;
  double gate_px = 8.0;
  // Pixels. The standard deviation of the events about a line at the right pose, which determines the power of the
  // tests, is that of the fit within these bounds: the noise of the sensor (SensorProfile::pixel_noise_px, 0.8) with an
  // error of the pose of 0.6 px, and twice the noise, the largest spread of an estimate.
  double min_spread_px = 1.0;
  double max_spread_px = 1.6;
  // Standard deviations by which the near events must exceed chance: 1e-3 one-sided under the normal.
  double significance_sigma = 3.1;
  // Standard deviations that the near events would exceed chance by at the right pose: a test with less power does not
  // contradict a pose. The right pose then remains below significance_sigma in 3 % of the tests of a line.
  double power_sigma = 5.0;
  // Variance of event counts relative to independent events, which is above 1 because one edge passage triggers several
  // events (see events_per_information).
  double dispersion = 5.0;
  // Background events per second and pixel. An EVK4 in dim light produces 1 to 3, with sensitive biases 10. Events near
  // the lines at up to this rate, and no denser than elsewhere on the sensor, do not contradict an object at rest.
  double max_noise_hz_per_px = 10.0;
  // Share of the excess that is expected at the right pose below which the events as a whole do not support a pose,
  // however significant the excess is: uniform clutter is never exactly uniform.
  double min_excess_ratio = 0.2;
  // Gated events that a test result requires: with fewer, single events decide about a line. More would delay all
  // results.
  int min_events = 150;
  // Microseconds that a test covers at least, two windows at 1 kHz: the error of a single window does not decide.
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
  // Least time, microseconds, after which a confirmed pose without support counts as unsupported: ten poses at 1 kHz.
  // At low event rates the power of the test determines the time.
  int64_t patience_us = 10'000;
  // Microseconds from the first unsupported test result on after which a further one makes the pose LOST. At ordinary
  // event rates a loss is thereby reported within 50 ms.
  int64_t lost_after_us = 25'000;
  // Sectors of the eight of the outline that may lack their events while a pose counts as supported: an occluder that
  // hides a third of the width of a disc hides three of them.
  int max_missing_sectors = 3;
  // Contradicting test results after which a tentative pose is rejected. A smaller number may reject a right pose whose
  // depth still converges; a larger one keeps wrong poses for longer.
  int max_contradictions = 3;
  // Pixels. A pose whose projected uncertainty exceeds this is wider than the gate and cannot be distinguished from a
  // wrong one.
  double max_uncertainty_px = 12.0;

  absl::Status Validate() const;
};

// Result of a test, with the statistics that led to it.
struct HealthResult {
  enum class Kind {
    kOpen,         // too few events for a result; counting continues
    kFewEvents,    // no more events than the background rate explains, as for an object at rest
    kSupported,    // the events support the pose
    kDoubtful,     // they support a part of it: the rest is occluded, or the part belongs to another object
    kUnsupported,  // there are enough events for a test with power, and they do not support the pose
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
  int missing_sectors = 0;  // sectors of the outline with significantly less than half of the expected events
};

// Result for one straight line or curve.
struct CurveResult {
  enum class Kind : uint8_t { kOpen, kSupported, kContradicted };
  Kind kind = Kind::kOpen;
  // Of the last memory_us: the events beyond those of clutter, and LineStatistics::expected.
  double events = 0.0;
  double expected = 0.0;
};

// Events of a window near the lines, compared with those of uniform clutter and of the right pose: equation (2) of the
// README over all lines.
struct EventConcentration {
  double sigma = 0.0;  // standard deviations by which near events exceed chance
  double ratio = 0.0;  // excess divided by that of the right pose
};

// Accumulates the event counts of the lines of one hypothesis and tests them.
class TrackHealth {
 public:
  // Distance in pixels from the lines up to which AddWindow() needs the events.
  static double ReachPx(const HealthOptions& options) { return options.gate_px + 2.0; }

  TrackHealth(const HealthOptions& options, double min_events_per_px2, int num_curves);

  // Returns whether, and how strongly, the events of a window are concentrated near the lines, without adding them.
  // `lines` are the images of `input.lines` at the state of `fit`, in the same order.
  EventConcentration Concentration(const WindowInput& input, absl::Span<const ImageLine> lines, const WindowFit& fit);
  // Adds the counts of a window.
  void AddWindow(const CameraModel& camera, const WindowInput& input, absl::Span<const ImageLine> lines,
                 const WindowFit& fit);
  // Tests the counts since the last result.
  //
  //   kSupported     supported length / testable length >= sure_support_ratio, with min_supported_lines supported ones;
  //                  at most max_missing_sectors sectors of the outline lack their events
  //   kDoubtful      the same with more such sectors; or supported length / testable length >= min_support_ratio with
  //                  as many lines, and supported length / decided length < sure_support_ratio
  //   kUnsupported   supported length / decided length < min_support_ratio, or fewer than min_supported_lines supported
  //                  lines, of at least as many decided ones; or all lines together have power and no support
  //   kFewEvents     no more events than the background explains, as for an object at rest, or no other result in 1 s
  //   kOpen          too few events so far; counting continues
  //
  // A line is testable if its events have enough information, and decided if it is supported or if the right
  // pose would reach power_sigma.
  //
  // kSupported is returned as soon as the counts reach it, kDoubtful and kUnsupported only after `patience_us`, because
  // flicker and clutter dilute the events of the object. Every result but kOpen resets the counts. The ratios and the
  // number of lines are stricter for confirming a pose than for keeping one (HealthOptions).
  HealthResult Test(double min_support_ratio, double sure_support_ratio, int min_supported_lines, int64_t patience_us);

  static void VisitState(auto& archive, auto& self) {
    auto& [options, min_events_per_px2, near_probability, testable_information, spread_step, statistics, memory, span_s,
           gated, gate_px2_s, recent, was_quiet, sectors, window_sectors, window_lines, places, distance_px, cell_px,
           is_nearest, line_of, curve_results] = self;
    for (auto& line : statistics) archive(line);
    for (auto& line : memory) archive(line);
    archive(Finite(span_s), Finite(gated), Finite(gate_px2_s), recent, was_quiet);
    for (auto& sector : sectors) archive(sector);
  }

  // With more sectors each has too few events to be tested; with fewer a hidden part of the outline must be larger to
  // be noticed (README, section 1).
  static constexpr int kNumSectors = 8;

  // Result of the last Test() with a result for each curve, by TrackedLine::curve. Not part of the state.
  absl::Span<const CurveResult> curve_results() const { return curve_results_; }

 private:
  // Counts of one polarity of a window near one line, and the terms of equation (2) without weights.
  struct PolarityCounts {
    double gated = 0.0, near = 0.0, excess = 0.0, variance = 0.0, right_excess = 0.0, information = 0.0;
  };
  struct WindowLine {            // a straight line or a curve
    int curve = 0;               // TrackedLine::curve
    int lines = 1;               // LineStatistics::lines
    double places_per_px = 0.0;  // number of places of LineStatistics::along per pixel
    std::array<PolarityCounts, 2> of = {};
    Eigen::Matrix<double, 8, 1> along = Eigen::Matrix<double, 8, 1>::Zero();
  };
  struct Place {
    size_t window_line = 0;          // index into window_lines_
    double begin_px = 0.0;           // length of the elements before this one in their curve
    std::array<int, 2> sector = {};  // sectors of the first and the second half
  };
  // Events of one of the eight sectors of the outline, as seen from its centre.
  struct Sector {
    double expected = 0.0;  // lower bound of the events that the motion should have produced
    double observed = 0.0;  // events of the lines, beyond those of clutter
    double variance = 0.0;  // variance of `observed`

    bool IsMissing(const HealthOptions& options) const;
    static void VisitState(auto& archive, auto& self) {
      auto& [expected, observed, variance] = self;
      archive(Finite(expected), Finite(observed), Finite(variance));
    }
  };
  // The events of the last 20 ms or less, which show whether the object is at rest.
  struct Recent {
    double span_s = 0.0, gated = 0.0, noise = 0.0;
    static void VisitState(auto& archive, auto& self) {
      auto& [span_s, gated, noise] = self;
      archive(Finite(span_s), Finite(gated), Finite(noise));
    }
  };

  void Reset();
  // Enters the lines of the window into window_lines_ and places_, and counts its events.
  void CountWindow(const WindowInput& input, absl::Span<const ImageLine> lines, const WindowFit& fit);
  void EnterLines(const WindowInput& input, absl::Span<const ImageLine> lines);
  struct NearEvent {
    double distance_px;
    double along_px;  // along the curve
    double competing;
    double cell_px;
    uint8_t polarity;
  };
  void AddEvent(const NearEvent& event, WindowLine& line, Sector& sector);
  // For each event that lies in the gates of several lines, finds the nearest of these lines and the width of its cell.
  void FindNearest(const LineEvents& events, absl::Span<const ImageLine> lines);
  // Adds the terms of equation (2) of one polarity.
  static void AddExcess(const PolarityCounts& counts, LineStatistics& statistics);
  void AddExpectedEvents(const CameraModel& camera, const WindowInput& input, absl::Span<const ImageLine> lines,
                         const Vector6d& twist);
  HealthResult Evaluate(double min_support_ratio, double sure_support_ratio, int min_supported_lines);
  // Whether the line would be supported at the right pose: it has, or should have produced, significantly more events
  // than the background, with as much information as kTestableEvents of an isolated line.
  bool IsTestable(const LineStatistics& line) const;
  // Whether the right pose would reach power_sigma.
  bool HasPower(const LineStatistics& line, double credited_ratio) const;
  // Standard deviations by which near events would exceed chance at the right pose.
  double PowerSigma(const LineStatistics& line, double credited_ratio) const;
  // Lines without power alone may have it together: the share of the excess of the right pose that they have, which is
  // the share of them that is supported; 0 if their excess is not significant.
  double PooledShare(const LineStatistics& pooled, double credited_ratio) const;
  // Share of the line's length on which events were expected or observed.
  double PresentRatio(const LineStatistics& line, double noise) const;
  // Whether the line's motion should have produced at least `events` events and significantly more than `noise`.
  bool IsExpected(const LineStatistics& line, double noise, double events) const;
  // The share of the background events that the test accepts as an explanation (see max_noise_hz_per_px).
  double CreditedNoiseRatio() const;
  // Whether `noise` background events explain `gated` events.
  bool IsExplained(double gated, double noise) const;
  // Background events in the gates since the last test result, as far as they are accepted as an explanation.
  double Noise() const;
  // right_excess without the share of the background events, as far as these are accepted (CreditedNoiseRatio()).
  static double RightExcess(const LineStatistics& line, double credited_ratio);
  double ExcessSigma(const LineStatistics& line) const;
  int MissingSectors() const;
  // Probability that an event of a cell with this half-width is near its line at the right pose.
  double RightProbability(double cell_px) const;
  double NearPx(double cell_px) const { return std::min(options_.near_px, 0.5 * cell_px); }

  const HealthOptions options_;
  const double min_events_per_px2_;
  // RightProbability() for steps of the spread from min_spread_px to max_spread_px, 0.2 px apart, and of the cell from
  // 0 to gate_px, 0.25 px apart. More steps would give the probability more exactly; the table takes 1 kB for each
  // hypothesis.
  static constexpr int kSpreadSteps = 3;
  static constexpr int kCellSteps = 32;
  std::array<std::array<double, kCellSteps + 1>, kSpreadSteps + 1> near_probability_;
  double testable_information_ = 0.0;
  int spread_step_ = 0;                     // spread step of the window
  std::vector<LineStatistics> statistics_;  // since the last test result
  // The same from earlier test results, fading out over memory_us: the event deficit of a line becomes significant
  // only over many windows, each of which expects too few events.
  std::vector<LineStatistics> memory_;
  double span_s_ = 0.0;
  double gated_ = 0.0;
  double gate_px2_s_ = 0.0;  // area of the union of the gates times time
  Recent recent_;
  bool was_quiet_ = false;  // the last test result was kFewEvents
  std::array<Sector, kNumSectors> sectors_;
  std::array<Sector, kNumSectors> window_sectors_;  // those of the window
  std::vector<WindowLine> window_lines_;
  std::vector<Place> places_;         // place of each line of the window
  std::vector<Lanes> distance_px_;    // distances of events in several gates; infinite beyond the ends of the line
  std::vector<Lanes> cell_px_;        // for the nearest line of an event: width of its cell on the side of the event
  std::vector<LaneMask> is_nearest_;  // the line is the nearest one of the event; indexed like distance_px_
  std::vector<uint16_t> line_of_;     // index of the line, by index of the EventLanes
  std::vector<CurveResult> curve_results_;
};

}  // namespace evpose
