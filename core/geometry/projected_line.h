// SPDX-License-Identifier: Apache-2.0

// The image line of a model line as a vector a, such that the distance of an event is linear in its bearing b = (x, y,
// 1): d = a . b in pixels (core/geometry/README.md, section 3; also for fx != fy).
#pragma once

#include <Eigen/Core>
#include <optional>

#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

struct ProjectedLine {
  // d = a . b in pixels, positive on the right side of the direction from p1_px to p2_px, as the image is displayed.
  Eigen::Vector3d a;
  Eigen::Matrix<double, 3, 6> jacobian;  // A = da / dxi, the tangent of rigid_transform.h
  Eigen::Vector2d p1_px;                 // projected end points, undistorted pixels
  Eigen::Vector2d p2_px;
};

// Projects the line from P1 to P2 (object frame, metres). A line that crosses the plane z = near_m is cut there: p1_px
// and p2_px belong to the part in front. nullopt if no part lies in front, or if the line projects to a point.
std::optional<ProjectedLine> ProjectLine(const CameraModel& camera, const RigidTransform& camera_from_object,
                                         const Eigen::Vector3d& p1_object, const Eigen::Vector3d& p2_object,
                                         double near_m = 1e-3);

// d(A V) / dxi: the derivative of the line's velocity a_dot = A V under the twist V with respect to the pose. Only for
// a line for which ProjectLine has a result.
Eigen::Matrix<double, 3, 6> LineVelocityJacobian(const CameraModel& camera, const RigidTransform& camera_from_object,
                                                 const Eigen::Vector3d& p1_object, const Eigen::Vector3d& p2_object,
                                                 const Vector6d& twist);

// Speed (px/s) of the line along its image normal at the bearing b = (x, y, 1) under the twist [v (m/s), w (rad/s)];
// positive towards the side where d = a . b is positive. For b on the line it is the normal component of the image
// velocity of that point of the line: a . b remains 0 on the moving line, so that a . b_dot = -a_dot . b.
double NormalVelocity(const ProjectedLine& line, const Vector6d& twist, const Eigen::Vector3d& bearing);

}  // namespace evpose
