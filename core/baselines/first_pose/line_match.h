// SPDX-License-Identifier: Apache-2.0

// Input of the baselines with known correspondences, and the linear and least-squares steps that several of them share.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/image_segment.h"
#include "core/geometry/projected_line.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

// A segment and the corresponding model line. The end points do not correspond.
struct LineMatch {
  Eigen::Vector3d p1;  // object frame, metres
  Eigen::Vector3d p2;
  ImageSegment segment;
};

// Gauss-Newton equations of the distances of points from their projected lines, pixels.
struct LineNormalEquations {
  Matrix6d hessian = Matrix6d::Zero();
  Vector6d gradient = Vector6d::Zero();
  double cost_px2 = 0.0;  // sum of the squared distances

  void Add(const ProjectedLine& line, const Eigen::Vector3d& bearing);
};

// Returns the translation in metres that solves n_j . (R P + T) = 0 for both end points P of each line in the
// least-squares sense (LOPET, Sec. III-B). With an inexact rotation both end points disagree, and their mean counts.
// Lines are weighted by the length of their segments, to which the noise of a normal is inverse. nullopt if the normals
// do not determine T.
std::optional<Eigen::Vector3d> SolveTranslation(absl::Span<const LineMatch> matches, const CameraModel& camera,
                                                const Eigen::Matrix3d& rotation);

// Refines a pose by Gauss-Newton on the distances of the end points of the segments from their projected lines, in
// pixels. nullopt if a line is not in front of the camera or the lines do not determine the pose.
std::optional<RigidTransform> RefinePose(absl::Span<const LineMatch> matches, const CameraModel& camera,
                                         const RigidTransform& start, int max_iterations);

// Root mean square of these distances in pixels; infinite if a line lies behind the camera.
double LineResidualPx(absl::Span<const LineMatch> matches, const CameraModel& camera, const RigidTransform& pose);

}  // namespace evpose
