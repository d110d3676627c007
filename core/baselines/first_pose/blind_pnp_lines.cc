// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/blind_pnp_lines.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <vector>

#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/baselines/first_pose/line_match.h"
#include "core/baselines/first_pose/pose_score.h"
#include "core/geometry/projected_line.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

// A Gaussian over poses, in the tangent of Perturb() at its mean.
struct Belief {
  RigidTransform pose;
  Matrix6d covariance;
};

// A projected line with the uncertainty of its ends.
struct UncertainLine {
  ProjectedLine line;
  Eigen::Vector2d along;  // unit vector from p1_px
  double length_px = 0.0;
  double reach_px = 0.0;  // three standard deviations of the ends along the line
};

class BlindPnp {
 public:
  BlindPnp(const ObjectModel& model, const CameraModel& camera, absl::Span<const ImageSegment> segments,
           const BlindPnpOptions& options)
      : options_(options),
        scorer_(model, camera, segments, options.threshold_px),
        line_used_(model.lines.size(), false),
        segment_used_(segments.size(), false) {
    for (const ImageSegment& segment : segments) {
      bearings_.push_back({BearingOf(camera, segment.p1_px), BearingOf(camera, segment.p2_px)});
    }
  }

  // Searches depth first from the distribution after `depth` matches.
  void Search(const Belief& belief, int depth);
  bool IsDone() const;
  absl::StatusOr<RigidTransform> Finish() const;

 private:
  std::optional<UncertainLine> Project(const Belief& belief, const ModelLine& line) const;
  bool MayMatch(const UncertainLine& line, size_t segment, const Belief& belief) const;
  std::optional<Belief> Update(const Belief& belief, const ProjectedLine& line, size_t segment) const;
  void ScoreHypothesis(const RigidTransform& pose);

  const BlindPnpOptions& options_;
  const PoseScorer scorer_;
  std::vector<std::array<Eigen::Vector3d, 2>> bearings_;
  std::vector<bool> line_used_;
  std::vector<bool> segment_used_;
  int num_scored_ = 0;
  BestPose best_;
};

// Rows: derivatives of the distances of the two ends by the pose.
Eigen::Matrix<double, 2, 6> MeasurementRows(const ProjectedLine& line, const std::array<Eigen::Vector3d, 2>& bearings) {
  Eigen::Matrix<double, 2, 6> rows;
  rows << (line.jacobian.transpose() * bearings[0]).transpose(), (line.jacobian.transpose() * bearings[1]).transpose();
  return rows;
}

std::optional<UncertainLine> BlindPnp::Project(const Belief& belief, const ModelLine& line) const {
  const Eigen::Vector3d eye = belief.pose.Inverse().translation_m;
  if (IsTurnedAway(line, eye)) return std::nullopt;
  const auto projected = ProjectLine(scorer_.camera(), belief.pose, line.p1, line.p2);
  if (!projected) return std::nullopt;
  UncertainLine uncertain{*projected, projected->p2_px - projected->p1_px, 0.0, 0.0};
  uncertain.length_px = uncertain.along.norm();
  if (uncertain.length_px < 2.0) return std::nullopt;
  uncertain.along /= uncertain.length_px;
  const double focal_px = scorer_.camera().MaxFocalPx();
  // The uncertainty of an end along its line is about that across it: f / z times that of its position.
  double variance_m2 = 0.0;
  double depth_m = 0.0;
  for (const Eigen::Vector3d& p : {line.p1, line.p2}) {
    Eigen::Matrix<double, 3, 6> rows;
    rows << Eigen::Matrix3d::Identity(), -Hat(belief.pose.rotation * p);
    const Eigen::Matrix3d place = rows * belief.covariance * rows.transpose();
    variance_m2 = std::max(variance_m2, place.trace() / 3.0);
    depth_m = std::max(depth_m, (belief.pose * p).z());
  }
  uncertain.reach_px = 3.0 * (focal_px / depth_m * std::sqrt(variance_m2) + options_.sigma_px);
  return uncertain;
}

bool BlindPnp::MayMatch(const UncertainLine& line, size_t segment, const Belief& belief) const {
  const ImageSegment& s = scorer_.segments()[segment];
  const double t1 = line.along.dot(s.p1_px - line.line.p1_px), t2 = line.along.dot(s.p2_px - line.line.p1_px);
  if (std::min(t1, t2) < -line.reach_px || std::max(t1, t2) > line.length_px + line.reach_px) return false;
  const Eigen::Matrix<double, 2, 6> rows = MeasurementRows(line.line, bearings_[segment]);
  Eigen::Matrix2d innovation = rows * belief.covariance * rows.transpose();
  innovation.diagonal().array() += options_.sigma_px * options_.sigma_px;
  const Eigen::Vector2d d(line.line.a.dot(bearings_[segment][0]), line.line.a.dot(bearings_[segment][1]));
  return d.dot(innovation.inverse() * d) < options_.gate;
}

