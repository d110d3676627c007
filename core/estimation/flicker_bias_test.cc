// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/flicker_bias.h"

#include <gtest/gtest.h>

#include <cmath>
#include <utility>

namespace evpose {
namespace {

constexpr double kGatePx = 3.0;
constexpr double kSpreadPx = 0.8;
constexpr double kStripPx = (1.0 - LineCounts::kLateralRatio) * kGatePx;
constexpr ByPolarity kAllKept = {1.0, 1.0};

// An edge beside a flickering surface. Each OFF event of the surface suppresses one ON event of the edge. The number
// and the mean position of the remaining ON events are integrated numerically across the edge.
struct Scene {
  double edge_events = 0.0;    // ON events of the edge
  ByPolarity off_per_px = {};  // OFF events per px at negative and at positive distances

  LineCounts counts;
  double mean_px = 0.0;  // mean distance of the remaining ON events from the edge

  Scene(double edge, ByPolarity off) : edge_events(edge), off_per_px(off) {
    constexpr double kStepPx = 1e-3;
    double moment = 0.0;
    for (double x = -6.0 * kSpreadPx; x < 6.0 * kSpreadPx; x += kStepPx) {
      const double z = x / kSpreadPx;
      const double density = edge_events / (kSpreadPx * std::sqrt(2.0 * M_PI)) * std::exp(-0.5 * z * z);
      const double remaining = std::max(0.0, density - off_per_px[x > 0.0 ? 1 : 0]) * kStepPx;
      counts.own[1] += remaining;
      moment += x * remaining;
    }
    for (int side = 0; side < 2; ++side) counts.beside[side][0] = off_per_px[side] * kStripPx;
    mean_px = moment / counts.own[1];
  }
  double ShiftPx() const { return FlickerBiasPx(counts, kAllKept, kGatePx, kSpreadPx); }
};

TEST(FlickerBiasTest, EqualsTheMeanOfTheRemainingEvents) {
  for (const double off_per_px : {2.0, 10.0, 30.0, 44.0}) {
    const Scene above(100.0, {0.0, off_per_px});
    EXPECT_LT(above.mean_px, 0.0);
    EXPECT_NEAR(above.ShiftPx(), above.mean_px, 2e-3) << off_per_px;
    const Scene below(100.0, {off_per_px, 0.0});
    EXPECT_NEAR(below.ShiftPx(), below.mean_px, 2e-3) << off_per_px;
  }
}

TEST(FlickerBiasTest, FlickerOnBothSidesPartlyCancels) {
  const Scene scene(100.0, {5.0, 20.0});
  EXPECT_LT(scene.mean_px, -0.01);
  EXPECT_NEAR(scene.ShiftPx(), scene.mean_px, 0.1 * std::abs(scene.mean_px));
  EXPECT_EQ(Scene(100.0, {20.0, 20.0}).ShiftPx(), 0.0);
}

TEST(FlickerBiasTest, IsZeroWithoutFlickerAndForNoiseOfBothPolarities) {
  EXPECT_EQ(Scene(100.0, {0.0, 0.0}).ShiftPx(), 0.0);
  EXPECT_EQ(FlickerBiasPx({}, kAllKept, kGatePx, kSpreadPx), 0.0);
  Scene scene(100.0, {0.0, 0.0});
  scene.counts.beside[1] = {12.0, 12.0};
  EXPECT_EQ(scene.ShiftPx(), 0.0);
}

TEST(FlickerBiasTest, FlickerOfTheSamePolarityHasNoEffect) {
  Scene scene(100.0, {0.0, 0.0});
  scene.counts.beside[1] = {0.0, 30.0};
  EXPECT_EQ(scene.ShiftPx(), 0.0);
}

TEST(FlickerBiasTest, IsSymmetricInPolarity) {
  const Scene on(100.0, {0.0, 20.0});
  LineCounts off = on.counts;
  std::swap(off.own[0], off.own[1]);
  for (ByPolarity& side : off.beside) std::swap(side[0], side[1]);
  EXPECT_EQ(FlickerBiasPx(off, kAllKept, kGatePx, kSpreadPx), on.ShiftPx());
}

TEST(FlickerBiasTest, AccountsForDownsampling) {
  const Scene scene(100.0, {0.0, 20.0});
  LineCounts kept = scene.counts;
  for (double* off : {&kept.own[0], &kept.beside[0][0], &kept.beside[1][0]}) *off /= 8.0;
  for (double* on : {&kept.own[1], &kept.beside[0][1], &kept.beside[1][1]}) *on /= 2.0;
  EXPECT_NEAR(FlickerBiasPx(kept, {8.0, 2.0}, kGatePx, kSpreadPx), scene.ShiftPx(), 1e-12);
}

TEST(FlickerBiasTest, AffectsOnePolarityOfAStripe) {
  // OFF events of the flicker do not remove OFF events of the stripe.
  Scene stripe(100.0, {0.0, 20.0});
  const double on_px = stripe.ShiftPx();
  stripe.counts.own[0] = stripe.counts.own[1];
  EXPECT_NEAR(stripe.ShiftPx(), 0.5 * on_px, 1e-12);
}

TEST(FlickerBiasTest, GrowsWithTheRatioUpToABound) {
  const FlickerBias& bias = FlickerBias::Get();
  EXPECT_EQ(bias.Away(0.0), 0.0);
  EXPECT_EQ(bias.Away(-1.0), 0.0);
  for (double ratio = 0.01; ratio <= 0.7; ratio += 0.01) EXPECT_GT(bias.Away(ratio), bias.Away(ratio - 0.01)) << ratio;
  EXPECT_EQ(bias.Away(1e9), bias.Away(0.7));
  // Mean of a half-normal distribution: the whole flank on one side is missing.
  EXPECT_LT(bias.Away(1e9), std::sqrt(2.0 / M_PI));
}

TEST(FlickerBiasTest, AFewEventsMoveLittle) {
  Scene scene(100.0, {0.0, 0.0});
  scene.counts.own[1] = 1.0;
  scene.counts.beside[1][0] = 1.0;
  EXPECT_GT(scene.ShiftPx(), -0.25 * kSpreadPx);
}

}  // namespace
}  // namespace evpose
