// SPDX-License-Identifier: Apache-2.0

// Tessellated models of shapes with known contours, with exact normals at the corners, and views of them.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <numbers>
#include <utility>
#include <vector>

#include "core/contours/edge_elements.h"
#include "core/models/object_model.h"
#include "core/models/view_testing.h"
#include "core/numerics/statistics.h"

namespace evpose {

// Distance of a point from a surface, negative inside.
using DistanceField = std::function<double(const Eigen::Vector3d&)>;

inline Eigen::Vector3d GradientOf(const DistanceField& field, const Eigen::Vector3d& point) {
  constexpr double kStep = 1e-6;
  Eigen::Vector3d gradient;
  for (int axis = 0; axis < 3; ++axis) {
    const Eigen::Vector3d step = kStep * Eigen::Vector3d::Unit(axis);
    gradient[axis] = field(point + step) - field(point - step);
  }
  return gradient.normalized();
}

class ModelBuilder {
 public:
  ObjectModel model;

  uint32_t AddRegion(const SurfaceRegion& region = {}) {
    model.surface.regions.push_back(region);
    return static_cast<uint32_t>(model.surface.regions.size() - 1);
  }
  uint32_t AddVertex(const Eigen::Vector3d& point) {
    model.vertices.push_back(point);
    return static_cast<uint32_t>(model.vertices.size() - 1);
  }
  // Adds a triangle with the winding of its normals; none without area.
  void AddTriangle(std::array<uint32_t, 3> corners, uint32_t region,
                   const std::function<Eigen::Vector3d(const Eigen::Vector3d&)>& normal_at) {
    const auto point = [&](int k) { return model.vertices[corners[k]]; };
    const Eigen::Vector3d area = (point(1) - point(0)).cross(point(2) - point(0));
    if (area.norm() < 1e-12) return;
    if (area.dot(normal_at((point(0) + point(1) + point(2)) / 3.0)) < 0.0) std::swap(corners[1], corners[2]);
    model.triangles.push_back(corners);
    model.surface.region_of.push_back(region);
    model.surface.normals.push_back(
        {normal_at(point(0)).cast<float>(), normal_at(point(1)).cast<float>(), normal_at(point(2)).cast<float>()});
  }
  // Adds a grid of count_u times count_v quadrangles, closed along u, and along v if `is_ring_v`. `point_at` has the
  // arguments u and v in [0, 1]. If all points of a row coincide, as at a pole, they are one vertex.
  void AddGrid(int count_u, int count_v, bool is_ring_v, const std::function<Eigen::Vector3d(double, double)>& point_at,
               uint32_t region, const std::function<Eigen::Vector3d(const Eigen::Vector3d&)>& normal_at) {
    std::vector<std::vector<uint32_t>> rows;
    for (int v = 0; v < count_v + (is_ring_v ? 0 : 1); ++v) {
      std::vector<uint32_t>& row = rows.emplace_back();
      for (int u = 0; u < count_u; ++u) {
        const Eigen::Vector3d point = point_at(static_cast<double>(u) / count_u, static_cast<double>(v) / count_v);
        const bool is_pole = u > 0 && (point - model.vertices[row[0]]).norm() < 1e-9;
        row.push_back(is_pole ? row[0] : AddVertex(point));
      }
    }
    for (int v = 0; v < count_v; ++v) {
      const auto& low = rows[v];
      const auto& high = rows[(v + 1) % rows.size()];
      for (int u = 0; u < count_u; ++u) {
        const int next = (u + 1) % count_u;
        AddTriangle({low[u], low[next], high[next]}, region, normal_at);
        AddTriangle({low[u], high[next], high[u]}, region, normal_at);
      }
    }
  }
};

inline Eigen::Vector2d OnCircle(double turn) {
  return {std::cos(2.0 * std::numbers::pi * turn), std::sin(2.0 * std::numbers::pi * turn)};
}

inline double TorusField(const Eigen::Vector3d& p, double ring_m, double tube_m) {
  return std::hypot(p.head<2>().norm() - ring_m, p.z()) - tube_m;
}
inline double CapsuleField(const Eigen::Vector3d& p, double half_m, double radius_m) {
  return (p - Eigen::Vector3d(0, 0, std::clamp(p.z(), -half_m, half_m))).norm() - radius_m;
}

// Torus about the z axis.
inline ObjectModel TorusModel(double ring_m, double tube_m, int count_u, int count_v) {
  ModelBuilder builder;
  builder.AddGrid(
      count_u, count_v, true,
      [=](double u, double v) {
        const Eigen::Vector2d tube = tube_m * OnCircle(v), around = (ring_m + tube.x()) * OnCircle(u);
        return Eigen::Vector3d(around.x(), around.y(), tube.y());
      },
      builder.AddRegion(),
      [=](const Eigen::Vector3d& p) {
        return GradientOf([=](const Eigen::Vector3d& q) { return TorusField(q, ring_m, tube_m); }, p);
      });
  builder.model.diameter_m = 2.0 * (ring_m + tube_m);
  return builder.model;
}

// Capsule along z as one region of unknown shape, of an odd number of rows; the middle one is the cylinder. A sphere,
// of an even number, has none.
inline ObjectModel CapsuleModel(double half_m, double radius_m, int count_u, int count_v) {
  ModelBuilder builder;
  const int cap_rows = count_v / 2;
  builder.AddGrid(
      count_u, count_v, false,
      [=](double u, double v) {
        const int row = static_cast<int>(std::lround(v * count_v));
        const bool is_above = row <= cap_rows;
        const int cap_row = is_above || half_m == 0.0 ? row : row - 1;
        const Eigen::Vector2d profile = OnCircle(0.25 * cap_row / cap_rows);  // from +z to -z
        const Eigen::Vector2d around = radius_m * profile.y() * OnCircle(u);
        return Eigen::Vector3d(around.x(), around.y(), radius_m * profile.x() + (is_above ? half_m : -half_m));
      },
      builder.AddRegion(),
      [=](const Eigen::Vector3d& p) {
        return GradientOf([=](const Eigen::Vector3d& q) { return CapsuleField(q, half_m, radius_m); }, p);
      });
  builder.model.diameter_m = 2.0 * (half_m + radius_m);
  return builder.model;
}

inline ObjectModel SphereModel(double radius_m, int count, bool is_fitted) {
  ObjectModel model = CapsuleModel(0.0, radius_m, count, count / 2);
  if (is_fitted) model.surface.regions[0] = {RegionShape::kSphere, {0, 0, 0}, {0, 0, 0}, radius_m, 0.0, true};
  return model;
}

// A circle about an axis parallel to z with `count` corners.
inline EdgeCurve RingCurve(const Eigen::Vector3d& centre, double radius_m, int count,
                           const Eigen::Vector3d& face_normal, double wall_sign) {
  EdgeCurve curve;
  for (int i = 0; i <= count; ++i) {
    const Eigen::Vector2d p = OnCircle(static_cast<double>(i % count) / count);
    curve.points.emplace_back(centre + radius_m * Eigen::Vector3d(p.x(), p.y(), 0.0));
    if (i == count) break;
    const Eigen::Vector2d n = wall_sign * OnCircle((i + 0.5) / count);
    curve.face_normals.push_back({face_normal, Eigen::Vector3d(n.x(), n.y(), 0.0)});
  }
  curve.turn_rad = 0.5 * std::numbers::pi;
  return curve;
}

// Cylinder along z with its caps and their creases.
inline ObjectModel CylinderModel(double half_m, double radius_m, int count) {
  ModelBuilder builder;
  const uint32_t wall = builder.AddRegion({RegionShape::kCylinder, {0, 0, 0}, {0, 0, 1}, radius_m, 0.0, true});
  builder.AddGrid(
      count, 1, false,
      [=](double u, double v) {
        const Eigen::Vector2d p = radius_m * OnCircle(u);
        return Eigen::Vector3d(p.x(), p.y(), (2.0 * v - 1.0) * half_m);
      },
      wall, [](const Eigen::Vector3d& p) { return Eigen::Vector3d(p.x(), p.y(), 0.0).normalized(); });
  for (const double side : {-1.0, 1.0}) {
    const Eigen::Vector3d normal(0, 0, side), centre(0, 0, side * half_m);
    const uint32_t cap = builder.AddRegion({RegionShape::kPlane, centre, normal});
    const uint32_t middle = builder.AddVertex(centre);
    const uint32_t first = side < 0.0 ? 0 : static_cast<uint32_t>(count);
    for (int i = 0; i < count; ++i) {
      builder.AddTriangle({middle, first + i, first + (i + 1) % count}, cap,
                          [normal](const Eigen::Vector3d&) { return normal; });
    }
    builder.model.curves.push_back(RingCurve(centre, radius_m, count, normal, 1.0));
  }
  builder.model.diameter_m = 2.0 * std::hypot(half_m, radius_m);
  return builder.model;
}

// Square plates of width 2 `half_m` about the points (x, 0, 0), each with a hole along z, from z = -thickness to 0.
// Curves: for each hole the rim in front (z = 0), then the rim behind.
inline ObjectModel PlateWithHoles(double half_m, double radius_m, double thickness_m, int count,
                                  const std::vector<double>& xs) {
  ModelBuilder builder;
  for (const double x : xs) {
    const Eigen::Vector3d centre(x, 0, 0), below(0, 0, -thickness_m);
    const auto hole = [=](double u) {
      const Eigen::Vector2d p = radius_m * OnCircle(u);
      return Eigen::Vector3d(centre + Eigen::Vector3d(p.x(), p.y(), 0.0));
    };
    const auto border = [=](double u) {
      const Eigen::Vector2d p = OnCircle(u);
      const Eigen::Vector2d q = half_m / p.cwiseAbs().maxCoeff() * p;
      return Eigen::Vector3d(centre + Eigen::Vector3d(q.x(), q.y(), 0.0));
    };
    for (const double side : {1.0, -1.0}) {
      const Eigen::Vector3d shift = side > 0.0 ? Eigen::Vector3d(0, 0, 0) : below, normal(0, 0, side);
      builder.AddGrid(
          count, 1, false, [=](double u, double v) { return Eigen::Vector3d((v < 0.5 ? hole(u) : border(u)) + shift); },
          builder.AddRegion({RegionShape::kPlane, shift, normal}), [=](const Eigen::Vector3d&) { return normal; });
      builder.model.curves.push_back(RingCurve(centre + shift, radius_m, count, normal, -1.0));
    }
    const uint32_t wall = builder.AddRegion({RegionShape::kCylinder, centre, {0, 0, 1}, radius_m, 0.0, false});
    builder.AddGrid(
        count, 1, false, [=](double u, double v) { return Eigen::Vector3d(hole(u) + v * below); }, wall,
        [=](const Eigen::Vector3d& p) {
          return Eigen::Vector3d((centre - p).cwiseProduct(Eigen::Vector3d(1, 1, 0)).normalized());
        });
  }
  builder.model.diameter_m = 4.0 * half_m * static_cast<double>(xs.size());
  return builder.model;
}

inline CameraModel ContourCamera() { return {640, 480, 700.0, 700.0, 320.0, 240.0, {}}; }

inline std::vector<EdgeElement> ElementsOf(const ObjectModel& model, const Eigen::Vector3d& eye,
                                           const EdgeElementOptions& options = {}) {
  const TriangleBvh faces(model.vertices, model.triangles);
  const EdgeElementExtractor extractor(model, faces, options);
  const CameraModel camera = ContourCamera();
  const RigidTransform pose = ViewFrom(eye);
  std::vector<EdgeElement> elements;
  extractor.Extract(camera, pose, DetailLevel(model, camera, pose, -1), elements);
  return elements;
}

// Five points along each element.
inline std::vector<Eigen::Vector3d> SamplesOf(const EdgeElement& element) {
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < 5; ++i) points.emplace_back(element.p1 + (0.1 + 0.2 * i) * (element.p2 - element.p1));
  return points;
}

