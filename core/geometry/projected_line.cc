#include "core/geometry/projected_line.h"

#include <cmath>

namespace evpose {
namespace {

// The end points are seen less than this angle (rad) apart: the line projects to a point and has no direction.
constexpr double kMinSubtendedAngle = 1e-9;

// Moves the end point that lies before the near plane onto it, along the line.
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
  Eigen::Vector3d p1 = camera_from_object * p1_object;
  Eigen::Vector3d p2 = camera_from_object * p2_object;
  // Written so that a number that is not finite is turned down, too.
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
  // da = (I / rho - n n_w^T / rho^3) dn with n_w = (n_x / fx^2, n_y / fy^2, 0), the gradient of rho^2 / 2.
  const Eigen::Vector3d n_w(n_px.x() / camera.fx_px, n_px.y() / camera.fy_px, 0.0);
  const Eigen::Matrix3d da_dn = (Eigen::Matrix3d::Identity() - a * (n_w / rho).transpose()) / rho;
  // dn/dt = [P1 - P2]x, dn/dtheta = [P1 - P2]x [T]x - [n]x.
  const Eigen::Matrix3d da_dt = da_dn * Hat(p1 - p2);
  line.jacobian.leftCols<3>() = da_dt;
  line.jacobian.rightCols<3>() = da_dt * Hat(camera_from_object.translation_m) - da_dn * Hat(n);

  CutAtNearPlane(near_m, p1, p2);
  line.p1_px = camera.Project(p1);
  line.p2_px = camera.Project(p2);
  return line;
}

Eigen::Matrix<double, 3, 6> LineVelocityJacobian(const CameraModel& camera, const RigidTransform& camera_from_object,
                                                 const Eigen::Vector3d& p1_object, const Eigen::Vector3d& p2_object,
                                                 const Vector6d& twist) {
  const Eigen::Matrix3d r1 = Hat(camera_from_object.rotation * p1_object);
  const Eigen::Matrix3d r2 = Hat(camera_from_object.rotation * p2_object);
  const Eigen::Vector3d p1 = camera_from_object * p1_object;
  const Eigen::Vector3d p2 = camera_from_object * p2_object;
  const Eigen::Matrix3d w = Hat(twist.tail<3>());
  // The end points' velocities, and dn/dt along the twist: dn = dP1 x P2 + P1 x dP2.
  const Eigen::Vector3d v1 = twist.head<3>() - r1 * twist.tail<3>();
  const Eigen::Vector3d v2 = twist.head<3>() - r2 * twist.tail<3>();
  const Eigen::Vector3d n = p1.cross(p2);
  const Eigen::Vector3d n_dot = v1.cross(p2) + p1.cross(v2);
  Eigen::Matrix<double, 3, 6> dn, dn_dot;
  dn << Hat(p1 - p2), Hat(p2) * r1 - Hat(p1) * r2;
  dn_dot << Hat(v1 - v2), Hat(v2) * r1 - Hat(v1) * r2 + Hat(p2) * w * r1 - Hat(p1) * w * r2;

  // a_dot = n_dot / rho - n (n_w . n_dot) / rho^3 by n and by n_dot, with rho^2 = n_w . n.
  const Eigen::Vector3d inverse_f2(1.0 / (camera.fx_px * camera.fx_px), 1.0 / (camera.fy_px * camera.fy_px), 0.0);
  const Eigen::Vector3d n_w = n.cwiseProduct(inverse_f2);
  const Eigen::Vector3d n_dot_w = n_dot.cwiseProduct(inverse_f2);
  const double rho2 = n.dot(n_w);
  const double rho = std::sqrt(rho2);
  const double along = n_w.dot(n_dot) / rho2;
  const Eigen::Matrix3d identity = Eigen::Matrix3d::Identity();
  const Eigen::Matrix3d by_n =
      -(n_dot * n_w.transpose() + n * n_dot_w.transpose() - (3.0 * along) * n * n_w.transpose()) / rho2 -
      along * identity;
  const Eigen::Matrix3d by_n_dot = identity - n * n_w.transpose() / rho2;
  return (by_n * dn + by_n_dot * dn_dot) / rho;
}

double NormalVelocity(const ProjectedLine& line, const Vector6d& twist, const Eigen::Vector3d& bearing) {
  return -bearing.dot(line.jacobian * twist);
}

}  // namespace evpose
