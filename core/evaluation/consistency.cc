// SPDX-License-Identifier: Apache-2.0
#include "core/evaluation/consistency.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>

#include "core/numerics/statistics.h"

namespace evpose {

double NormalisedErrorSquared(const RigidTransform& truth, const RigidTransform& estimate, const Matrix6d& covariance) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  if (!covariance.allFinite()) return kNan;
  // Metres and radians differ by orders of magnitude, so the covariance is scaled to a correlation matrix first.
  const Vector6d variance = covariance.diagonal();
  if (!(variance.minCoeff() > 0.0)) return kNan;
  const Vector6d scale = variance.cwiseSqrt().cwiseInverse();
  const Eigen::LLT<Matrix6d> cholesky(Matrix6d(scale.asDiagonal() * covariance * scale.asDiagonal()));
  if (cholesky.info() != Eigen::Success) return kNan;
  const Vector6d error = scale.cwiseProduct(Difference(truth, estimate));
  return cholesky.matrixL().solve(error).squaredNorm();
}

Consistency SummariseConsistency(std::vector<double> normalised_errors_squared) {
  std::vector<double>& values = normalised_errors_squared;
  Consistency result;
  const size_t num_all = values.size();
  std::erase_if(values, [](double value) { return std::isnan(value); });
  result.num_poses = values.size();
  result.num_without = num_all - values.size();
  if (values.empty()) {
    result.median = result.p5 = result.p95 = std::numeric_limits<double>::quiet_NaN();
    return result;
  }
  std::sort(values.begin(), values.end());
  result.median = InterpolatedQuantile(values, 0.5);
  result.p5 = InterpolatedQuantile(values, 0.05);
  result.p95 = InterpolatedQuantile(values, 0.95);
  return result;
}

}  // namespace evpose
