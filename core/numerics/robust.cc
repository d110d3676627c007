// SPDX-License-Identifier: Apache-2.0
#include "core/numerics/robust.h"

#include <cmath>
#include <limits>

#include "core/numerics/math.h"
#include "core/numerics/statistics.h"

namespace evpose {

double MadScale(std::vector<double>& values) {
  if (values.empty()) return 0.0;
  const double median = UpperMedian(values);
  for (double& value : values) value = std::abs(value - median);
  return UpperMedian(values) / kNormalMad;
}

double TukeyScale(absl::Span<const double> residuals, double start) {
  constexpr int kMaxIterations = 50;            // a bound only: Newton's method converges quadratically
  constexpr double kRelativeTolerance = 1e-10;  // relative to the mean of rho
  double sigma = start;
  double low = 0.0, high = std::numeric_limits<double>::infinity();  // the bracket of the solution
  for (int k = 0; k < kMaxIterations && !residuals.empty(); ++k) {
    const double inverse = 1.0 / sigma;
    double sum = 0.0;
    double slope = 0.0;  // derivative of the sum by -log(sigma): sum of psi(u) u
    for (const double d : residuals) {
      const double u = d * inverse;
      sum += TukeyRho(u, kTukeyBreakdown);
      slope += u * u * TukeyWeight(u, kTukeyBreakdown);
    }
    const double target = kTukeyScaleTarget * static_cast<double>(residuals.size());
    const double ratio = sum / target;
    // All residuals are zero: the scale would become 0.
    if (!(ratio > 1e-12)) break;
    (ratio > 1.0 ? low : high) = sigma;
    const double newton = sigma * (1.0 + (sum - target) / slope);
    sigma = newton > low && newton < high ? newton : sigma * std::sqrt(ratio);
    if (std::abs(ratio - 1.0) < kRelativeTolerance) break;
  }
  return sigma;
}

ExpTable::ExpTable() {
  for (int i = 0; i < kSize; ++i) values_[i] = DeterministicExp(-static_cast<double>(i) / kStepsPerUnit);
}

}  // namespace evpose
