// SPDX-License-Identifier: Apache-2.0

// Whether the events speak for the pose (core/tracking/README.md, section 1). Counts of events near the lines, against
// what clutter would give.
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

// Track health (core/tracking/README.md, section 1): tests with stated false alarm rates, all on the same count of
// events.
struct HealthOptions {
  // Pixels: events this near to their line count as its own, of those within gate_px of it. Where nothing is, the share
  // of the near ones is that of the areas.
  double near_px = 2.0;
  double gate_px = 8.0;
  // Standard deviations by which the near events must exceed chance: 1e-3 one-sided under the normal.
  double significance_sigma = 3.1;
  // Variance of counts relative to independent events: they come in groups (see events_per_information).
  double dispersion = 5.0;
  // Events per second and pixel of background in which a moving object may come to rest: an EVK4 in dim light makes 1
  // to 3, with sensitive biases 10. Up to so many, and no denser than elsewhere on the sensor, the events near the
  // lines say nothing against a still object.
  double max_noise_hz_per_px = 10.0;
  // Events in the gate that a verdict needs.
  int min_events = 150;
  // Microseconds: a verdict is taken over at least this much.
  int64_t min_span_us = 2000;
  // Share of the testable length of lines that must be supported: a wrong pose can be fitted to about three lines'
  // worth of clutter (6 unknowns, 2 per line); a right one has nearly all, less what is hidden.
  double confirm_support_ratio = 0.6;
  double keep_support_ratio = 0.35;
  // Microseconds over which the evidence of a line that is short or slow is summed.
  int64_t memory_us = 100'000;
  // Share of the visible lines' length that must have had the time to answer before the first verdict for a pose is
  // believed, and until when a pose stays on trial: part of an object may be all of another one.
  double min_tested_ratio = 0.9;
  // Microseconds that the first verdict is held back for it, at most: a line along its motion never answers.
  int64_t max_hold_us = 15'000;
  // Microseconds after which a tracked pose that the events have not supported counts as unsupported: ten poses at 1
  // kHz.
  int64_t patience_us = 10'000;
  // Microseconds of plentiful but unexplained events, from the first such verdict on, after which the pose is LOST.
  // With the patience before it, a lost object is known as such within 50 ms.
  int64_t lost_after_us = 25'000;
  // Verdicts with plenty of events that a first pose gets.
  int max_unconfirmed_verdicts = 3;
  // Pixels: a pose that is less certain than the gate is wide cannot be told from a wrong one.
  double max_uncertainty_px = 12.0;

  absl::Status Validate() const;
};

// What the windows since the last verdict say of one model line.
struct LineEvidence {
  double gated = 0.0;  // events within gate_px of it, nearest to it
  // Of them those within near_px, less their number times the near share of the gate's area, and the variance of that
  // by chance. Each window's events of each polarity weigh the less the more are not near: while a lamp grows brighter
  // its ON events are everywhere, and what the OFF events say is not to drown in them.
  double excess = 0.0;
  double variance = 0.0;
  double noise = 0.0;     // of the gated, those that come anywhere on the sensor
  double expected = 0.0;  // events that its motion should have made at the least
  // Of the gated ones, by their place along it: a line's own come all along it, those of what crosses it at one place.
  Eigen::Matrix<double, 8, 1> along = Eigen::Matrix<double, 8, 1>::Zero();
  double length_px = 0.0;  // mean projected length, weighted by time

  void Add(const LineEvidence& other);
  void Fade(double factor);

  // Of most lines of a large model there is nothing to be kept.
  static void VisitState(auto& archive, auto& self) {
    auto& [gated, excess, variance, noise, expected, along, length_px] = self;
    bool is_empty = gated == 0 && excess == 0 && variance == 0 && noise == 0 && expected == 0 && length_px == 0;
    archive(is_empty);
    if (is_empty) return;
    archive(Finite(gated), Finite(excess), Finite(variance), Finite(noise), Finite(expected), Finite(along),
            Finite(length_px));
  }
};

