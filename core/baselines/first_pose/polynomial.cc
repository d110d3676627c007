// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/polynomial.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

namespace evpose {
namespace {

double Polished(const Eigen::VectorXd& a, const Eigen::VectorXd& derivative, double x) {
  for (int i = 0; i < 3; ++i) {
    const double value = PolynomialValue(a, x);
    const double slope = PolynomialValue(derivative, x);
    if (slope == 0.0) break;
    const double next = x - value / slope;
    if (!(std::abs(PolynomialValue(a, next)) < std::abs(value))) break;
    x = next;
  }
  return x;
}

}  // namespace

double PolynomialValue(const Eigen::VectorXd& a, double x) {
  double value = 0.0;
  for (Eigen::Index i = a.size(); i-- > 0;) value = value * x + a[i];
  return value;
}

Eigen::VectorXd PolynomialProduct(const Eigen::VectorXd& a, const Eigen::VectorXd& b) {
  Eigen::VectorXd product = Eigen::VectorXd::Zero(a.size() + b.size() - 1);
  for (Eigen::Index i = 0; i < a.size(); ++i) product.segment(i, b.size()) += a[i] * b;
  return product;
}

Eigen::VectorXd PolynomialDerivative(const Eigen::VectorXd& a) {
  Eigen::VectorXd derivative(std::max<Eigen::Index>(a.size() - 1, 1));
  derivative[0] = 0.0;
  for (Eigen::Index i = 1; i < a.size(); ++i) derivative[i - 1] = static_cast<double>(i) * a[i];
  return derivative;
}

std::vector<double> RealRoots(const Eigen::VectorXd& coefficients, double imaginary_ratio) {
  constexpr double kVanishes = 1e-13;  // of the largest coefficient
  Eigen::Index degree = coefficients.size() - 1;
  const double largest = coefficients.cwiseAbs().maxCoeff();
  while (degree > 0 && !(std::abs(coefficients[degree]) > kVanishes * largest)) --degree;
  if (degree < 1) return {};
  const Eigen::VectorXd a = coefficients.head(degree + 1);
  const Eigen::VectorXd derivative = PolynomialDerivative(a);
  Eigen::MatrixXd companion = Eigen::MatrixXd::Zero(degree, degree);
  companion.diagonal(-1).setOnes();
  companion.col(degree - 1) = -a.head(degree) / a[degree];
  const Eigen::EigenSolver<Eigen::MatrixXd> solver(companion, /*computeEigenvectors=*/false);
  std::vector<double> roots;
  if (solver.info() != Eigen::Success) return roots;
  for (Eigen::Index i = 0; i < degree; ++i) {
    const auto root = solver.eigenvalues()[i];
    if (std::abs(root.imag()) > imaginary_ratio * (1.0 + std::abs(root.real()))) continue;
    if (root.imag() < 0.0) continue;  // its conjugate has the same real part
    roots.push_back(Polished(a, derivative, root.real()));
  }
  std::sort(roots.begin(), roots.end());
  return roots;
}

}  // namespace evpose
