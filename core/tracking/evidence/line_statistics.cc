// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/line_statistics.h"

#include <algorithm>

namespace evpose {

void LineStatistics::Add(const LineStatistics& other, double kept_ratio) {
  gated = kept_ratio * gated + other.gated;
  along = kept_ratio * along + other.along;
  excess = kept_ratio * excess + other.excess;
  variance = kept_ratio * variance + other.variance;
  right_excess = kept_ratio * right_excess + other.right_excess;
  information = kept_ratio * information + other.information;
  noise = kept_ratio * noise + other.noise;
  expected = kept_ratio * expected + other.expected;
  length_px = kept_ratio * length_px + other.length_px;
  lines = std::max(lines, other.lines);
}

}  // namespace evpose
