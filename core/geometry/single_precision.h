// SPDX-License-Identifier: Apache-2.0

// Covariances and twists of published poses have the precision of single-precision numbers, so that a store needs a
// quarter of the bytes for them. Their errors are far below the uncertainty that they describe.
#pragma once

#include <array>
#include <optional>

#include "core/geometry/rigid_transform.h"

namespace evpose {

// Lower triangular matrix L, row by row.
using CovarianceRoot = std::array<float, 21>;

// L L^T: symmetric and positive semidefinite with any L. Has the same bits on every machine.
Matrix6d CovarianceOf(const CovarianceRoot& root);

// CovarianceOf() of the Cholesky factor of `covariance`, rounded to single precision: unlike rounded elements, it stays
// positive definite when directions are known with very different accuracy. Returns `covariance` itself if it is not
// positive definite, or out of the range of single-precision numbers.
Matrix6d InSinglePrecision(const Matrix6d& covariance);
Vector6d InSinglePrecision(const Vector6d& twist);

// Returns the root for which CovarianceOf() has the same bits as `covariance`, or nullopt if no such root is found.
std::optional<CovarianceRoot> FindCovarianceRoot(const Matrix6d& covariance);

}  // namespace evpose
