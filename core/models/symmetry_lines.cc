// SPDX-License-Identifier: Apache-2.0
#include "core/models/symmetry_lines.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>

#include "core/models/collinear_lines.h"

namespace evpose {

CentredSegments::CentredSegments(const ObjectModel& model, double max_tolerance_m) : cell_m_(2.0 * max_tolerance_m) {
  std::vector<ModelLine> lines;
  for (const ModelLine& line : model.lines) {
    if ((line.p2 - line.p1).norm() > 0.0) lines.push_back(line);
  }
  const double tolerance_m = kCollinearTolerance * model.diameter_m;
  segments_ = JoinCollinear(lines, tolerance_m, -tolerance_m, true);
  double length_m = 0.0;
  for (const ModelLine& segment : segments_) {
    const double weight = (segment.p2 - segment.p1).norm();
    centre_ += 0.5 * weight * (segment.p1 + segment.p2);
    length_m += weight;
  }
  if (length_m > 0.0) centre_ /= length_m;
  for (ModelLine& segment : segments_) {
    segment.p1 -= centre_;
    segment.p2 -= centre_;
  }
  for (uint32_t i = 0; i < segments_.size(); ++i) {
    grid_.push_back({Cell(0.5 * (segments_[i].p1 + segments_[i].p2), Eigen::Vector3d::Zero(), 0), i});
  }
  std::sort(grid_.begin(), grid_.end());
}

// The cell of corner 0 to 7 of a cube about `point` with the half side `offset`. Cells are twice the largest tolerance
// wide, so that a cube of that half side meets only the cells of its eight corners.
uint64_t CentredSegments::Cell(const Eigen::Vector3d& point, const Eigen::Vector3d& offset, int corner) const {
  uint64_t cell = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const double coordinate = point[axis] + ((corner >> axis & 1) != 0 ? offset[axis] : -offset[axis]);
    const int64_t index = static_cast<int64_t>(std::floor(coordinate / cell_m_));
    cell = cell << 21 | (static_cast<uint64_t>(index) & 0x1fffff);
  }
  return cell;
}

std::optional<CentredSegments::Match> CentredSegments::Find(const Eigen::Matrix3d& rotation, size_t segment,
                                                            double tolerance_m) const {
  const ModelLine& from = segments_[segment];
  const Eigen::Vector3d p1 = rotation * from.p1, p2 = rotation * from.p2, middle = 0.5 * (p1 + p2);
  std::vector<Eigen::Vector3d> normals;  // of `from`, rotated; computed for the first segment that is near enough
  const auto normals_match = [&](const ModelLine& to) {
    if (normals.empty()) {
      for (const Eigen::Vector3d& normal : from.face_normals) normals.push_back(rotation * normal);
    }
    return HaveMatchingNormals(normals, to.face_normals);
  };
  std::optional<Match> best;
  double best2 = tolerance_m * tolerance_m;
  std::array<uint64_t, 8> visited;
  for (int corner = 0; corner < 8; ++corner) {
    visited[corner] = Cell(middle, Eigen::Vector3d::Constant(tolerance_m), corner);
    if (std::find(visited.begin(), visited.begin() + corner, visited[corner]) != visited.begin() + corner) continue;
    auto entry = std::lower_bound(grid_.begin(), grid_.end(), std::make_pair(visited[corner], uint32_t{0}));
    for (; entry != grid_.end() && entry->first == visited[corner]; ++entry) {
      const ModelLine& to = segments_[entry->second];
      const double same2 = std::max((to.p1 - p1).squaredNorm(), (to.p2 - p2).squaredNorm());
      const double reversed2 = std::max((to.p1 - p2).squaredNorm(), (to.p2 - p1).squaredNorm());
      const double distance2 = std::min(same2, reversed2);
      if (distance2 > best2 || !normals_match(to)) continue;
      best2 = distance2;
      best = Match{entry->second, reversed2 < same2};
    }
  }
  return best;
}

}  // namespace evpose
