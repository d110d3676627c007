// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/near_probability.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

namespace evpose {
namespace {

// Share of a normal distribution about 0 within +-near_px.
double NormalShare(double near_px, double spread_px) { return std::erf(near_px / (spread_px * std::sqrt(2.0))); }

TEST(NearProbabilityTest, TheWidestCellHasTheProbabilityOfANormalDistribution) {
  const HealthOptions options;
  const NearProbability probability(options);
  for (const double spread_px : {options.min_spread_px, options.max_spread_px}) {
    const CellTerms terms = probability.Of(options.gate_px, probability.SpreadStepOf(spread_px));
    EXPECT_EQ(terms.near_px, options.near_px);
    EXPECT_EQ(terms.chance, options.near_px / options.gate_px);
    EXPECT_NEAR(terms.chance + terms.right_excess, NormalShare(options.near_px, spread_px), 1e-4) << spread_px;
  }
}

// Events of the next line, at the distance of the width of the cell, are in the cell, too.
TEST(NearProbabilityTest, AnEventInANarrowCellShowsLittle) {
  const HealthOptions options;
  const NearProbability probability(options);
  const int step = probability.SpreadStepOf(options.min_spread_px);
  double last = probability.Of(options.gate_px, step).right_excess;
  for (const double half_cell_px : {4.0, 2.0, 1.0, 0.5}) {
    const CellTerms terms = probability.Of(half_cell_px, step);
    EXPECT_EQ(terms.near_px, std::min(options.near_px, 0.5 * half_cell_px));
    EXPECT_EQ(terms.chance, 0.5);
    EXPECT_LT(terms.right_excess, last) << half_cell_px;
    last = terms.right_excess;
  }
  EXPECT_NEAR(last, 0.0, 1e-3);
  const CellTerms none = probability.Of(0.0, step);
  EXPECT_EQ(none.chance, 0.5);
  EXPECT_EQ(none.right_excess, 0.0);
}

TEST(NearProbabilityTest, TheSpreadIsRoundedUp) {
  const HealthOptions options;
  const NearProbability probability(options);
  EXPECT_EQ(probability.SpreadStepOf(0.5 * options.min_spread_px), 0);
  EXPECT_EQ(probability.SpreadStepOf(options.min_spread_px + 0.01), 1);
  EXPECT_EQ(probability.SpreadStepOf(2.0 * options.max_spread_px), NearProbability::kSpreadSteps);
}

}  // namespace
}  // namespace evpose
