// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/line_sums.h"

#include <Eigen/LU>

#include "core/numerics/target_clones.h"

namespace evpose {

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

void LineEquations::AddTo(Matrix12d* hessian, Vector12d& gradient) const {
  gradient.head<6>() += a_ * d0_ + b_ * d1_;
  gradient.tail<6>() += a_ * d1_;
  if (hessian == nullptr) return;
  const PoseRows pose_m0 = a_ * m00_ + b_ * m01_.transpose();
  const PoseRows pose_m1 = a_ * m01_ + b_ * m11_;
  hessian->topLeftCorner<6, 6>() += pose_m0 * a_.transpose() + pose_m1 * b_.transpose();
  hessian->bottomLeftCorner<6, 6>() += a_ * pose_m1.transpose();
  hessian->bottomRightCorner<6, 6>() += PoseRows(a_ * m11_) * a_.transpose();
}

EVPOSE_CLONES void ArcEquations::Add(const CameraModel& camera, const LineSums& sums, const ImageLine& element,
                                     double scale, double position, double half_length) {
  // The row of J at (1, s) on the element is rows[0] + s rows[1].
  const Eigen::Vector3d middle = BearingOf(camera, element.PointAt(0.5));
  const Eigen::Vector2d half_px = 0.5 * element.length_px * element.direction;
  const Eigen::Vector2d half(half_px.x() / camera.fx_px, half_px.y() / camera.fy_px);
  std::array<Row, 2> rows = {};
  for (int i = 0; i < 6; ++i) {
    const auto column = element.jacobian.col(i);
    rows[0][i] = column.dot(middle);
    rows[1][i] = column.x() * half.x() + column.y() * half.y();
  }
  // Sums of w tau^n b and of w tau^n s b; with both, those of w tau^n (1, s)^T (1, s).
  const Eigen::Vector3d along = AlongLine(camera, element).col(1);
  std::array<std::array<Eigen::Vector3d, 2>, 3> by_bearing;
  std::array<std::array<Row, 2>, 3> weighted;
  for (int n = 0; n < 3; ++n) {
    by_bearing[n] = {scale * sums.Sum(n), scale * sums.Times(n, along)};
    const double one = by_bearing[n][0].z(), s = by_bearing[n][1].z(), s2 = by_bearing[n][1].dot(along);
    weighted[n] = {one * rows[0] + s * rows[1], s * rows[0] + s2 * rows[1]};
    for (int i = 0; i < 6; ++i) blocks_[n][i] += weighted[n][0] * rows[0][i] + weighted[n][1] * rows[1][i];
  }
  const auto residual = [&](int n, int power) {
    return by_bearing[n][power].dot(element.a_expected) + by_bearing[n + 1][power].dot(element.a_dot);
  };
  for (int n = 0; n < 2; ++n) {
    gradient_[n] += residual(n, 0) * rows[0] + residual(n, 1) * rows[1];
    by_displacement_[n][0] += weighted[n][0];
    by_displacement_[n][1] += position * weighted[n][0] + half_length * weighted[n][1];
  }
  Eigen::Matrix2d in_arc;  // maps (1, s) on the element to (1, s) on the arc
  in_arc << 1.0, position, 0.0, half_length;
  Eigen::Matrix2d n00;
  n00 << by_bearing[0][0].z(), by_bearing[0][1].z(), by_bearing[0][1].z(), by_bearing[0][1].dot(along);
  information_ += in_arc.transpose() * n00 * in_arc;
  residual_ += in_arc.transpose() * Eigen::Vector2d(residual(0, 0), residual(0, 1));
}

EVPOSE_CLONES void ArcEquations::AddTo(double sigma_px, Matrix12d* hessian, Vector12d& gradient) const {
  Eigen::Matrix2d inverse = Eigen::Matrix2d::Zero();
  if (sigma_px > 0.0) {
    Eigen::Matrix2d information = information_;
    information.diagonal().array() += 2.0 / (sigma_px * sigma_px);  // as in LineEquations::Marginalise()
    inverse = information.inverse();
  }
  for (int row = 0; row < 2; ++row) {
    const std::array<Row, 2>& by = by_displacement_[row];
    const std::array<Row, 2> weighted = {by[0] * inverse(0, 0) + by[1] * inverse(1, 0),
                                         by[0] * inverse(0, 1) + by[1] * inverse(1, 1)};
    const Row change = gradient_[row] - (weighted[0] * residual_[0] + weighted[1] * residual_[1]);
    for (int i = 0; i < 6; ++i) gradient[6 * row + i] += change[i];
    for (int column = 0; column <= row && hessian != nullptr; ++column) {
      const std::array<Row, 2>& other = by_displacement_[column];
      for (int k = 0; k < 6; ++k) {
        const Row sum = blocks_[row + column][k] - (weighted[0] * other[0][k] + weighted[1] * other[1][k]);
        for (int i = 0; i < 6; ++i) (*hessian)(6 * row + i, 6 * column + k) += sum[i];
      }
    }
  }
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
