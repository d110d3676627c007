// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/mesh_renderer.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>

#include "core/simulation/smooth_mesh.h"

namespace evpose {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// Pixels between the surface and its triangles: a tenth of the standard deviation of events about an edge.
constexpr double kTolerancePx = 0.02;
// Pixels. The distortion of a lens bends a longer edge by more than the tolerance: it changes by 3e-4 per pixel near
// the border of the standard cameras, which is 0.02 px on 24 px.
constexpr double kMaxEdgePx = 24.0;
constexpr double kMinDepthM = 1e-9;  // metres; protects the division
// Painted lines. Their width relative to the diameter is that of a thin pen, 1.5 px at 300 px, but at least
// kLineWidthPx at the nearest depth, because the lens and the pixels blur thinner lines to a contrast below the
// threshold of a sensor. They are farther in front of the surface, relative to the diameter, than a strip is below a
// curved one. Their light relative to that of the surface is that of dark ink.
constexpr double kLineWidth = 0.005;
constexpr double kLineWidthPx = 2.0;
constexpr double kLineLift = 1e-3;
constexpr double kLineLight = 0.25;

}  // namespace

Vector3d LightDirectionCamera() { return Vector3d(-0.4, -0.6, -0.7).normalized(); }

MeshRenderer::MeshRenderer(const ObjectModel& model, const SceneOptions& options, const CameraModel& camera,
                           double nearest_m)
    : finish_(options.finish), diffuse_ratio_(options.light.diffuse_ratio), camera_(camera) {
  SmoothMesh mesh = MakeSmoothMesh(model);
  is_closed_ = IsClosed(mesh);
  const double pixel_m = nearest_m / camera.MaxFocalPx();
  const double max_edge_m = camera.HasDistortion() ? kMaxEdgePx * pixel_m : std::numeric_limits<double>::infinity();
  Subdivide(kTolerancePx * pixel_m, max_edge_m, mesh);
  // Corners with equal points and normals become one vertex.
  std::vector<uint32_t> order(3 * mesh.triangles.size());
  for (uint32_t i = 0; i < order.size(); ++i) order[i] = i;
  const auto key = [&](uint32_t corner) {
    const Vector3d& normal = mesh.normals[corner / 3][corner % 3];
    return std::tuple(mesh.triangles[corner / 3][corner % 3], normal.x(), normal.y(), normal.z());
  };
  std::sort(order.begin(), order.end(), [&](uint32_t a, uint32_t b) { return key(a) < key(b); });
  triangles_.resize(mesh.triangles.size());
  for (size_t i = 0; i < order.size(); ++i) {
    const uint32_t corner = order[i];
    if (i == 0 || key(order[i - 1]) != key(corner)) {
      vertices_.push_back({mesh.points[mesh.triangles[corner / 3][corner % 3]], mesh.normals[corner / 3][corner % 3]});
    }
    triangles_[corner / 3][corner % 3] = static_cast<uint32_t>(vertices_.size() - 1);
  }
  AddStrips(model, std::max(kLineWidth * model.diameter_m, kLineWidthPx * pixel_m), max_edge_m);
  screen_.resize(vertices_.size());
  FindEdges();
}

void MeshRenderer::FindEdges() {
  std::vector<Edge> sides;
  for (uint32_t t = 0; t < triangles_.size(); ++t) {
    for (int k = 0; k < 3; ++k) {
      const uint32_t a = triangles_[t][k], b = triangles_[t][(k + 1) % 3];
      sides.push_back({{std::min(a, b), std::max(a, b)}, {t, kNoTriangle}});
    }
  }
  std::sort(sides.begin(), sides.end(),
            [](const Edge& a, const Edge& b) { return std::tie(a.ends, a.triangles) < std::tie(b.ends, b.triangles); });
  for (size_t i = 0; i < sides.size();) {
    size_t end = i + 1;
    while (end < sides.size() && sides[end].ends == sides[i].ends) ++end;
    if (end - i == 2) {
      edges_.push_back({sides[i].ends, {sides[i].triangles[0], sides[i + 1].triangles[0]}});
    } else {
      edges_.insert(edges_.end(), sides.begin() + static_cast<std::ptrdiff_t>(i),
                    sides.begin() + static_cast<std::ptrdiff_t>(end));
    }
    i = end;
  }
}

