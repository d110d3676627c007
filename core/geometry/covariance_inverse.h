// SPDX-License-Identifier: Apache-2.0

// The inverse of a covariance or information matrix of a pose and its twist.
#pragma once

#include "core/geometry/motion_prior.h"

namespace evpose {

// Returns the inverse of a symmetric positive definite matrix, by its Cholesky factors. Reads the lower triangle. If a
// pivot shows that the matrix is not positive definite, within rounding, the result is that of Eigen's pivoted LDLT:
// the inverse in the directions that have a pivot.
Matrix12d CovarianceInverse(const Matrix12d& matrix);

}  // namespace evpose
