// SPDX-License-Identifier: Apache-2.0

// The edges of a model that the tracker uses in views from all sides, and how well they determine the pose there
// (core/evaluation/README.md).
#pragma once

#include <limits>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/association/association.h"
#include "core/association/visible_edges.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

// The defaults describe a usual view; they are not tuned. model_views_test checks the results for a cube.
struct ModelViewOptions {
  int num_views = 96;        // directions, evenly over the sphere: 22 degrees apart
  double object_px = 300.0;  // diameter of the object in the image: a third of the width of a usual sensor
  // Events of the object in a window, spread evenly over the visible length of its edges, and the standard deviation of
  // their distance from the edge, pixels: typical of a window of 1 ms at 1 Mev/s.
  double events = 1000.0;
  double sigma_px = 0.7;

  absl::Status Validate() const;
};

struct ModelView {
  RigidTransform camera_from_object;
  std::vector<TrackedLine> elements;  // visible edge elements, object frame
  bool has_more = false;              // edges that the limits of lines and elements leave out
  double length_px = 0.0;             // length of all elements
  double contour_px = 0.0;            // length of the occluding contours among them
  // Standard deviation, pixels, by which the outline of the object moves along the least certain direction of motion;
  // directions of a continuous symmetry are excepted. Infinite if the elements do not determine it.
  double weakest_px = 0.0;
  // The same for each motion alone, all others being unknown: translation along x and y of the camera (across the view)
  // and z (along it), rotation about these axes through the centre.
  Vector6d deviation_px = Vector6d::Constant(std::numeric_limits<double>::infinity());
  // The least certain direction as a motion of the object about its centre, camera frame: translation, m, and rotation,
  // rad, that move the outline by about 1 px.
  Vector6d weakest = Vector6d::Zero();
};

// Directions (object frame, from the object to the camera) that are evenly spread over the sphere.
std::vector<Eigen::Vector3d> EvenDirections(int count);

// Computes views of one model. Keeps a reference to the model. Camera and options must be valid.
class ModelViewer {
 public:
  ModelViewer(const ObjectModel& model, const CameraModel& camera, const ModelViewOptions& options);

  // The view from a direction at which the object has a diameter of `object_px`, its centre on the optical axis.
  ModelView From(const Eigen::Vector3d& direction, double object_px);
  ModelView At(const RigidTransform& camera_from_object);
  // The elements of the latest view in the image, in their order.
  absl::Span<const ImageLine> image_lines() const { return image_lines_; }
  // Centre of the symmetry, or else of the bounding box, object frame.
  const Eigen::Vector3d& centre() const { return centre_; }

 private:
  Matrix6d Information(const ModelView& view, const Matrix6d& motions) const;
  void FindDeviations(ModelView& view) const;

  const ObjectModel& model_;
  const CameraModel camera_;
  const ModelViewOptions options_;
  const Eigen::Vector3d centre_;
  const ModelEdges edges_;
  VisibleEdges visible_;
  std::vector<ImageLine> image_lines_;
};

// The views of a model from a distance at which it has the given size, its centre on the optical axis. Errors:
// INVALID_ARGUMENT for invalid options or an invalid camera.
absl::StatusOr<std::vector<ModelView>> ViewModel(const ObjectModel& model, const CameraModel& camera,
                                                 const ModelViewOptions& options = {});
// The view from one direction (object frame, from the object to the camera), for a picture.
absl::StatusOr<ModelView> ViewModelFrom(const Eigen::Vector3d& direction, const ObjectModel& model,
                                        const CameraModel& camera, const ModelViewOptions& options = {});

}  // namespace evpose
