// SPDX-License-Identifier: Apache-2.0

// Per-line sums that hold all that a least-squares step needs of the events (core/estimation/README.md, section 2): a
// step costs no pass over the events, and a pass costs a few multiplications per event.
#pragma once

#include <Eigen/Core>
#include <array>

#include "core/association/association.h"
#include "core/geometry/motion_prior.h"
#include "core/numerics/lanes.h"

namespace evpose {

// M_n = sum_i w_i tau_i^n b_i b_i^T for n = 0, 1, 2, b = (x, y, 1): the six different numbers of each.
class LineSums {
 public:
  void Add(double bx, double by, double tau_s, double weight) {
    const double wx = weight * bx;
    const double wy = weight * by;
    Products products;
    products << wx * bx, wx * by, wy * by, wx, wy, weight;
    const Products first = products * tau_s;
    sums_[0] += products;
    sums_[1] += first;
    sums_[2] += first * tau_s;
  }

  // w tau^n times (x^2, x y, y^2, x, y, 1) of events side by side, b = (x, y, 1) + origin.
  using LaneProducts = std::array<Lanes, 6>;
  void Add(const std::array<LaneProducts, 3>& sums, const Eigen::Vector2d& origin);

  double weight() const { return sums_[0][5]; }
  Eigen::Matrix3d Moment(int n) const;
  // Sum of w tau^n b.
  Eigen::Vector3d Sum(int n) const { return {sums_[n][3], sums_[n][4], sums_[n][5]}; }

 private:
  using Products = Eigen::Array<double, 6, 1>;
  std::array<Products, 3> sums_ = {Products::Zero(), Products::Zero(), Products::Zero()};
};

// What the events of a line have in common: they all lie off it by a displacement that is linear along the line, of
// which nothing is known but its size. `basis`: (displacement at the middle, and from there to the second end) =
// basis^T b in pixels per unit.
struct LineDisplacement {
  Eigen::Matrix<double, 3, 2> basis = Eigen::Matrix<double, 3, 2>::Zero();
  double sigma_px = 0.0;  // of each end by itself
};

// A line's share of H = sum w J^T J and g = sum w J^T d, where d = (a_expected + tau a_dot) . b and
// J = [(A + tau B)^T b, tau A^T b] with respect to pose and twist: a_dot = A V, and B is its derivative by the pose.
// Exactly the derivatives of d while a_expected differs from a by a constant. Pixels^2 per tangent unit.
class LineEquations {
 public:
  LineEquations(const LineSums& sums, const ImageLine& line, double scale);
  // Takes out what the displacement may be instead (Schur complement): however many the events, the line's place is
  // known no better than the displacement is. Its motion within the window is not affected. At most once.
  void Marginalise(const LineDisplacement& displacement);
  void AddTo(Matrix12d& hessian, Vector12d& gradient) const;

 private:
  // Derivatives by the pose, A and B, one parameter a row: stored by columns of six, which take few instructions to
  // multiply.
  using PoseRows = Eigen::Matrix<double, 6, 3>;
  PoseRows a_, b_;
  // Blocks of the moment of (b, tau b), and of its product with d: what is taken out of six by six numbers need not be
  // of twelve by twelve.
  Eigen::Matrix3d m00_, m01_, m11_;
  Eigen::Vector3d d0_, d1_;
};

}  // namespace evpose
