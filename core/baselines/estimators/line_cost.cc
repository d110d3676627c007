// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/estimators/line_cost.h"

#include <ceres/problem.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <array>
#include <cmath>

#include "absl/strings/str_cat.h"

namespace evpose {
namespace {

using RowMajor36d = Eigen::Matrix<double, 3, 6, Eigen::RowMajor>;

// Returns L^T of M = L L^T, also for a singular M: all events exactly on a line, or all at one place.
Eigen::Matrix3d SquareRoot(const LineMoment& moment) {
  const Eigen::LDLT<Eigen::Matrix3d> ldlt(moment);
  const Eigen::Vector3d roots = ldlt.vectorD().cwiseMax(0.0).cwiseSqrt();
  Eigen::Matrix3d root = Eigen::Matrix3d::Identity();
  root = ldlt.transpositionsP() * root;
  root = ldlt.matrixU() * root;
  return roots.asDiagonal() * root;
}

}  // namespace

LineCost::LineCost(const CameraModel& camera, absl::Span<const LineEnds> lines, absl::Span<const LineMoment> moments,
                   const RigidTransform& origin)
    : camera_(camera), lines_(lines), origin_(origin) {
  for (size_t k = 0; k < lines.size(); ++k) {
    if (!(moments[k](2, 2) > 0.0)) continue;
    used_.push_back(static_cast<int>(k));
    square_roots_.push_back(SquareRoot(moments[k]));
  }
  set_num_residuals(3 * static_cast<int>(used_.size()));
  mutable_parameter_block_sizes()->push_back(6);
}

bool LineCost::Evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  const Eigen::Map<const Vector6d> xi(parameters[0]);
  const RigidTransform pose = Perturb(origin_, xi);
  // A further rotation dtheta of the parameter rotates the object by J dtheta on the left of the present rotation.
  const Eigen::Matrix3d turn = LeftJacobianSo3(xi.tail<3>());
  for (size_t i = 0; i < used_.size(); ++i) {
    const LineEnds& ends = lines_[used_[i]];
    const std::optional<ProjectedLine> line = ProjectLine(camera_, pose, ends.p1, ends.p2);
    if (!line) return false;
    Eigen::Map<Eigen::Vector3d>(residuals + 3 * i) = square_roots_[i] * line->a;
    if (jacobians == nullptr || jacobians[0] == nullptr) continue;
    Eigen::Map<RowMajor36d> jacobian(jacobians[0] + 18 * i);
    jacobian = square_roots_[i] * line->jacobian;
    jacobian.rightCols<3>() *= turn;
  }
  return true;
}

ceres::Solver::Options LineSolverOptions() {
  ceres::Solver::Options options;
  options.trust_region_strategy_type = ceres::DOGLEG;
  options.linear_solver_type = ceres::DENSE_QR;
  options.num_threads = 1;
  options.logging_type = ceres::SILENT;
  options.max_num_iterations = 50;
  options.function_tolerance = 1e-16;  // relative change of the cost
  options.gradient_tolerance = 0.0;    // largest entry, pixels^2 per tangent unit
  options.parameter_tolerance = 0.0;   // relative length of the step
  return options;
}

absl::StatusOr<RigidTransform> MinimiseLineCost(const CameraModel& camera, absl::Span<const LineEnds> lines,
                                                absl::Span<const LineMoment> moments, const RigidTransform& initial,
                                                const ceres::Solver::Options& options) {
  // Checked before, because Ceres would print a message on standard error.
  for (size_t k = 0; k < lines.size(); ++k) {
    if (!(moments[k](2, 2) > 0.0) || ProjectLine(camera, initial, lines[k].p1, lines[k].p2)) continue;
    return absl::FailedPreconditionError(
        absl::StrCat("line ", k, " has events, but is not in view at the pose that the fit starts from"));
  }
  LineCost cost(camera, lines, moments, initial);
  if (cost.num_residuals() == 0)
    return absl::FailedPreconditionError(
        "no event has a positive weight, so that nothing determines the pose; check the labels and the start");

  ceres::Problem::Options problem_options;
  problem_options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.disable_all_safety_checks = true;
  ceres::Problem problem(problem_options);
  std::array<double, 6> xi = {};
  problem.AddResidualBlock(&cost, nullptr, xi.data());
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  const Eigen::Map<const Vector6d> step(xi.data());
  if (!summary.IsSolutionUsable() || !step.allFinite()) {
    return absl::FailedPreconditionError("the fit finds no pose: the lines leave the view on the way");
  }
  return Perturb(initial, step);
}

Matrix6d LineCostHessian(absl::Span<const std::optional<ProjectedLine>> lines, absl::Span<const LineMoment> moments) {
  Matrix6d hessian = Matrix6d::Zero();
  for (size_t k = 0; k < lines.size(); ++k) {
    if (lines[k]) hessian += lines[k]->jacobian.transpose() * moments[k] * lines[k]->jacobian;
  }
  return 0.5 * (hessian + hessian.transpose());
}

absl::StatusOr<Matrix6d> InvertPoseHessian(const Matrix6d& hessian) {
  // The criterion applies to the matrix scaled to a unit diagonal, so that neither the units nor the number of events
  // matter. A degenerate pose leaves rounding, 1e-16; an object of a hundredth of its distance gives 1e-4.
  constexpr double kSingular = 1e-12;
  const Vector6d scale = hessian.diagonal().cwiseSqrt().cwiseInverse();
  const Matrix6d scaled = scale.asDiagonal() * hessian * scale.asDiagonal();
  if (scaled.allFinite()) {
    const Eigen::SelfAdjointEigenSolver<Matrix6d> solver(scaled);
    if (solver.eigenvalues()[0] > kSingular) {
      const Matrix6d inverse =
          solver.eigenvectors() * solver.eigenvalues().cwiseInverse().asDiagonal() * solver.eigenvectors().transpose();
      return Matrix6d(scale.asDiagonal() * (0.5 * (inverse + inverse.transpose())) * scale.asDiagonal());
    }
  }
  return absl::FailedPreconditionError(
      "the events do not determine the pose: their lines leave a direction of it free; events of further lines, not "
      "parallel and not through one point, are needed");
}

}  // namespace evpose