// Iterated Kalman update with both distances measured as 0. `line` is the projection at the mean.
std::optional<Belief> BlindPnp::Update(const Belief& belief, const ProjectedLine& line, size_t segment) const {
  const Eigen::Matrix<double, 2, 6> rows = MeasurementRows(line, bearings_[segment]);
  Eigen::Matrix2d innovation = rows * belief.covariance * rows.transpose();
  innovation.diagonal().array() += options_.sigma_px * options_.sigma_px;
  const Eigen::Matrix<double, 6, 2> gain = belief.covariance * rows.transpose() * innovation.inverse();
  const Eigen::Vector2d d(line.a.dot(bearings_[segment][0]), line.a.dot(bearings_[segment][1]));
  const Vector6d step = -gain * d;
  const Matrix6d covariance = belief.covariance - gain * rows * belief.covariance;
  if (!step.allFinite()) return std::nullopt;
  return Belief{Perturb(belief.pose, step), 0.5 * (covariance + covariance.transpose())};
}

bool BlindPnp::IsDone() const {
  return num_scored_ >= options_.max_hypotheses ||
         best_.score.inliers >=
             std::max(options_.good_ratio * static_cast<double>(scorer_.segments().size()), 1.0 * kMinInliers);
}

void BlindPnp::ScoreHypothesis(const RigidTransform& pose) {
  ++num_scored_;
  // The prior is wide and the updates are of first order; one or two least-squares steps with the explained segments
  // precede the final score.
  const PoseScore score = scorer_.Score(pose);
  best_.Offer(pose, score);
  if (const auto refined = RefinePose(scorer_.Matches(score), scorer_.camera(), pose, 3)) {
    best_.Offer(*refined, scorer_.Score(*refined));
  }
}

void BlindPnp::Search(const Belief& belief, int depth) {
  if (depth == options_.matches_per_hypothesis) return ScoreHypothesis(belief.pose);
  size_t next_line = scorer_.model().lines.size();
  std::optional<UncertainLine> next;
  std::vector<size_t> candidates;
  for (size_t k = 0; k < scorer_.model().lines.size(); ++k) {
    if (line_used_[k]) continue;
    const auto line = Project(belief, scorer_.model().lines[k]);
    if (!line) continue;
    std::vector<size_t> found;
    for (size_t j = 0; j < scorer_.segments().size(); ++j) {
      if (!segment_used_[j] && MayMatch(*line, j, belief)) found.push_back(j);
    }
    if (found.empty() || (next && found.size() >= candidates.size())) continue;
    next_line = k;
    next = line;
    candidates = std::move(found);
  }
  if (!next) return;
  line_used_[next_line] = true;
  for (const size_t j : candidates) {
    if (IsDone()) break;
    const auto updated = Update(belief, next->line, j);
    if (!updated) continue;
    segment_used_[j] = true;
    Search(*updated, depth + 1);
    segment_used_[j] = false;
  }
  line_used_[next_line] = false;
}

absl::StatusOr<RigidTransform> BlindPnp::Finish() const {
  if (!best_.pose) return absl::NotFoundError("BlindPnP: no hypothesis explains four segments");
  return RefinePose(scorer_.Matches(best_.score), scorer_.camera(), *best_.pose, 10).value_or(*best_.pose);
}

Belief MakeBelief(const RigidTransform& pose, const PosePrior& prior, double scale) {
  const double depth_m = prior.camera_from_object.translation_m.z();
  Vector6d sigma;
  sigma.head<3>().setConstant(scale * prior.translation_ratio * depth_m);
  sigma.tail<3>().setConstant(scale * prior.rotation_rad);
  return {pose, sigma.cwiseAbs2().asDiagonal().toDenseMatrix()};
}

}  // namespace

absl::Status BlindPnpOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("BlindPnpOptions.num_components", num_components, 1, 10'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("BlindPnpOptions.component_scale", component_scale, 0.01, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("BlindPnpOptions.sigma_px", sigma_px, 0.01, 100.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("BlindPnpOptions.gate", gate, 0.1, 1000.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("BlindPnpOptions.matches_per_hypothesis", matches_per_hypothesis, 1, 10));
  EVPOSE_RETURN_IF_ERROR(CheckRange("BlindPnpOptions.max_hypotheses", max_hypotheses, 1, 100'000'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("BlindPnpOptions.good_ratio", good_ratio, 0.0, 1.0));
  return CheckRange("BlindPnpOptions.threshold_px", threshold_px, 0.01, 1000.0);
}

absl::StatusOr<RigidTransform> EstimatePoseByBlindPnp(const ObjectModel& model, const CameraModel& camera,
                                                      absl::Span<const ImageSegment> segments, const PosePrior& prior,
                                                      const BlindPnpOptions& options, uint64_t seed) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  BlindPnp search(model, camera, segments, options);
  Random random(seed);
  for (int i = 0; i < options.num_components && !search.IsDone(); ++i) {
    const RigidTransform pose = i == 0 ? prior.camera_from_object : prior.Draw(random);
    search.Search(MakeBelief(pose, prior, options.component_scale), 0);
  }
  return search.Finish();
}

}  // namespace evpose
