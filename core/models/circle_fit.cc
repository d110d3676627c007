// SPDX-License-Identifier: Apache-2.0
#include "core/models/circle_fit.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <vector>

namespace evpose {
namespace {

// Three points determine a circle; the others show whether the curve is one.
constexpr size_t kMinCirclePoints = 5;
// Largest distance of a point from the circle, relative to the height of the arc: a flat arc must be as round as a
// ring.
constexpr double kMaxRelativeCircleDistance = 0.02;
// Keeps the equations regular for collinear points, relative to their trace.
constexpr double kCircleDamping = 1e-13;
// Steps from the algebraic circle, which is exact for exact points, to the geometric one.
constexpr int kCircleSteps = 3;

// Largest distance of a point from the line through the ends; of a ring, whose ends are one point, from that point.
double ArcHeight(absl::Span<const Eigen::Vector3d> points) {
  const Eigen::Vector3d chord = points.back() - points.front();
  const double length2 = chord.squaredNorm();
  double height2 = 0.0;
  for (const Eigen::Vector3d& p : points) {
    const Eigen::Vector3d offset = p - points.front();
    const double along = length2 > 0.0 ? offset.dot(chord) / length2 : 0.0;
    height2 = std::max(height2, (offset - along * chord).squaredNorm());
  }
  return std::sqrt(height2);
}

// In the plane of the first two coordinates, (x, y, radius): |p|^2 = 2 p . c + (r^2 - |c|^2) is linear in c and the
// bracket (Kasa, "A circle fitting procedure and its error analysis", 1976).
Eigen::Vector3d AlgebraicCircle(absl::Span<const Eigen::Vector2d> points) {
  Eigen::Matrix3d a = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  for (const Eigen::Vector2d& p : points) {
    const Eigen::Vector3d row(2.0 * p.x(), 2.0 * p.y(), 1.0);
    a += row * row.transpose();
    b += row * p.squaredNorm();
  }
  a.diagonal().array() += kCircleDamping * a.trace();
  const Eigen::Vector3d solution = a.ldlt().solve(b);
  const double radius2 = solution[2] + solution.head<2>().squaredNorm();
  return {solution[0], solution[1], std::sqrt(std::max(0.0, radius2))};
}

// One Gauss-Newton step on the distances from the circle.
void StepCircle(absl::Span<const Eigen::Vector2d> points, Eigen::Vector3d& circle) {
  Eigen::Matrix3d a = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  for (const Eigen::Vector2d& p : points) {
    const Eigen::Vector2d away = p - circle.head<2>();
    const double distance = away.norm();
    if (!(distance > 0.0)) continue;
    const Eigen::Vector3d row(away.x() / distance, away.y() / distance, 1.0);
    a += row * row.transpose();
    b += row * (distance - circle[2]);
  }
  a.diagonal().array() += kCircleDamping * a.trace();
  circle += a.ldlt().solve(b);
}

}  // namespace

std::optional<Circle> FitCircle(absl::Span<const Eigen::Vector3d> points, double max_distance_m) {
  const bool is_ring = points.size() > 1 && points.front() == points.back();
  const absl::Span<const Eigen::Vector3d> distinct = is_ring ? points.subspan(1) : points;
  if (distinct.size() < kMinCirclePoints) return std::nullopt;
  const double tolerance_m = std::min(max_distance_m, kMaxRelativeCircleDistance * ArcHeight(points));
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& p : distinct) middle += (p - distinct[0]) / static_cast<double>(distinct.size());
  middle += distinct[0];
  Eigen::Matrix3d products = Eigen::Matrix3d::Zero();
  for (const Eigen::Vector3d& p : distinct) products += (p - middle) * (p - middle).transpose();
  const double size_m = std::sqrt(products.trace() / static_cast<double>(distinct.size()));
  if (!(size_m > 0.0)) return std::nullopt;
  products /= products.trace();
  Circle circle;
  circle.axis = Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(products).eigenvectors().col(0);
  const Eigen::Vector3d e1 = circle.axis.unitOrthogonal(), e2 = circle.axis.cross(e1);
  std::vector<Eigen::Vector2d> flat;
  for (const Eigen::Vector3d& p : distinct) {
    flat.emplace_back((p - middle).dot(e1) / size_m, (p - middle).dot(e2) / size_m);
  }
  Eigen::Vector3d fit = AlgebraicCircle(flat);
  for (int i = 0; i < kCircleSteps; ++i) StepCircle(flat, fit);
  circle.centre = middle + size_m * (fit.x() * e1 + fit.y() * e2);
  circle.radius_m = size_m * fit.z();
  for (const Eigen::Vector3d& p : distinct) {
    const double height_m = (p - circle.centre).dot(circle.axis);
    const double across_m = (p - circle.centre - height_m * circle.axis).norm() - circle.radius_m;
    // Written so that a fit that is not finite fails.
    if (!(height_m * height_m + across_m * across_m <= tolerance_m * tolerance_m)) return std::nullopt;
  }
  return circle;
}

}  // namespace evpose
