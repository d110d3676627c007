// SPDX-License-Identifier: Apache-2.0

// Consistency of an estimator's covariance with its errors: the normalised estimation error squared (NEES); Bar-Shalom,
// Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, Sec. 5.4.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

// Median of a chi-square distribution with six degrees of freedom: the median NEES of a consistent covariance.
inline constexpr double kNeesMedian = 5.348;

// Returns e^T P^-1 e with e = [translation, rotation], Perturb(estimate, e) = truth, and P the estimate's covariance in
// the same tangent space (rigid_transform.h). NaN unless P is finite and positive definite. For a symmetric object,
// `truth` must be the nearest equivalent true pose.
double NormalisedErrorSquared(const RigidTransform& truth, const RigidTransform& estimate, const Matrix6d& covariance);
// The same for the 5 directions that the events of an object with an axis of symmetry determine, or the 3 of a sphere:
// the error and the covariance along the free directions are marginalised (README, equation (4)).
double NormalisedErrorSquared(const RigidTransform& truth, const RigidTransform& estimate, const Matrix6d& covariance,
                              const ContinuousSymmetry& symmetry);
// Number of degrees of freedom of the error of an object: 6, less the free directions of its symmetry.
int NumObservable(const std::optional<ContinuousSymmetry>& symmetry);

struct Consistency {
  uint64_t num_poses = 0;    // number of poses with a positive definite covariance
  uint64_t num_without = 0;  // number of poses without one
  // Quantiles of the NEES; NaN without any pose.
  double median = 0.0;
  double p5 = 0.0;
  double p95 = 0.0;
  double inside_95_ratio = 0.0;  // share of poses with the truth inside the 95 % ellipsoid; NaN likewise
};
// Summarises the values of NormalisedErrorSquared(), in any order; NaN counts as a pose without covariance.
// `num_degrees_of_freedom` is that of NumObservable().
Consistency SummariseConsistency(std::vector<double> normalised_errors_squared, int num_degrees_of_freedom = 6);

}  // namespace evpose
