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

void ArcEquations::Add(const CameraModel& camera, const LineSums& sums, const ImageLine& element, double scale,
                       double position, double half_length) {
  using Basis = Eigen::Matrix<double, 3, 2>;
  const Basis basis = AlongLine(camera, element);
  const Eigen::Vector2d half_px = 0.5 * element.length_px * element.direction;
  Basis points;  // the bearing at (1, s) on the element
  points.col(0) = BearingOf(camera, element.PointAt(0.5));
  points.col(1) << half_px.x() / camera.fx_px, half_px.y() / camera.fy_px, 0.0;
  const Eigen::Matrix<double, 6, 2> rows = element.jacobian.transpose() * points;
  const Eigen::Matrix3d m00 = scale * sums.Moment(0), m01 = scale * sums.Moment(1), m11 = scale * sums.Moment(2);
  const Basis m00_basis = m00 * basis, m01_basis = m01 * basis;
  const Eigen::Matrix2d n00 = basis.transpose() * m00_basis, n01 = basis.transpose() * m01_basis;
  const Eigen::Matrix2d n11 = basis.transpose() * (m11 * basis);
  const Eigen::Vector2d d0 = m00_basis.transpose() * element.a_expected + m01_basis.transpose() * element.a_dot;
  const Eigen::Vector2d d1 = m01_basis.transpose() * element.a_expected + basis.transpose() * (m11 * element.a_dot);
  const Eigen::Matrix<double, 6, 2> rows_n00 = rows * n00, rows_n01 = rows * n01, rows_n11 = rows * n11;
  pose_ += rows_n00 * rows.transpose();
  cross_ += rows_n01 * rows.transpose();
  twist_ += rows_n11 * rows.transpose();
  gradient_.head<6>() += rows * d0;
  gradient_.tail<6>() += rows * d1;
  Eigen::Matrix2d in_arc;  // maps (1, s) on the element to (1, s) on the arc
  in_arc << 1.0, position, 0.0, half_length;
  by_displacement_.topRows<6>() += rows_n00 * in_arc;
  by_displacement_.bottomRows<6>() += rows_n01 * in_arc;
  information_ += in_arc.transpose() * n00 * in_arc;
  residual_ += in_arc.transpose() * d0;
}

void ArcEquations::AddTo(double sigma_px, Matrix12d& hessian, Vector12d& gradient) const {
  hessian.topLeftCorner<6, 6>() += pose_;
  hessian.topRightCorner<6, 6>() += cross_;
  hessian.bottomLeftCorner<6, 6>() += cross_;  // symmetric
  hessian.bottomRightCorner<6, 6>() += twist_;
  gradient += gradient_;
  if (!(sigma_px > 0.0)) return;
  Eigen::Matrix2d information = information_;
  information.diagonal().array() += 2.0 / (sigma_px * sigma_px);  // as in LineEquations::Marginalise()
  const Eigen::Matrix<double, 12, 2> weighted = by_displacement_ * information.inverse();
  // Not as one product, which would use the blocked algorithm for large matrices.
  for (int i = 0; i < 2; ++i) hessian -= weighted.col(i) * by_displacement_.col(i).transpose();
  gradient -= weighted * residual_;
}

Eigen::Matrix<double, 3, 2> AlongLine(const CameraModel& camera, const ImageLine& line) {
  const Eigen::Vector2d along = 2.0 / line.length_px * line.direction;
  Eigen::Matrix<double, 3, 2> basis;
  basis.col(0) = Eigen::Vector3d::UnitZ();
  basis.col(1) << along.x() * camera.fx_px, along.y() * camera.fy_px,
      along.dot(Eigen::Vector2d(camera.cx_px, camera.cy_px) - line.p1_px) - 1.0;
  return basis;
}

}  // namespace evpose
