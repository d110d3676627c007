// SPDX-License-Identifier: Apache-2.0

// Tests whether the events support a pose (core/tracking/README.md, section 1). The test statistic is the number of
// events near the projected lines minus the number that uniform clutter would put there.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/association/association.h"
#include "core/estimation/estimator.h"
#include "core/tracking/evidence/health_options.h"
#include "core/tracking/evidence/line_contrast.h"
#include "core/tracking/evidence/line_statistics.h"
#include "core/tracking/evidence/near_probability.h"

namespace evpose {

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
  enum class Kind : uint8_t {
    kOpen,          // not testable
    kPooled,        // testable, and decided only together with the other pooled curves
    kSupported,     // its own events support it
    kContradicted,  // its own test has power and no support
  };
  Kind kind = Kind::kOpen;
  // The events of the last memory_us beyond those of clutter, and LineStatistics::expected of the same time.
  double events = 0.0;
  double expected = 0.0;
  double support_ratio = 0.0;  // share that is supported: 1 for kSupported; for kPooled that of the pooled test
};

// Events of a window near the lines, compared with those of uniform clutter and of the right pose: equation (2) of the
// README over all lines.
struct EventConcentration {
  double sigma = 0.0;  // standard deviations by which near events exceed chance
  double ratio = 0.0;  // excess divided by that of the right pose
};

// The thresholds of a test. They are stricter for confirming a pose than for keeping one (HealthOptions).
struct TestThresholds {
  double keep_support_ratio = 0.0;   // share of the testable length; a pose with less support is contradicted
  int min_lines = 0;                 // supported lines
  int64_t min_contradiction_us = 0;  // counts of a shorter time do not contradict a pose
};

// Accumulates the event counts of the lines of one hypothesis and tests them.
class TrackHealth {
 public:
  // Distance in pixels from the predicted lines up to which AddWindow() needs the events: the gates, and 2 px by which
  // the fit may move the lines.
  static double ReachPx(const HealthOptions& options) { return options.gate_px + 2.0; }

  // `near_probability` must be that of the options and outlive this object.
  TrackHealth(const HealthOptions& options, const NearProbability& near_probability, double min_events_per_px2,
              int num_curves);

  // Returns whether, and how strongly, the events of a window are concentrated near the lines, without adding them.
  // `lines` are the images of `input.lines` at the state of `fit`, in the same order.
  EventConcentration Concentration(const WindowInput& input, absl::Span<const ImageLine> lines, const WindowFit& fit);
  // Adds the counts of a window.
  void AddWindow(const CameraModel& camera, const WindowInput& input, absl::Span<const ImageLine> lines,
                 const WindowFit& fit);
  // Tests the counts since the last result (core/tracking/README.md, section 1, has the conditions of each result).
  //
  // kSupported is returned as soon as the counts reach it, kDoubtful and kUnsupported only after
  // `min_contradiction_us`, because flicker and clutter dilute the events of the object. Every result but kOpen resets
  // the counts.
  HealthResult Test(const TestThresholds& thresholds);

  static void VisitState(auto& archive, auto& self) {
    auto& [options, near_probability, min_events_per_px2, testable_information, statistics, memory, span_s, gated,
           gate_px2_s, contrast, recent, had_few_events, sectors, window_sectors, window_lines, places, distance_px,
           half_cell_px, is_nearest, line_of, curve_results] = self;
    for (auto& line : statistics) archive(line);
    for (auto& line : memory) archive(line);
    archive(Finite(span_s), Finite(gated), Finite(gate_px2_s), contrast, recent, had_few_events);
    for (auto& sector : sectors) archive(sector);
  }

  // Result of the last Test() with a result for each curve, by TrackedLine::curve. Not part of the state.
  absl::Span<const CurveResult> curve_results() const { return curve_results_; }

 private:
  // Counts of one polarity of a window near one line, and the terms of equation (2) without weights.
  struct PolarityCounts {
    double gated = 0.0, near = 0.0, excess = 0.0, variance = 0.0, right_excess = 0.0, information = 0.0;

    void Add(double new_gated, double new_near, const CellTerms& cell);
  };
  struct WindowLine {          // a straight line or a curve
    int curve = 0;             // TrackedLine::curve
    int lines = 1;             // LineStatistics::lines
    double bins_per_px = 0.0;  // bins of LineStatistics::along per pixel
    std::array<PolarityCounts, 2> by_polarity = {};
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
    // Adds `gated` events that have this cell; `near` of them are near their line.
    void Add(double gated, double near, const CellTerms& cell);
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

  // Sums over the curves of a test; lengths in pixels times seconds.
  struct CurveSums {
    LineStatistics total, pooled;
    double present_length = 0.0, testable_length = 0.0, supported_length = 0.0, contradicting_length = 0.0;
    double pooled_length = 0.0, displaced_length = 0.0;
    int testable_lines = 0, supported_lines = 0, decided_lines = 0, pooled_lines = 0;
  };

