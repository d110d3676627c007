// SPDX-License-Identifier: Apache-2.0

// Robust weights and scales, and the mixture density. core/estimation/README.md, section 1, has the formulas, where
// they differ from the published ones.
#pragma once

#include <array>
#include <vector>

#include "absl/types/span.h"

namespace evpose {

// Tukey's bisquare, u = d / sigma. A residual beyond c sigma has weight 0.
//
// c of the M and MM estimators: 95 % efficiency under the normal distribution.
inline constexpr double kTukeyEfficient = 4.685;
// c of the S estimator: breakdown point 50 %.
inline constexpr double kTukeyBreakdown = 1.547;
// E[rho(u)] under the normal distribution for c = 1.547; also half the largest value of rho, c^2 / 6. The paper prints
// it truncated, 0.199, which gives a slightly larger scale and a breakdown point slightly below 50 %.
inline constexpr double kTukeyScaleTarget = 0.1995;

inline double TukeyRho(double u, double c) {
  const double s = (u / c) * (u / c);
  if (s >= 1.0) return c * c / 6.0;
  return u * u * (0.5 + s * (-0.5 + s / 6.0));
}
// psi(u) / u, the weight in iteratively re-weighted least squares.
inline double TukeyWeight(double u, double c) {
  const double s = 1.0 - (u / c) * (u / c);
  return s <= 0.0 ? 0.0 : s * s;
}

// Median of |u| under the standard normal distribution: the upper quartile of u.
inline constexpr double kNormalMad = 0.6745;
// The median of |d - median(d)| over kNormalMad, which is sigma for normal residuals. 0 without values. Overwrites
// `values`.
double MadScale(std::vector<double>& values);

// The S scale: the sigma with mean(rho(d / sigma)) = kTukeyScaleTarget for c = kTukeyBreakdown. Newton's method from
// `start`; a step out of the bracket of the solution is replaced by the fixed-point step sigma^2 <- sigma^2 mean(rho) /
// target, which never passes the solution, because rho grows no faster than u^2. Positive for a positive `start`;
// `start` without residuals.
double TukeyScale(absl::Span<const double> residuals, double start);

// exp(-x) for x >= 0 by linear interpolation in a table, with an absolute error below 3.1e-5, which suffices for
// weights; 0 from x = 32 on. The same bits on every machine (core/numerics/README.md, section 1).
class ExpTable {
 public:
  ExpTable();
  double NegativeExp(double x) const {
    const double scaled = x * kStepsPerUnit;
    if (!(scaled < kSize - 1)) return 0.0;
    const int index = static_cast<int>(scaled);
    const double fraction = scaled - index;
    return values_[index] + fraction * (values_[index + 1] - values_[index]);
  }

 private:
  static constexpr int kStepsPerUnit = 64;  // error 1 / (8 * 64^2); the table of 16 KiB fits the first cache
  static constexpr int kSize = 32 * kStepsPerUnit + 1;  // exp(-32) = 1e-14
  std::array<double, kSize> values_;
};

// The mixture of core/estimation/README.md, section 1: the distances of a line's events are normally distributed, those
// of the other events uniformly over the gate.
struct MixtureDensity {
  double sigma_px = 1.0;
  double outlier_ratio = 0.1;  // eps
  double gate_px = 6.0;        // half-width g

  // Density of the events of one line at distance d, at d = 0, and of the other events; per pixel.
  double Line(double d_px, const ExpTable& table) const {
    const double inverse = 1.0 / sigma_px;
    return Peak() * table.NegativeExp(0.5 * inverse * inverse * (d_px * d_px));
  }
  double Peak() const { return (1.0 - outlier_ratio) * kInverseSqrt2Pi / sigma_px; }
  double Outlier() const { return outlier_ratio / (2.0 * gate_px); }
  // The integral of Line / (Line + Outlier) over the gate, by the midpoint rule: the width of the strip of uniformly
  // distributed events that are attributed to the line.
  double OwnWidthPx(const ExpTable& table) const {
    constexpr int kSteps = 16;  // on one side of the line; the integrand is smooth
    double sum = 0.0;
    for (int i = 0; i < kSteps; ++i) {
      const double line = Line((i + 0.5) * gate_px / kSteps, table);
      sum += line / (line + Outlier());
    }
    return 2.0 * gate_px * sum / kSteps;
  }

  static constexpr double kInverseSqrt2Pi = 0.3989422804014327;
};

}  // namespace evpose
