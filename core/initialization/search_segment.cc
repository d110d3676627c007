// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/search_segment.h"

#include <Eigen/Geometry>
#include <algorithm>

namespace evpose {
namespace {

// A segment shorter than this number of standard deviations of its ends has no reliable direction.
constexpr double kMinLengthSigmas = 4.0;

SearchSegment MakeSearchSegment(const CameraModel& camera, const ImageSegment& segment, int index, double sigma_px) {
  SearchSegment line;
  line.index = index;
  const double length_px = segment.length_px();
  line.middle_px = 0.5 * (segment.p1_px + segment.p2_px);
  line.half_px = 0.5 * length_px;
  line.along = (segment.p2_px - segment.p1_px) / length_px;
  line.across = {-line.along.y(), line.along.x()};
  line.q1 = BearingOf(camera, segment.p1_px);
  line.q2 = BearingOf(camera, segment.p2_px);
  line.normal = BackProjectedNormal(camera, segment);
  line.sight = (line.q1.normalized() + line.q2.normalized()).normalized();
  line.sideways = line.normal.cross(line.sight);
  const double subtended_rad = line.q1.cross(line.q2).norm() / (line.q1.norm() * line.q2.norm());
  const double sigma_rad = sigma_px / std::min(camera.fx_px, camera.fy_px);
  line.turn_variance = 2.0 * sigma_rad * sigma_rad / (subtended_rad * subtended_rad);
  line.shift_variance = 0.5 * sigma_rad * sigma_rad;
  return line;
}

}  // namespace

std::vector<SearchSegment> MakeSearchSegments(const CameraModel& camera, absl::Span<const ImageSegment> segments,
                                              double sigma_px, int max_segments) {
  std::vector<int> order;
  for (size_t i = 0; i < segments.size(); ++i) {
    const ImageSegment& segment = segments[i];
    if (!segment.p1_px.allFinite() || !segment.p2_px.allFinite()) continue;
    if (segment.length_px() > kMinLengthSigmas * sigma_px) order.push_back(static_cast<int>(i));
  }
  std::stable_sort(order.begin(), order.end(),
                   [&](int i, int j) { return segments[i].length_px() > segments[j].length_px(); });
  if (order.size() > static_cast<size_t>(max_segments)) order.resize(max_segments);
  std::vector<SearchSegment> longest;
  longest.reserve(order.size());
  for (const int i : order) longest.push_back(MakeSearchSegment(camera, segments[i], i, sigma_px));
  return longest;
}

}  // namespace evpose
