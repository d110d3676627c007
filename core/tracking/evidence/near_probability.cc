// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/near_probability.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/numerics/math.h"

namespace evpose {
namespace {

// Probability that an event is within `near_px` of its nearest line, README, equation (1): events are normal about
// lines at the distance 2 half_cell_px. The distance from the nearest line has a wrapped normal distribution, which is
// integrated by its Fourier series.
double ProbabilityAtRightPose(double near_px, double half_cell_px, double spread_px) {
  constexpr int kTerms = 16;  // the next one is below 1e-9 for cells of up to eight spreads
  constexpr double kPi = std::numbers::pi;
  const double exponent = 0.5 * kPi * kPi * spread_px * spread_px / (half_cell_px * half_cell_px);
  double probability = near_px / half_cell_px;
  for (int m = 1; m <= kTerms; ++m) {
    const double amplitude = DeterministicExp(-exponent * m * m);
    probability += 2.0 / (kPi * m) * amplitude * DeterministicSinCos(kPi * m * near_px / half_cell_px).sin;
  }
  return probability;
}

}  // namespace

NearProbability::NearProbability(const HealthOptions& options)
    : near_px_(options.near_px),
      gate_px_(options.gate_px),
      min_spread_px_(options.min_spread_px),
      max_spread_px_(options.max_spread_px) {
  for (int step = 0; step <= kSpreadSteps; ++step) {
    const double spread_px = min_spread_px_ + (max_spread_px_ - min_spread_px_) * step / kSpreadSteps;
    at_right_pose_[step][0] = 0.5;  // the limit for a cell that is much narrower than the spread
    for (int i = 1; i <= kCellSteps; ++i) {
      const double half_cell_px = gate_px_ * i / kCellSteps;
      at_right_pose_[step][i] = ProbabilityAtRightPose(NearPx(half_cell_px), half_cell_px, spread_px);
    }
  }
}

double NearProbability::NearPx(double half_cell_px) const { return std::min(near_px_, 0.5 * half_cell_px); }

int NearProbability::SpreadStepOf(double spread_px) const {
  const double range_px = std::max(1e-6, max_spread_px_ - min_spread_px_);
  const double beyond = std::clamp((spread_px - min_spread_px_) / range_px, 0.0, 1.0);
  return static_cast<int>(std::ceil(beyond * kSpreadSteps));
}

CellTerms NearProbability::Of(double half_cell_px, int spread_step) const {
  constexpr double kLeastHalfCellPx = 1e-3;  // width of the cell of an event on two lines at the same place
  half_cell_px = std::max(half_cell_px, kLeastHalfCellPx);
  CellTerms terms;
  terms.near_px = NearPx(half_cell_px);
  terms.chance = terms.near_px / half_cell_px;
  const int step = std::clamp(RoundNonNegative(half_cell_px / gate_px_ * kCellSteps), 0, kCellSteps);
  terms.right_excess = at_right_pose_[spread_step][step] - terms.chance;
  return terms;
}

}  // namespace evpose
