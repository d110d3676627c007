// SPDX-License-Identifier: Apache-2.0
#include "core/association/visible_edges.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace evpose {
namespace {

// Changes of the view below which the visible parts are not computed again: translation of the image, pixels, which
// moves the ends of a visible part by little against a line's length; and rotation, radians (0.3 degrees). Faces that
// turn towards or away from the camera are checked separately, at every pose.
constexpr double kChangePx = 2.0;
constexpr double kChangeRad = 0.005;

}  // namespace

VisibleEdges::VisibleEdges(const ObjectModel& model, const CameraModel& camera, const VisibilityTester& tester)
    : model_(model), camera_(camera), tester_(tester) {}

bool VisibleEdges::ViewChanged(const RigidTransform& camera_from_object) const {
  if (!computed_at_) return true;
  const Vector6d change = Difference(camera_from_object, *computed_at_);
  const double depth_m = camera_from_object.translation_m.norm();
  const double focal_px = camera_.MaxFocalPx();
  return change.head<3>().norm() * focal_px > kChangePx * depth_m || change.tail<3>().norm() > kChangeRad;
}

void VisibleEdges::FacingFaces(const Eigen::Vector3d& eye, std::vector<bool>& facing) const {
  facing.clear();
  for (const ModelLine& line : model_.lines) {
    for (const Eigen::Vector3d& normal : line.face_normals) facing.push_back(normal.dot(eye - line.p1) > 0.0);
  }
}

absl::Span<const TrackedLine> VisibleEdges::At(const RigidTransform& camera_from_object) {
  const Eigen::Vector3d eye = camera_from_object.Inverse().translation_m;
  FacingFaces(eye, facing_now_);
  if (facing_now_ != facing_ || ViewChanged(camera_from_object)) {
    facing_.swap(facing_now_);
    ComputeAt(camera_from_object);
  }
  MeasureFaces(eye);
  return lines_;
}

void VisibleEdges::MeasureFaces(const Eigen::Vector3d& eye) {
  const double focal_px = camera_.MaxFocalPx();
  for (TrackedLine& line : lines_) {
    const Eigen::Vector3d to_eye = eye - 0.5 * (line.p1 + line.p2);
    const double width_px = focal_px * model_.diameter_m / to_eye.squaredNorm();
    line.narrowest_face_px = std::numeric_limits<double>::infinity();
    for (const Eigen::Vector3d& normal : model_.lines[line.model_line].face_normals) {
      line.narrowest_face_px = std::min(line.narrowest_face_px, width_px * std::abs(normal.dot(to_eye)));
    }
  }
}

void VisibleEdges::ComputeAt(const RigidTransform& camera_from_object) {
  computed_at_ = camera_from_object;
  lines_.clear();
  tester_.FindVisibleSegments(camera_, camera_from_object, segments_);
  for (const VisibleSegment& segment : segments_) {
    const ModelLine& line = model_.lines[segment.line];
    const Eigen::Vector3d extent = line.p2 - line.p1;
    lines_.push_back({segment.line, line.p1 + segment.begin * extent, line.p1 + segment.end * extent});
  }
}

void VisibleEdges::SaveState(StateWriter& writer) const { writer(computed_at_); }

void VisibleEdges::LoadState(StateReader& reader) {
  facing_.clear();
  lines_.clear();
  reader(computed_at_);
  if (!reader.ok() || !computed_at_) return;
  const RigidTransform pose = *computed_at_;
  FacingFaces(pose.Inverse().translation_m, facing_);
  ComputeAt(pose);
}

}  // namespace evpose
