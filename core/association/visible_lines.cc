// SPDX-License-Identifier: Apache-2.0
#include "core/association/visible_lines.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace evpose {
namespace {

// The image moved by as much as an event is rounded by, or the view turned by a quarter of what the grazing limit
// allows: less changes nothing that matters.
constexpr double kChangePx = 2.0;
constexpr double kChangeRad = 0.005;

}  // namespace

VisibleLines::VisibleLines(const ObjectModel& model, const CameraModel& camera, const VisibilityTester& tester)
    : model_(model), camera_(camera), tester_(tester) {}

bool VisibleLines::ViewChanged(const RigidTransform& camera_from_object) const {
  if (!looked_from_) return true;
  const Vector6d change = Difference(camera_from_object, *looked_from_);
  const double depth_m = camera_from_object.translation_m.norm();
  const double focal_px = camera_.MaxFocalPx();
  return change.head<3>().norm() * focal_px > kChangePx * depth_m || change.tail<3>().norm() > kChangeRad;
}

void VisibleLines::FacingFaces(const Eigen::Vector3d& eye, std::vector<bool>& facing) const {
  facing.clear();
  for (const ModelLine& line : model_.lines) {
    for (const Eigen::Vector3d& normal : line.face_normals) facing.push_back(normal.dot(eye - line.p1) > 0.0);
  }
}

absl::Span<const TrackedLine> VisibleLines::At(const RigidTransform& camera_from_object) {
  const Eigen::Vector3d eye = camera_from_object.Inverse().translation_m;
  FacingFaces(eye, facing_now_);
  if (facing_now_ != facing_ || ViewChanged(camera_from_object)) {
    facing_.swap(facing_now_);
    LookFrom(camera_from_object);
  }
  MeasureFaces(eye);
  return lines_;
}

void VisibleLines::MeasureFaces(const Eigen::Vector3d& eye) {
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

void VisibleLines::LookFrom(const RigidTransform& camera_from_object) {
  looked_from_ = camera_from_object;
  lines_.clear();
  tester_.FindVisibleSegments(camera_, camera_from_object, segments_);
  for (const VisibleSegment& segment : segments_) {
    const ModelLine& line = model_.lines[segment.line];
    const Eigen::Vector3d extent = line.p2 - line.p1;
    lines_.push_back({segment.line, line.p1 + segment.begin * extent, line.p1 + segment.end * extent});
  }
}

void VisibleLines::SaveState(StateWriter& writer) const { writer(looked_from_); }

void VisibleLines::LoadState(StateReader& reader) {
  facing_.clear();
  lines_.clear();
  reader(looked_from_);
  if (!reader.ok() || !looked_from_) return;
  const RigidTransform pose = *looked_from_;
  FacingFaces(pose.Inverse().translation_m, facing_);
  LookFrom(pose);
}

}  // namespace evpose
