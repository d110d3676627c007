// SPDX-License-Identifier: Apache-2.0

// Whether an estimator's covariance is what its errors are: the normalised estimation error squared (NEES), Bar-Shalom,
// Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, Sec. 5.4.
#pragma once

#include <cstdint>
#include <vector>

#include "core/geometry/rigid_transform.h"

namespace evpose {

// The median of a chi-square of six degrees of freedom: what the NEES of an honest covariance has.
inline constexpr double kNeesMedian = 5.348;

// e^T P^-1 e of e = [translation, rotation] with Perturb(estimate, e) = truth and P the estimate's covariance in the
// same tangent space (rigid_transform.h). NaN unless P is finite and positive definite. Of a symmetric object the truth
// is the nearest one.
double NormalisedErrorSquared(const RigidTransform& truth, const RigidTransform& estimate, const Matrix6d& covariance);

struct Consistency {
  uint64_t num_poses = 0;    // with a covariance that is positive definite
  uint64_t num_without = 0;  // the others
  // Of the NEES; NaN without any pose.
  double median = 0.0;
  double p5 = 0.0;
  double p95 = 0.0;
};
Consistency SummariseConsistency(std::vector<double> normalised_errors_squared);

}  // namespace evpose