void MeshRenderer::AddStrips(const ObjectModel& model, double width_m, double max_part_m) {
  first_strip_vertex_ = vertices_.size();
  first_strip_ = triangles_.size();
  lift_m_ = kLineLift * model.diameter_m;
  const SmoothMesh strips = PaintedStrips(model, width_m, max_part_m);
  for (size_t i = 0; i < strips.triangles.size(); ++i) {
    const auto first = static_cast<uint32_t>(vertices_.size());
    for (int k = 0; k < 3; ++k) vertices_.push_back({strips.points[strips.triangles[i][k]], strips.normals[i][k]});
    triangles_.push_back({first, first + 1, first + 2});
  }
}

// Equation (8) of the README.
double MeshRenderer::LightOf(const Vector3d& point_camera, Vector3d normal_camera) const {
  static const Vector3d light_direction = LightDirectionCamera();
  const Vector3d to_camera = -point_camera.normalized();
  // Both sides of an open surface are visible.
  if (!is_closed_ && normal_camera.dot(to_camera) < 0.0) normal_camera = -normal_camera;
  const double lit = std::max(0.0, normal_camera.dot(light_direction));
  const double diffuse = finish_.reflectance * (1.0 - diffuse_ratio_ + diffuse_ratio_ * lit);
  double gloss = std::max(0.0, normal_camera.dot((light_direction + to_camera).normalized()));
  for (int i = 0; i < kGlossSquarings; ++i) gloss *= gloss;
  return diffuse + (lit > 0.0 ? finish_.specular_ratio * gloss : 0.0);
}

PixelRect MeshRenderer::Render(const RigidTransform& camera_from_object, double light) {
  Vector2d low = Vector2d::Constant(std::numeric_limits<double>::infinity());
  Vector2d high = -low;
  for (size_t i = 0; i < vertices_.size(); ++i) {
    Vector3d point = camera_from_object * vertices_[i].point;
    point.z() = std::max(point.z(), kMinDepthM);
    ScreenVertex& vertex = screen_[i];
    vertex.point_px = camera_.Distort(camera_.Project(point));
    const bool is_strip = i >= first_strip_vertex_;
    vertex.inverse_depth = static_cast<float>(1.0 / std::max(point.z() - (is_strip ? lift_m_ : 0.0), kMinDepthM));
    const double of_surface = light * LightOf(point, camera_from_object.rotation * vertices_[i].normal);
    vertex.light = static_cast<float>(is_strip ? kLineLight * of_surface : of_surface);
    low = low.cwiseMin(vertex.point_px);
    high = high.cwiseMax(vertex.point_px);
  }
  const Vector2d corners[] = {low, high};
  const PixelRect rect = BoundingRect(corners).Intersection({0, 0, camera_.width_px, camera_.height_px});
  seen_triangles_.clear();
  faces_camera_.clear();
  for (size_t t = 0; t < triangles_.size(); ++t) {
    const std::array<uint32_t, 3>& triangle = triangles_[t];
    const Vector2d a = screen_[triangle[0]].point_px;
    const Vector2d u = screen_[triangle[1]].point_px - a;
    const Vector2d v = screen_[triangle[2]].point_px - a;
    faces_camera_.push_back(u.x() * v.y() - u.y() * v.x() < 0.0);
    // The inside of a closed surface is never seen, and a line that is painted on a face only on its side.
    if (faces_camera_.back() || (!is_closed_ && t < first_strip_)) seen_triangles_.push_back(triangle);
  }
  seen_edges_.clear();
  for (const Edge& edge : edges_) {
    const bool first = faces_camera_[edge.triangles[0]];
    const bool is_crease = edge.triangles[1] == kNoTriangle;
    const bool is_seen = is_crease ? first || !is_closed_ : first != faces_camera_[edge.triangles[1]];
    if (is_seen) seen_edges_.push_back(edge.ends);
  }
  rasterizer_.Render(rect, {screen_, seen_triangles_, seen_edges_});
  return rect;
}

}  // namespace evpose
