// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/line_clutter.h"

#include <algorithm>
#include <cmath>

namespace evpose {

int LineClutter::Direction(const ImageLine& line) const {
  // Pixels per second: slower lines produce too few events compared with noise.
  constexpr double kMinSpeedPxPerS = 20.0;
  const double speed = NormalSpeedPxPerS(camera_, line, 0.5);
  if (std::abs(speed) < kMinSpeedPxPerS) return 0;
  return speed > 0.0 ? 1 : -1;
}

void LineClutter::Add(const LineCounts& counts, int direction, double gate_px, Memory& memory) {
  const double strip_px = (1.0 - LineCounts::kLateralRatio) * gate_px;
  const double all_own = counts.own[0] + counts.own[1];
  for (int polarity = 0; polarity < 2; ++polarity) {
    memory.own[polarity] += direction == 0 ? 0.5 * all_own : counts.own[direction > 0 ? polarity : 1 - polarity];
    for (int side = 0; side < 2; ++side) {
      memory.beside_per_px[side][polarity] += counts.beside[side][polarity] / strip_px;
    }
  }
}

void LineClutter::Densities(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines,
                            absl::Span<const LineCounts> counts, double counts_gate_px, const MixtureDensity& density,
                            std::vector<LineDensities>& densities) const {
  // The vector grows by factors; assign() would allocate for each new maximum.
  densities.clear();
  for (size_t k = 0; k < tracked.size(); ++k) densities.push_back(LineDensities::Of(density));
  ForEachCurve(tracked, [&](size_t first, size_t end) {
    const auto index = static_cast<size_t>(tracked[first].curve);
    Memory memory = index < curves_.size() ? curves_[index] : Memory();
    for (size_t k = first; k < end && !counts.empty(); ++k) {
      if (lines[k].in_view()) Add(counts[k], Direction(lines[k]), counts_gate_px, memory);
    }
    for (size_t k = first; k < end; ++k) {
      if (lines[k].in_view()) SetDensities(memory, Direction(lines[k]), density, densities[k]);
    }
  });
}

void LineClutter::SetDensities(const Memory& memory, int direction, const MixtureDensity& density,
                               LineDensities& line) {
  // Events of the line, a lower bound for the denominators: fewer are no estimate of the rate or of the polarity.
  constexpr double kFewEvents = 10.0;
  const double shared = density.Outlier();
  const double own = memory.own[0] + memory.own[1];
  // The factor 2 drops the probability 1/2 of each polarity, as LineDensities::own does: the mean over both polarities
  // equals the density without them.
  const double scale = 2.0 * (1.0 - density.outlier_ratio) / std::max(own, kFewEvents);
  for (int polarity = 0; polarity < 2; ++polarity) {
    const double of_polarity = memory.own[direction > 0 ? polarity : 1 - polarity];
    if (direction != 0) line.own[polarity] = (2.0 * of_polarity + kFewEvents) / (own + kFewEvents);
    const double negative = scale * memory.beside_per_px[0][polarity];
    const double positive = scale * memory.beside_per_px[1][polarity];
    const double denser = std::max(negative, positive);
    line.beside[0][polarity] = std::max(shared, direction == 0 ? denser : negative);
    line.beside[1][polarity] = std::max(shared, direction == 0 ? denser : positive);
  }
}

void LineClutter::Learn(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines,
                        absl::Span<const LineCounts> counts, double gate_px) {
  // Events of a line and its clutter over which the counts are averaged: enough for a ratio with 10 % of error, and few
  // enough to follow a change of the background within tens of milliseconds.
  constexpr double kMemoryEvents = 100.0;
  const double strip_px = (1.0 - LineCounts::kLateralRatio) * gate_px;
  if (counts.empty()) return;
  ForEachCurve(tracked, [&](size_t first, size_t end) {
    const absl::Span<const ImageLine> of_curve = lines.subspan(first, end - first);
    if (std::none_of(of_curve.begin(), of_curve.end(), [](const ImageLine& line) { return line.in_view(); })) return;
    const auto index = static_cast<size_t>(tracked[first].curve);
    if (index >= curves_.size()) curves_.resize(index + 1);
    Memory& memory = curves_[index];
    for (size_t k = first; k < end; ++k) {
      if (lines[k].in_view()) Add(counts[k], Direction(lines[k]), gate_px, memory);
    }
    double all = memory.own[0] + memory.own[1];
    for (const ByPolarity& side : memory.beside_per_px) all += strip_px * (side[0] + side[1]);
    const double keep = std::min(1.0, kMemoryEvents / std::max(all, 1.0));
    for (int polarity = 0; polarity < 2; ++polarity) {
      memory.own[polarity] *= keep;
      for (ByPolarity& side : memory.beside_per_px) side[polarity] *= keep;
    }
  });
}

}  // namespace evpose
