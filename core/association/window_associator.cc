// SPDX-License-Identifier: Apache-2.0
#include "core/association/window_associator.h"

#include <algorithm>
#include <cmath>

namespace evpose {

void WindowAssociator::BuildGrid(absl::Span<const ImageLine> lines, double reach_px, double duration_s) {
  // No gate is wider than this in practice; the bound limits the work.
  constexpr double kMaxReachPx = 128.0;
  double motion_px = 0.0;
  for (const ImageLine& line : lines) {
    if (!line.in_view()) continue;
    const double speed = std::abs(NormalSpeedPxPerS(camera_, line, 0.5));
    motion_px = std::max(motion_px, 0.5 * speed * duration_s);
  }
  grid_.Build(lines, std::min(reach_px + motion_px, kMaxReachPx));
}

}  // namespace evpose
