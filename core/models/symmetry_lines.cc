#include "core/models/symmetry_lines.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>

namespace evpose {
namespace {

// Lines within this of one straight line are parts of it, of the model's diameter: as edges of a mesh are joined.
constexpr double kCollinearTolerance = 1e-5;
// Directions that may belong to one straight line; the tolerance above decides.
constexpr double kNearlyParallelCosine = 0.999;
// Faces that look the same way: 25 degrees, for the faces of a noisy model are rough, and creases turn by more.
constexpr double kSameNormalCosine = 0.9;

bool EachHasItsLike(absl::Span<const Eigen::Vector3d> from, absl::Span<const Eigen::Vector3d> to) {
  return std::all_of(from.begin(), from.end(), [&](const Eigen::Vector3d& normal) {
    return std::any_of(to.begin(), to.end(),
                       [&](const Eigen::Vector3d& other) { return other.dot(normal) > kSameNormalCosine; });
  });
}

bool LookTheSameWay(absl::Span<const Eigen::Vector3d> a, absl::Span<const Eigen::Vector3d> b) {
  return EachHasItsLike(a, b) && EachHasItsLike(b, a);
}

struct Straight {
  Eigen::Vector3d p1, direction;
  double length_m;
};

Straight StraightOf(const ModelLine& line) {
  const double length_m = (line.p2 - line.p1).norm();
  return {line.p1, (line.p2 - line.p1) / length_m, length_m};
}

// Both ends of `line` near the straight line of `longer`, and some of it between that one's ends.
bool IsPartOf(const ModelLine& line, const Straight& longer, double tolerance_m) {
  const Eigen::Vector3d d1 = line.p1 - longer.p1, d2 = line.p2 - longer.p1;
  if (d1.cross(longer.direction).norm() > tolerance_m || d2.cross(longer.direction).norm() > tolerance_m) return false;
  const double t1 = d1.dot(longer.direction), t2 = d2.dot(longer.direction);
  return std::max(t1, t2) >= -tolerance_m && std::min(t1, t2) <= longer.length_m + tolerance_m;
}

// For each line the first of those that make one straight line with it.
std::vector<uint32_t> GroupCollinear(absl::Span<const ModelLine> lines, double tolerance_m) {
  std::vector<Straight> straight;
  for (const ModelLine& line : lines) straight.push_back(StraightOf(line));
  std::vector<uint32_t> group(lines.size());
  std::iota(group.begin(), group.end(), 0u);
  const auto root = [&group](uint32_t i) {
    while (group[i] != i) i = group[i] = group[group[i]];
    return i;
  };
  for (uint32_t i = 0; i < lines.size(); ++i) {
    for (uint32_t j = i + 1; j < lines.size(); ++j) {
      if (std::abs(straight[i].direction.dot(straight[j].direction)) < kNearlyParallelCosine) continue;
      const bool i_is_longer = straight[i].length_m >= straight[j].length_m;
      if (!IsPartOf(lines[i_is_longer ? j : i], straight[i_is_longer ? i : j], tolerance_m)) continue;
      if (!LookTheSameWay(lines[i].face_normals, lines[j].face_normals)) continue;
      const uint32_t a = root(i), b = root(j);
      group[std::max(a, b)] = std::min(a, b);
    }
  }
  for (uint32_t i = 0; i < lines.size(); ++i) group[i] = root(i);
  return group;
}

// The straight line from one end of the group to the other, or the lines as they are: many edges that hardly turn are
// a curve.
void AppendJoined(absl::Span<const ModelLine> lines, absl::Span<const uint32_t> members, double tolerance_m,
                  std::vector<CentredSegment>& segments) {
  const auto longest = std::max_element(members.begin(), members.end(), [&](uint32_t a, uint32_t b) {
    return (lines[a].p2 - lines[a].p1).squaredNorm() < (lines[b].p2 - lines[b].p1).squaredNorm();
  });
  const Straight straight = StraightOf(lines[*longest]);
  CentredSegment joined{lines[*longest].p1, lines[*longest].p2, lines[*longest].face_normals};
  double begin = 0.0, end = straight.length_m, farthest_m = 0.0;
  for (const uint32_t member : members) {
    for (const Eigen::Vector3d& point : {lines[member].p1, lines[member].p2}) {
      const double t = (point - straight.p1).dot(straight.direction);
      farthest_m = std::max(farthest_m, (point - straight.p1).cross(straight.direction).norm());
      if (t < begin) joined.p1 = point;
      if (t > end) joined.p2 = point;
      begin = std::min(begin, t);
      end = std::max(end, t);
    }
  }
  if (farthest_m <= 2.0 * tolerance_m) {
    segments.push_back(std::move(joined));
    return;
  }
  for (const uint32_t member : members) {
    segments.push_back({lines[member].p1, lines[member].p2, lines[member].face_normals});
  }
}

}  // namespace

CentredSegments::CentredSegments(const ObjectModel& model, double max_tolerance_m) : cell_m_(2.0 * max_tolerance_m) {
  std::vector<ModelLine> lines;
  for (const ModelLine& line : model.lines) {
    if ((line.p2 - line.p1).norm() > 0.0) lines.push_back(line);
  }
  const double tolerance_m = kCollinearTolerance * model.diameter_m;
  const std::vector<uint32_t> group = GroupCollinear(lines, tolerance_m);
  std::vector<std::vector<uint32_t>> members(lines.size());
  for (uint32_t i = 0; i < lines.size(); ++i) members[group[i]].push_back(i);
  for (const std::vector<uint32_t>& group_members : members) {
    if (!group_members.empty()) AppendJoined(lines, group_members, tolerance_m, segments_);
  }
  double length_m = 0.0;
  for (const CentredSegment& segment : segments_) {
    const double weight = (segment.p2 - segment.p1).norm();
    centre_ += 0.5 * weight * (segment.p1 + segment.p2);
    length_m += weight;
  }
  if (length_m > 0.0) centre_ /= length_m;
  for (CentredSegment& segment : segments_) {
    segment.p1 -= centre_;
    segment.p2 -= centre_;
  }
  BuildGrid();
}

// Cells are twice the largest tolerance wide: of the cube of that tolerance about a point, the eight corners' cells
// are all that it meets. Corner 0 to 7 of the cube of half the side `offset`.
uint64_t CentredSegments::Cell(const Eigen::Vector3d& point, const Eigen::Vector3d& offset, int corner) const {
  uint64_t cell = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const double coordinate = point[axis] + ((corner >> axis & 1) != 0 ? offset[axis] : -offset[axis]);
    const int64_t index = static_cast<int64_t>(std::floor(coordinate / cell_m_));
    cell = cell << 21 | (static_cast<uint64_t>(index) & 0x1fffff);
  }
  return cell;
}

