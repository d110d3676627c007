// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/pose_refinement.h"

#include <ceres/autodiff_cost_function.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>

namespace evpose {
namespace {

// A pose that several segments determine converges in 6 to 20 iterations; one that has not converged after this number
// is rejected.
constexpr int kMaxIterations = 50;
// Relative change of the cost at convergence; close to the minimum it is the square of the pose error.
constexpr double kCostTolerance = 1e-16;

// Rotation by 2 atan(|v| / 2) about v, from the unit quaternion along (1, v / 2): equal to exp(v) to first order, and
// rational.
template <typename T>
Eigen::Quaternion<T> RationalRotation(const T* v) {
  return Eigen::Quaternion<T>(T(1.0), 0.5 * v[0], 0.5 * v[1], 0.5 * v[2]).normalized();
}

// The four residuals of a match, in standard deviations: both ends across the line and both along it.
struct MatchResiduals {
  const CameraModel& camera;
  const RigidTransform& start;
  const SearchSegment& seen;
  const SegmentMatch& match;
  const FitWeights& weights;

  // `change` holds the translation and the rotation relative to the start; the unit of the translation is the distance
  // of the start from the camera.
  template <typename T>
  bool operator()(const T* change, T* residuals) const {
    using Vector2 = Eigen::Matrix<T, 2, 1>;
    using Vector3 = Eigen::Matrix<T, 3, 1>;
    const Eigen::Quaternion<T> turn = RationalRotation(change + 3);
    const Vector3 shift = start.translation_m.norm() * Eigen::Map<const Vector3>(change);
    std::array<Vector2, 2> ends;
    for (const int end : {0, 1}) {
      const Eigen::Vector3d turned = start.rotation * (end == 0 ? match.p1 : match.p2);
      const Vector3 x = turn * turned.cast<T>() + start.translation_m.cast<T>() + shift;
      if (!(x.z() > 0.0)) return false;
      ends[end] = Vector2(camera.fx_px * x.x() / x.z() + camera.cx_px, camera.fy_px * x.y() / x.z() + camera.cy_px);
    }
    const Vector2 extent = ends[1] - ends[0];
    const T length = extent.norm();
    if (!(length > 0.0)) return false;
    for (const int end : {0, 1}) {
      const double side = end == 0 ? -1.0 : 1.0;
      const Eigen::Vector2d seen_end = seen.middle_px + side * seen.half_px * seen.along;
      const Vector2 way = seen_end.cast<T>() - ends[0];
      residuals[end] = std::sqrt(weights.across) * (extent.x() * way.y() - extent.y() * way.x()) / length;
      const Vector2 past = ends[end] - seen_end.cast<T>();
      const T u = std::sqrt(weights.along) * side * (seen.along.x() * past.x() + seen.along.y() * past.y());
      residuals[2 + end] = u < 0.0 ? u : u / sqrt(1.0 + u * u / weights.short_cost);
    }
    return true;
  }
};

ceres::Solver::Options SolverOptions() {
  ceres::Solver::Options options;
  options.trust_region_strategy_type = ceres::DOGLEG;
  options.linear_solver_type = ceres::DENSE_QR;
  options.num_threads = 1;
  options.logging_type = ceres::SILENT;
  options.max_num_iterations = kMaxIterations;
  options.function_tolerance = kCostTolerance;
  options.gradient_tolerance = 0.0;
  options.parameter_tolerance = 0.0;
  return options;
}

}  // namespace

bool RefineToMinimum(const CameraModel& camera, absl::Span<const SearchSegment> lines,
                     absl::Span<const SegmentMatch> matches, const FitWeights& weights, RigidTransform& pose) {
  // Ceres would print a warning on standard error.
  const auto is_before = [&](const SegmentMatch& match) {
    return (pose * match.p1).z() > 0.0 && (pose * match.p2).z() > 0.0;
  };
  if (!std::all_of(matches.begin(), matches.end(), is_before)) return false;
  ceres::Problem::Options problem_options;
  problem_options.disable_all_safety_checks = true;
  ceres::Problem problem(problem_options);
  std::array<double, 6> change = {};
  for (const SegmentMatch& match : matches) {
    using Cost = ceres::AutoDiffCostFunction<MatchResiduals, 4, 6>;
    problem.AddResidualBlock(new Cost(new MatchResiduals{camera, pose, lines[match.segment], match, weights}), nullptr,
                             change.data());
  }
  ceres::Solver::Summary summary;
  ceres::Solve(SolverOptions(), &problem, &summary);
  if (!summary.IsSolutionUsable()) return false;
  const Eigen::Vector3d shift = pose.translation_m.norm() * Eigen::Vector3d(change[0], change[1], change[2]);
  pose = {(RationalRotation(&change[3]) * Eigen::Quaterniond(pose.rotation)).normalized().toRotationMatrix(),
          pose.translation_m + shift};
  return true;
}

}  // namespace evpose
