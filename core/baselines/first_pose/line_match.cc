// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/line_match.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>

namespace evpose {
namespace {

// Squared sine of the angle between planes (0.06 deg) below which their common point is determined by noise only.
constexpr double kMinEigenvalue = 1e-6;

std::optional<LineNormalEquations> Linearise(absl::Span<const LineMatch> matches, const CameraModel& camera,
                                             const RigidTransform& pose) {
  LineNormalEquations equations;
  for (const LineMatch& match : matches) {
    const auto line = ProjectLine(camera, pose, match.p1, match.p2);
    if (!line) return std::nullopt;
    for (const Eigen::Vector2d& end : {match.segment.p1_px, match.segment.p2_px}) {
      equations.Add(*line, BearingOf(camera, end));
    }
  }
  return equations;
}

}  // namespace

void LineNormalEquations::Add(const ProjectedLine& line, const Eigen::Vector3d& bearing) {
  const double d_px = line.a.dot(bearing);
  const Vector6d row = line.jacobian.transpose() * bearing;
  hessian += row * row.transpose();
  gradient += d_px * row;
  cost_px2 += d_px * d_px;
}

std::optional<Eigen::Vector3d> SolveTranslation(absl::Span<const LineMatch> matches, const CameraModel& camera,
                                                const Eigen::Matrix3d& rotation) {
  Eigen::Matrix3d hessian = Eigen::Matrix3d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  double longest_px = 0.0;
  for (const LineMatch& match : matches) longest_px = std::max(longest_px, match.segment.length_px());
  for (const LineMatch& match : matches) {
    const double weight = match.segment.length_px() / longest_px;
    const Eigen::Vector3d normal = weight * BackProjectedNormal(camera, match.segment);
    hessian += normal * normal.transpose();
    right -= normal.dot(rotation * (0.5 * (match.p1 + match.p2))) * normal;
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(hessian);
  if (!(solver.eigenvalues()[0] > kMinEigenvalue)) return std::nullopt;
  const Eigen::Vector3d inverse = solver.eigenvalues().cwiseInverse();
  return solver.eigenvectors() * inverse.cwiseProduct(solver.eigenvectors().transpose() * right);
}

std::optional<RigidTransform> RefinePose(absl::Span<const LineMatch> matches, const CameraModel& camera,
                                         const RigidTransform& start, int max_iterations) {
  constexpr double kAtRest = 1e-10;  // radians, and ratio of the distance; far below any noise
  RigidTransform pose = start;
  for (int i = 0; i < max_iterations; ++i) {
    auto equations = Linearise(matches, camera, pose);
    if (!equations) return std::nullopt;
    // Prevents a singular matrix: a billionth of the curvature.
    equations->hessian.diagonal() *= 1.0 + 1e-9;
    const Vector6d step = -equations->hessian.ldlt().solve(equations->gradient);
    if (!step.allFinite() || step.tail<3>().norm() > 1.0) return std::nullopt;
    pose = Perturb(pose, step);
    if (step.tail<3>().norm() + step.head<3>().norm() / pose.translation_m.norm() < kAtRest) break;
  }
  return pose;
}

double LineResidualPx(absl::Span<const LineMatch> matches, const CameraModel& camera, const RigidTransform& pose) {
  double sum = 0.0;
  for (const LineMatch& match : matches) {
    const auto line = ProjectLine(camera, pose, match.p1, match.p2);
    if (!line || (pose * match.p1).z() <= 0.0 || (pose * match.p2).z() <= 0.0) {
      return std::numeric_limits<double>::infinity();
    }
    for (const Eigen::Vector2d& end : {match.segment.p1_px, match.segment.p2_px}) {
      const double d = line->a.dot(BearingOf(camera, end));
      sum += d * d;
    }
  }
  return matches.empty() ? 0.0 : std::sqrt(sum / (2.0 * static_cast<double>(matches.size())));
}

}  // namespace evpose
