#include "core/tracking/robust.h"

#include <algorithm>
#include <cmath>

#include "core/base/math.h"

namespace evpose {
namespace {

double Median(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace

double MadScale(std::vector<double>& values) {
  if (values.empty()) return 0.0;
  const double median = Median(values);
  for (double& value : values) value = std::abs(value - median);
  return Median(values) / 0.6745;
}

double TukeyScale(absl::Span<const double> residuals, double start) {
  constexpr int kMaxIterations = 50;
  constexpr double kRelativeTolerance = 1e-10;
  double sigma = start;
  for (int k = 0; k < kMaxIterations && !residuals.empty(); ++k) {
    double sum = 0.0;
    for (const double d : residuals) sum += TukeyRho(d / sigma, kTukeyBreakdown);
    const double ratio = sum / (kTukeyScaleTarget * static_cast<double>(residuals.size()));
    // All residuals zero: the scale would collapse.
    if (!(ratio > 1e-12)) break;
    sigma *= std::sqrt(ratio);
    if (std::abs(ratio - 1.0) < kRelativeTolerance) break;
  }
  return sigma;
}

ExpTable::ExpTable() {
  for (int i = 0; i < kSize; ++i) values_[i] = DeterministicExp(-static_cast<double>(i) / kStepsPerUnit);
}

}  // namespace evpose
