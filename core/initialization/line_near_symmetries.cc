// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/line_near_symmetries.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <map>

#include "core/base/yield_point.h"

namespace evpose {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Distance below which lines coincide, as a share of the radius: about the resolution of an image of 100 px.
constexpr double kToleranceOfRadius = 0.02;
// Angle below which lines are parallel: the tolerance over a line as long as two thirds of the radius.
constexpr double kParallelRad = 0.03;
// Smallest share of the lines' length that a near-symmetry aligns. With less, the segments of the other lines decide.
constexpr double kMinAlignedRatio = 0.5;
// Number of near-symmetries: further ones align less and only take time.
constexpr size_t kMaxMotions = 7;

struct Line {
  Vector3d middle, along;
  double length_m = 0.0;

  Vector3d End(double share) const { return middle + share * length_m * along; }
};

std::vector<Line> MakeLines(absl::Span<const ModelLine> lines) {
  std::vector<Line> made;
  for (const ModelLine& line : lines) {
    const double length_m = (line.p2 - line.p1).norm();
    if (length_m > 0.0) made.push_back({0.5 * (line.p1 + line.p2), (line.p2 - line.p1) / length_m, length_m});
  }
  return made;
}

bool AreParallel(const Line& a, const Line& b) { return a.along.cross(b.along).norm() < kParallelRad; }

// Returns the shift that aligns the largest length of line ends of one direction: of the rotated lines to `lines`. Ends
// are compared, because an edge may be drawn in several parts.
Vector3d BestShift(const std::vector<Line>& turned, const std::vector<Line>& lines, double tolerance_m) {
  struct Votes {
    double weight = 0.0;
    Vector3d sum = Vector3d::Zero();
  };
  std::map<std::array<int64_t, 3>, Votes> cells;
  const double cell_m = 2.0 * tolerance_m;
  Votes most;
  const auto vote = [&](const Vector3d& shift, double weight) {
    std::array<int64_t, 3> cell;
    for (int axis = 0; axis < 3; ++axis) cell[axis] = std::llround(shift[axis] / cell_m);
    Votes& votes = cells[cell];
    votes.weight += weight;
    votes.sum += weight * shift;
    if (votes.weight > most.weight) most = votes;
  };
  for (const Line& from : turned) {
    for (const Line& to : lines) {
      if (!AreParallel(from, to)) continue;
      for (const double from_end : {-0.5, 0.5}) {
        for (const double to_end : {-0.5, 0.5}) {
          vote(to.End(to_end) - from.End(from_end), std::min(from.length_m, to.length_m));
        }
      }
    }
  }
  return most.weight > 0.0 ? Vector3d(most.sum / most.weight) : Vector3d::Zero();
}

// Returns the length of the shifted `line` that another line coincides with.
double CoveredLength(const Line& line, const Vector3d& shift, const std::vector<Line>& lines, double tolerance_m) {
  double covered_m = 0.0;
  for (const Line& other : lines) {
    if (!AreParallel(line, other)) continue;
    const Vector3d apart = other.middle - line.middle - shift;
    const double along_m = std::abs(apart.dot(line.along));
    if (apart.cross(line.along).norm() > tolerance_m) continue;
    const double overlap_m = 0.5 * (line.length_m + other.length_m) - along_m;
    covered_m += std::clamp(overlap_m, 0.0, std::min(line.length_m, other.length_m));
  }
  return std::min(covered_m, line.length_m);
}

}  // namespace

std::vector<RigidTransform> FindLineNearSymmetries(absl::Span<const ModelLine> lines,
                                                   absl::Span<const Matrix3d> rotations, double radius_m) {
  const double tolerance_m = kToleranceOfRadius * radius_m;
  const std::vector<Line> all = MakeLines(lines);
  struct Found {
    double share;
    RigidTransform motion;
  };
  std::vector<Found> found;
  for (const Matrix3d& rotation : rotations) {
    if (rotation.isIdentity()) continue;
    YieldPoint();
    std::vector<Line> turned;
    for (const Line& line : all) turned.push_back({rotation * line.middle, rotation * line.along, line.length_m});
    const Vector3d shift = BestShift(turned, all, tolerance_m);
    double covered_m = 0.0, length_m = 0.0;
    for (const Line& line : turned) {
      covered_m += CoveredLength(line, shift, all, tolerance_m);
      length_m += line.length_m;
    }
    if (length_m > 0.0 && covered_m >= kMinAlignedRatio * length_m)
      found.push_back({covered_m / length_m, {rotation, shift}});
  }
  std::stable_sort(found.begin(), found.end(), [](const Found& a, const Found& b) { return a.share > b.share; });
  if (found.size() > kMaxMotions) found.resize(kMaxMotions);
  std::vector<RigidTransform> near_symmetries;
  for (const Found& each : found) near_symmetries.push_back(each.motion);
  return near_symmetries;
}

}  // namespace evpose
