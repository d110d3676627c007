// SPDX-License-Identifier: Apache-2.0

// The cost of an image segment against a projected model line.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "core/initialization/pose_search.h"
#include "core/initialization/search_segment.h"

namespace evpose {

// Inverse variances (1 / px^2) of a segment's ends across and along it, and the bounds of the two costs.
struct FitWeights {
  double across = 1.0;
  double along = 1.0;
  double max_across_cost = 16.0;
  double short_cost = 4.0;

  // Standard deviations are those of the options times `widening`.
  static FitWeights Make(const PoseSearchOptions& options, double widening) {
    const auto weight = [widening](double sigma) { return 1.0 / (widening * widening * sigma * sigma); };
    return {weight(options.end_point_sigma_px), weight(options.end_point_along_sigma_px), options.max_across_cost(),
            options.short_cost};
  }
};

// A match of an image segment and the visible part of a line.
struct SegmentMatch {
  int segment = 0;         // index into the list of SearchSegments
  int line = 0;            // index into SearchModel::lines
  Eigen::Vector3d p1, p2;  // ends of the part, object frame; p1 corresponds to the segment's first end
};

struct SegmentFit {
  double cost = 0.0;         // squared standard deviations
  double across_cost = 0.0;  // its part that is due to the distances across the line
  double overlap_px = 0.0;   // overlap of the segment and the projected line
};

// Cost of a segment's end that is `inside_px` before the end of its line (negative: beyond it). Beyond the line the
// cost is quadratic, because no cause explains such an end. Before the end either the detector is as accurate as usual
// or it lost the line somewhere: the cost is bounded (the function of Geman and McClure).
inline double EndCost(double inside_px, const FitWeights& weights) {
  const double u2 = inside_px * inside_px * weights.along;
  return inside_px < 0.0 ? u2 : u2 * weights.short_cost / (weights.short_cost + u2);
}
// Returns the weight (1 / px^2) with which the squared residual has the gradient of EndCost.
inline double EndWeight(double inside_px, const FitWeights& weights) {
  if (inside_px < 0.0) return weights.along;
  const double share = weights.short_cost / (weights.short_cost + inside_px * inside_px * weights.along);
  return share * share * weights.along;
}

// Compares a segment of the image with a part of a model line. `a` and `b` are the projections of the two ends of this
// part, in undistorted pixels. The cost depends on the distances of both ends of the segment from the line through `a`
// and `b`, and on their positions along it. Returns false, and leaves `fit` undefined, if the cost reaches `cap`, if
// the segment and the part do not overlap, or if the angle between them exceeds 45 degrees.
inline bool FitSegment(const SearchSegment& segment, const Eigen::Vector2d& a, const Eigen::Vector2d& b,
                       const FitWeights& weights, double cap, SegmentFit& fit) {
  const Eigen::Vector2d to_a = a - segment.middle_px, to_b = b - segment.middle_px;
  const double sa = segment.along.dot(to_a), sb = segment.along.dot(to_b);
  const double low = std::min(sa, sb), high = std::max(sa, sb);
  const double h = segment.half_px;
  fit.overlap_px = std::min(high, h) - std::max(low, -h);
  if (!(fit.overlap_px > 0.0)) return false;
  const double ya = segment.across.dot(to_a), yb = segment.across.dot(to_b);
  const double run = sb - sa, rise = yb - ya;
  if (std::abs(rise) > std::abs(run)) return false;
  const double slope = rise / run;
  const double middle = ya - slope * sa, half_rise = slope * h;
  // The distances of the two ends are middle -+ half_rise.
  fit.across_cost = 2.0 * (middle * middle + half_rise * half_rise) * weights.across;
  if (fit.across_cost >= weights.max_across_cost) return false;
  fit.cost = fit.across_cost + (EndCost(-h - low, weights) + EndCost(high - h, weights));
  return fit.cost < cap;
}

// Returns the cost of a visible line with the length `length_px` if segments cover only `covered_px` of it. Short lines
// are often not detected, and ends are uncertain.
inline double MissingCost(double length_px, double covered_px, const PoseSearchOptions& options) {
  const double slack_px = 2.0 * options.end_point_along_sigma_px;
  const double missing_px = std::max(0.0, length_px - covered_px - slack_px);
  return options.missing_cost * missing_px / (length_px + slack_px);
}

}  // namespace evpose