struct HealthVerdict {
  enum class Kind {
    kOpen,         // too little was seen yet
    kFewEvents,    // nothing but what the sensor's noise makes: a still object looks like that
    kSupported,    // the events speak for the pose
    kDoubtful,     // they speak for a part of it, as when the rest is hidden, or when that part is somebody else's
    kUnsupported,  // there are events, and they do not
  };
  Kind kind = Kind::kOpen;
  double sigma = 0.0;  // standard deviations by which near events exceed chance
  // Share of the visible lines' length that should have answered since the last verdict, or has other events near it.
  double present_ratio = 0.0;
  double testable_ratio = 0.0;  // the same, with what is remembered of the time before
  double support_ratio = 0.0;   // share of the testable lines' length that is supported
  int supported_lines = 0;
  int testable_lines = 0;
};

class TrackHealth {
 public:
  // Pixels about the lines from which it wants events.
  static double ReachPx(const HealthOptions& options) { return options.gate_px + 2.0; }

  TrackHealth(const HealthOptions& options, double min_events_per_px2, int num_model_lines);

  // `lines` are those of `input`, as the fit left them; `twist` is the fit's.
  void AddWindow(const CameraModel& camera, const WindowInput& input, absl::Span<const ImageLine> lines,
                 const Vector6d& twist);
  // A pose is supported when the share of its lines' length that is supported reaches `sure_support_ratio`, and in
  // doubt from `min_support_ratio` on; with the least number of supported lines these make the difference between
  // taking up a pose and keeping it. It is supported as soon as the counts say so, and in doubt or unsupported when
  // they still do not after `patience_us`: in flicker or clutter its own events are few among many. Anything but kOpen
  // starts the counts anew.
  HealthVerdict Judge(double min_support_ratio, double sure_support_ratio, int min_supported_lines,
                      int64_t patience_us);

  static void VisitState(auto& archive, auto& self) {
    auto& [options, min_events_per_px2, evidence, memory, span_s, gated, gate_px2_s, was_quiet, window_lines,
           distance_px, is_nearest] = self;
    for (auto& line : evidence) archive(line);
    for (auto& line : memory) archive(line);
    archive(Finite(span_s), Finite(gated), Finite(gate_px2_s), was_quiet);
  }

 private:
  void Reset();
  void AddEvents(const LineEvents& events, absl::Span<const ImageLine> lines);
  // Of the shared groups, which events are nearest to their line, of those whose gates they are in.
  void FindNearest(const LineEvents& events, absl::Span<const ImageLine> lines);
  HealthVerdict Weigh(double min_support_ratio, double sure_support_ratio, int min_supported_lines) const;
  bool IsSupported(const LineEvidence& line) const;
  // Whether a line of the right pose would be supported: it has, or should have made, enough beyond the background.
  bool IsTestable(const LineEvidence& line) const;
  // Share of its length that it should have answered on, from its own events or from what else is there.
  double PresentRatio(const LineEvidence& line, double noise) const;
  // Whether its motion should have made enough events to tell them from `noise`.
  bool IsExpected(const LineEvidence& line, double noise) const;
  // The share of the background noise that a verdict reckons with.
  double CreditedNoiseRatio() const;
  bool IsQuiet() const;
  void AddExcess(double gated, double near, LineEvidence& evidence) const;
  double ExcessSigma(const LineEvidence& line) const;

  const HealthOptions options_;
  const double min_events_per_px2_;
  std::vector<LineEvidence> evidence_;  // since the last verdict
  // The same, fading over memory_us: a line that never answers is told by what it should have made in many windows,
  // each of which alone expects too little of it.
  std::vector<LineEvidence> memory_;
  double span_s_ = 0.0;
  double gated_ = 0.0;
  double gate_px2_s_ = 0.0;  // area of the gates times time
  bool was_quiet_ = false;   // the last verdict was kFewEvents
  struct WindowLine {
    LineEvidence* evidence;
    double places_per_px;                               // of LineEvidence::along
    std::array<double, 2> gated_of = {}, near_of = {};  // by polarity
  };
  void AddEvent(double distance_px, double along_px, double competing, uint8_t polarity, WindowLine& line);
  std::vector<WindowLine> window_lines_;
  std::vector<Lanes> distance_px_;    // of the shared groups; infinite beyond the gates
  std::vector<LaneMask> is_nearest_;  // likewise
};

}  // namespace evpose
