// SPDX-License-Identifier: Apache-2.0
#include "core/models/symmetry_lines.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "core/models/circle_fit.h"
#include "core/models/collinear_lines.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

// Number of segments that represent a curve with ends. The ends alone do not determine its shape.
constexpr size_t kSegmentsOfCurve = 4;
// Points of a ring that is no circle. Between them a smooth ring is nearer than the tolerance to its chords.
constexpr size_t kOutlinePoints = 128;
// Largest distance of a ring from a circle that is equal to all rotated copies of itself, relative to the diameter.
constexpr double kCircleTolerance = 5e-4;

double LengthOf(const EdgeCurve& curve) {
  double length_m = 0.0;
  for (size_t i = 0; i + 1 < curve.points.size(); ++i) length_m += (curve.points[i + 1] - curve.points[i]).norm();
  return length_m;
}

// Points along a curve at equal steps of its length, one more than `count`.
std::vector<Eigen::Vector3d> StepsAlong(const EdgeCurve& curve, size_t count) {
  const double step_m = LengthOf(curve) / static_cast<double>(count);
  std::vector<Eigen::Vector3d> steps = {curve.points.front()};
  double passed_m = 0.0;
  for (size_t i = 0; i + 1 < curve.points.size(); ++i) {
    const Eigen::Vector3d along = curve.points[i + 1] - curve.points[i];
    const double length_m = along.norm();
    while (steps.size() < count && passed_m + length_m >= step_m * static_cast<double>(steps.size())) {
      const double rest_m = step_m * static_cast<double>(steps.size()) - passed_m;
      steps.emplace_back(curve.points[i] + (length_m > 0.0 ? rest_m / length_m : 0.0) * along);
    }
    passed_m += length_m;
  }
  steps.push_back(curve.points.back());
  return steps;
}

// The centre of a curve's length.
Eigen::Vector3d MiddleOf(const EdgeCurve& curve, double length_m) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (size_t i = 0; i + 1 < curve.points.size(); ++i) {
    sum += 0.5 * (curve.points[i + 1] - curve.points[i]).norm() * (curve.points[i + 1] + curve.points[i]);
  }
  return sum / length_m;
}

// Twice the area that a ring encloses, along the normal.
Eigen::Vector3d AreaOf(const EdgeCurve& ring) {
  Eigen::Vector3d area = Eigen::Vector3d::Zero();
  for (size_t i = 0; i + 1 < ring.points.size(); ++i) {
    area += (ring.points[i] - ring.points[0]).cross(ring.points[i + 1] - ring.points[0]);
  }
  return area;
}

}  // namespace

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
  origins_.assign(segments_.size(), Origin::kLine);
  outlines_.resize(segments_.size());
  for (const EdgeCurve& curve : model.curves) {
    const double weight = LengthOf(curve);
    if (!(weight > 0.0)) continue;
    AddCurve(curve, kCircleTolerance * model.diameter_m);
    centre_ += weight * MiddleOf(curve, weight);
    length_m += weight;
  }
  if (length_m > 0.0) centre_ /= length_m;
  for (std::vector<Eigen::Vector3d>& outline : outlines_) {
    for (Eigen::Vector3d& point : outline) point -= centre_;
  }
  for (ModelLine& segment : segments_) {
    segment.p1 -= centre_;
    segment.p2 -= centre_;
  }
  for (uint32_t i = 0; i < segments_.size(); ++i) {
    grid_.push_back({Cell(0.5 * (segments_[i].p1 + segments_[i].p2), Eigen::Vector3d::Zero(), 0), i});
  }
  std::sort(grid_.begin(), grid_.end());
}

void CentredSegments::AddCurve(const EdgeCurve& curve, double tolerance_m) {
  if (!curve.is_ring()) {
    const std::vector<Eigen::Vector3d> steps = StepsAlong(curve, kSegmentsOfCurve);
    for (size_t i = 0; i + 1 < steps.size(); ++i) {
      segments_.push_back({steps[i], steps[i + 1], {}, curve.kind});
      origins_.push_back(Origin::kCurve);
      outlines_.emplace_back();
    }
    return;
  }
  const double length_m = LengthOf(curve);
  const Eigen::Vector3d middle = MiddleOf(curve, length_m), area = AreaOf(curve);
  Eigen::Vector3d half = Eigen::Vector3d::Zero();  // a ring without area has a centre only
  if (area.norm() > tolerance_m * length_m) half = length_m / (2.0 * std::numbers::pi) * area.normalized();
  segments_.push_back({middle - half, middle + half, {}, curve.kind});
  origins_.push_back(Origin::kRing);
  const bool is_circle = FitCircle(curve.points, tolerance_m).has_value();
  outlines_.push_back(is_circle ? std::vector<Eigen::Vector3d>() : StepsAlong(curve, kOutlinePoints));
}

std::vector<double> CentredSegments::LobesOf(size_t segment, const Eigen::Vector3d& axis, double least_m) const {
  const std::vector<Eigen::Vector3d>& points = outlines_[segment];
  if (points.size() < 3) return {};
  const size_t count = points.size() - 1;  // the last point is the first
  const Eigen::Vector3d first = axis.unitOrthogonal(), second = axis.cross(first);
  std::vector<double> radii_m, angles_rad;  // angles continue beyond half a turn
  for (size_t i = 0; i < points.size(); ++i) {
    const double x = points[i].dot(first), y = points[i].dot(second);
    const double angle_rad = DeterministicAtan2(y, x), turns = 2.0 * std::numbers::pi;
    radii_m.push_back(std::sqrt(x * x + y * y));
    angles_rad.push_back(i == 0 ? angle_rad : angle_rad + turns * std::round((angles_rad.back() - angle_rad) / turns));
  }
  const auto [low, high] = std::minmax_element(radii_m.begin(), radii_m.end());
  const double level_m = 0.5 * (*low + *high), round_rad = angles_rad[count] - angles_rad[0];
  const auto begin = static_cast<size_t>(low - radii_m.begin()) % count;
  std::vector<double> lobes;
  double rise_rad = 0.0, crossing_rad = 0.0;  // where the level was crossed: into the present part, and last
  bool is_above = false;
  for (size_t k = 1; k <= count; ++k) {
    const size_t i = (begin + k - 1) % count;
    const double from_m = radii_m[i] - level_m, to_m = radii_m[i + 1] - level_m;
    if ((from_m < 0.0) != (to_m < 0.0)) {
      const double rounds = begin + k - 1 >= count ? round_rad : 0.0;
      crossing_rad = angles_rad[i] + rounds + from_m / (from_m - to_m) * (angles_rad[i + 1] - angles_rad[i]);
    }
    if (is_above ? to_m >= -least_m : to_m <= least_m) continue;
    if (is_above) lobes.push_back(0.5 * (rise_rad + crossing_rad));
    rise_rad = crossing_rad;
    is_above = !is_above;
  }
  return lobes;
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
  // Normals of `from`, rotated; computed for the first segment that is near enough.
  std::vector<Eigen::Vector3d> normals;
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
      if (origins_[entry->second] != origins_[segment]) continue;
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
