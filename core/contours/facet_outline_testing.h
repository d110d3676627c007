// SPDX-License-Identifier: Apache-2.0

// Models whose facets are those of the object, and the outline of convex ones in the image.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <limits>
#include <vector>

#include "core/geometry/camera.h"
#include "core/models/object_model.h"

namespace evpose {

// The model of the same triangles, which are those of the object.
inline ObjectModel WithFacets(const ObjectModel& shape, ModelOptions options = {}) {
  RawMesh mesh;
  mesh.points = shape.vertices;
  mesh.triangles = shape.triangles;
  options.is_smooth = false;
  return BuildObjectModel(mesh, options).value();
}

// Corners of the convex hull of the projected vertices, in order (Andrew, 1979).
inline std::vector<Eigen::Vector2d> OutlineOfVertices(const ObjectModel& model,
                                                      const RigidTransform& camera_from_object,
                                                      const CameraModel& camera) {
  std::vector<Eigen::Vector2d> points;
  for (const Eigen::Vector3d& vertex : model.vertices) points.push_back(camera.Project(camera_from_object * vertex));
  std::sort(points.begin(), points.end(), [](const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
    return a.x() != b.x() ? a.x() < b.x() : a.y() < b.y();
  });
  std::vector<Eigen::Vector2d> hull;
  for (const bool is_lower : {true, false}) {
    const size_t first = hull.size();
    for (const Eigen::Vector2d& point : points) {
      const auto turns_left = [&] {
        const Eigen::Vector2d a = hull.back() - hull[hull.size() - 2], b = point - hull.back();
        return a.x() * b.y() - a.y() * b.x() > 0.0;
      };
      while (hull.size() >= first + 2 && !turns_left()) hull.pop_back();
      hull.push_back(point);
    }
    hull.pop_back();
    if (is_lower) std::reverse(points.begin(), points.end());
  }
  return hull;
}

// Distance of a point from the nearest side of a polygon.
inline double DistanceFrom(const std::vector<Eigen::Vector2d>& polygon, const Eigen::Vector2d& point) {
  double least = std::numeric_limits<double>::infinity();
  for (size_t i = 0; i < polygon.size(); ++i) {
    const Eigen::Vector2d along = polygon[(i + 1) % polygon.size()] - polygon[i];
    const double position = std::clamp((point - polygon[i]).dot(along) / along.squaredNorm(), 0.0, 1.0);
    least = std::min(least, (point - polygon[i] - position * along).norm());
  }
  return least;
}

}  // namespace evpose
