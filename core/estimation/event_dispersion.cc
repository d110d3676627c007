// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/event_dispersion.h"

#include <algorithm>

namespace evpose {

void EventDispersion::Add(int curve, double sum_px, double variance_px2, double weight) {
  // Sum of weights of a block: a displacement by half of the spread of the events makes the mean square six times as
  // large, and a slow line has as many events in about ten windows.
  constexpr double kBlockWeight = 20.0;
  // Share of a block in the running mean, which covers about 200 blocks: its standard deviation is 10 %.
  constexpr double kForget = 0.005;
  const auto index = static_cast<size_t>(curve);
  if (index >= blocks_.size()) blocks_.resize(index + 1);
  Block& block = blocks_[index];
  block.sum_px += sum_px;
  block.variance_px2 += variance_px2;
  block.weight += weight;
  if (block.weight < kBlockWeight || !(block.variance_px2 > 0.0)) return;
  const double square = std::min(kMaxSquare, block.sum_px * block.sum_px / block.variance_px2);
  mean_ += kForget * (square - mean_);
  block = Block();
}

double EventDispersion::factor() const {
  // Two standard deviations of the running mean: independent events have no excess beyond it.
  constexpr double kChance = 0.2;
  return std::clamp(mean_ - kChance, 1.0, kMaxFactor);
}

}  // namespace evpose
