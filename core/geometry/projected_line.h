// The image line of a model line, in a form in which the distance of an event is linear in the event.
// method.md 2.7, with fx != fy: d = a . b in pixels, b = (x, y, 1) the undistorted normalised bearing.
#pragma once

#include <optional>

#include <Eigen/Core>

#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

struct ProjectedLine {
  Eigen::Vector3d a;                     // d = a . b, pixels; sign: positive on the side of the image normal
  Eigen::Matrix<double, 3, 6> jacobian;  // A = da / dxi, xi = [dt, dtheta] of rigid_transform.h, left perturbation
  Eigen::Vector2d p1_px;                 // projections of the end points, undistorted pixels
  Eigen::Vector2d p2_px;
};

// Projects the line from P1 to P2 (object frame, metres). A line that crosses the plane z = near_m is cut there
// (p1_px, p2_px are of the part in front); nullopt when no part lies in front, or when it projects to a point.
std::optional<ProjectedLine> ProjectLine(const CameraModel& camera, const RigidTransform& camera_from_object,
                                         const Eigen::Vector3d& p1_object, const Eigen::Vector3d& p2_object,
                                         double near_m = 1e-3);

// Image velocity, pixels per second, of the point at `point_px` on the line under the twist [v (m/s), w (rad/s)]
// (dT/dt = v, dR/dt = w^ R), along the line's image normal: -a_dot . b where d = a . b stays 0 on the line.
double NormalVelocity(const ProjectedLine& line, const Vector6d& twist, const Eigen::Vector3d& bearing);

}  // namespace evpose
