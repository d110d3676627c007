// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/clutter_share.h"

#include <algorithm>
#include <optional>

namespace evpose {
namespace {

// Time constant with which the share of clutter decays: a period of the mains at 50 Hz, in which a lamp becomes
// brighter and darker twice.
constexpr double kMemoryUs = 20'000.0;
// Sum of the scores near the lines in a window; with less, the share of clutter is chance.
constexpr double kMinNear = 20.0;

}  // namespace

ByPolarity ClutterShare::Update(absl::Span<const Scores> poses, int64_t t_us) {
  ByPolarity weights{};
  std::optional<double> ratio;
  for (const auto& [near, beside] : poses) {
    for (size_t polarity = 0; polarity < weights.size(); ++polarity) {
      if (near[polarity] == 0.0) continue;
      weights[polarity] = std::max(weights[polarity], 1.0 - beside[polarity] / near[polarity]);
    }
    const double all_near = near[0] + near[1];
    if (all_near < kMinNear) continue;
    ratio = std::min(ratio.value_or(1.0), (beside[0] + beside[1]) / all_near);
  }
  const double elapsed_us = std::max(0.0, static_cast<double>(t_us - updated_us_));
  ratio_ *= kMemoryUs / (kMemoryUs + elapsed_us);
  ratio_ = std::max(ratio_, ratio.value_or(0.0));
  updated_us_ = t_us;
  return weights;
}

}  // namespace evpose
