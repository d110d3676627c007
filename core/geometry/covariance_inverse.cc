// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/covariance_inverse.h"

#include <Eigen/Cholesky>
#include <array>
#include <cmath>

#include "core/numerics/target_clones.h"

namespace evpose {
namespace {

constexpr int kSize = 12;
using Column = std::array<double, kSize>;
using Columns = std::array<Column, kSize>;

// Replaces the lower triangle by the inverse of its Cholesky factor, by columns. All loops run along columns, so that
// the compiler uses vectors. Returns false if a pivot is not positive.
EVPOSE_CLONES bool InvertFactor(Columns& columns) {
  // Pivot relative to the diagonal below which it is rounding error.
  constexpr double kLeastPivot = 1e-13;
  Columns inverse = {};
  std::array<double, kSize> diagonal;
  for (int j = 0; j < kSize; ++j) diagonal[j] = columns[j][j];
  for (int j = 0; j < kSize; ++j) {
    Column& column = columns[j];
    if (!(column[j] > kLeastPivot * diagonal[j])) return false;
    const double scale = 1.0 / std::sqrt(column[j]);
    for (int i = j; i < kSize; ++i) column[i] *= scale;
    for (int k = j + 1; k < kSize; ++k) {
      for (int i = k; i < kSize; ++i) columns[k][i] -= column[k] * column[i];
    }
  }
  for (int j = 0; j < kSize; ++j) {
    Column& solution = inverse[j];
    solution[j] = 1.0;
    for (int k = j; k < kSize; ++k) {
      solution[k] /= columns[k][k];
      for (int i = k + 1; i < kSize; ++i) solution[i] -= solution[k] * columns[k][i];
    }
  }
  columns = inverse;
  return true;
}

// Returns X^T X for a lower triangle X.
EVPOSE_CLONES Matrix12d Square(const Columns& lower) {
  Matrix12d square = Matrix12d::Zero();
  for (int k = 0; k < kSize; ++k) {
    Column row;
    for (int i = 0; i <= k; ++i) row[i] = lower[i][k];
    for (int j = 0; j <= k; ++j) {
      double* const column = square.data() + kSize * j;
      for (int i = 0; i <= k; ++i) column[i] += row[j] * row[i];
    }
  }
  return square;
}

// Column by column: for the whole identity matrix Eigen would use the blocked algorithm for large matrices, which is
// slower here.
Matrix12d PivotedInverse(const Matrix12d& matrix) {
  const Eigen::LDLT<Matrix12d> factors(matrix);
  Matrix12d inverse;
  for (int k = 0; k < kSize; ++k) inverse.col(k) = factors.solve(Vector12d::Unit(k));
  return 0.5 * (inverse + inverse.transpose());
}

}  // namespace

Matrix12d CovarianceInverse(const Matrix12d& matrix) {
  Columns columns;
  for (int j = 0; j < kSize; ++j) {
    for (int i = 0; i < kSize; ++i) columns[j][i] = matrix(i, j);
  }
  return InvertFactor(columns) ? Square(columns) : PivotedInverse(matrix);
}

}  // namespace evpose