inline double LengthPx(const std::vector<EdgeElement>& elements, EdgeKind kind, const Eigen::Vector3d& eye) {
  double length_px = 0.0;
  const CameraModel camera = ContourCamera();
  const RigidTransform pose = ViewFrom(eye);
  for (const EdgeElement& element : elements) {
    if (element.kind == kind)
      length_px += (camera.Project(pose * element.p1) - camera.Project(pose * element.p2)).norm();
  }
  return length_px;
}

// How far, pixels, the ray through a point passes the surface nearest to that point: 0 on the contour, positive
// outside.
inline double OutsidePx(const DistanceField& field, const Eigen::Vector3d& eye, const Eigen::Vector3d& point,
                        double window_m) {
  const double distance_m = (point - eye).norm();
  const Eigen::Vector3d ray = (point - eye) / distance_m;
  double low = distance_m - window_m, high = distance_m + window_m;
  for (int i = 0; i < 100; ++i) {
    const double a = low + (high - low) / 3.0, b = high - (high - low) / 3.0;
    (field(eye + a * ray) < field(eye + b * ray) ? high : low) = field(eye + a * ray) < field(eye + b * ray) ? b : a;
  }
  return field(eye + low * ray) * ContourCamera().fx_px / low;
}

// Whether the surface hides a point: the ray enters it by more than `depth_m` before.
inline bool IsHidden(const DistanceField& field, const Eigen::Vector3d& eye, const Eigen::Vector3d& point,
                     double depth_m) {
  constexpr int kSteps = 2000;
  for (int i = 0; i < kSteps; ++i) {
    if (field(eye + static_cast<double>(i) / kSteps * (point - eye)) < -depth_m) return true;
  }
  return false;
}

// The p-quantile; NaN if there are no values.
inline double Quantile(std::vector<double> values, double p) {
  return values.empty() ? std::nan("") : UpperQuantile(values, p);
}

}  // namespace evpose
