// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/single_precision.h"

#include <Eigen/Cholesky>
#include <cmath>

namespace evpose {
namespace {

std::optional<CovarianceRoot> RoundedRoot(const Matrix6d& covariance) {
  const Eigen::LLT<Matrix6d> factorization(covariance);
  if (factorization.info() != Eigen::Success) return std::nullopt;
  const Matrix6d lower = factorization.matrixL();
  CovarianceRoot root;
  size_t next = 0;
  for (int row = 0; row < 6; ++row) {
    for (int column = 0; column <= row; ++column) {
      const auto element = static_cast<float>(lower(row, column));
      if (!std::isfinite(element) || (row == column && !std::isnormal(element))) return std::nullopt;
      root[next++] = element;
    }
  }
  return root;
}

}  // namespace

Matrix6d CovarianceOf(const CovarianceRoot& root) {
  const auto element = [&root](int row, int column) {
    const int index = row * (row + 1) / 2 + column;
    return static_cast<double>(root[static_cast<size_t>(index)]);
  };
  Matrix6d covariance;
  for (int row = 0; row < 6; ++row) {
    for (int column = 0; column <= row; ++column) {
      double sum = 0.0;
      for (int k = 0; k <= column; ++k) sum += element(row, k) * element(column, k);
      covariance(row, column) = covariance(column, row) = sum;
    }
  }
  return covariance;
}

Matrix6d InSinglePrecision(const Matrix6d& covariance) {
  const std::optional<CovarianceRoot> root = RoundedRoot(covariance);
  return root.has_value() ? CovarianceOf(*root) : covariance;
}

// Not twist.cast<float>().cast<double>(): g++ 12 with -O3 removes both conversions of the last two elements.
Vector6d InSinglePrecision(const Vector6d& twist) {
  Vector6d rounded;
  for (int i = 0; i < 6; ++i) rounded[i] = static_cast<float>(twist[i]);
  return rounded;
}

std::optional<CovarianceRoot> FindCovarianceRoot(const Matrix6d& covariance) {
  const std::optional<CovarianceRoot> root = RoundedRoot(covariance);
  if (!root.has_value() || CovarianceOf(*root) != covariance) return std::nullopt;
  return root;
}

}  // namespace evpose
