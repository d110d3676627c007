// SPDX-License-Identifier: Apache-2.0

// Segments of the image that share their events (core/contours/README.md, section 5).
#pragma once

#include <Eigen/Core>
#include <cmath>

namespace evpose {

struct SegmentImage {
  Eigen::Vector2d middle_px;
  Eigen::Vector2d direction;  // unit
  double half_length_px = 0.0;
};

// Requires two different points.
inline SegmentImage SegmentBetween(const Eigen::Vector2d& p1_px, const Eigen::Vector2d& p2_px) {
  const double length_px = (p2_px - p1_px).norm();
  return {0.5 * (p1_px + p2_px), (p2_px - p1_px) / length_px, 0.5 * length_px};
}

// Whether most events of a segment are also those of a stronger one: it differs by less than 15 degrees, and its middle
// is within 2 px of the stronger one. The spread of the events about an edge is up to 2 px, and segments of the same
// edge at a corner or an arc differ by some degrees. Not validated separately.
inline bool IsBeside(const SegmentImage& segment, const SegmentImage& stronger) {
  constexpr double kParallelPx = 2.0;
  constexpr double kParallelSine = 0.26;
  const Eigen::Vector2d& along = stronger.direction;
  const auto across = [&along](const Eigen::Vector2d& v) { return std::abs(along.x() * v.y() - along.y() * v.x()); };
  if (across(segment.direction) > kParallelSine) return false;
  const Eigen::Vector2d offset = segment.middle_px - stronger.middle_px;
  return std::abs(along.dot(offset)) <= stronger.half_length_px && across(offset) < kParallelPx;
}

}  // namespace evpose
