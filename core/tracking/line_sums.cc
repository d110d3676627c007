#include "core/tracking/line_sums.h"

#include <Eigen/LU>

namespace evpose {

Eigen::Matrix3d LineSums::Moment(int n) const {
  const std::array<double, 6>& s = sums_[n];
  Eigen::Matrix3d moment;
  moment << s[0], s[1], s[3],  //
      s[1], s[2], s[4],        //
      s[3], s[4], s[5];
  return moment;
}

void AddNormalEquations(const LineSums& sums, const ImageLine& line, double scale, Matrix12d& hessian,
                        Vector12d& gradient) {
  using LineJacobian = Eigen::Matrix<double, 3, 6>;
  const Eigen::Matrix3d m0 = scale * sums.Moment(0);
  const Eigen::Matrix3d m1 = scale * sums.Moment(1);
  const Eigen::Matrix3d m2 = scale * sums.Moment(2);
  const LineJacobian& a = line.jacobian;
  const LineJacobian& b = line.a_dot_jacobian;
  const LineJacobian m0_a = m0 * a + m1 * b;
  const LineJacobian m1_a = m1 * a + m2 * b;
  const Matrix6d cross = m1_a.transpose() * a;
  hessian.topLeftCorner<6, 6>() += a.transpose() * m0_a + b.transpose() * m1_a;
  hessian.topRightCorner<6, 6>() += cross;
  hessian.bottomLeftCorner<6, 6>() += cross.transpose();
  hessian.bottomRightCorner<6, 6>() += a.transpose() * m2 * a;
  const Eigen::Vector3d d0 = m0 * line.a_expected + m1 * line.a_dot;
  const Eigen::Vector3d d1 = m1 * line.a_expected + m2 * line.a_dot;
  gradient.head<6>() += a.transpose() * d0 + b.transpose() * d1;
  gradient.tail<6>() += a.transpose() * d1;
}

void MarginaliseDisplacement(const LineSums& sums, const ImageLine& line, double scale,
                             const LineDisplacement& displacement, Matrix12d& hessian, Vector12d& gradient) {
  const Eigen::Matrix<double, 3, 2>& basis = displacement.basis;
  const Eigen::Matrix3d m0 = scale * sums.Moment(0);
  const Eigen::Matrix3d m1 = scale * sums.Moment(1);
  Eigen::Matrix<double, 2, 12> cross;
  cross.leftCols<6>() = basis.transpose() * (m0 * line.jacobian + m1 * line.a_dot_jacobian);
  cross.rightCols<6>() = basis.transpose() * m1 * line.jacobian;
  // Ends that are displaced independently displace the middle, and tilt, by half of the variance each.
  Eigen::Matrix2d information = basis.transpose() * m0 * basis;
  information.diagonal().array() += 2.0 / (displacement.sigma_px * displacement.sigma_px);
  const Eigen::Matrix2d covariance = information.inverse();
  hessian -= cross.transpose() * covariance * cross;
  gradient -= cross.transpose() * (covariance * (basis.transpose() * (m0 * line.a_expected + m1 * line.a_dot)));
}

}  // namespace evpose
