// SPDX-License-Identifier: Apache-2.0

// The expectation step of the mixture (core/estimation/README.md, equations (3) and (5)): assigns the events of a
// window to the lines at their present positions.
#pragma once

#include <array>
#include <vector>

#include "absl/types/span.h"
#include "core/association/line_events.h"
#include "core/estimation/edge_bias.h"
#include "core/estimation/line_clutter.h"
#include "core/estimation/line_sums.h"
#include "core/numerics/robust.h"

namespace evpose {

// Result of a pass over the events for one line.
struct MixtureLine {
  LineSums sums;
  // Weights of the observations on the first and the second half, by polarity.
  std::array<ByPolarity, 2> half_weight = {};
  // The same for those observations that follow an event of the other polarity at their pixel (EdgeCounts::reversals).
  std::array<ByPolarity, 2> half_reversals = {};
  std::array<ByPolarity, 2> beside = {};  // clutter by side and polarity (LineCounts::beside)
  double ambiguous_px2 = 0.0;             // sum of w (1 - w) d^2, for ObservedRatio()
  // Observed information about the position of the line divided by the complete one, in [0.1, 1]: the missing
  // information principle (Louis, "Finding the observed information matrix when using the EM algorithm", 1982).
  // `sigma_px` is the standard deviation of the events about the line.
  double ObservedRatio(double sigma_px) const { return ObservedRatio(ambiguous_px2, sums.weight(), sigma_px); }
  // The same for the sums of several elements.
  static double ObservedRatio(double ambiguous_px2, double weight, double sigma_px);
  ByPolarity weight() const { return {half_weight[0][0] + half_weight[1][0], half_weight[0][1] + half_weight[1][1]}; }
  // Counts for edge_bias.h. `events_per_observation` is the downsampling factor of each polarity.
  EdgeCounts Counts(const ByPolarity& events_per_observation) const;
};

// Sums over all lines of a pass.
struct MixtureTotals {
  double num_gated = 0.0;             // observations in a gate, without the share of other objects
  double weight = 0.0;                // sum of the weights of all lines
  double weighted_squares_px2 = 0.0;  // sum of weight times squared distance
};

// Performs passes over the events; the memory is kept for the next pass.
class MixturePass {
 public:
  // Computes the weights of every event for its two nearest lines, for other objects (Observation::others_per_px) and
  // for the clutter beside the nearest line, and sums by line. `densities` has one entry per line of `lines`; `sums`
  // likewise, and is overwritten. Returns the sums over all lines.
  MixtureTotals Accumulate(const LineEvents& events, absl::Span<const ImageLine> lines, const MixtureDensity& density,
                           absl::Span<const LineDensities> densities, std::vector<MixtureLine>& sums);

 private:
  // Terms of the likelihoods of several events near one line, one event per lane.
  struct Terms {
    Lanes distance_px;
    Lanes along_px;
    LaneMask is_gated;
    Lanes likelihood;  // density of the line at the event
    Lanes outlier;     // density of the clutter on this side of the line
  };
  class GroupTerms;
  struct GroupSums;
  void ShareEvents(const LineEvents& events, const MixtureDensity& density);

  // Terms of the groups with shared events, one entry per vector of events; a group begins at LineGroup::first.
  std::vector<Terms> terms_;
  std::vector<Lanes> inverse_;        // reciprocal of the sum of the likelihoods of the event
  std::vector<LaneMask> is_nearest_;  // the line is the nearest one of the event
};

}  // namespace evpose
