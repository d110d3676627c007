// SPDX-License-Identifier: Apache-2.0

// Rotations from three lines with known correspondences.
#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

namespace evpose {

// Frames in which the constraint of the first line is solved: R = camera * Rz(alpha) * Rx(beta) * object rotates the
// direction v_0 into the plane with normal n_0 for all alpha and beta.
struct P3lFrame {
  Eigen::Matrix3d camera;
  Eigen::Matrix3d object;

  P3lFrame(const Eigen::Vector3d& normal, const Eigen::Vector3d& direction);
  Eigen::Matrix3d Rotation(double alpha_rad, double beta_rad) const;
};

// n . R v = a cos(beta) + b sin(beta) + d, each of the three linear in (1, cos(alpha), sin(alpha)).
struct P3lConstraint {
  Eigen::Vector3d a;
  Eigen::Vector3d b;
  Eigen::Vector3d d;

  P3lConstraint(const P3lFrame& frame, const Eigen::Vector3d& normal, const Eigen::Vector3d& direction);
};

// Result of eliminating beta from two constraints: a polynomial of degree 8 in t = tan(alpha / 2), by increasing power,
// which is zero where both constraints hold for a common beta. If both directions are perpendicular to the first one (a
// box), it is the square of a polynomial of degree 4, which is returned instead, and `is_perpendicular` is true.
struct P3lPolynomial {
  Eigen::VectorXd coefficients;
  bool is_perpendicular = false;
};
P3lPolynomial EliminateBeta(const P3lConstraint& first, const P3lConstraint& second);

// Value of the polynomial at an angle, divided by the power of 1 + t^2 that keeps it finite.
double ConstraintOfAlpha(const P3lConstraint& first, const P3lConstraint& second, double alpha_rad);

// Real roots of a polynomial with coefficients by rising power, in rising order. A root counts as real if its imaginary
// part is at most `imaginary_ratio` of 1 + |real part|, so that a double root that noise has split is not lost.
// Vanishing leading coefficients are ignored.
std::vector<double> RealRoots(const Eigen::VectorXd& coefficients, double imaginary_ratio);

// Returns all rotations with n_i . R v_i = 0, i = 0, 1, 2, to rounding (Dhome, Richetin, Lapreste, Rives,
// "Determination of the attitude of 3-D objects from a single perspective view", PAMI 1989; Chen, "Pose determination
// from line-to-plane correspondences", PAMI 1991): at most eight. Empty if there is none, or if the directions do not
// determine them (all three parallel).
std::vector<Eigen::Matrix3d> SolveP3l(const std::array<Eigen::Vector3d, 3>& normals,
                                      const std::array<Eigen::Vector3d, 3>& directions);

}  // namespace evpose
