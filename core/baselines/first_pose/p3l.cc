// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/p3l.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <unsupported/Eigen/Polynomials>
#include <utility>

namespace evpose {
namespace {

// Right-handed frame with the given first column.
Eigen::Matrix3d FrameWithFirst(const Eigen::Vector3d& x) {
  Eigen::Matrix3d frame;
  frame.col(0) = x;
  frame.col(1) = x.unitOrthogonal();
  frame.col(2) = x.cross(frame.col(1));
  return frame;
}

// k . (1, cos, sin) times (1 + t^2).
Eigen::VectorXd InTangent(const Eigen::Vector3d& k) { return Eigen::Vector3d(k[0] + k[1], 2.0 * k[2], k[0] - k[1]); }

Eigen::VectorXd PolynomialProduct(const Eigen::VectorXd& a, const Eigen::VectorXd& b) {
  Eigen::VectorXd product = Eigen::VectorXd::Zero(a.size() + b.size() - 1);
  for (Eigen::Index i = 0; i < a.size(); ++i) product.segment(i, b.size()) += a[i] * b;
  return product;
}

// p q' - p' q.
Eigen::VectorXd Determinant(const Eigen::VectorXd& p, const Eigen::VectorXd& q, const Eigen::VectorXd& p2,
                            const Eigen::VectorXd& q2) {
  return PolynomialProduct(p, q2) - PolynomialProduct(p2, q);
}

// Newton's method, as long as it reduces the polynomial's absolute value: of a split double root, the real part alone
// is accurate only to the square root of the rounding error.
double RefineRoot(const Eigen::VectorXd& coefficients, double x) {
  // Newton's method converges quadratically from a root that is accurate to half of the digits.
  constexpr int kSteps = 3;
  for (int i = 0; i < kSteps; ++i) {
    double value = 0.0, slope = 0.0;
    for (Eigen::Index k = coefficients.size(); k-- > 0;) {
      slope = slope * x + value;
      value = value * x + coefficients[k];
    }
    if (slope == 0.0) break;
    const double next = x - value / slope;
    if (!(std::abs(Eigen::poly_eval(coefficients, next)) < std::abs(value))) break;
    x = next;
  }
  return x;
}

double At(const Eigen::Vector3d& k, double alpha_rad) {
  return k[0] + k[1] * std::cos(alpha_rad) + k[2] * std::sin(alpha_rad);
}

// Returns the one or two angles beta at which both constraints vanish for this alpha.
std::vector<double> SolveBeta(const P3lConstraint& p, const P3lConstraint& q, double alpha_rad, bool is_perpendicular) {
  const double a1 = At(p.a, alpha_rad), b1 = At(p.b, alpha_rad), d1 = At(p.d, alpha_rad);
  const double a2 = At(q.a, alpha_rad), b2 = At(q.b, alpha_rad), d2 = At(q.d, alpha_rad);
  if (is_perpendicular) {  // a cos + b sin = 0, twice the same equation; the one with the larger coefficients is used
    const bool is_first = a1 * a1 + b1 * b1 > a2 * a2 + b2 * b2;
    const double beta = is_first ? std::atan2(-a1, b1) : std::atan2(-a2, b2);
    return {beta, beta + M_PI};
  }
  const double determinant = a1 * b2 - a2 * b1;
  const double x = b1 * d2 - b2 * d1;
  const double y = a2 * d1 - a1 * d2;
  // If both equations are equal, they have two solutions.
  if (determinant * determinant < 1e-12 * (a1 * a1 + b1 * b1) * (a2 * a2 + b2 * b2)) {
    const bool is_first = a1 * a1 + b1 * b1 > a2 * a2 + b2 * b2;
    const double a = is_first ? a1 : a2, b = is_first ? b1 : b2, d = is_first ? d1 : d2;
    const double length = std::hypot(a, b);
    if (length < 1e-12 || std::abs(d) > length) return {};
    const double middle = std::atan2(b, a);
    const double half = std::acos(-d / length);
    return {middle - half, middle + half};
  }
  return {std::atan2(y / determinant, x / determinant)};
}

// Whether both directions are perpendicular to that of the first line, to the rounding of model coordinates.
bool ArePerpendicular(const P3lConstraint& first, const P3lConstraint& second) {
  constexpr double kSine = 1e-6;  // coordinates of models have single precision
  return first.d.norm() < kSine && second.d.norm() < kSine;
}

}  // namespace

P3lFrame::P3lFrame(const Eigen::Vector3d& normal, const Eigen::Vector3d& direction) {
  const Eigen::Matrix3d frame = FrameWithFirst(normal);
  camera << frame.col(1), frame.col(2), frame.col(0);
  object = FrameWithFirst(direction).transpose();
}

Eigen::Matrix3d P3lFrame::Rotation(double alpha_rad, double beta_rad) const {
  const Eigen::AngleAxisd about_z(alpha_rad, Eigen::Vector3d::UnitZ());
  const Eigen::AngleAxisd about_x(beta_rad, Eigen::Vector3d::UnitX());
  return camera * (about_z * about_x).toRotationMatrix() * object;
}

P3lConstraint::P3lConstraint(const P3lFrame& frame, const Eigen::Vector3d& normal, const Eigen::Vector3d& direction) {
  const Eigen::Vector3d n = frame.camera.transpose() * normal;
  const Eigen::Vector3d v = frame.object * direction;
  // (n_x c + n_y s) v_x + (n_y c - n_x s)(v_y cos(beta) - v_z sin(beta)) + n_z (v_y sin(beta) + v_z cos(beta)).
  a = Eigen::Vector3d(v.z() * n.z(), v.y() * n.y(), -v.y() * n.x());
  b = Eigen::Vector3d(v.y() * n.z(), -v.z() * n.y(), v.z() * n.x());
  d = Eigen::Vector3d(0.0, v.x() * n.x(), v.x() * n.y());
}

P3lPolynomial EliminateBeta(const P3lConstraint& first, const P3lConstraint& second) {
  const Eigen::VectorXd a1 = InTangent(first.a), b1 = InTangent(first.b), d1 = InTangent(first.d);
  const Eigen::VectorXd a2 = InTangent(second.a), b2 = InTangent(second.b), d2 = InTangent(second.d);
  const Eigen::VectorXd determinant = Determinant(a1, b1, a2, b2);
  P3lPolynomial polynomial;
  if (ArePerpendicular(first, second)) {
    polynomial.coefficients = determinant;
    polynomial.is_perpendicular = true;
    return polynomial;
  }
  const Eigen::VectorXd x = Determinant(b1, d1, b2, d2);
  const Eigen::VectorXd y = Determinant(a1, d1, a2, d2);
  polynomial.coefficients =
      PolynomialProduct(x, x) + PolynomialProduct(y, y) - PolynomialProduct(determinant, determinant);
  return polynomial;
}

double ConstraintOfAlpha(const P3lConstraint& first, const P3lConstraint& second, double alpha_rad) {
  const Eigen::Vector3d base(1.0, std::cos(alpha_rad), std::sin(alpha_rad));
  const double a1 = first.a.dot(base), b1 = first.b.dot(base), d1 = first.d.dot(base);
  const double a2 = second.a.dot(base), b2 = second.b.dot(base), d2 = second.d.dot(base);
  const double determinant = a1 * b2 - a2 * b1;
  if (ArePerpendicular(first, second)) return determinant;
  const double x = b1 * d2 - b2 * d1;
  const double y = a1 * d2 - a2 * d1;
  return x * x + y * y - determinant * determinant;
}

std::vector<double> RealRoots(const Eigen::VectorXd& coefficients, double imaginary_ratio) {
  constexpr double kVanishes = 1e-13;  // relative to the largest coefficient: some hundred roundings
  Eigen::Index degree = coefficients.size() - 1;
  const double largest = coefficients.cwiseAbs().maxCoeff();
  while (degree > 0 && !(std::abs(coefficients[degree]) > kVanishes * largest)) --degree;
  if (degree < 1) return {};
  const Eigen::VectorXd polynomial = coefficients.head(degree + 1);
  const Eigen::PolynomialSolver<double, Eigen::Dynamic> solver(polynomial);
  std::vector<double> roots;
  for (const auto& root : solver.roots()) {
    // Only one root of a conjugate pair is counted.
    if (root.imag() < 0.0 || root.imag() > imaginary_ratio * (1.0 + std::abs(root.real()))) continue;
    roots.push_back(RefineRoot(polynomial, root.real()));
  }
  std::sort(roots.begin(), roots.end());
  return roots;
}

std::vector<Eigen::Matrix3d> SolveP3l(const std::array<Eigen::Vector3d, 3>& normals,
                                      const std::array<Eigen::Vector3d, 3>& directions) {
  constexpr double kParallel = 1e-6;  // sine of the angle, above the rounding of coordinates in single precision
  const auto are_parallel = [&](int i, int j) { return directions[i].cross(directions[j]).norm() < kParallel; };
  // The first line must be parallel to neither of the others, which may be parallel to each other.
  std::array<int, 3> order = {0, 1, 2};
  if (are_parallel(0, 1)) std::swap(order[0], order[2]);
  if (are_parallel(order[0], order[2])) std::swap(order[0], order[1]);
  if (are_parallel(order[0], order[1]) || are_parallel(order[0], order[2])) return {};
  const P3lFrame frame(normals[order[0]], directions[order[0]]);
  const P3lConstraint first(frame, normals[order[1]], directions[order[1]]);
  const P3lConstraint second(frame, normals[order[2]], directions[order[2]]);
  const P3lPolynomial polynomial = EliminateBeta(first, second);
  // Double roots that rounding has separated are accepted; the caller selects among the rotations. Where the two
  // equations of beta are nearly dependent, beta can be wrong by any angle: such a rotation is no solution.
  constexpr double kMaxCosine = 1e-2;
  const auto is_solution = [&](const Eigen::Matrix3d& rotation) {
    double worst = 0.0;
    for (int i = 0; i < 3; ++i) worst = std::max(worst, std::abs(normals[i].dot(rotation * directions[i])));
    return worst < kMaxCosine;
  };
  std::vector<Eigen::Matrix3d> rotations;
  for (const double t : RealRoots(polynomial.coefficients, 1e-3)) {
    const double alpha = 2.0 * std::atan(t);
    for (const double beta : SolveBeta(first, second, alpha, polynomial.is_perpendicular)) {
      const Eigen::Matrix3d rotation = frame.Rotation(alpha, beta);
      if (is_solution(rotation)) rotations.push_back(rotation);
    }
  }
  return rotations;
}

}  // namespace evpose
