// SPDX-License-Identifier: Apache-2.0

// Expected distance of the events of a moving edge from the edge (core/estimation/README.md, section 3).
//
// A line that moves along its normal produces n events per square pixel that it sweeps. At a fraction h of the swept
// pixels the first of these events reverses the polarity, i.e. the previous event of the pixel had the other one. A
// reversal costs one threshold c without an event, so that the log contrast of the edge is L = (n + h) c, and the
// levels at which events occur begin h c above the start of the edge. n and h are counted for each line; c and the blur
// belong to the sensor profile (sensor_profile.h). From these edge_response.h computes the mean distance of the events
// from the edge: towards its dark side, the more the higher the contrast, and behind the motion, the more the lower it
// is. Uncorrected, a bright object appears larger and therefore nearer.
#pragma once

#include <array>
#include <vector>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "core/association/association.h"
#include "core/estimation/edge_response.h"
#include "core/estimation/sensor_profile.h"

namespace evpose {

// Events that the fit of a window attributes to one line: sums of their weights, scaled up by the downsampling.
struct EdgeCounts {
  std::array<double, 2> polarity = {};  // by polarity: OFF, ON
  // Events after one of the other polarity, on the first and on the second half of the line. An event with an unknown
  // predecessor counts one half.
  std::array<double, 2> reversals = {};

  void Add(const Observation& event, int half, double weight) {
    polarity[event.polarity] += weight;
    reversals[half] += event.ReversalProbability() * weight;
  }
};

// Rates of the events of a moving line.
struct EdgeRates {
  double events_per_px2 = 0.0;            // per square pixel of LiveAreaPx2()
  double reversals_per_px2 = 0.0;         // events after one of the other polarity, per square pixel of the swept area
  double recent_reversals_per_px2 = 0.0;  // the same over the last milliseconds
  double kappa = 0.0;                     // mean of the polarity (+-1) times the sign of the normal velocity
};

// Area in square pixels that a line sweeps while the pixels are able to respond. After each event a pixel is
// insensitive for SensorProfile::refractory_us and misses the change of light during this time; at `speed_px_per_s`
// this corresponds to a share of the width of the blurred edge. `swept_px2` is the whole area swept, `events` the
// number of events in it.
double LiveAreaPx2(const SensorProfile& sensor, double swept_px2, double events, double speed_px_per_s);

// Expected distance of the events of a line along its normal, pixels, without the part that the latency causes.
struct EdgeOffsets {
  double along_px = 0.0;    // if the line moves along its normal
  double against_px = 0.0;  // if it moves against it

  // `motion` is the sign of the normal velocity, smoothed near rest.
  double At(double motion) const { return 0.5 * ((1.0 + motion) * along_px + (1.0 - motion) * against_px); }
};
EdgeOffsets ExpectedEdgeOffsets(const SensorProfile& sensor, const EdgeRates& rates);
using HalfOffsets = std::array<EdgeOffsets, 2>;  // of the first and the second half of a line

// Estimation of the contrast of the lines, which the correction of the edge bias requires. The constants of the sensor
// are in its profile. Validated together with the constants of the profile by the position errors of `evpose bench
// tracking` (core/experiments/RESULTS.md, Tracking): without the correction the depth had a bias of 0.09 to 0.24 %. The
// choice of min_events follows from the errors of 1 % and 3 degrees that a stripe caused (core/estimation/README.md,
// section 3). edge_bias_test bounds reversal_memory_px2 from above.
struct EdgeOptions {
  // Explained events of a line before a correction is applied to it: with a step correction, the line of a stripe
  // converges to one of its sides (core/estimation/README.md, section 3).
  double min_events = 200.0;
  // Explained events over which the contrast is averaged. The contrast changes with the view and the background within
  // about a second.
  double memory_events = 5000.0;
  // Square pixels, swept by one half of a line, over which the recent rate of polarity reversals is averaged: some
  // milliseconds. The previous events of the pixels change as soon as the motion does.
  double reversal_memory_px2 = 150.0;

  absl::Status Validate() const;
};

class EdgeBias {
 public:
  EdgeBias(const EdgeOptions& options, const SensorProfile& sensor, const CameraModel& camera)
      : options_(options), sensor_(sensor), camera_(camera) {}

  // Sets the expected offsets of each line. They change with Learn() only, whereas the lines are corrected several
  // times in each window.
  void FindOffsets(absl::Span<const TrackedLine> tracked, std::vector<HalfOffsets>& offsets) const;
  // Sets ImageLine::a_expected of each line: the image line displaced to the expected position of its events. `offsets`
  // and `lines` have the same order and length.
  void Correct(absl::Span<const HalfOffsets> offsets, absl::Span<ImageLine> lines) const;
  // Updates the counts of each edge curve after a window was accepted; those of a curve with several elements are
  // summed. `counts` has one entry per line; `duration_s` is that of the window.
  void Learn(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines,
             absl::Span<const EdgeCounts> counts, double duration_s);

  static void VisitState(auto& archive, auto& self) {
    auto& [options, sensor, camera, curves] = self;
    archive(curves);
  }

 private:
  struct CurveCounts {
    double events = 0.0;           // explained events
    double swept_px2 = 0.0;        // area that the line swept while it produced them
    double live_px2 = 0.0;         // share of it by LiveAreaPx2()
    double polarity_motion = 0.0;  // sum of polarity (+-1) times the sign of the normal velocity
    double reversals = 0.0;        // events after one of the other polarity
    // Reversals and swept area of each half over the last milliseconds (EdgeOptions::reversal_memory_px2).
    std::array<double, 2> recent_reversals = {};
    std::array<double, 2> recent_swept_px2 = {};

    static void VisitState(auto& archive, auto& self) {
      auto& [events, swept_px2, live_px2, polarity_motion, reversals, recent_reversals, recent_swept_px2] = self;
      // No line reaches it: at 1e9 events per second it takes eleven days. Ratios of loaded values stay finite, so that
      // no index of a table overflows.
      constexpr double kMax = 1e15;
      bool is_empty = events == 0 && swept_px2 == 0;
      archive(is_empty);
      if (is_empty) return;
      archive(AtMost(events, kMax), AtMost(swept_px2, kMax), AtMost(live_px2, kMax),
              InRange(polarity_motion, -kMax, kMax), AtMost(reversals, kMax));
      for (int half = 0; half < 2; ++half)
        archive(AtMost(recent_reversals[half], kMax), AtMost(recent_swept_px2[half], kMax));
    }
  };
  // Adds the counts of one window. The velocity is normal to the line, the swept areas are those of its halves.
  void Add(const EdgeCounts& counts, double velocity_px_per_s, const std::array<double, 2>& swept_px2,
           CurveCounts& curve) const;
  // ExpectedEdgeOffsets() of one half of a line; 0 before EdgeOptions::min_events were counted.
  EdgeOffsets ExpectedOffsets(const CurveCounts& curve, int half) const;

  const EdgeOptions options_;
  const SensorProfile sensor_;
  const CameraModel camera_;
  std::vector<CurveCounts> curves_;  // indexed by TrackedLine::curve
};

}  // namespace evpose
