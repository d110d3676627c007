// SPDX-License-Identifier: Apache-2.0

// Real roots of a polynomial.
#pragma once

#include <Eigen/Core>
#include <vector>

namespace evpose {

// Coefficients by rising power. Roots whose imaginary part is at most `imaginary_ratio` of 1 + |root| count as real, so
// that a double root that noise has parted is not lost. Companion matrix, then Newton where that improves. Rising; an
// infinite root (vanishing leading coefficients) is left out.
std::vector<double> RealRoots(const Eigen::VectorXd& coefficients, double imaginary_ratio = 1e-6);

Eigen::VectorXd PolynomialProduct(const Eigen::VectorXd& a, const Eigen::VectorXd& b);
Eigen::VectorXd PolynomialDerivative(const Eigen::VectorXd& a);
double PolynomialValue(const Eigen::VectorXd& a, double x);

}  // namespace evpose
