// SPDX-License-Identifier: Apache-2.0

// The probability that an event is near its line, under clutter and at the right pose, by the width of the line's cell
// at the event (core/tracking/README.md, section 1).
#pragma once

#include <array>

#include "core/tracking/evidence/health_options.h"

namespace evpose {

// The terms of equation (2) of the README that depend on the cell only.
struct CellTerms {
  double near_px = 0.0;       // an event at up to this distance is near its line
  double chance = 0.0;        // probability that an event of uniform clutter is near
  double right_excess = 0.0;  // the same probability at the right pose minus `chance`

  // Variance, under uniform clutter, of the number that is 1 if an event is near and else 0.
  double Variance() const { return chance * (1.0 - chance); }
  // Information of an event of this cell: (p - c)^2 / (c (1 - c)) of the README, section 1.
  double Information() const { return right_excess * right_excess / Variance(); }
};

// Depends on the options only, so that all hypotheses of an object share it: the table takes about 0.1 ms to compute.
class NearProbability {
 public:
  explicit NearProbability(const HealthOptions& options);

  // Number of steps of the spread from HealthOptions::min_spread_px to max_spread_px, 0.2 px apart.
  static constexpr int kSpreadSteps = 3;
  // Returns the step of a spread, from 0 to kSpreadSteps.
  int SpreadStepOf(double spread_px) const;
  // Returns the terms of a cell of this half-width for events with the spread of a step.
  CellTerms Of(double half_cell_px, int spread_step) const;

 private:
  // Number of steps of the half-width of the cell from 0 to gate_px, 0.25 px apart. More steps would give the
  // probability more exactly.
  static constexpr int kCellSteps = 32;

  double NearPx(double half_cell_px) const;

  const double near_px_, gate_px_, min_spread_px_, max_spread_px_;
  std::array<std::array<double, kCellSteps + 1>, kSpreadSteps + 1> at_right_pose_;
};

}  // namespace evpose
