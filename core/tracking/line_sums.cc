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

void AddNormalEquations(const LineSums& sums, const Eigen::Vector3d& a, const Eigen::Vector3d& a_dot,
                        const Eigen::Matrix<double, 3, 6>& jacobian, double scale, Matrix12d& hessian,
                        Vector12d& gradient) {
  const Eigen::Matrix3d m0 = scale * sums.Moment(0);
  const Eigen::Matrix3d m1 = scale * sums.Moment(1);
  const Eigen::Matrix3d m2 = scale * sums.Moment(2);
  const Matrix6d cross = jacobian.transpose() * m1 * jacobian;
  hessian.topLeftCorner<6, 6>() += jacobian.transpose() * m0 * jacobian;
  hessian.topRightCorner<6, 6>() += cross;
  hessian.bottomLeftCorner<6, 6>() += cross.transpose();
  hessian.bottomRightCorner<6, 6>() += jacobian.transpose() * m2 * jacobian;
  gradient.head<6>() += jacobian.transpose() * (m0 * a + m1 * a_dot);
  gradient.tail<6>() += jacobian.transpose() * (m1 * a + m2 * a_dot);
}

void MarginaliseDisplacement(const LineSums& sums, const Eigen::Vector3d& a, const Eigen::Vector3d& a_dot,
                             const Eigen::Matrix<double, 3, 6>& jacobian, double scale,
                             const LineDisplacement& displacement, Matrix12d& hessian, Vector12d& gradient) {
  const Eigen::Matrix<double, 3, 2>& basis = displacement.basis;
  const Eigen::Matrix3d m0 = scale * sums.Moment(0);
  const Eigen::Matrix3d m1 = scale * sums.Moment(1);
  Eigen::Matrix<double, 2, 12> cross;
  cross.leftCols<6>() = basis.transpose() * m0 * jacobian;
  cross.rightCols<6>() = basis.transpose() * m1 * jacobian;
  // Ends that are displaced independently displace the middle, and tilt, by half of the variance each.
  Eigen::Matrix2d information = basis.transpose() * m0 * basis;
  information.diagonal().array() += 2.0 / (displacement.sigma_px * displacement.sigma_px);
  const Eigen::Matrix2d covariance = information.inverse();
  hessian -= cross.transpose() * covariance * cross;
  gradient -= cross.transpose() * (covariance * (basis.transpose() * (m0 * a + m1 * a_dot)));
}

}  // namespace evpose
