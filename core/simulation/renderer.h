// SPDX-License-Identifier: Apache-2.0

// Renders the image that the sensor's pixels integrate: linear light with exact area coverage, through the lens.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/simulation/mesh_renderer.h"
#include "core/simulation/objects.h"
#include "core/simulation/rasterizer.h"
#include "core/simulation/scene.h"

namespace evpose {

class SceneRenderer {
 public:
  // Keeps a reference to `object`, which must outlive it. `options` and `camera` must be valid. The seed determines the
  // texture of the background.
  SceneRenderer(const SceneOptions& options, const SceneObject& object, const CameraModel& camera, uint64_t seed);

  // Renders the scene at `t_s` since the start. Returns the pixels that may differ from the previous picture (all of
  // them in the first call); the others are unchanged.
  PixelRect Render(const RigidTransform& camera_from_object, double t_s);

  // Light per pixel, row by row: 1 is white paint under full light.
  const std::vector<float>& picture() const { return picture_; }

  // Returns the largest motion in the image between two times, pixels, of the object's extremes, the occluder, and the
  // texture and the moving edge of the background.
  double LargestMotionPx(const RigidTransform& pose_a, double t_a_s, const RigidTransform& pose_b, double t_b_s) const;

  // Returns the longest step that resolves the changes of the light, seconds.
  double LongestStepS() const;

 private:
  struct Shape {  // a polygon ready for the rasterizer
    std::vector<Eigen::Vector2d> points_px;
    double value;
    double alpha;
  };

  std::vector<Shape> MakeTexture(uint64_t seed) const;
  // Paints the background without its moving edge as it is at `t_s`.
  void PaintBackground(double t_s);
  bool IsTextureMoving() const;
  // Displacement of the texture since its middle position, pixels.
  Eigen::Vector2d TextureShiftPx(double t_s) const;
  double LightAt(double t_s) const;
  std::vector<Shape> BodyShapes(const Body& body, const RigidTransform& camera_from_object, double light) const;
  std::vector<Shape> OccluderShapes(const RigidTransform& camera_from_object, double t_s) const;
  std::vector<Eigen::Vector2d> ProjectOutline(const std::vector<Eigen::Vector3d>& outline_object,
                                              const RigidTransform& camera_from_object) const;
  double OccluderX(const RigidTransform& camera_from_object, double t_s) const;
  double EdgeX(double t_s) const;
  // Repaints the area that the moving edge has swept since the previous call; returns it.
  PixelRect MoveBackgroundEdge(double t_s);
  void Composite(const std::vector<Shape>& shapes);

  SceneOptions options_;
  const SceneObject& object_;
  CameraModel camera_;
  PixelRect image_;
  CoverageRasterizer rasterizer_;
  GaussianBlur blur_;
  std::unique_ptr<MeshRenderer> mesh_;  // renderer of SceneOptions::model
  std::vector<Shape> texture_;          // of the background, in its middle position; the last one is in front
  std::vector<float> background_;       // without the lens, under full light
  std::vector<float> edgeless_;         // the same without the moving edge; empty if there is none
  std::vector<float> sharp_;            // the image without the lens
  std::vector<float> picture_;
  PixelRect last_rect_;
  double last_background_light_ = -1.0;
  std::optional<double> last_edge_x_px_;
};

}  // namespace evpose
