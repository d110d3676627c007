// SPDX-License-Identifier: Apache-2.0
#include "core/numerics/robust.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "core/numerics/random.h"

namespace evpose {
namespace {

// Integral of f(u) times the standard normal density.
template <typename Function>
double NormalMean(Function f) {
  constexpr double kStep = 1e-3;
  double sum = 0.0;
  for (double u = -9.0; u <= 9.0; u += kStep) sum += f(u) * std::exp(-0.5 * u * u) * kStep;
  return sum / std::sqrt(2.0 * M_PI);
}

TEST(Tukey, ScaleTargetIsTheMeanUnderTheNormal) {
  // The constant has four digits, and is half the largest value: the breakdown point is one half.
  const double mean = NormalMean([](double u) { return TukeyRho(u, kTukeyBreakdown); });
  EXPECT_NEAR(mean, kTukeyScaleTarget, 5e-5);
  EXPECT_NEAR(mean / TukeyRho(1e9, kTukeyBreakdown), 0.5, 5e-4);
}

TEST(Tukey, EfficiencyOfTheEstimatorIs95Percent) {
  // Efficiency of a location M-estimator: E[psi']^2 / E[psi^2], and E[psi'] = E[u psi] under the normal.
  const auto psi = [](double u) { return u * TukeyWeight(u, kTukeyEfficient); };
  const double derivative = NormalMean([&](double u) { return u * psi(u); });
  const double square = NormalMean([&](double u) { return psi(u) * psi(u); });
  EXPECT_NEAR(derivative * derivative / square, 0.95, 1e-3);
}

TEST(Tukey, WeightIsTheDerivativeOverU) {
  for (const double c : {kTukeyBreakdown, kTukeyEfficient}) {
    for (double u = -6.0; u < 6.0; u += 0.37) {
      const double h = 1e-5;
      const double derivative = (TukeyRho(u + h, c) - TukeyRho(u - h, c)) / (2.0 * h);
      EXPECT_NEAR(derivative, u * TukeyWeight(u, c), 1e-8) << u << " " << c;
    }
    EXPECT_NEAR(TukeyRho(c + 1.0, c), c * c / 6.0, 1e-12);
    EXPECT_EQ(TukeyWeight(c + 0.1, c), 0.0);
  }
}

TEST(Scales, NormalResidualsWithOutliers) {
  Random random(3);
  std::vector<double> residuals;
  for (int i = 0; i < 20'000; ++i) residuals.push_back(0.7 * random.Normal());
  std::vector<double> copy = residuals;
  EXPECT_NEAR(MadScale(copy), 0.7, 0.02);
  EXPECT_NEAR(TukeyScale(residuals, 5.0), 0.7, 0.02);
  EXPECT_NEAR(TukeyScale(residuals, 0.1), 0.7, 0.02);
  for (int i = 0; i < 5'000; ++i) residuals.push_back(random.Uniform(-50.0, 50.0));
  EXPECT_NEAR(TukeyScale(residuals, 5.0), 1.0, 0.2);  // a fifth are outliers: raised by less than a half
  for (const double start : {0.001, 0.1, 5.0, 1e5}) {
    const double sigma = TukeyScale(residuals, start);
    double sum = 0.0;
    for (const double d : residuals) sum += TukeyRho(d / sigma, kTukeyBreakdown);
    EXPECT_NEAR(sum / static_cast<double>(residuals.size()), kTukeyScaleTarget, 1e-9) << start;
  }
  copy.clear();
  EXPECT_EQ(MadScale(copy), 0.0);
  EXPECT_GT(TukeyScale({0.0, 0.0, 0.0}, 0.5), 0.0);
}

TEST(ExpTable, IsCloseToExp) {
  const ExpTable table;
  for (double x = 0.0; x < 31.9; x += 0.013) EXPECT_NEAR(table.NegativeExp(x), std::exp(-x), 3e-5) << x;
  EXPECT_EQ(table.NegativeExp(40.0), 0.0);
  EXPECT_EQ(table.NegativeExp(std::nan("")), 0.0);
}

TEST(MixtureDensity, WeightOfTheLineAtKnownDistances) {
  const ExpTable table;
  const MixtureDensity density{0.5, 0.2, 4.0};
  const auto weight = [&](double d) { return density.Line(d, table) / (density.Line(d, table) + density.Outlier()); };
  // w = (1 - eps) N / ((1 - eps) N + eps / 2g) with eps = 0.2, g = 4.
  EXPECT_NEAR(weight(0.0), 0.8 * 0.79788456 / (0.8 * 0.79788456 + 0.025), 1e-4);
  EXPECT_NEAR(weight(1.0), 0.8 * 0.10798193 / (0.8 * 0.10798193 + 0.025), 1e-4);
  EXPECT_LT(weight(3.0), 1e-6);
}

}  // namespace
}  // namespace evpose
