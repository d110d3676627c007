// SPDX-License-Identifier: Apache-2.0

// Dispersion of the events about their lines: the number of events that carry the information of one independent event
// (core/estimation/README.md, section 7). Events of one pixel and edge share an error. If an edge passes a pixel within
// one window and the edge bias is corrected, this error is small. If it takes many windows, as at low speed, or if the
// thresholds of the pixels differ, the mean distance of the events of a line persists from window to window, and their
// number overstates their information.
#pragma once

#include <cstddef>
#include <vector>

#include "core/base/state_io.h"

namespace evpose {

class EventDispersion {
 public:
  // Adds the events of one edge curve in an accepted window: the weighted sum of their distances (px), its variance
  // under independent events and the displacement of the window (px^2), and the sum of the weights.
  void Add(int curve, double sum_px, double variance_px2, double weight);

  // The factor, in [1, kMaxFactor], by which the variance of the sums exceeds that of independent events.
  double factor() const;

  // A larger dispersion is that of a wrong association, for which no covariance is right.
  static constexpr double kMaxFactor = 10.0;

  static void VisitState(auto& archive, auto& self) {
    auto& [blocks, mean] = self;
    archive(blocks, InRange(mean, 0.0, kMaxSquare));
  }

 private:
  // Bound of one squared sum in units of its variance: five standard deviations.
  static constexpr double kMaxSquare = 25.0;
  // Sums over successive windows.
  struct Block {
    double sum_px = 0.0, variance_px2 = 0.0, weight = 0.0;
    static void VisitState(auto& archive, auto& self) {
      auto& [sum_px, variance_px2, weight] = self;
      // Far above the sums of a block, which ends at kBlockWeight; ratios of loaded sums stay finite.
      constexpr double kMax = 1e9;
      archive(InRange(sum_px, -kMax, kMax), InRange(variance_px2, 0.0, kMax), InRange(weight, 0.0, kMax));
    }
  };
  std::vector<Block> blocks_;  // indexed by TrackedLine::curve
  double mean_ = 1.0;          // running mean of the squared sums, in units of their variance
};

}  // namespace evpose
