// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/projected_line.h"

#include <cmath>

namespace evpose {
namespace {

// Angle (rad) between the bearings of the end points below which the line counts as a point: its direction would be
// rounding error.
constexpr double kMinSubtendedAngle = 1e-9;

using LineJacobian = Eigen::Matrix<double, 3, 6>;

// The Jacobian of n = P1 x P2 with respect to the pose, with Q = P - T (core/geometry/README.md, equation (5)):
// [ [P1 - P2]x, [P2]x [Q1]x - [P1]x [Q2]x ], where [p]x [q]x = q p^T - (p . q) I. Single assignments, because a block
// of three rows is read in pairs, for which the processor waits when they were written one by one.
LineJacobian NormalJacobian(const Eigen::Vector3d& p1, const Eigen::Vector3d& p2, const Eigen::Vector3d& q1,
                            const Eigen::Vector3d& q2) {
  const Eigen::Vector3d d = p1 - p2;
  const double trace = p2.dot(q1) - p1.dot(q2);
  const auto turn = [&](int row, int column) { return q1[row] * p2[column] - q2[row] * p1[column]; };
  LineJacobian jacobian;
  jacobian << 0.0, -d.z(), d.y(), turn(0, 0) - trace, turn(0, 1), turn(0, 2),  //
      d.z(), 0.0, -d.x(), turn(1, 0), turn(1, 1) - trace, turn(1, 2),          //
      -d.y(), d.x(), 0.0, turn(2, 0), turn(2, 1), turn(2, 2) - trace;
  return jacobian;
}

// Moves an end point between the camera and the near plane along the line onto the plane.
void CutAtNearPlane(double near_m, Eigen::Vector3d& p1, Eigen::Vector3d& p2) {
  Eigen::Vector3d& behind = p1.z() < p2.z() ? p1 : p2;
  const Eigen::Vector3d& front = p1.z() < p2.z() ? p2 : p1;
  if (behind.z() >= near_m) return;
  const double fraction = (near_m - behind.z()) / (front.z() - behind.z());
  behind += fraction * (front - behind);
  behind.z() = near_m;
}

}  // namespace

std::optional<ProjectedLine> ProjectLine(const CameraModel& camera, const RigidTransform& camera_from_object,
                                         const Eigen::Vector3d& p1_object, const Eigen::Vector3d& p2_object,
                                         double near_m) {
  const Eigen::Vector3d q1 = camera_from_object.rotation * p1_object;
  const Eigen::Vector3d q2 = camera_from_object.rotation * p2_object;
  Eigen::Vector3d p1 = q1 + camera_from_object.translation_m;
  Eigen::Vector3d p2 = q2 + camera_from_object.translation_m;
  // This form of the condition also rejects NaN.
  if (!(p1.z() > near_m || p2.z() > near_m)) return std::nullopt;
  const Eigen::Vector3d n = p1.cross(p2);
  if (!(n.squaredNorm() > kMinSubtendedAngle * kMinSubtendedAngle * p1.squaredNorm() * p2.squaredNorm())) {
    return std::nullopt;
  }

  // n . b = 0 on the line. In pixels its gradient is (n_x / fx, n_y / fy), of length rho: a = n / rho.
  const Eigen::Vector3d n_px(n.x() / camera.fx_px, n.y() / camera.fy_px, 0.0);
  const double rho = n_px.norm();
  const Eigen::Vector3d a = n / rho;
  if (!a.allFinite()) return std::nullopt;

  ProjectedLine line;
  line.a = a;
  // da = (I - a n_w^T / rho) dn / rho with n_w = (n_x / fx^2, n_y / fy^2, 0), the gradient of rho^2 / 2.
  const Eigen::RowVector2d n_w(n_px.x() / camera.fx_px, n_px.y() / camera.fy_px);
  line.jacobian = NormalJacobian(p1, p2, q1, q2);
  const Eigen::Matrix<double, 1, 6> along = n_w / rho * line.jacobian.topRows<2>();
  line.jacobian -= a * along;
  line.jacobian /= rho;

  CutAtNearPlane(near_m, p1, p2);
  line.p1_px = camera.Project(p1);
  line.p2_px = camera.Project(p2);
  return line;
}

Eigen::Matrix<double, 3, 6> LineVelocityJacobian(const CameraModel& camera, const RigidTransform& camera_from_object,
                                                 const Eigen::Vector3d& p1_object, const Eigen::Vector3d& p2_object,
                                                 const Vector6d& twist) {
  const Eigen::Vector3d q1 = camera_from_object.rotation * p1_object;
  const Eigen::Vector3d q2 = camera_from_object.rotation * p2_object;
  const Eigen::Vector3d p1 = q1 + camera_from_object.translation_m;
  const Eigen::Vector3d p2 = q2 + camera_from_object.translation_m;
  const Eigen::Vector3d w = twist.tail<3>();
  // The end points' velocities, and dn/dt along the twist: dn = dP1 x P2 + P1 x dP2.
  const Eigen::Vector3d v1 = twist.head<3>() + w.cross(q1);
  const Eigen::Vector3d v2 = twist.head<3>() + w.cross(q2);
  const Eigen::Vector3d n = p1.cross(p2);
  const Eigen::Vector3d n_dot = v1.cross(p2) + p1.cross(v2);
  const LineJacobian dn = NormalJacobian(p1, p2, q1, q2);
  // The Jacobian of n_dot: that of n with velocities in place of points, plus the change of the velocities by a
  // rotation, [P2]x [w]x [Q1]x - [P1]x [w]x [Q2]x.
  LineJacobian dn_dot = NormalJacobian(v1, v2, q1, q2);
  dn_dot.rightCols<3>() += (p2.cross(q1) - p1.cross(q2)) * w.transpose() + Hat(w.dot(q2) * p1 - w.dot(q1) * p2);

  // The derivatives of a_dot = n_dot / rho - n (n_w . n_dot) / rho^3 with respect to n and n_dot; rho^2 = n_w . n.
  const Eigen::Vector2d inverse_f2(1.0 / (camera.fx_px * camera.fx_px), 1.0 / (camera.fy_px * camera.fy_px));
  const Eigen::Vector2d n_w = n.head<2>().cwiseProduct(inverse_f2);
  const Eigen::Vector2d n_dot_w = n_dot.head<2>().cwiseProduct(inverse_f2);
  const double rho2 = n.head<2>().dot(n_w);
  const double along = n_w.dot(n_dot.head<2>()) / rho2;
  const Eigen::Matrix<double, 1, 6> by_n_w = n_w.transpose() * dn.topRows<2>();
  const Eigen::Matrix<double, 1, 6> by_n_dot_w = n_dot_w.transpose() * dn.topRows<2>();
  const Eigen::Matrix<double, 1, 6> by_both = by_n_dot_w - 3.0 * along * by_n_w + n_w.transpose() * dn_dot.topRows<2>();
  return (dn_dot - along * dn - (n_dot * by_n_w + n * by_both) / rho2) / std::sqrt(rho2);
}

}  // namespace evpose
