// SPDX-License-Identifier: Apache-2.0
#include "core/models/collinear_lines.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"

namespace evpose {
namespace {

// Least cosine between lines that are compared (2.6 degrees): skips most pairs. The tolerance decides about the others.
constexpr double kNearlyParallelCosine = 0.999;
constexpr double kMatchingNormalCosine = 0.9;  // 25 degrees

struct StraightLine {
  Eigen::Vector3d p1, direction;
  double length_m;
};

StraightLine StraightLineOf(const ModelLine& line) {
  const double length_m = (line.p2 - line.p1).norm();
  return {line.p1, (line.p2 - line.p1) / length_m, length_m};
}

// Whether both ends of `line` are near the straight line of `longer`, and enough of it lies between the ends of that.
bool IsPartOf(const ModelLine& line, const StraightLine& longer, double tolerance_m, double min_overlap_m) {
  const Eigen::Vector3d d1 = line.p1 - longer.p1, d2 = line.p2 - longer.p1;
  if (d1.cross(longer.direction).norm() > tolerance_m || d2.cross(longer.direction).norm() > tolerance_m) return false;
  const double t1 = d1.dot(longer.direction), t2 = d2.dot(longer.direction);
  return std::min(std::max(t1, t2), longer.length_m) - std::max(std::min(t1, t2), 0.0) >= min_overlap_m;
}

}  // namespace

bool ContainsNormal(const Eigen::Vector3d& normal, absl::Span<const Eigen::Vector3d> normals, double cosine) {
  return std::any_of(normals.begin(), normals.end(),
                     [&](const Eigen::Vector3d& other) { return other.dot(normal) > cosine; });
}

bool HaveMatchingNormals(absl::Span<const Eigen::Vector3d> a, absl::Span<const Eigen::Vector3d> b) {
  const auto contains_each = [](absl::Span<const Eigen::Vector3d> from, absl::Span<const Eigen::Vector3d> to) {
    return std::all_of(from.begin(), from.end(), [&](const Eigen::Vector3d& normal) {
      return ContainsNormal(normal, to, kMatchingNormalCosine);
    });
  };
  return contains_each(a, b) && contains_each(b, a);
}

namespace {

// Groups lines that are parts of one straight line. Returns indices, ascending in each group, the groups in the order
// of their first line.
std::vector<std::vector<uint32_t>> GroupCollinear(absl::Span<const ModelLine> lines, double tolerance_m,
                                                  double min_overlap_m, bool same_faces) {
  std::vector<StraightLine> straight;
  for (const ModelLine& line : lines) straight.push_back(StraightLineOf(line));
  std::vector<uint32_t> first(lines.size());  // an earlier line of the group, or itself: a disjoint-set forest
  std::iota(first.begin(), first.end(), 0u);
  const auto root = [&first](uint32_t i) {
    while (first[i] != i) i = first[i] = first[first[i]];
    return i;
  };
  for (uint32_t i = 0; i < lines.size(); ++i) {
    for (uint32_t j = i + 1; j < lines.size(); ++j) {
      if (std::abs(straight[i].direction.dot(straight[j].direction)) < kNearlyParallelCosine) continue;
      const bool i_is_longer = straight[i].length_m >= straight[j].length_m;
      const uint32_t longer = i_is_longer ? i : j, shorter = i_is_longer ? j : i;
      if (!IsPartOf(lines[shorter], straight[longer], tolerance_m, min_overlap_m)) continue;
      if (same_faces && !HaveMatchingNormals(lines[i].face_normals, lines[j].face_normals)) continue;
      const uint32_t a = root(i), b = root(j);
      first[std::max(a, b)] = std::min(a, b);
    }
  }
  std::vector<std::vector<uint32_t>> members(lines.size());
  for (uint32_t i = 0; i < lines.size(); ++i) members[root(i)].push_back(i);
  std::erase_if(members, [](const std::vector<uint32_t>& group) { return group.empty(); });
  return members;
}

// The line from one end of a group to the other, with the normals of all members. nullopt if a member is not within
// twice the tolerance of it: many lines that each turn a little form a curve.
std::optional<ModelLine> JoinGroup(absl::Span<const ModelLine> lines, absl::Span<const uint32_t> group,
                                   double tolerance_m) {
  const auto longest = std::max_element(group.begin(), group.end(), [&](uint32_t a, uint32_t b) {
    return (lines[a].p2 - lines[a].p1).squaredNorm() < (lines[b].p2 - lines[b].p1).squaredNorm();
  });
  const StraightLine straight = StraightLineOf(lines[*longest]);
  ModelLine joined = lines[*longest];
  double begin = 0.0, end = straight.length_m;
  for (const uint32_t member : group) {
    for (const Eigen::Vector3d& point : {lines[member].p1, lines[member].p2}) {
      if ((point - straight.p1).cross(straight.direction).norm() > 2.0 * tolerance_m) return std::nullopt;
      const double t = (point - straight.p1).dot(straight.direction);
      if (t < begin) joined.p1 = point;
      if (t > end) joined.p2 = point;
      begin = std::min(begin, t);
      end = std::max(end, t);
    }
    for (const Eigen::Vector3d& normal : lines[member].face_normals) {
      if (!ContainsNormal(normal, joined.face_normals, kSameNormalCosine)) joined.face_normals.push_back(normal);
    }
  }
  return joined;
}

}  // namespace

std::vector<ModelLine> JoinCollinear(absl::Span<const ModelLine> lines, double tolerance_m, double min_overlap_m,
                                     bool same_faces) {
  std::vector<ModelLine> all;
  for (const std::vector<uint32_t>& group : GroupCollinear(lines, tolerance_m, min_overlap_m, same_faces)) {
    if (std::optional<ModelLine> joined = JoinGroup(lines, group, tolerance_m); joined.has_value()) {
      all.push_back(*std::move(joined));
    } else {
      for (const uint32_t member : group) all.push_back(lines[member]);
    }
  }
  return all;
}

void MergeOverlapping(double tolerance_m, std::vector<ModelLine>& lines, std::vector<std::string>& notices) {
  std::vector<ModelLine> merged = JoinCollinear(lines, tolerance_m, tolerance_m, false);
  if (merged.size() < lines.size()) {
    notices.push_back(absl::StrCat(lines.size() - merged.size(), " lines merged with overlapping ones"));
  }
  lines = std::move(merged);
}

}  // namespace evpose
