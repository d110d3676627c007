// SPDX-License-Identifier: Apache-2.0
#include "core/models/slippage.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "absl/types/span.h"

namespace evpose {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Matrix36d = Eigen::Matrix<double, 3, 6>;
using Row6d = Eigen::Matrix<double, 6, 1>;

struct Corners {
  std::array<Vector3d, 3> points;
  Vector3d area_normal;  // length: twice the area
};

Corners CornersOf(const ObjectModel& model, size_t triangle) {
  const auto& [a, b, c] = model.triangles[triangle];
  Corners corners;
  corners.points = {model.vertices[a], model.vertices[b], model.vertices[c]};
  corners.area_normal = (corners.points[1] - corners.points[0]).cross(corners.points[2] - corners.points[0]);
  return corners;
}

// Sets the centroid and the radius. Returns twice the area, 0 without one.
double MeasureArea(const ObjectModel& model, SurfaceMoments& moments) {
  double area = 0.0;
  const Vector3d origin = model.vertices.empty() ? Vector3d(Vector3d::Zero()) : model.vertices[0];
  Vector3d sum = Vector3d::Zero();
  for (size_t i = 0; i < model.triangles.size(); ++i) {
    const Corners corners = CornersOf(model, i);
    const double weight = corners.area_normal.norm();
    area += weight;
    for (const Vector3d& point : corners.points) sum += weight / 3.0 * (point - origin);
  }
  if (!(area > 0.0)) return 0.0;
  moments.centroid = origin + sum / area;
  double squares = 0.0;
  for (size_t i = 0; i < model.triangles.size(); ++i) {
    const Corners corners = CornersOf(model, i);
    const double weight = corners.area_normal.norm();
    for (const Vector3d& point : corners.points) squares += weight / 3.0 * (point - moments.centroid).squaredNorm();
  }
  moments.radius_m = std::sqrt(squares / area);
  return area;
}

Matrix3d BlockAbout(const SurfaceMoments& moments, const Vector3d& point) {
  // (x - p) x n = x x n - p x n.
  Matrix36d about;
  about << Matrix3d::Identity(), -Hat(point);
  return about * moments.slippage * about.transpose();
}

}  // namespace

SurfaceMoments MomentsOf(const ObjectModel& model) {
  SurfaceMoments moments;
  const double area = MeasureArea(model, moments);
  if (!(area > 0.0)) return moments;
  const bool is_smooth = model.surface.normals.size() == model.triangles.size();
  for (size_t i = 0; i < model.triangles.size(); ++i) {
    const Corners corners = CornersOf(model, i);
    const double weight = corners.area_normal.norm();
    if (!(weight > 0.0)) continue;
    const Vector3d facet_normal = corners.area_normal / weight;
    for (int k = 0; k < 3; ++k) {
      // The corners lie on the true surface and have its normals. For a facet, the middles of the sides integrate the
      // quadratic form exactly.
      Vector3d point = corners.points[k];
      Vector3d normal = facet_normal;
      if (is_smooth) {
        const Vector3d stated = model.surface.normals[i][k].cast<double>();
        if (stated.squaredNorm() > 0.0) normal = stated.normalized();
      } else {
        point = 0.5 * (point + corners.points[(k + 1) % 3]);
      }
      Row6d row;
      row << ((point - moments.centroid) / moments.radius_m).cross(normal), normal;
      moments.slippage.noalias() += (weight / (3.0 * area)) * row * row.transpose();
    }
  }
  return moments;
}

SlippageAxis FindSlippageAxis(const SurfaceMoments& moments, const Matrix3d& preferred) {
  // The direction depends on the point in second order only.
  constexpr int kRounds = 3;
  // Share of the surface whose normals are not parallel to the axis, below which the point stays near the centroid: for
  // a flat disc only its centroid is known.
  constexpr double kDamping = 1e-4;
  SlippageAxis axis;
  axis.point = Vector3d::Zero();
  for (int round = 0; round < kRounds; ++round) {
    const Eigen::SelfAdjointEigenSolver<Matrix3d> solver(Matrix3d(BlockAbout(moments, axis.point) + preferred));
    axis.direction = solver.eigenvectors().col(0);
    for (int i = 0; i < 3; ++i) axis.ratios[i] = std::sqrt(std::max(0.0, solver.eigenvalues()[i]));
    // core/models/README.md, equation (6).
    const Matrix3d across = Hat(axis.direction);
    const Matrix3d normals = moments.slippage.bottomRightCorner<3, 3>();
    const Matrix3d hessian = across * normals * across.transpose() + kDamping * Matrix3d::Identity();
    const Vector3d right = -across * (moments.slippage.bottomLeftCorner<3, 3>() * axis.direction);
    axis.point = hessian.ldlt().solve(right);
    axis.point -= axis.direction * axis.direction.dot(axis.point);
  }
  return axis;
}

Matrix3d LineSlippage(const ObjectModel& model, const SurfaceMoments& moments) {
  Matrix3d sum = Matrix3d::Zero();
  double length_m = 0.0;
  const auto add = [&](const Vector3d& a, const Vector3d& b) {
    const double segment_m = (b - a).norm();
    if (!(segment_m > 0.0)) return;
    const Vector3d tangent = (b - a) / segment_m;
    const Vector3d middle = (0.5 * (a + b) - moments.centroid) / moments.radius_m;
    const Matrix3d moved = Hat(tangent) * Hat(middle);  // length of t x (x x omega): the speed across the line
    sum += segment_m * moved.transpose() * moved;
    length_m += segment_m;
  };
  for (const ModelLine& line : model.lines) add(line.p1, line.p2);
  for (const EdgeCurve& curve : model.curves) {
    for (size_t i = 0; i + 1 < curve.points.size(); ++i) add(curve.points[i], curve.points[i + 1]);
  }
  return length_m > 0.0 ? Matrix3d(sum / length_m) : sum;
}

}  // namespace evpose
