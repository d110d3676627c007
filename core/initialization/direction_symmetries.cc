// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/direction_symmetries.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "core/base/yield_point.h"

namespace evpose {
namespace {

// Sine of the angle between two unit vectors up to sign; for small angles it equals the angle.
double SineBetween(const Eigen::Vector3d& a, const Eigen::Vector3d& b) { return a.cross(b).norm(); }

// Sine of the angle between a vector and the nearest direction of the set, up to sign.
double SineToSet(absl::Span<const Eigen::Vector3d> directions, const Eigen::Vector3d& v) {
  double nearest = 1.0;
  for (const Eigen::Vector3d& direction : directions) nearest = std::min(nearest, SineBetween(direction, v));
  return nearest;
}

double Deviation(absl::Span<const Eigen::Vector3d> directions, const Eigen::Matrix3d& rotation) {
  double worst = 0.0;
  for (const Eigen::Vector3d& v : directions) worst = std::max(worst, SineToSet(directions, rotation * v));
  return worst;
}

// Right-handed frame of unit vectors: first axis a, second axis in the plane of a and b. The function of the same name
// in core/models/symmetry.cc also normalises a. The rounding of that division would change the bits of poses here.
Eigen::Matrix3d Frame(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  Eigen::Matrix3d frame;
  frame.col(0) = a;
  frame.col(2) = a.cross(b).normalized();
  frame.col(1) = frame.col(2).cross(a);
  return frame;
}

bool Holds(const std::vector<Eigen::Matrix3d>& rotations, const Eigen::Matrix3d& rotation, double tolerance_rad) {
  return std::any_of(rotations.begin(), rotations.end(), [&](const Eigen::Matrix3d& other) {
    return (other - rotation).norm() < 4.0 * tolerance_rad;  // the Frobenius norm is about sqrt(2) times the angle
  });
}

// Returns whether the set is closed under products. Rotations that map the directions onto themselves only within the
// tolerance need not form a group.
bool IsClosed(const std::vector<Eigen::Matrix3d>& rotations, double tolerance_rad) {
  for (const Eigen::Matrix3d& a : rotations) {
    for (const Eigen::Matrix3d& b : rotations) {
      if (!Holds(rotations, a * b, tolerance_rad)) return false;
    }
  }
  return true;
}

}  // namespace

std::vector<Eigen::Vector3d> UniqueDirections(const ObjectModel& model, double tolerance_rad) {
  std::vector<Eigen::Vector3d> unique;
  for (const ModelLine& line : model.lines) {
    const double length = (line.p2 - line.p1).norm();
    if (!(length > 0.0)) continue;
    const Eigen::Vector3d direction = (line.p2 - line.p1) / length;
    if (unique.empty() || SineToSet(unique, direction) > tolerance_rad) unique.push_back(direction);
  }
  return unique;
}

std::vector<Eigen::Matrix3d> DirectionSymmetries(absl::Span<const Eigen::Vector3d> directions, double tolerance_rad) {
  std::vector<Eigen::Matrix3d> symmetries = {Eigen::Matrix3d::Identity()};
  if (directions.size() < 2) return symmetries;
  // A rotation is determined by the images of the first two directions; their angle is preserved.
  const Eigen::Matrix3d from = Frame(directions[0], directions[1]);
  const double cosine = directions[0].dot(directions[1]);
  for (const Eigen::Vector3d& a : directions) {
    for (const Eigen::Vector3d& b : directions) {
      YieldPoint();
      for (int signs = 0; signs < 4; ++signs) {
        const Eigen::Vector3d to_a = (signs & 1) != 0 ? Eigen::Vector3d(-a) : a;
        const Eigen::Vector3d to_b = (signs & 2) != 0 ? Eigen::Vector3d(-b) : b;
        if (SineBetween(to_a, to_b) <= tolerance_rad) continue;
        if (std::abs(to_a.dot(to_b) - cosine) > 2.0 * tolerance_rad) continue;
        const Eigen::Matrix3d rotation = Frame(to_a, to_b) * from.transpose();
        if (Deviation(directions, rotation) > tolerance_rad || Holds(symmetries, rotation, tolerance_rad)) continue;
        symmetries.push_back(rotation);
      }
    }
  }
  if (!IsClosed(symmetries, tolerance_rad)) symmetries.resize(1);
  return symmetries;
}

std::vector<Eigen::Matrix3d> SignSymmetries(absl::Span<const Eigen::Vector3d> directions, double tolerance_rad) {
  std::vector<Eigen::Vector3d> unique;
  for (const Eigen::Vector3d& v : directions) {
    if (unique.empty() || SineToSet(unique, v) > tolerance_rad) unique.push_back(v);
  }
  std::vector<Eigen::Matrix3d> kept;
  for (const Eigen::Matrix3d& q : DirectionSymmetries(unique, tolerance_rad)) {
    const auto stays = [&](const Eigen::Vector3d& v) { return SineBetween(q * v, v) <= tolerance_rad; };
    if (std::all_of(unique.begin(), unique.end(), stays)) kept.push_back(q);
  }
  return kept;
}

double SymmetryDeviation(absl::Span<const Eigen::Vector3d> directions, absl::Span<const Eigen::Matrix3d> symmetries) {
  double worst = 0.0;
  for (const Eigen::Matrix3d& rotation : symmetries) worst = std::max(worst, Deviation(directions, rotation));
  return worst;
}

}  // namespace evpose
