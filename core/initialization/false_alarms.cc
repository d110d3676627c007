// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/false_alarms.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "core/geometry/lines_of_a_pose.h"

namespace evpose {
namespace {

// Upper bound of the number of poses with three given matches (Dhome et al., "Determination of the attitude of 3D
// objects from a single perspective view", PAMI 1989).
constexpr double kMaxPosesOfThree = 8.0;
constexpr double kMinSidePx = 1.0;  // side of the region of the segments, against a division by zero

// The region of the segments: its area, and the mean length of a random chord of it (area pi / perimeter).
struct Region {
  double area_px2 = 0.0;
  double chord_px = 0.0;
};

Region RegionOf(absl::Span<const SearchSegment> segments, double margin_px) {
  Eigen::Vector2d low = segments[0].middle_px, high = low;
  for (const SearchSegment& segment : segments) {
    for (const double side : {-1.0, 1.0}) {
      const Eigen::Vector2d end = segment.middle_px + side * segment.half_px * segment.along;
      low = low.cwiseMin(end);
      high = high.cwiseMax(end);
    }
  }
  const Eigen::Vector2d size = ((high - low).array() + 2.0 * margin_px).max(kMinSidePx);
  return {size.x() * size.y(), std::numbers::pi * size.x() * size.y() / (2.0 * size.sum())};
}

}  // namespace

double ExpectedFalseAlarms(const ExplainedSegments& explained, absl::Span<const SearchSegment> segments,
                           absl::Span<const double> part_lengths_px, double lines_per_part, double num_symmetries,
                           const PoseSearchOptions& options) {
  const int surplus = explained.num_lines - kLinesOfAPose;
  const auto count = static_cast<double>(segments.size());
  if (surplus < 1 || part_lengths_px.empty()) return std::numeric_limits<double>::infinity();
  const double sigma_px = options.end_point_sigma_px;
  // A matched segment may extend beyond either end of its line by as much as the mean cost of a chance match across the
  // line, half of the maximum, leaves.
  const double beyond_px =
      options.end_point_along_sigma_px * std::sqrt(options.unexplained_cost - 0.5 * options.max_across_cost());
  const Region region = RegionOf(segments, beyond_px);
  double range_in_chords = 0.0;  // sum of (10) over all pairs, in chords
  double chance = 0.0;           // mean of (11)
  for (const SearchSegment& segment : segments) {
    const double half_px = std::max(segment.half_px, 2.0 * sigma_px);
    double range_px = 0.0;
    for (const double length_px : part_lengths_px) {
      const double inside_px = length_px - 2.0 * half_px;
      if (inside_px <= -2.0 * beyond_px) continue;
      range_px += std::min(std::max(inside_px, 0.0) + 2.0 * beyond_px, region.chord_px);
    }
    range_in_chords += range_px / region.chord_px;
    const double area_px2 = 0.5 * options.max_across_cost() * sigma_px * sigma_px / half_px * range_px;
    chance += std::min(1.0, area_px2 / region.area_px2) / count;
  }
  const double triples = lines_per_part * range_in_chords;
  double expected = kMaxPosesOfThree / (6.0 * num_symmetries) * triples * triples * triples;
  double as_close = 1.0;
  const double relative_cost = explained.across_cost / options.max_across_cost();
  for (int i = 1; i <= surplus; ++i) {
    expected *= chance * (count - kLinesOfAPose - surplus + i) / i;
    as_close *= relative_cost / i;
  }
  return expected * std::min(1.0, as_close);
}

}  // namespace evpose
