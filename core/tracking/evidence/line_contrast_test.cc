// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/line_contrast.h"

#include <gtest/gtest.h>

#include <cmath>

namespace evpose {
namespace {

// A window with 100 explained events, `beside` others in gates of 6 px, and 50 of the background.
WindowFit FitWith(double residual_px, double beside) {
  WindowFit fit;
  fit.num_explained = 100.0;
  fit.num_background = 50.0;
  fit.num_gated = fit.num_explained + fit.num_background + beside;
  fit.residual_rms_px = residual_px;
  fit.gate_px = 6.0;
  return fit;
}

TEST(LineContrastTest, UniformEventsHaveNoContrast) {
  // As many events as the tails of the normal leave beside it, if the density is the same everywhere.
  constexpr double kResidualPx = 1.0;
  const double width_px = std::sqrt(2.0 * M_PI) * kResidualPx;
  LineContrast contrast;
  contrast.Add(FitWith(kResidualPx, 100.0 * 12.0 / width_px), 1.0);
  EXPECT_NEAR(contrast.Ratio(), 1.0, 1e-12);
  EXPECT_NEAR(contrast.SpreadPx(), kResidualPx, 1e-12);
}

TEST(LineContrastTest, IsHigherForSharperLinesAndFewerEventsBesideThem) {
  const auto ratio = [](double residual_px, double beside) {
    LineContrast contrast;
    contrast.Add(FitWith(residual_px, beside), 1.0);
    return contrast.Ratio();
  };
  EXPECT_NEAR(ratio(0.8, 20.0), 2.0 * ratio(1.6, 20.0), 1e-9);
  EXPECT_NEAR(ratio(0.8, 20.0), 2.0 * ratio(0.8, 40.0), 1e-9);
  EXPECT_TRUE(std::isinf(ratio(0.8, 0.0)));
}

TEST(LineContrastTest, EarlierWindowsFadeOut) {
  LineContrast contrast;
  for (int i = 0; i < 200; ++i) contrast.Add(FitWith(1.6, 40.0), 0.9);
  for (int i = 0; i < 200; ++i) contrast.Add(FitWith(0.8, 20.0), 0.9);
  LineContrast last;
  last.Add(FitWith(0.8, 20.0), 1.0);
  EXPECT_NEAR(contrast.Ratio(), last.Ratio(), 1e-6);
  EXPECT_NEAR(contrast.SpreadPx(), 0.8, 1e-6);
}

TEST(LineContrastTest, WithoutWindowsAndWithoutAGateIsInfinite) {
  LineContrast contrast;
  EXPECT_TRUE(std::isinf(contrast.Ratio()));
  EXPECT_EQ(contrast.SpreadPx(), 0.0);
  WindowFit fit = FitWith(1.0, 20.0);
  fit.gate_px = 0.0;
  contrast.Add(fit, 1.0);
  EXPECT_TRUE(std::isinf(contrast.Ratio()));
}

}  // namespace
}  // namespace evpose
