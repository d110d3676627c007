// SPDX-License-Identifier: Apache-2.0

// The image line of a model line, in a form in which the distance of an event is linear in the event.
// core/geometry/README.md, section 3, with fx != fy: d = a . b in pixels, b = (x, y, 1) the undistorted normalised
// bearing.
#pragma once

#include <Eigen/Core>
#include <optional>

#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

struct ProjectedLine {
  // d = a . b, pixels; positive to the right of the way from p1_px to p2_px, as seen on the image.
  Eigen::Vector3d a;
  Eigen::Matrix<double, 3, 6> jacobian;  // A = da / dxi, xi = [dt, dtheta] of rigid_transform.h, left perturbation
  Eigen::Vector2d p1_px;                 // projections of the end points, undistorted pixels
  Eigen::Vector2d p2_px;
};

// Projects the line from P1 to P2 (object frame, metres). A line that crosses the plane z = near_m is cut there
// (p1_px, p2_px are of the part in front); nullopt when no part lies in front, or when it projects to a point.
std::optional<ProjectedLine> ProjectLine(const CameraModel& camera, const RigidTransform& camera_from_object,
                                         const Eigen::Vector3d& p1_object, const Eigen::Vector3d& p2_object,
                                         double near_m = 1e-3);

// d(A V) / dxi under the twist V: how the line's own velocity a_dot = A V changes with the pose. For a line that
// ProjectLine projects.
Eigen::Matrix<double, 3, 6> LineVelocityJacobian(const CameraModel& camera, const RigidTransform& camera_from_object,
                                                 const Eigen::Vector3d& p1_object, const Eigen::Vector3d& p2_object,
                                                 const Vector6d& twist);

}  // namespace evpose
