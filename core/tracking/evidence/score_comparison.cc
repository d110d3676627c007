// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/score_comparison.h"

#include <algorithm>
#include <cmath>

namespace evpose {

void ScoreComparison::Add(double difference, double squares, double explained) {
  if (squares <= 0.0) return;
  explained_ += explained;
  difference_ += difference;
  squares_ += squares;
  differences2_ += difference * difference;
  products_ += difference * squares;
  squares2_ += squares * squares;
  ++num_windows_;
}

double ScoreComparison::Sigma(double dispersion, double model_error_ratio) const {
  if (squares_ <= 0.0) return 0.0;
  double variance = dispersion * squares_;
  if (num_windows_ > 1) {
    const double ratio = difference_ / squares_;
    const double residuals2 = differences2_ - 2.0 * ratio * products_ + ratio * ratio * squares2_;
    const auto count = static_cast<double>(num_windows_);
    variance = std::max(variance, residuals2 * count / (count - 1.0));
  }
  const double of_model = model_error_ratio * std::max(0.0, explained_);
  return difference_ / std::sqrt(variance + of_model * of_model);
}

}  // namespace evpose
