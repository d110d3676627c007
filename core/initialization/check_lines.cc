// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/check_lines.h"

#include "core/geometry/lines_of_a_pose.h"

// Checks whether the lines of a model determine a pose at all.
#include <Eigen/Cholesky>
#include <algorithm>
#include <vector>

#include "absl/strings/str_cat.h"

namespace evpose {
namespace {

using Eigen::Vector3d;

// Two directions are parallel if the sine of their angle is below this, and two points coincide if their distance is
// below this share of the diameter. A pose that depends on a difference of less than a thousandth depends on errors of
// the model.
constexpr double kSame = 1e-3;

struct InfiniteLine {
  Vector3d point;
  Vector3d direction;  // unit vector
};

double Distance(const InfiniteLine& line, const Vector3d& point) {
  return line.direction.cross(point - line.point).norm();
}

bool IsParallel(const InfiniteLine& a, const InfiniteLine& b) { return a.direction.cross(b.direction).norm() < kSame; }

// The lines are compared in pairs, so that only this many of the longest are.
constexpr size_t kMaxCompared = 1024;

std::vector<ModelLine> LongestOf(const ObjectModel& model) {
  std::vector<ModelLine> lines = model.lines;
  if (lines.size() <= kMaxCompared) return lines;
  std::stable_sort(lines.begin(), lines.end(), [](const ModelLine& a, const ModelLine& b) {
    return (a.p2 - a.p1).squaredNorm() > (b.p2 - b.p1).squaredNorm();
  });
  lines.resize(kMaxCompared);
  return lines;
}

// Collinear pieces are one line, because they constrain a pose in the same way.
std::vector<InfiniteLine> DistinctLines(const ObjectModel& model) {
  std::vector<InfiniteLine> lines;
  for (const ModelLine& line : LongestOf(model)) {
    const Vector3d extent = line.p2 - line.p1;
    if (!(extent.norm() > kSame * model.diameter_m)) continue;
    const InfiniteLine candidate{line.p1, extent.normalized()};
    const bool is_new = std::none_of(lines.begin(), lines.end(), [&](const InfiniteLine& other) {
      return IsParallel(candidate, other) && Distance(other, line.p1) < kSame * model.diameter_m;
    });
    if (is_new) lines.push_back(candidate);
  }
  return lines;
}

// The point nearest to all lines in the least-squares sense. The lines must not all be parallel.
Vector3d NearestPoint(const std::vector<InfiniteLine>& lines) {
  Eigen::Matrix3d h = Eigen::Matrix3d::Zero();
  Vector3d g = Vector3d::Zero();
  for (const InfiniteLine& line : lines) {
    const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - line.direction * line.direction.transpose();
    h += across;
    g += across * line.point;
  }
  return h.ldlt().solve(g);
}

}  // namespace

absl::Status CheckLinesDeterminePose(const ObjectModel& model) {
  const std::vector<InfiniteLine> lines = DistinctLines(model);
  if (lines.size() < kLinesOfAPose) {
    return absl::InvalidArgumentError(absl::StrCat(
        "the model has ", lines.size(), " distinct lines (of ", model.lines.size(),
        "; collinear lines count as one), and a pose needs at least 3, because each gives two equations for its six "
        "unknowns; add lines to the model"));
  }
  if (std::all_of(lines.begin(), lines.end(), [&](const auto& line) { return IsParallel(line, lines[0]); })) {
    return absl::InvalidArgumentError(absl::StrCat(
        "all ", lines.size(),
        " lines of the model are parallel, so the pose is undetermined: a translation along them does not change the "
        "image; add lines in another direction to the model"));
  }
  const Vector3d point = NearestPoint(lines);
  const auto meets = [&](const InfiniteLine& line) { return Distance(line, point) < kSame * model.diameter_m; };
  if (std::all_of(lines.begin(), lines.end(), meets)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "all ", lines.size(),
        " lines of the model meet in one point, so the distance is undetermined: it does not change the image lines; "
        "add a line that does not pass through this point to the model"));
  }
  return absl::OkStatus();
}

}  // namespace evpose
