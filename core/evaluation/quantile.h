// SPDX-License-Identifier: Apache-2.0

// Quantiles of samples.
#pragma once

#include <vector>

namespace evpose {

// Linear between order statistics. `sorted` ascends and is not empty; q in [0, 1].
inline double Quantile(const std::vector<double>& sorted, double q) {
  const double position = q * static_cast<double>(sorted.size() - 1);
  const size_t below = static_cast<size_t>(position);
  const size_t above = below + 1 < sorted.size() ? below + 1 : below;
  return sorted[below] + (position - static_cast<double>(below)) * (sorted[above] - sorted[below]);
}

}  // namespace evpose
