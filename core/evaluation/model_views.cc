// SPDX-License-Identifier: Apache-2.0
#include "core/evaluation/model_views.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

#include "core/association/observability.h"
#include "core/association/visible_edges.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/geometry/motion_prior.h"
#include "core/geometry/spiral_direction.h"
#include "core/models/visibility.h"

namespace evpose {
namespace {

// Returns the centre of the bounding box of the model, object frame.
Eigen::Vector3d CentreOf(const ObjectModel& model) {
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& vertex : model.vertices) box.extend(vertex);
  for (const ModelLine& line : model.lines) box.extend(line.p1).extend(line.p2);
  return box.center();
}

// Returns the pose at which the camera looks along -direction at `centre` from `distance_m`.
RigidTransform LookAt(const Eigen::Vector3d& direction, const Eigen::Vector3d& centre, double distance_m) {
  const Eigen::Vector3d forward = -direction.normalized();
  // The vertical of the image is the object's z axis, unless the camera looks along it.
  const Eigen::Vector3d up = std::abs(forward.z()) < 0.99 ? Eigen::Vector3d::UnitZ() : Eigen::Vector3d::UnitY();
  const Eigen::Vector3d right = forward.cross(up).normalized();
  RigidTransform pose;
  pose.rotation << right.transpose(), forward.cross(right).transpose(), forward.transpose();
  pose.translation_m = Eigen::Vector3d(0.0, 0.0, distance_m) - pose.rotation * centre;
  return pose;
}

}  // namespace

ModelViewer::ModelViewer(const ObjectModel& model, const CameraModel& camera, const ModelViewOptions& options)
    : model_(model),
      camera_(camera),
      options_(options),
      centre_(model.continuous_symmetry ? model.continuous_symmetry->centre : CentreOf(model)),
      edges_(model, VisibilityOptions(), {.max_arc_px = 0.0}),  // the pictures have straight elements
      visible_(camera, edges_) {}

ModelView ModelViewer::From(const Eigen::Vector3d& direction, double object_px) {
  return At(LookAt(direction, centre_, camera_.MaxFocalPx() * model_.diameter_m / object_px));
}

ModelView ModelViewer::At(const RigidTransform& camera_from_object) {
  ModelView view;
  view.camera_from_object = camera_from_object;
  const absl::Span<const TrackedLine> elements = visible_.At(view.camera_from_object);
  view.elements.assign(elements.begin(), elements.end());
  view.has_more = visible_.has_more();
  MotionState state;
  state.camera_from_object = view.camera_from_object;
  ProjectLines(camera_, state, view.elements, image_lines_);
  for (size_t i = 0; i < view.elements.size(); ++i) {
    view.length_px += image_lines_[i].length_px;
    if (view.elements[i].kind == EdgeKind::kContour) view.contour_px += image_lines_[i].length_px;
  }
  FindDeviations(view);
  return view;
}

// The information of the events about the motions, 1/px^2.
Matrix6d ModelViewer::Information(const ModelView& view, const Matrix6d& motions) const {
  Matrix6d information = Matrix6d::Zero();
  for (const ImageLine& line : image_lines_) {
    if (!line.in_view()) continue;
    const double events = options_.events * line.length_px / view.length_px;
    AddInformation(camera_, line, events / (options_.sigma_px * options_.sigma_px), motions, information);
  }
  return information;
}

void ModelViewer::FindDeviations(ModelView& view) const {
  view.weakest_px = std::numeric_limits<double>::infinity();
  if (!(view.length_px > 0.0)) return;
  const Matrix6d motions = OutlineMotions(camera_, view.camera_from_object, centre_, 0.5 * model_.diameter_m);
  Matrix6d information = Information(view, motions);
  // The free rotations count as known.
  const Eigen::Matrix3Xd free = FreeRotations(model_, view.camera_from_object.rotation);
  information.bottomRightCorner<3, 3>() += information.trace() * free * free.transpose();
  const Eigen::SelfAdjointEigenSolver<Matrix6d> solver(information);
  // Below it, an eigenvalue is due to rounding.
  constexpr double kRounding = 1e-12;
  const Vector6d variances = solver.eigenvalues().unaryExpr([largest = solver.eigenvalues()(5)](double value) {
    return value > kRounding * largest ? 1.0 / value : std::numeric_limits<double>::infinity();
  });
  view.weakest_px = std::sqrt(variances(0));
  for (int motion = 0; motion < 6; ++motion) {
    double variance = 0.0;
    for (int i = 0; i < 6; ++i) {
      const double share = solver.eigenvectors()(motion, i) * solver.eigenvectors()(motion, i);
      if (share > kRounding) variance += share * variances(i);
    }
    view.deviation_px(motion) = std::sqrt(variance);
  }
  view.weakest = motions * solver.eigenvectors().col(0);
}

std::vector<Eigen::Vector3d> EvenDirections(int count) {
  std::vector<Eigen::Vector3d> directions;
  for (int i = 0; i < count; ++i) directions.push_back(SpiralDirection(i, 1.0 - (2.0 * i + 1.0) / count));
  return directions;
}

absl::Status ModelViewOptions::Validate() const {
  constexpr int kMaxViews = 10'000;  // two degrees apart; bounds the time
  EVPOSE_RETURN_IF_ERROR(CheckRange("num_views", num_views, 1, kMaxViews));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("object_px", object_px));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("events", events));
  return CheckPositive("sigma_px", sigma_px);
}

absl::StatusOr<std::vector<ModelView>> ViewModel(const ObjectModel& model, const CameraModel& camera,
                                                 const ModelViewOptions& options) {
  EVPOSE_RETURN_IF_ERROR(camera.Validate());
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  ModelViewer viewer(model, camera, options);
  std::vector<ModelView> views;
  for (const Eigen::Vector3d& direction : EvenDirections(options.num_views)) {
    views.push_back(viewer.From(direction, options.object_px));
  }
  return views;
}

absl::StatusOr<ModelView> ViewModelFrom(const Eigen::Vector3d& direction, const ObjectModel& model,
                                        const CameraModel& camera, const ModelViewOptions& options) {
  EVPOSE_RETURN_IF_ERROR(camera.Validate());
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  return ModelViewer(model, camera, options).From(direction, options.object_px);
}

}  // namespace evpose
