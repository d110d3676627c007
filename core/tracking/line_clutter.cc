#include "core/tracking/line_clutter.h"

#include <algorithm>
#include <cmath>

namespace evpose {

bool LineClutter::IsMoving(const ImageLine& line) const {
  // Slower lines make too few events to tell from noise.
  constexpr double kMinSpeedPxPerS = 20.0;
  return line.in_view() && std::abs(NormalSpeedPxPerS(camera_, line, 0.5)) >= kMinSpeedPxPerS;
}

void LineClutter::Densities(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines,
                            const MixtureDensity& density, std::vector<SideDensities>& densities) const {
  // Fewer of its own do not tell how many there are of its own.
  constexpr double kFewEvents = 10.0;
  const double shared = density.Outlier();
  densities.clear();
  for (size_t k = 0; k < tracked.size(); ++k) {
    const auto index = static_cast<size_t>(tracked[k].model_line);
    const Memory memory = index < lines_.size() && IsMoving(lines[k]) ? lines_[index] : Memory();
    const double scale = (1.0 - density.outlier_ratio) / std::max(memory.own, kFewEvents);
    densities.push_back(
        {std::max(shared, scale * memory.beside_per_px[0]), std::max(shared, scale * memory.beside_per_px[1])});
  }
}

void LineClutter::Learn(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines,
                        absl::Span<const LineCounts> counts, double gate_px) {
  constexpr double kMemoryEvents = 100.0;
  const double strip_px = (1.0 - LineCounts::kBesideRatio) * gate_px;
  for (size_t k = 0; k < counts.size(); ++k) {
    if (!IsMoving(lines[k])) continue;
    const auto index = static_cast<size_t>(tracked[k].model_line);
    if (index >= lines_.size()) lines_.resize(index + 1);
    Memory& memory = lines_[index];
    memory.own += counts[k].own;
    for (int side = 0; side < 2; ++side) memory.beside_per_px[side] += counts[k].beside[side] / strip_px;
    const double all = memory.own + strip_px * (memory.beside_per_px[0] + memory.beside_per_px[1]);
    const double keep = std::min(1.0, kMemoryEvents / std::max(all, 1.0));
    memory.own *= keep;
    for (double& beside_per_px : memory.beside_per_px) beside_per_px *= keep;
  }
}

}  // namespace evpose
