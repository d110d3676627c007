// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/search_segment.h"

#include <Eigen/Geometry>
#include <algorithm>

namespace evpose {
namespace {

// A segment shorter than this number of standard deviations of its ends has no reliable direction.
constexpr double kMinLengthSigmas = 4.0;

SearchSegment MakeSearchSegment(const CameraModel& camera, const ImageSegment& image, int index, double sigma_px) {
  SearchSegment segment;
  segment.index = index;
  const double length_px = image.length_px();
  segment.middle_px = 0.5 * (image.p1_px + image.p2_px);
  segment.half_px = 0.5 * length_px;
  segment.along = (image.p2_px - image.p1_px) / length_px;
  segment.across = {-segment.along.y(), segment.along.x()};
  segment.q1 = BearingOf(camera, image.p1_px);
  segment.q2 = BearingOf(camera, image.p2_px);
  segment.normal = BackProjectedNormal(camera, image);
  segment.sight = (segment.q1.normalized() + segment.q2.normalized()).normalized();
  segment.sideways = segment.normal.cross(segment.sight);
  const double subtended_rad = segment.q1.cross(segment.q2).norm() / (segment.q1.norm() * segment.q2.norm());
  const double sigma_rad = sigma_px / std::min(camera.fx_px, camera.fy_px);
  segment.turn_variance = 2.0 * sigma_rad * sigma_rad / (subtended_rad * subtended_rad);
  segment.shift_variance = 0.5 * sigma_rad * sigma_rad;
  return segment;
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
