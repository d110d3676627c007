// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/event_dispersion.h"

#include <gtest/gtest.h>

#include <vector>

#include "core/numerics/random.h"

namespace evpose {
namespace {

constexpr int kCurves = 10;
constexpr double kSpreadPx = 0.8;

// Windows with `events` events of each line. The events of a line share a displacement for `windows_per_shift` windows.
double FactorOf(int num_windows, int events, double shift_px, int windows_per_shift) {
  Random random(11);
  EventDispersion dispersion;
  std::vector<double> shifts(kCurves, 0.0);
  for (int i = 0; i < num_windows; ++i) {
    for (int curve = 0; curve < kCurves; ++curve) {
      if (i % windows_per_shift == 0) shifts[curve] = shift_px * random.Normal();
      double sum_px = 0.0;
      for (int k = 0; k < events; ++k) sum_px += shifts[curve] + kSpreadPx * random.Normal();
      dispersion.Add(curve, sum_px, events * kSpreadPx * kSpreadPx, events);
    }
  }
  return dispersion.factor();
}

TEST(EventDispersionTest, IndependentEventsHaveNone) {
  EXPECT_LT(FactorOf(1000, 100, 0.0, 1), 1.1);
  EXPECT_LT(FactorOf(1000, 4, 0.0, 1), 1.1) << "few events per line and window";
}

TEST(EventDispersionTest, FindsADisplacementThatPersistsOverManyWindows) {
  // 20 events with the same displacement of 0.4 px: 1 + 20 (0.4 / 0.8)^2.
  EXPECT_NEAR(FactorOf(3000, 4, 0.4, 10), 6.0, 2.0);
  // The same displacement in each window anew: 1 + 4 (0.4 / 0.8)^2.
  EXPECT_NEAR(FactorOf(3000, 4, 0.4, 1), 2.0, 0.5);
}

TEST(EventDispersionTest, IsBounded) { EXPECT_EQ(FactorOf(3000, 4, 20.0, 50), EventDispersion::kMaxFactor); }

}  // namespace
}  // namespace evpose
