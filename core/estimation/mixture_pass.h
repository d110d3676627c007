// SPDX-License-Identifier: Apache-2.0

// The expectation step of the mixture (core/estimation/README.md, section 1): whose the events of a window are, by
// where the lines are now.
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

// What a pass over the events leaves of one line.
struct MixtureLine {
  LineSums sums;
  std::array<ByPolarity, 2> half_weight = {};  // explained observations of its first and its second half
  std::array<ByPolarity, 2> half_turns = {};   // of them, EdgeCounts::turns
  std::array<ByPolarity, 2> beside = {};       // LineCounts::beside
  double ambiguous_px2 = 0.0;                  // sum of w (1 - w) d^2
  // What the events tell of where the line is, as a share of what they would, were it known which are the line's: the
  // missing information principle (Louis, "Finding the observed information matrix when using the EM algorithm", 1982).
  double ObservedRatio(double sigma_px) const;
  ByPolarity weight() const { return {half_weight[0][0] + half_weight[1][0], half_weight[0][1] + half_weight[1][1]}; }
  // As many events as each observation stands for.
  EdgeCounts Counts(const ByPolarity& events_per_observation) const;
};

struct MixtureTotals {
  double num_gated = 0.0;
  double weight = 0.0;
  double weighted_squares_px2 = 0.0;
};

// Keeps its memory for the next pass.
class MixturePass {
 public:
  // Shares every event between its two nearest lines, other objects and the clutter beside the nearest line (one entry
  // of `densities` for each line), and sums by line. `sums` has one entry per image line and is overwritten.
  MixtureTotals Accumulate(const LineEvents& events, absl::Span<const ImageLine> lines, const MixtureDensity& density,
                           absl::Span<const LineDensities> densities, std::vector<MixtureLine>& sums);

 private:
  // Of events near a line, side by side: what their likelihoods are made of.
  struct Terms {
    Lanes distance_px;
    Lanes along_px;
    LaneMask is_gated;
    Lanes likelihood;  // as one of the line's
    Lanes outlier;     // as clutter beside it
  };
  class GroupTerms;
  struct GroupSums;
  void ShareEvents(const LineEvents& events, const MixtureDensity& density);

  // Of the shared groups, by the number of their lanes.
  std::vector<Terms> terms_;
  std::vector<Lanes> inverse_;        // one over the sum of the event's likelihoods
  std::vector<LaneMask> is_nearest_;  // of the event's lines
};

}  // namespace evpose
