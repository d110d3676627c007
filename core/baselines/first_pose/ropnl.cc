// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/ropnl.h"

#include <cmath>
#include <limits>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "core/initialization/direction_symmetries.h"

namespace evpose {
namespace {

struct Solution {
  RigidTransform pose;
  double residual_px = std::numeric_limits<double>::infinity();
};

// Translation for a rotation, from the matches that the rotation explains.
Solution SolveFor(const Eigen::Matrix3d& rotation, const CameraModel& camera, absl::Span<const LineMatch> matches,
                  absl::Span<const Eigen::Vector3d> normals, absl::Span<const Eigen::Vector3d> directions,
                  double max_cosine) {
  std::vector<LineMatch> inliers;
  for (size_t j = 0; j < matches.size(); ++j) {
    if (std::abs(normals[j].dot(rotation * directions[j])) <= max_cosine) inliers.push_back(matches[j]);
  }
  const auto translation_m = SolveTranslation(inliers, camera, rotation);
  if (!translation_m) return {};
  const RigidTransform pose{rotation, *translation_m};
  return {pose, LineResidualPx(inliers, camera, pose)};
}

}  // namespace

absl::StatusOr<RigidTransform> EstimatePoseByRopnl(const CameraModel& camera, absl::Span<const LineMatch> matches,
                                                   const RotationBnbOptions& options) {
  if (matches.size() < 3) {
    return absl::InvalidArgumentError(absl::StrCat("RoPnL needs three matches: there are ", matches.size()));
  }
  std::vector<Eigen::Vector3d> normals;
  std::vector<Eigen::Vector3d> directions;
  for (const LineMatch& match : matches) {
    normals.push_back(BackProjectedNormal(camera, match.segment));
    directions.push_back((match.p2 - match.p1).normalized());
  }
  EVPOSE_ASSIGN_OR_RETURN(const RotationBnbResult result,
                          MaximisePerpendicular(normals, directions, options, Correspondences::kKnown));
  const std::vector<Eigen::Matrix3d> symmetries = SignSymmetries(directions);
  const double max_cosine = std::sin(options.inlier_rad);
  Solution best;
  for (const Eigen::Matrix3d& rotation : result.rotations) {
    for (const Eigen::Matrix3d& q : symmetries) {
      const Solution solution = SolveFor(rotation * q, camera, matches, normals, directions, max_cosine);
      if (solution.residual_px < best.residual_px) best = solution;
    }
  }
  if (!std::isfinite(best.residual_px)) {
    return absl::NotFoundError("RoPnL: no translation puts the lines in front of the camera");
  }
  return best.pose;
}

}  // namespace evpose
