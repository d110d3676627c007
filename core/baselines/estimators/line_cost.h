// SPDX-License-Identifier: Apache-2.0

// The weighted squares of event-to-line distances as Ceres minimises them. A distance is linear in its event
// (core/geometry/README.md, section 3), so three residuals per line hold what all of its events say of a pose, exactly.
#pragma once

#include <ceres/cost_function.h>

#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/projected_line.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

// Object frame, metres.
struct LineEnds {
  Eigen::Vector3d p1;
  Eigen::Vector3d p2;
};

// sum_i w_i b_i b_i^T of one line's events, b = (x, y, 1).
using LineMoment = Eigen::Matrix3d;

// Half the sum of squares of its residuals is sum_j a_j^T M_j a_j / 2, pixels^2: of line j, L_j^T a_j with
// M_j = L_j L_j^T. The one parameter block is the tangent from `origin`, [translation, rotation].
class LineCost : public ceres::CostFunction {
 public:
  // One moment per line; all arguments must outlive it. Lines without events may be out of view.
  LineCost(const CameraModel& camera, absl::Span<const LineEnds> lines, absl::Span<const LineMoment> moments,
           const RigidTransform& origin);

  // False when a line with events has left the view.
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

 private:
  const CameraModel& camera_;
  const absl::Span<const LineEnds> lines_;
  const RigidTransform& origin_;
  std::vector<int> used_;                      // lines with events
  std::vector<Eigen::Matrix3d> square_roots_;  // L^T of the used lines
};

// When to stop. The defaults are as far as double precision carries.
struct LineSolverOptions {
  int max_iterations = 50;
  double cost_tolerance = 1e-16;       // relative change of the cost
  double gradient_tolerance = 0.0;     // largest entry, pixels^2 per tangent unit
  double parameter_tolerance = 0.0;    // relative length of the step
  bool use_levenberg_damping = false;  // else Powell's dog leg, whose last steps are Newton's
};

// The pose of least cost near `initial`. Errors: FAILED_PRECONDITION when a line with events is not in view there, or
// Ceres finds no usable pose.
absl::StatusOr<RigidTransform> MinimiseLineCost(const CameraModel& camera, absl::Span<const LineEnds> lines,
                                                absl::Span<const LineMoment> moments, const RigidTransform& initial,
                                                const LineSolverOptions& options);

// sum_j A_j^T M_j A_j, the cost's Hessian but for the second derivatives of the lines. Lines out of view add nothing.
Matrix6d LineCostHessian(absl::Span<const std::optional<ProjectedLine>> lines, absl::Span<const LineMoment> moments);

// The inverse of a Hessian over poses. Errors: FAILED_PRECONDITION when it is singular to within rounding.
absl::StatusOr<Matrix6d> InvertPoseHessian(const Matrix6d& hessian);

}  // namespace evpose
