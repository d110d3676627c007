// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/ransac_p3l.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <array>
#include <cmath>
#include <optional>
#include <vector>

#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/baselines/first_pose/line_match.h"
#include "core/baselines/first_pose/p3l.h"
#include "core/baselines/first_pose/pose_score.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

// Draws three different numbers below `bound`, which is at least three.
std::array<size_t, 3> DrawThree(Random& random, size_t bound) {
  std::array<size_t, 3> drawn;
  drawn[0] = random.UniformInt(bound);
  do drawn[1] = random.UniformInt(bound);
  while (drawn[1] == drawn[0]);
  do drawn[2] = random.UniformInt(bound);
  while (drawn[2] == drawn[0] || drawn[2] == drawn[1]);
  return drawn;
}

class Ransac {
 public:
  Ransac(const ObjectModel& model, const CameraModel& camera, absl::Span<const ImageSegment> segments,
         const RansacP3lOptions& options)
      : options_(options), scorer_(model, camera, segments, options.threshold_px) {
    for (const ImageSegment& segment : segments) normals_.push_back(BackProjectedNormal(camera, segment));
    for (const ModelLine& line : model.lines) directions_.push_back((line.p2 - line.p1).normalized());
  }

  void Draw(Random& random);
  absl::StatusOr<RigidTransform> Finish() const;

 private:
  void TryMatches(const std::array<size_t, 3>& segments, const std::array<size_t, 3>& lines);

  const RansacP3lOptions& options_;
  const PoseScorer scorer_;
  std::vector<Eigen::Vector3d> normals_;
  std::vector<Eigen::Vector3d> directions_;
  BestPose best_;
};

void Ransac::Draw(Random& random) {
  const std::array<size_t, 3> segments = DrawThree(random, scorer_.segments().size());
  const std::array<size_t, 3> lines = DrawThree(random, scorer_.model().lines.size());
  TryMatches(segments, lines);
}

void Ransac::TryMatches(const std::array<size_t, 3>& segments, const std::array<size_t, 3>& lines) {
  Eigen::Matrix3d normals;
  for (int i = 0; i < 3; ++i) normals.row(i) = normals_[segments[i]];
  // Image lines through one point do not determine the translation.
  if (std::abs(normals.determinant()) < 1e-4) return;
  const auto rotations = SolveP3l({normals_[segments[0]], normals_[segments[1]], normals_[segments[2]]},
                                  {directions_[lines[0]], directions_[lines[1]], directions_[lines[2]]});
  const Eigen::Matrix3d inverse = normals.inverse();
  for (const Eigen::Matrix3d& rotation : rotations) {
    Eigen::Vector3d right;
    for (int i = 0; i < 3; ++i) right[i] = -normals.row(i).dot(rotation * scorer_.model().lines[lines[i]].p1);
    const RigidTransform pose{rotation, inverse * right};
    best_.Offer(pose, scorer_.QuickScore(pose, best_.score.inliers));
  }
}

absl::StatusOr<RigidTransform> Ransac::Finish() const {
  if (!best_.pose) return absl::NotFoundError("RANSAC: no draw explains four segments");
  RigidTransform pose = *best_.pose;
  for (int pass = 0; pass < 2; ++pass) {
    const std::vector<LineMatch> matches = scorer_.Matches(scorer_.Score(pose));
    const auto refined = RefinePose(matches, scorer_.camera(), pose, options_.refinement_iterations);
    if (!refined || scorer_.Score(*refined).inliers < best_.score.inliers) break;
    pose = *refined;
  }
  return pose;
}

}  // namespace

absl::Status RansacP3lOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("RansacP3lOptions.num_draws", num_draws, 1, 100'000'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("RansacP3lOptions.threshold_px", threshold_px, 0.0, 1000.0, OpenEnds::kLow));
  return CheckRange("RansacP3lOptions.refinement_iterations", refinement_iterations, 0, 1000);
}

absl::StatusOr<RigidTransform> EstimatePoseByRansac(const ObjectModel& model, const CameraModel& camera,
                                                    absl::Span<const ImageSegment> segments,
                                                    const RansacP3lOptions& options, uint64_t seed) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  if (segments.size() < kMinInliers || model.lines.size() < 3) {
    return absl::NotFoundError("RANSAC: fewer than four segments or three model lines");
  }
  Ransac ransac(model, camera, segments, options);
  Random random(seed);
  for (int i = 0; i < options.num_draws; ++i) ransac.Draw(random);
  return ransac.Finish();
}

}  // namespace evpose