void CentredSegments::BuildGrid() {
  for (uint32_t i = 0; i < segments_.size(); ++i) {
    grid_.push_back({Cell(0.5 * (segments_[i].p1 + segments_[i].p2), Eigen::Vector3d::Zero(), 0), i});
  }
  std::sort(grid_.begin(), grid_.end());
}

std::optional<CentredSegments::Match> CentredSegments::Find(const Eigen::Matrix3d& rotation, size_t segment,
                                                            double tolerance_m) const {
  const CentredSegment& from = segments_[segment];
  const Eigen::Vector3d p1 = rotation * from.p1, p2 = rotation * from.p2, middle = 0.5 * (p1 + p2);
  std::vector<Eigen::Vector3d> normals;  // rotated when a segment lies near enough to ask
  const auto look_the_same_way = [&](const CentredSegment& to) {
    if (normals.empty()) {
      for (const Eigen::Vector3d& normal : from.normals) normals.push_back(rotation * normal);
    }
    return LookTheSameWay(normals, to.normals);
  };
  std::optional<Match> best;
  double best2 = tolerance_m * tolerance_m;
  std::array<uint64_t, 8> visited;
  for (int corner = 0; corner < 8; ++corner) {
    visited[corner] = Cell(middle, Eigen::Vector3d::Constant(tolerance_m), corner);
    if (std::find(visited.begin(), visited.begin() + corner, visited[corner]) != visited.begin() + corner) continue;
    auto entry = std::lower_bound(grid_.begin(), grid_.end(), std::make_pair(visited[corner], uint32_t{0}));
    for (; entry != grid_.end() && entry->first == visited[corner]; ++entry) {
      const CentredSegment& to = segments_[entry->second];
      const double same2 = std::max((to.p1 - p1).squaredNorm(), (to.p2 - p2).squaredNorm());
      const double reversed2 = std::max((to.p1 - p2).squaredNorm(), (to.p2 - p1).squaredNorm());
      const double distance2 = std::min(same2, reversed2);
      if (distance2 > best2 || !look_the_same_way(to)) continue;
      best2 = distance2;
      best = Match{entry->second, reversed2 < same2, std::sqrt(distance2)};
    }
  }
  return best;
}

}  // namespace evpose
