// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/line_sums.h"

#include <Eigen/LU>

namespace evpose {

void LineSums::Add(const std::array<LaneProducts, 3>& sums, const Eigen::Vector2d& origin) {
  const double ox = origin.x();
  const double oy = origin.y();
  for (int n = 0; n < 3; ++n) {
    const LaneProducts& lanes = sums[n];
    const double x = SumOf(lanes[3]);
    const double y = SumOf(lanes[4]);
    const double one = SumOf(lanes[5]);
    Products products;
    products << SumOf(lanes[0]) + ox * (2.0 * x + ox * one), SumOf(lanes[1]) + ox * y + oy * (x + ox * one),
        SumOf(lanes[2]) + oy * (2.0 * y + oy * one), x + ox * one, y + oy * one, one;
    sums_[n] += products;
  }
}

Eigen::Matrix3d LineSums::Moment(int n) const {
  const Products& s = sums_[n];
  Eigen::Matrix3d moment;
  moment << s[0], s[1], s[3],  //
      s[1], s[2], s[4],        //
      s[3], s[4], s[5];
  return moment;
}

LineEquations::LineEquations(const LineSums& sums, const ImageLine& line, double scale)
    : a_(line.jacobian.transpose()),
      b_(line.a_dot_jacobian.transpose()),
      m00_(scale * sums.Moment(0)),
      m01_(scale * sums.Moment(1)),
      m11_(scale * sums.Moment(2)) {
  d0_ = m00_ * line.a_expected + m01_ * line.a_dot;
  d1_ = m01_ * line.a_expected + m11_ * line.a_dot;
}

void LineEquations::Marginalise(const LineDisplacement& displacement) {
  const Eigen::Matrix<double, 3, 2>& basis = displacement.basis;
  const Eigen::Matrix<double, 3, 2> m00_basis = m00_ * basis;
  const Eigen::Matrix<double, 3, 2> m10_basis = m01_ * basis;  // symmetric before the marginalisation
  // With independent displacements of the two ends, the middle and half the difference each have half of the variance.
  Eigen::Matrix2d information = basis.transpose() * m00_basis;
  information.diagonal().array() += 2.0 / (displacement.sigma_px * displacement.sigma_px);
  const Eigen::Matrix2d inverse = information.inverse();
  const Eigen::Matrix<double, 3, 2> weighted0 = m00_basis * inverse;
  const Eigen::Matrix<double, 3, 2> weighted1 = m10_basis * inverse;
  const Eigen::Vector2d residual = basis.transpose() * d0_;
  d0_ -= weighted0 * residual;
  d1_ -= weighted1 * residual;
  m00_ -= weighted0 * m00_basis.transpose();
  m01_ -= weighted0 * m10_basis.transpose();
  m11_ -= weighted1 * m10_basis.transpose();
}

void SharedDisplacement::Add(const LineEquations& equations, const Eigen::Matrix<double, 3, 2>& basis) {
  const Eigen::Matrix<double, 3, 2> m00_basis = equations.m00_ * basis;
  const Eigen::Matrix<double, 3, 2> m01_basis = equations.m01_ * basis;
  cross_.topRows<6>() += equations.a_ * m00_basis + equations.b_ * m01_basis;
  cross_.bottomRows<6>() += equations.a_ * m01_basis;
  information_ += basis.transpose() * m00_basis;
  residual_ += basis.transpose() * equations.d0_;
}

void SharedDisplacement::Marginalise(double sigma_px, Matrix12d& hessian, Vector12d& gradient) const {
  Eigen::Matrix2d information = information_;
  information.diagonal().array() += 2.0 / (sigma_px * sigma_px);  // as in LineEquations::Marginalise()
  const Eigen::Matrix<double, 12, 2> weighted = cross_ * information.inverse();
  hessian -= weighted * cross_.transpose();
  gradient -= weighted * residual_;
}

void LineEquations::AddTo(Matrix12d& hessian, Vector12d& gradient) const {
  const PoseRows pose_m0 = a_ * m00_ + b_ * m01_.transpose();
  const PoseRows pose_m1 = a_ * m01_ + b_ * m11_;
  const Matrix6d cross = pose_m1 * a_.transpose();
  hessian.topLeftCorner<6, 6>() += pose_m0 * a_.transpose() + pose_m1 * b_.transpose();
  hessian.topRightCorner<6, 6>() += cross;
  hessian.bottomLeftCorner<6, 6>() += cross.transpose();
  hessian.bottomRightCorner<6, 6>() += PoseRows(a_ * m11_) * a_.transpose();
  gradient.head<6>() += a_ * d0_ + b_ * d1_;
  gradient.tail<6>() += a_ * d1_;
}

}  // namespace evpose
