// SPDX-License-Identifier: Apache-2.0
#include "core/models/collinear_lines.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/counted.h"
#include "core/numerics/disjoint_sets.h"

namespace evpose {
namespace {

// Least cosine between lines that are compared (2.6 degrees): skips most pairs. The tolerance decides about the others.
// Normals of their faces match up to 25 degrees: the faces of a noisy mesh are rough, and creases turn by more.
constexpr double kNearlyParallelCosine = 0.999;
constexpr double kMatchingNormalCosine = 0.9;
// Largest number of pairs of lines that are compared, which takes two seconds. Ordinary models need some tens per line.
constexpr int64_t kMaxPairs = 30'000'000;
// Cells of a grid along each axis, most: bounds the memory at two million cells.
constexpr double kMaxCells = 128.0;

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

// Lines by the cells of a grid that they cross, so that only lines near each other are compared.
class LineGrid {
 public:
  LineGrid(absl::Span<const ModelLine> lines, double margin_m) : margin_m_(margin_m) {
    double length_m = 0.0;
    for (const ModelLine& line : lines) {
      box_.extend(line.p1).extend(line.p2);
      length_m += (line.p2 - line.p1).norm();
    }
    const double largest_m = box_.isEmpty() ? 0.0 : box_.sizes().maxCoeff();
    const double mean_m = length_m / static_cast<double>(std::max<size_t>(1, lines.size()));
    cell_m_ = std::max({2.0 * mean_m, largest_m / kMaxCells, 8.0 * margin_m});
    for (int axis = 0; axis < 3; ++axis) {
      num_cells_[axis] = 1 + (box_.isEmpty() ? 0 : static_cast<int>(box_.sizes()[axis] / cell_m_));
    }
    for (uint32_t i = 0; i < lines.size(); ++i) AddCells(lines[i], i);
    std::sort(entries_.begin(), entries_.end());
    entries_.erase(std::unique(entries_.begin(), entries_.end()), entries_.end());
    first_.assign(static_cast<size_t>(num_cells_[0]) * num_cells_[1] * num_cells_[2] + 1, 0);
    for (const auto& [cell, line] : entries_) ++first_[cell + 1];
    std::partial_sum(first_.begin(), first_.end(), first_.begin());
  }

  // Calls `visit` with the lines in the cells around a point, among them all that come within the margin of it; with
  // some more than once.
  template <typename Visit>
  void VisitNear(const Eigen::Vector3d& point, const Visit& visit) const {
    const Eigen::Vector3d margin = Eigen::Vector3d::Constant(margin_m_);
    ForEachCell(point - margin, point + margin, [&](uint32_t cell) {
      for (uint32_t k = first_[cell]; k < first_[cell + 1]; ++k) visit(entries_[k].second);
    });
  }

 private:
  void AddCells(const ModelLine& line, uint32_t index) {
    const Eigen::Vector3d whole = line.p2 - line.p1;
    const int parts = 1 + static_cast<int>(whole.norm() / cell_m_);
    for (int part = 0; part < parts; ++part) {
      const Eigen::Vector3d from = line.p1 + static_cast<double>(part) / parts * whole;
      const Eigen::Vector3d to = line.p1 + static_cast<double>(part + 1) / parts * whole;
      ForEachCell(from.cwiseMin(to), from.cwiseMax(to), [&](uint32_t cell) { entries_.push_back({cell, index}); });
    }
  }

  int Index(double coordinate, int axis) const {
    const double index = (coordinate - box_.min()[axis]) / cell_m_;
    return static_cast<int>(std::clamp(index, 0.0, static_cast<double>(num_cells_[axis] - 1)));
  }

  template <typename Function>
  void ForEachCell(const Eigen::Vector3d& low, const Eigen::Vector3d& high, const Function& function) const {
    for (int x = Index(low.x(), 0); x <= Index(high.x(), 0); ++x) {
      for (int y = Index(low.y(), 1); y <= Index(high.y(), 1); ++y) {
        for (int z = Index(low.z(), 2); z <= Index(high.z(), 2); ++z) {
          function(static_cast<uint32_t>((x * num_cells_[1] + y) * num_cells_[2] + z));
        }
      }
    }
  }

  const double margin_m_;
  Eigen::AlignedBox3d box_;
  double cell_m_ = 0.0;
  std::array<int, 3> num_cells_ = {1, 1, 1};
  std::vector<std::pair<uint32_t, uint32_t>> entries_;  // cell and line, sorted
  std::vector<uint32_t> first_;                         // for each cell, its first entry
};

// Groups lines that are parts of one straight line. Returns indices, ascending in each group, the groups in the order
// of their first line.
std::vector<std::vector<uint32_t>> GroupCollinear(absl::Span<const ModelLine> lines, double tolerance_m,
                                                  double min_overlap_m, bool same_faces) {
  std::vector<StraightLine> straight;
  for (const ModelLine& line : lines) straight.push_back(StraightLineOf(line));
  DisjointSets groups(lines.size());
  const auto compare = [&](uint32_t i, uint32_t j) {
    if (std::abs(straight[i].direction.dot(straight[j].direction)) < kNearlyParallelCosine) return;
    const bool i_is_longer = straight[i].length_m >= straight[j].length_m;
    const uint32_t longer = i_is_longer ? i : j, shorter = i_is_longer ? j : i;
    if (!IsPartOf(lines[shorter], straight[longer], tolerance_m, min_overlap_m)) return;
    if (same_faces && !HaveMatchingNormals(lines[i].face_normals, lines[j].face_normals)) return;
    groups.Join(i, j);
  };
  // Of two lines that are parts of one, an end of one is this near to the other: the perpendicular distance is at most
  // the tolerance, and so is a gap.
  const LineGrid grid(lines, 2.0 * tolerance_m);
  int64_t comparisons = 0;
  for (uint32_t i = 0; i < lines.size() && comparisons < kMaxPairs; ++i) {
    for (const Eigen::Vector3d* end : {&lines[i].p1, &lines[i].p2}) {
      grid.VisitNear(*end, [&](uint32_t j) {
        if (i != j && ++comparisons < kMaxPairs) compare(std::min(i, j), std::max(i, j));
      });
    }
  }
  std::vector<std::vector<uint32_t>> members(lines.size());
  for (uint32_t i = 0; i < lines.size(); ++i) members[groups.Find(i)].push_back(i);
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
      if (joined.face_normals.size() < kMaxFaceNormals &&
          !ContainsNormal(normal, joined.face_normals, kSameNormalCosine))
        joined.face_normals.push_back(normal);
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
    notices.push_back(absl::StrCat(Counted(lines.size() - merged.size(), "line"), " merged with overlapping ones"));
  }
  lines = std::move(merged);
}

}  // namespace evpose
