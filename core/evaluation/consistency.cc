// SPDX-License-Identifier: Apache-2.0
#include "core/evaluation/consistency.h"

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <limits>

#include "core/models/continuous_symmetry.h"
#include "core/numerics/statistics.h"

namespace evpose {

namespace {

// e^T covariance^-1 e; NaN unless the covariance is finite and positive definite.
template <typename Vector, typename Matrix>
double QuadraticForm(const Vector& error, const Matrix& covariance) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  if (!covariance.allFinite()) return kNan;
  // Metres and radians differ by orders of magnitude, so the covariance is scaled to a correlation matrix first.
  const Vector variance = covariance.diagonal();
  if (!(variance.minCoeff() > 0.0)) return kNan;
  const Vector scale = variance.cwiseSqrt().cwiseInverse();
  const Eigen::LLT<Matrix> cholesky(Matrix(scale.asDiagonal() * covariance * scale.asDiagonal()));
  if (cholesky.info() != Eigen::Success) return kNan;
  return cholesky.matrixL().solve(Vector(scale.cwiseProduct(error))).squaredNorm();
}

// 95 % quantile of the chi-square distribution for the numbers that NumObservable() returns.
double ChiSquare95(int num_degrees_of_freedom) {
  switch (num_degrees_of_freedom) {
    case 3:
      return 7.815;
    case 5:
      return 11.070;
    default:
      return 12.592;
  }
}

}  // namespace

double NormalisedErrorSquared(const RigidTransform& truth, const RigidTransform& estimate, const Matrix6d& covariance) {
  return QuadraticForm(Difference(truth, estimate), covariance);
}

double NormalisedErrorSquared(const RigidTransform& truth, const RigidTransform& estimate, const Matrix6d& covariance,
                              const ContinuousSymmetry& symmetry) {
  const FreeDirections free = FreeDirectionsAt(symmetry, estimate);
  const Eigen::MatrixXd basis = Eigen::MatrixXd(free).householderQr().householderQ() * Eigen::MatrixXd::Identity(6, 6);
  const Eigen::MatrixXd observable = basis.rightCols(6 - free.cols()).transpose();
  const Eigen::VectorXd error = observable * Difference(truth, estimate);
  return QuadraticForm(error, Eigen::MatrixXd(observable * covariance * observable.transpose()));
}

int NumObservable(const std::optional<ContinuousSymmetry>& symmetry) {
  if (!symmetry) return 6;
  return symmetry->kind == ContinuousSymmetry::Kind::kAxis ? 5 : 3;
}

Consistency SummariseConsistency(std::vector<double> normalised_errors_squared, int num_degrees_of_freedom) {
  std::vector<double>& values = normalised_errors_squared;
  Consistency result;
  const size_t num_all = values.size();
  std::erase_if(values, [](double value) { return std::isnan(value); });
  result.num_poses = values.size();
  result.num_without = num_all - values.size();
  if (values.empty()) {
    result.median = result.p5 = result.p95 = result.inside_95_ratio = std::numeric_limits<double>::quiet_NaN();
    return result;
  }
  std::sort(values.begin(), values.end());
  result.median = InterpolatedQuantile(values, 0.5);
  result.p5 = InterpolatedQuantile(values, 0.05);
  result.p95 = InterpolatedQuantile(values, 0.95);
  const auto outside = std::upper_bound(values.begin(), values.end(), ChiSquare95(num_degrees_of_freedom));
  result.inside_95_ratio = static_cast<double>(outside - values.begin()) / static_cast<double>(values.size());
  return result;
}

}  // namespace evpose
