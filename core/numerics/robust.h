// SPDX-License-Identifier: Apache-2.0

// Robust weights and scales (core/estimation/README.md, section 1, which corrects the published formulas).
#pragma once

#include <array>
#include <vector>

#include "absl/types/span.h"

namespace evpose {

// Tukey's bisquare, u = d / sigma.
// c of M and MM: residuals beyond this many sigma have no weight; 95 % efficiency under the normal distribution.
inline constexpr double kTukeyEfficient = 4.685;
inline constexpr double kTukeyBreakdown = 1.547;  // c of S: 50 % breakdown
// E[rho(u)] under the normal at c = 1.547, and half of rho's largest value. The printed 0.199 is this, cut short: with
// it the scale is a little too large, and breaks down a little before half of the events are outliers.
inline constexpr double kTukeyScaleTarget = 0.1995;

inline double TukeyRho(double u, double c) {
  const double s = (u / c) * (u / c);
  if (s >= 1.0) return c * c / 6.0;
  return u * u * (0.5 + s * (-0.5 + s / 6.0));
}
// psi(u) / u, which is also the weight of the pose.
inline double TukeyWeight(double u, double c) {
  const double s = 1.0 - (u / c) * (u / c);
  return s <= 0.0 ? 0.0 : s * s;
}

// Median of |u| under the standard normal distribution: the upper quartile of u.
inline constexpr double kNormalMad = 0.6745;
// The median of |d - median(d)| over kNormalMad, which is sigma for normal residuals. 0 without values. Overwrites
// `values`.
double MadScale(std::vector<double>& values);

// The S scale: mean(rho(d / sigma)) = 0.1995 at c = 1.547, solved from `start` by Newton's steps, and where they would
// leave what is known to hold the solution, by the fixed point sigma^2 <- sigma^2 mean(rho) / 0.1995, which never
// passes it: rho grows no faster than u^2. Positive for a positive start.
double TukeyScale(absl::Span<const double> residuals, double start);

// exp(-x) for x >= 0 from a table, to 2e-5: weights need no more, and it is the same on every machine.
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
  static constexpr int kStepsPerUnit = 64;
  static constexpr int kSize = 32 * kStepsPerUnit + 1;
  std::array<double, kSize> values_;
};

// The mixture of core/estimation/README.md, section 1: events of lines are normal about their line, the rest uniform
// over the gate.
struct MixtureDensity {
  double sigma_px = 1.0;
  double outlier_ratio = 0.1;  // eps
  double gate_px = 6.0;        // half-width g

  // Density of the events of one line at distance d, and of the rest; per pixel.
  double Line(double d_px, const ExpTable& table) const {
    const double inverse = 1.0 / sigma_px;
    return Peak() * table.NegativeExp(0.5 * inverse * inverse * (d_px * d_px));
  }
  double Peak() const { return (1.0 - outlier_ratio) * kInverseSqrt2Pi / sigma_px; }
  double Outlier() const { return outlier_ratio / (2.0 * gate_px); }
  // The integral of the line's share over the gate: how wide a strip of evenly spread events it takes for its own.
  double OwnWidthPx(const ExpTable& table) const {
    constexpr int kSteps = 16;
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
