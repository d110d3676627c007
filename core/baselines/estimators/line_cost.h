// SPDX-License-Identifier: Apache-2.0

// Weighted sum of squared event-to-line distances as a cost function for Ceres. A distance is linear in its event
// (core/geometry/README.md, section 3), so that three residuals per line represent all of its events exactly.
#pragma once

#include <ceres/cost_function.h>
#include <ceres/solver.h>

#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/projected_line.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

// End points of a model line, object frame, metres.
struct LineEnds {
  Eigen::Vector3d p1;
  Eigen::Vector3d p2;
};

// Second moment of the events of one line: sum_i w_i b_i b_i^T with the bearings b = (x, y, 1).
using LineMoment = Eigen::Matrix3d;

// The cost sum_j a_j^T M_j a_j, pixels^2, as a sum of squared residuals: those of line j are L_j^T a_j with M_j = L_j
// L_j^T. The one parameter block is the tangent at `origin`, [translation, rotation].
class LineCost : public ceres::CostFunction {
 public:
  // `moments` has one element per line; all arguments must outlive the cost. Lines without events may be out of view.
  LineCost(const CameraModel& camera, absl::Span<const LineEnds> lines, absl::Span<const LineMoment> moments,
           const RigidTransform& origin);

  // Returns false if a line with events has left the view.
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

 private:
  const CameraModel& camera_;
  const absl::Span<const LineEnds> lines_;
  const RigidTransform& origin_;
  std::vector<int> used_;                      // lines with events
  std::vector<Eigen::Matrix3d> square_roots_;  // L^T of the used lines
};

// Options of Ceres for the cost: the full double precision, and Powell's dog leg, which ends with Newton steps.
ceres::Solver::Options LineSolverOptions();

// Returns the pose of least cost near `initial`. Errors: FAILED_PRECONDITION if a line with events is not in view
// there, or Ceres finds no usable pose.
absl::StatusOr<RigidTransform> MinimiseLineCost(const CameraModel& camera, absl::Span<const LineEnds> lines,
                                                absl::Span<const LineMoment> moments, const RigidTransform& initial,
                                                const ceres::Solver::Options& options);

// Returns sum_j A_j^T M_j A_j: the Hessian of the cost without the second derivatives of the lines. Lines out of view
// contribute nothing.
Matrix6d LineCostHessian(absl::Span<const std::optional<ProjectedLine>> lines, absl::Span<const LineMoment> moments);

// Returns the inverse of the Hessian of a pose. Errors: FAILED_PRECONDITION if it is singular to within rounding.
absl::StatusOr<Matrix6d> InvertPoseHessian(const Matrix6d& hessian);

}  // namespace evpose
