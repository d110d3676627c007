// How an image segment fits a projected model line.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "core/initialization/image_line.h"
#include "core/initialization/pose_search.h"

namespace evpose {

// One over the variances (1 / px^2) of a segment's ends across and along it.
struct FitWeights {
  double across = 1.0;
  double along = 1.0;
};

struct SegmentFit {
  double cost = 0.0;        // squared standard deviations: both ends' distance from the line, and what stands over
  double overlap_px = 0.0;  // of the segment and the projected line
};

// Against the part of a line that projects to a--b (pixels). A segment may be shorter than the line, that costs
// nothing here; where it stands over the line's ends, it does. Returns false, `fit` undefined, when the cost is `cap`
// or more, when they do not overlap, or when they are turned by more than 45 degrees.
inline bool FitSegment(const ImageLine& line, const Eigen::Vector2d& a, const Eigen::Vector2d& b,
                       const FitWeights& weights, double cap, SegmentFit& fit) {
  const Eigen::Vector2d to_a = a - line.middle_px, to_b = b - line.middle_px;
  const double sa = line.along.dot(to_a), sb = line.along.dot(to_b);
  const double low = std::min(sa, sb), high = std::max(sa, sb);
  const double h = line.half_px;
  fit.overlap_px = std::min(high, h) - std::max(low, -h);
  if (!(fit.overlap_px > 0.0)) return false;
  const double ya = line.across.dot(to_a), yb = line.across.dot(to_b);
  const double run = sb - sa, rise = yb - ya;
  if (std::abs(rise) > std::abs(run)) return false;
  const double slope = rise / run;
  const double middle = ya - slope * sa, half_rise = slope * h;
  // The two ends' distances are middle -+ half_rise.
  fit.cost = 2.0 * (middle * middle + half_rise * half_rise) * weights.across;
  if (fit.cost >= cap) return false;
  const double over_low = std::max(0.0, low + h), over_high = std::max(0.0, h - high);
  fit.cost += (over_low * over_low + over_high * over_high) * weights.along;
  return fit.cost < cap;
}

// What a visible line costs of which segments cover only so much: short lines are often missed, and ends are uncertain.
inline double MissingCost(double length_px, double covered_px, const PoseSearchOptions& options) {
  const double slack_px = 2.0 * options.end_point_along_sigma_px;
  const double missing_px = std::max(0.0, length_px - covered_px - slack_px);
  return options.missing_cost * missing_px / (length_px + slack_px);
}

}  // namespace evpose