  void Reset();
  // Enters the lines of the window into window_lines_ and places_, and counts its events.
  void CountWindow(const WindowInput& input, absl::Span<const ImageLine> lines, const WindowFit& fit);
  void EnterLines(const WindowInput& input, absl::Span<const ImageLine> lines);
  struct NearEvent {
    double distance_px;
    double along_px;  // along the curve
    double others_per_px;
    uint8_t polarity;
  };
  void AddEvent(const NearEvent& event, const CellTerms& cell, WindowLine& line, Sector& sector);
  // Adds the events of a group that have one candidate line, in a window without events of other objects. The cell of
  // each of these events is the whole gate.
  void AddOwnEvents(const LineGroup& group, const GroupLine& line, const Place& place, const CellTerms& cell);
  // For each event that lies in the gates of several lines, finds the nearest of these lines and the width of its cell.
  void FindNearest(const LineEvents& events, absl::Span<const ImageLine> lines);
  // Adds the terms of equation (2) of one polarity.
  static void AddExcess(const PolarityCounts& counts, LineStatistics& statistics);
  void AddExpectedEvents(const CameraModel& camera, const WindowInput& input, absl::Span<const ImageLine> lines,
                         const Vector6d& twist);
  // Tests a curve, and adds it to the sums.
  void AddCurve(size_t k, double accepted_noise_ratio, CurveSums& sums);
  HealthResult Evaluate(const TestThresholds& thresholds);
  // Whether the line would be supported at the right pose: it has, or should have produced, significantly more events
  // than the background, with as much information as kTestableEvents of an isolated line.
  bool IsTestable(const LineStatistics& line) const;
  // Whether the right pose would reach power_sigma.
  bool HasPower(const LineStatistics& line, double accepted_noise_ratio) const;
  // Standard deviations by which near events would exceed chance at the right pose.
  double PowerSigma(const LineStatistics& line, double accepted_noise_ratio) const;
  // `pooled` is the sum over the lines whose own tests have no power. Returns the supported share of their length:
  // their excess divided by the excess that is expected at the right pose, at most 1; 0 if it is not significant.
  double PooledShare(const LineStatistics& pooled, double accepted_noise_ratio) const;
  // Share of the line's length on which events were expected or observed.
  double PresentRatio(const LineStatistics& line, double noise) const;
  // Share of the bins of LineStatistics::along with at least their part of `noise` and of kTestableEvents events.
  static double PresentBins(const LineStatistics& line, double noise);
  // Whether the present counts and those of about the last memory_us, along most of a curve, give its test power and do
  // not support it.
  bool IsDisplaced(size_t curve, double accepted_noise_ratio) const;
  // Whether the line's motion should have produced at least `events` events and significantly more than `noise`.
  bool IsExpected(const LineStatistics& line, double noise, double events) const;
  // The share of the background events that the test accepts as an explanation (see max_noise_hz_per_px).
  double AcceptedNoiseRatio() const;
  // Whether `noise` background events explain `gated` events.
  bool IsExplained(double gated, double noise) const;
  // Whether the events are spread about the lines and lie beside them, as those of edges that the estimate follows in
  // part.
  bool IsAttractedByClutter() const {
    return contrast_.SpreadPx() > options_.wide_spread_px && contrast_.Ratio() < options_.min_contrast;
  }
  // Background events in the gates since the last test result, as far as they are accepted as an explanation.
  double Noise() const;
  // right_excess without the share of the background events, as far as these are accepted (AcceptedNoiseRatio()).
  static double RightExcess(const LineStatistics& line, double accepted_noise_ratio);
  double ExcessSigma(const LineStatistics& line) const;
  int MissingSectors() const;

  const HealthOptions options_;
  const NearProbability& near_probability_;
  const double min_events_per_px2_;
  double testable_information_ = 0.0;
  std::vector<LineStatistics> statistics_;  // since the last test result
  // The same from earlier test results, fading out over memory_us: the event deficit of a line becomes significant
  // only over many windows, each of which expects too few events.
  std::vector<LineStatistics> memory_;
  double span_s_ = 0.0;
  double gated_ = 0.0;
  double gate_px2_s_ = 0.0;  // area of the union of the gates times time
  LineContrast contrast_;
  Recent recent_;
  bool had_few_events_ = false;  // the last test result was kFewEvents
  std::array<Sector, kNumOutlineSectors> sectors_;
  std::array<Sector, kNumOutlineSectors> window_sectors_;  // those of the window
  std::vector<WindowLine> window_lines_;
  std::vector<Place> places_;         // place of each line of the window
  std::vector<Lanes> distance_px_;    // distances of events in several gates; infinite beyond the ends of the line
  std::vector<Lanes> half_cell_px_;   // for the nearest line of an event: half-width of its cell
  std::vector<LaneMask> is_nearest_;  // the line is the nearest one of the event; indexed like distance_px_
  std::vector<uint16_t> line_of_;     // index of the line, by index of the EventLanes
  std::vector<CurveResult> curve_results_;
};

}  // namespace evpose
