// SPDX-License-Identifier: Apache-2.0
#include "core/models/symmetry_rings.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <tuple>

#include "core/numerics/math.h"

namespace evpose {
namespace {

constexpr double kPi = std::numbers::pi;
// A segment of a curve that turns by more about the axis is no chord of a circle about it.
constexpr double kMaxTurnRad = kPi / 2.0;

}  // namespace

AxialRings::AxialRings(const ObjectModel& model, const Eigen::Vector3d& centre, const Eigen::Vector3d& axis,
                       double tolerance_m)
    : centre_(centre),
      axis_(axis),
      first_(axis.unitOrthogonal()),
      second_(axis.cross(first_)),
      tolerance_m_(tolerance_m) {
  for (const ModelLine& line : model.lines) AddSegment(line.p1, line.p2, line.kind, false);
  for (const EdgeCurve& curve : model.curves) {
    for (size_t i = 0; i + 1 < curve.points.size(); ++i) {
      AddSegment(curve.points[i], curve.points[i + 1], curve.kind, true);
    }
  }
  std::sort(arcs_.begin(), arcs_.end(), IsBefore);
  CountIncomplete();
}

bool AxialRings::IsBefore(const Arc& a, const Arc& b) {
  const auto key = [](const Arc& arc) {
    return std::tie(arc.kind, arc.radius_cell, arc.height_cell, arc.begin_rad, arc.end_rad);
  };
  return key(a) < key(b);
}

AxialRings::Polar AxialRings::ToPolar(const Eigen::Vector3d& point) const {
  const Eigen::Vector3d d = point - centre_;
  const double x = d.dot(first_), y = d.dot(second_);
  return {std::sqrt(x * x + y * y), d.dot(axis_), DeterministicAtan2(y, x)};
}

// Points of one circle are within two tolerances: cells that are as wide make them neighbours.
int64_t AxialRings::Cell(double coordinate_m) const {
  return static_cast<int64_t>(std::floor(coordinate_m / (2.0 * tolerance_m_)));
}

void AxialRings::AddSegment(const Eigen::Vector3d& p1, const Eigen::Vector3d& p2, EdgeKind kind, bool may_bend) {
  const double length_m = (p2 - p1).norm();
  length_m_ += length_m;
  const Polar a = ToPolar(p1), b = ToPolar(p2);
  if (std::max(a.radius_m, b.radius_m) <= tolerance_m_) {
    has_one_sided_axis_line_ |= std::abs(a.height_m + b.height_m) > 2.0 * tolerance_m_;
    return;
  }
  double turn_rad = b.angle_rad - a.angle_rad;
  if (turn_rad > kPi) turn_rad -= 2.0 * kPi;
  if (turn_rad < -kPi) turn_rad += 2.0 * kPi;
  const double radius_m = 0.5 * (a.radius_m + b.radius_m), height_m = 0.5 * (a.height_m + b.height_m);
  const double sagitta_m = may_bend ? 0.0 : radius_m - ToPolar(0.5 * (p1 + p2)).radius_m;
  if (std::abs(a.radius_m - b.radius_m) > tolerance_m_ || std::abs(a.height_m - b.height_m) > tolerance_m_ ||
      sagitta_m > tolerance_m_ || std::abs(turn_rad) > kMaxTurnRad) {
    broken_m_ += length_m;
    return;
  }
  const Arc arc = {kind, Cell(radius_m), Cell(height_m), 0.0, 0.0, radius_m, height_m, length_m};
  AddArc(arc, turn_rad < 0.0 ? b.angle_rad : a.angle_rad, std::abs(turn_rad));
}

void AxialRings::AddArc(Arc arc, double begin_rad, double turn_rad) {
  arc.begin_rad = begin_rad;
  arc.end_rad = std::min(begin_rad + turn_rad, kPi);
  arcs_.push_back(arc);
  if (begin_rad + turn_rad <= kPi) return;
  arc.begin_rad = -kPi;
  arc.end_rad = begin_rad + turn_rad - 2.0 * kPi;
  arc.length_m = 0.0;  // counted with the first part
  arcs_.push_back(arc);
}

void AxialRings::FindNear(EdgeKind kind, int64_t radius_cell, int64_t height_cell, std::vector<Arc>& found) const {
  for (int64_t radius = radius_cell - 1; radius <= radius_cell + 1; ++radius) {
    Arc key = {kind, radius, height_cell - 1, -kPi, -kPi, 0.0, 0.0, 0.0};
    const auto begin = std::lower_bound(arcs_.begin(), arcs_.end(), key, IsBefore);
    key.height_cell = height_cell + 2;
    const auto end = std::lower_bound(begin, arcs_.end(), key, IsBefore);
    found.insert(found.end(), begin, end);
  }
}

bool AxialRings::CoverAll(std::vector<Arc>& arcs) const {
  std::sort(arcs.begin(), arcs.end(), [](const Arc& a, const Arc& b) { return a.begin_rad < b.begin_rad; });
  double covered_rad = -kPi;
  for (const Arc& arc : arcs) {
    // A gap that is not longer than the tolerance is none.
    const double gap_rad = tolerance_m_ / std::max(arc.radius_m, tolerance_m_);
    if (arc.begin_rad > covered_rad + gap_rad) return false;
    covered_rad = std::max(covered_rad, arc.end_rad);
  }
  return !arcs.empty() && covered_rad + tolerance_m_ / std::max(arcs.back().radius_m, tolerance_m_) >= kPi;
}

void AxialRings::CountIncomplete() {
  std::vector<Arc> near;
  for (size_t begin = 0; begin < arcs_.size();) {
    const Arc& first = arcs_[begin];
    size_t end = begin;
    double length_m = 0.0;
    for (; end < arcs_.size() && arcs_[end].kind == first.kind && arcs_[end].radius_cell == first.radius_cell &&
           arcs_[end].height_cell == first.height_cell;
         ++end) {
      length_m += arcs_[end].length_m;
    }
    near.clear();
    FindNear(first.kind, first.radius_cell, first.height_cell, near);
    if (!CoverAll(near)) broken_m_ += length_m;
    begin = end;
  }
}

bool AxialRings::AreFlippable() const {
  if (has_one_sided_axis_line_) return false;
  std::vector<Arc> near;
  for (size_t i = 0; i < arcs_.size(); ++i) {
    const Arc& arc = arcs_[i];
    // The result is the same for all arcs of one circle.
    if (i > 0 && arcs_[i - 1].kind == arc.kind && arcs_[i - 1].radius_cell == arc.radius_cell &&
        arcs_[i - 1].height_cell == arc.height_cell) {
      continue;
    }
    near.clear();
    FindNear(arc.kind, arc.radius_cell, Cell(-arc.height_m), near);
    if (near.empty()) return false;
  }
  return true;
}

}  // namespace evpose
