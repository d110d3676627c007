// SPDX-License-Identifier: Apache-2.0

// Sums by line that contain all that a least-squares step requires from the events (core/estimation/README.md,
// equations (7) and (8)): a step needs no pass over the events, and a pass costs a few multiplications per event.
#pragma once

#include <Eigen/Core>
#include <array>

#include "core/association/association.h"
#include "core/geometry/motion_prior.h"
#include "core/numerics/lanes.h"

namespace evpose {

// M_n = sum_i w_i tau_i^n b_i b_i^T for n = 0, 1, 2 with b = (x, y, 1), equation (7): the six different elements of
// each. tau is in seconds.
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

  // Sums of w tau^n (x^2, x y, y^2, x, y, 1) that were accumulated in parallel over the lanes: the six for n = 0, then
  // those for n = 1 and n = 2.
  using LaneProducts = std::array<Lanes, 18>;
  // Adds such sums, with b = (x, y, 1) + (origin, 0). Always inlined, for the clones of the passes.
  [[gnu::always_inline]] void Add(const LaneProducts& lanes, const Eigen::Vector2d& origin) {
    const std::array<double, 18> all = SumsOf(lanes);
    const double ox = origin.x();
    const double oy = origin.y();
    for (size_t n = 0; n < 3; ++n) {
      const double* const sums = &all[6 * n];
      const double x = sums[3];
      const double y = sums[4];
      const double one = sums[5];
      Products products;
      products << sums[0] + ox * (2.0 * x + ox * one), sums[1] + ox * y + oy * (x + ox * one),
          sums[2] + oy * (2.0 * y + oy * one), x + ox * one, y + oy * one, one;
      sums_[n] += products;
    }
  }

  double weight() const { return sums_[0][5]; }
  Eigen::Matrix3d Moment(int n) const;
  // Returns the sum of w tau^n b.
  Eigen::Vector3d Sum(int n) const { return {sums_[n][3], sums_[n][4], sums_[n][5]}; }
  // Returns M_n v.
  Eigen::Vector3d Times(int n, const Eigen::Vector3d& v) const {
    const Products& s = sums_[n];
    return {s[0] * v.x() + s[1] * v.y() + s[3] * v.z(), s[1] * v.x() + s[2] * v.y() + s[4] * v.z(),
            s[3] * v.x() + s[4] * v.y() + s[5] * v.z()};
  }

 private:
  using Products = Eigen::Array<double, 6, 1>;
  std::array<Products, 3> sums_ = {Products::Zero(), Products::Zero(), Products::Zero()};
};

// Displacement that all events of a line share: it is linear along the line, unknown, and has a known standard
// deviation (core/estimation/README.md, section 7). `basis` maps it to the bearing: (displacement of the middle, half
// the difference of the ends) = basis^T b, in pixels per unit.
struct LineDisplacement {
  Eigen::Matrix<double, 3, 2> basis = Eigen::Matrix<double, 3, 2>::Zero();
  double sigma_px = 0.0;  // standard deviation of the displacement of each end; the ends are independent
};

// Contribution of one line to H = sum w J^T J and g = sum w J^T d, equation (8), where d = (a_expected + tau a_dot) . b
// and J = [(A + tau B)^T b, tau A^T b] is its derivative by pose and twist: a_dot = A V, and B is the derivative of
// a_dot by the pose. J is exact as long as a_expected - a is constant. Units: pixels^2 per tangent unit.
class LineEquations {
 public:
  LineEquations(const LineSums& sums, const ImageLine& line, double scale);
  // Marginalises the displacement (Schur complement): the position of the line is then known no better than the
  // displacement, regardless of the number of events. Its motion within the window is not affected. To be called at
  // most once.
  void Marginalise(const LineDisplacement& displacement);
  // Adds H to the lower triangle of `hessian`, which is all that a Cholesky decomposition reads, and g; only g if
  // `hessian` is null.
  void AddTo(Matrix12d* hessian, Vector12d& gradient) const;

 private:
  // A and B transposed, one row per parameter of the pose: stored in columns of six, which multiply with few
  // instructions.
  using PoseRows = Eigen::Matrix<double, 6, 3>;
  PoseRows a_, b_;
  // Blocks of the moment matrix of (b, tau b), and of its product with d. Marginalising in these 6 x 6 blocks is
  // cheaper than in the 12 x 12 equations.
  Eigen::Matrix3d m00_, m01_, m11_;
  Eigen::Vector3d d0_, d1_;
};

// Contribution of the elements of an arc, which share one displacement (core/estimation/README.md, section 7). An
// element is short and its events are near it, so that J needs two values on it: J = [A^T b, tau A^T b] at the event's
// foot on the element. The derivative of a_dot by the pose, of the order of the rotation within a window, is left out.
class ArcEquations {
 public:
  // Adds an element; `position` and `half_length` of its middle and half its length in the arc, which goes from -1
  // to 1.
  void Add(const CameraModel& camera, const LineSums& sums, const ImageLine& element, double scale, double position,
           double half_length);
  // As LineEquations::AddTo(). `sigma_px` is that of LineDisplacement, for the ends of the arc; 0: no displacement.
  void AddTo(double sigma_px, Matrix12d* hessian, Vector12d& gradient) const;

 private:
  // One value for each parameter of the pose, and two unused ones: whole vector registers.
  using Row = double __attribute__((vector_size(64)));

  // The blocks of the Hessian for pose and pose, pose and twist, twist and twist; symmetric, by column.
  std::array<std::array<Row, 6>, 3> blocks_ = {};
  std::array<Row, 2> gradient_ = {};                        // for pose and twist
  std::array<std::array<Row, 2>, 2> by_displacement_ = {};  // C of equation (12): rows for pose and twist, by column
  Eigen::Matrix2d information_ = Eigen::Matrix2d::Zero();
  Eigen::Vector2d residual_ = Eigen::Vector2d::Zero();
};

// Basis for which basis^T b = (1, position along the line from -1 to 1), for a bearing b.
Eigen::Matrix<double, 3, 2> AlongLine(const CameraModel& camera, const ImageLine& line);

}  // namespace evpose
