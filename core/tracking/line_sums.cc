#include "core/tracking/line_sums.h"

#include <Eigen/LU>

namespace evpose {
namespace {

// Derivatives by the pose, one parameter a row: stored by columns of six, which take few instructions to multiply.
using PoseRows = Eigen::Matrix<double, 6, 3>;

}  // namespace

Eigen::Matrix3d LineSums::Moment(int n) const {
  const Products& s = sums_[n];
  Eigen::Matrix3d moment;
  moment << s[0], s[1], s[3],  //
      s[1], s[2], s[4],        //
      s[3], s[4], s[5];
  return moment;
}

void AddNormalEquations(const LineSums& sums, const ImageLine& line, double scale, Matrix12d& hessian,
                        Vector12d& gradient) {
  const Eigen::Matrix3d m0 = scale * sums.Moment(0);
  const Eigen::Matrix3d m1 = scale * sums.Moment(1);
  const Eigen::Matrix3d m2 = scale * sums.Moment(2);
  const PoseRows a = line.jacobian.transpose();
  const PoseRows b = line.a_dot_jacobian.transpose();
  const PoseRows a_m1 = a * m1;
  const PoseRows pose_m0 = a * m0 + b * m1;
  const PoseRows pose_m1 = a_m1 + b * m2;
  const Matrix6d cross = pose_m1 * a.transpose();
  hessian.topLeftCorner<6, 6>() += pose_m0 * a.transpose() + pose_m1 * b.transpose();
  hessian.topRightCorner<6, 6>() += cross;
  hessian.bottomLeftCorner<6, 6>() += cross.transpose();
  hessian.bottomRightCorner<6, 6>() += PoseRows(a * m2) * a.transpose();
  const Eigen::Vector3d d0 = m0 * line.a_expected + m1 * line.a_dot;
  const Eigen::Vector3d d1 = m1 * line.a_expected + m2 * line.a_dot;
  gradient.head<6>() += a * d0 + b * d1;
  gradient.tail<6>() += a * d1;
}

void MarginaliseDisplacement(const LineSums& sums, const ImageLine& line, double scale,
                             const LineDisplacement& displacement, Matrix12d& hessian, Vector12d& gradient) {
  const Eigen::Matrix<double, 3, 2>& basis = displacement.basis;
  const Eigen::Matrix3d m0 = scale * sums.Moment(0);
  const Eigen::Matrix3d m1 = scale * sums.Moment(1);
  const Eigen::Matrix<double, 3, 2> m0_basis = m0 * basis;
  const Eigen::Matrix<double, 3, 2> m1_basis = m1 * basis;
  const PoseRows a = line.jacobian.transpose();
  Eigen::Matrix<double, 12, 2> cross;
  cross.topRows<6>() = a * m0_basis + line.a_dot_jacobian.transpose() * m1_basis;
  cross.bottomRows<6>() = a * m1_basis;
  // Ends that are displaced independently displace the middle, and tilt, by half of the variance each.
  Eigen::Matrix2d information = basis.transpose() * m0_basis;
  information.diagonal().array() += 2.0 / (displacement.sigma_px * displacement.sigma_px);
  const Eigen::Matrix<double, 12, 2> weighted = cross * information.inverse();
  for (int k = 0; k < 12; ++k) hessian.col(k) -= weighted * cross.row(k).transpose();
  gradient -= weighted * (m0_basis.transpose() * line.a_expected + m1_basis.transpose() * line.a_dot);
}

}  // namespace evpose
