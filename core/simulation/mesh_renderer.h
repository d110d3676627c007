// SPDX-License-Identifier: Apache-2.0

// Renders the model of a file as a smooth, shaded surface with its painted lines.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/simulation/mesh_rasterizer.h"
#include "core/simulation/scene.h"

namespace evpose {

// Unit vector towards the light, camera frame: above, to the left, and on the side of the camera.
Eigen::Vector3d LightDirectionCamera();

class MeshRenderer {
 public:
  // `nearest_m` is the smallest depth at which the model will be seen: the surface is divided so that it is exact to
  // 0.02 px there.
  MeshRenderer(const ObjectModel& model, const SceneOptions& options, const CameraModel& camera, double nearest_m);

  // Computes the picture at this pose; `light` is that of the lamp. Returns the pixels that it may cover.
  PixelRect Render(const RigidTransform& camera_from_object, double light);
  // Draws this picture over another one, whose stride is the camera's width.
  void CompositeOnto(std::vector<float>& picture) const { rasterizer_.CompositeOnto(camera_.width_px, picture); }

 private:
  // A point of the surface with one normal; a point of a crease has several.
  struct Vertex {
    Eigen::Vector3d point;
    Eigen::Vector3d normal;
  };

  // An edge of one triangle (a border, or one side of a crease) or of two triangles with equal normals there.
  static constexpr uint32_t kNoTriangle = 0xFFFFFFFF;
  struct Edge {
    std::array<uint32_t, 2> ends;       // indices of vertices_
    std::array<uint32_t, 2> triangles;  // indices of triangles_; the second one may be kNoTriangle
  };

  void FindEdges();
  // Appends the painted lines of the model, with vertices of their own.
  void AddStrips(const ObjectModel& model, double width_m, double max_part_m);
  double LightOf(const Eigen::Vector3d& point_camera, Eigen::Vector3d normal_camera) const;

  const MeshFinish finish_;
  const double diffuse_ratio_;
  const CameraModel camera_;
  std::vector<Vertex> vertices_;
  std::vector<std::array<uint32_t, 3>> triangles_;  // indices of vertices_
  std::vector<Edge> edges_;
  size_t first_strip_vertex_ = 0;  // first vertex of the painted lines, which are last
  size_t first_strip_ = 0;         // first of their triangles
  double lift_m_ = 0.0;            // by which these are drawn nearer to the camera than the surface
  bool is_closed_ = false;
  std::vector<ScreenVertex> screen_;  // vertices_ in the image
  std::vector<bool> faces_camera_;    // whether each of triangles_ faces the camera
  std::vector<std::array<uint32_t, 3>> seen_triangles_;
  std::vector<std::array<uint32_t, 2>> seen_edges_;  // contours, borders and creases
  MeshRasterizer rasterizer_;
};

}  // namespace evpose
