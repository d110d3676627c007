// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/softposit_lines.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <vector>

#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/baselines/first_pose/line_match.h"
#include "core/baselines/first_pose/pose_score.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

// Ratio of the smallest to the largest eigenvalue of the second moments of the points below which they lie in a plane.
constexpr double kPlanar = 1e-9;

// Distance of a point from a line segment.
double DistanceToPiece(const Eigen::Vector2d& point, const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  const Eigen::Vector2d way = b - a;
  const double length2 = way.squaredNorm();
  const double s = length2 > 0.0 ? std::clamp((point - a).dot(way) / length2, 0.0, 1.0) : 0.0;
  return (point - a - s * way).norm();
}

class SoftPosit {
 public:
  SoftPosit(const ObjectModel& model, const CameraModel& camera, absl::Span<const ImageSegment> segments,
            const SoftPositOptions& options)
      : model_(model), camera_(camera), segments_(segments), options_(options) {
    for (const ModelLine& line : model.lines) {
      centre_ += 0.5 / static_cast<double>(model.lines.size()) * (line.p1 + line.p2);
    }
  }

  // Whether the lines of the model do not lie in a plane.
  bool IsSolid() const;
  std::optional<RigidTransform> Run(const RigidTransform& start) const;

 private:
  // End points of the model lines in the image, for the lines that may be visible.
  struct Projection {
    std::vector<std::array<Eigen::Vector2d, 2>> ends_px;
    std::vector<bool> is_seen;
  };
  std::optional<Projection> Project(const RigidTransform& pose) const;
  Eigen::MatrixXd SoftAssignment(const Projection& projection, double beta) const;
  std::optional<RigidTransform> Posit(const RigidTransform& pose, const Projection& projection,
                                      const Eigen::MatrixXd& weights) const;

  const ObjectModel& model_;
  const CameraModel& camera_;
  const absl::Span<const ImageSegment> segments_;
  const SoftPositOptions& options_;
  Eigen::Vector3d centre_ = Eigen::Vector3d::Zero();  // origin of the object frame of POSIT
};

bool SoftPosit::IsSolid() const {
  Eigen::Matrix3d moments = Eigen::Matrix3d::Zero();
  for (const ModelLine& line : model_.lines) {
    for (const Eigen::Vector3d& p : {line.p1, line.p2}) moments += (p - centre_) * (p - centre_).transpose();
  }
  const Eigen::Vector3d values = Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(moments).eigenvalues();
  return values[0] > kPlanar * values[2];
}

std::optional<SoftPosit::Projection> SoftPosit::Project(const RigidTransform& pose) const {
  const Eigen::Vector3d eye = pose.Inverse().translation_m;
  Projection projection;
  for (const ModelLine& line : model_.lines) {
    const Eigen::Vector3d a = pose * line.p1, b = pose * line.p2;
    if (!(a.z() > 0.1 * model_.diameter_m && b.z() > 0.1 * model_.diameter_m)) return std::nullopt;
    projection.ends_px.push_back({camera_.Project(a), camera_.Project(b)});
    projection.is_seen.push_back(!IsTurnedAway(line, eye));
  }
  return projection;
}

// Rows: segments and a slack; columns: model lines and a slack. Except for the slacks, rows and columns sum to 1.
Eigen::MatrixXd SoftPosit::SoftAssignment(const Projection& projection, double beta) const {
  constexpr int kMaxSweeps = 30;       // about the bound of the paper; later sweeps have no effect
  constexpr double kConverged = 1e-3;  // largest change of an assignment in a sweep
  const Eigen::Index rows = static_cast<Eigen::Index>(segments_.size());
  const Eigen::Index columns = static_cast<Eigen::Index>(model_.lines.size());
  const double alpha_px2 = 2.0 * options_.max_distance_px * options_.max_distance_px;
  Eigen::MatrixXd m = Eigen::MatrixXd::Zero(rows + 1, columns + 1);
  m.row(rows).setOnes();
  m.col(columns).setOnes();
  for (Eigen::Index j = 0; j < rows; ++j) {
    for (Eigen::Index k = 0; k < columns; ++k) {
      if (!projection.is_seen[k]) continue;
      const auto& [a, b] = projection.ends_px[k];
      const double d1 = DistanceToPiece(segments_[j].p1_px, a, b), d2 = DistanceToPiece(segments_[j].p2_px, a, b);
      m(j, k) = std::exp(-beta * (d1 * d1 + d2 * d2 - alpha_px2));
    }
  }
  for (int sweep = 0; sweep < kMaxSweeps; ++sweep) {
    for (Eigen::Index k = 0; k < columns; ++k) m.col(k) /= m.col(k).sum();
    double change = 0.0;
    for (Eigen::Index j = 0; j < rows; ++j) {
      const double sum = m.row(j).sum();
      change = std::max(change, std::abs(sum - 1.0));
      m.row(j) /= sum;
    }
    if (change < kConverged) break;
  }
  return m;
}

// Minimises sum m_jk |(Q1 . S, Q2 . S) - w (x, y)|^2 over Q1 and Q2, the first two rows of the pose over its depth.
std::optional<RigidTransform> SoftPosit::Posit(const RigidTransform& pose, const Projection& projection,
                                               const Eigen::MatrixXd& weights) const {
  const Eigen::Vector3d centre_camera = pose * centre_;
  Eigen::Matrix4d moments = Eigen::Matrix4d::Zero();
  Eigen::Matrix<double, 4, 2> right = Eigen::Matrix<double, 4, 2>::Zero();
  for (size_t k = 0; k < model_.lines.size(); ++k) {
    for (int end = 0; end < 2; ++end) {
      const Eigen::Vector3d offset = (end == 0 ? model_.lines[k].p1 : model_.lines[k].p2) - centre_;
      const Eigen::Vector4d point(offset.x(), offset.y(), offset.z(), 1.0);
      const double w = 1.0 + (pose.rotation.row(2).dot(offset)) / centre_camera.z();
      for (size_t j = 0; j < segments_.size(); ++j) {
        const double weight = weights(static_cast<Eigen::Index>(j), static_cast<Eigen::Index>(k));
        if (weight < 1e-6) continue;
        const auto line = Eigen::ParametrizedLine<double, 2>::Through(segments_[j].p1_px, segments_[j].p2_px);
        const Eigen::Vector3d image = BearingOf(camera_, line.projection(projection.ends_px[k][end]));
        moments += weight * point * point.transpose();
        right += weight * w * point * image.head<2>().transpose();
      }
    }
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> solver(moments);
  if (!(solver.eigenvalues()[0] > kPlanar * solver.eigenvalues()[3])) return std::nullopt;
  const Eigen::Matrix<double, 4, 2> q = moments.ldlt().solve(right);
  const double scale = std::sqrt(q.col(0).head<3>().norm() * q.col(1).head<3>().norm());  // 1 / depth
  const Eigen::Vector3d r1 = q.col(0).head<3>().normalized();
  const Eigen::Vector3d r3 = r1.cross(q.col(1).head<3>()).normalized();
  if (!r3.allFinite() || !(scale > 0.0)) return std::nullopt;
  RigidTransform next;
  next.rotation << r1.transpose(), r3.cross(r1).transpose(), r3.transpose();
  next.translation_m = Eigen::Vector3d(q(3, 0), q(3, 1), 1.0) / scale - next.rotation * centre_;
  return next;
}

std::optional<RigidTransform> SoftPosit::Run(const RigidTransform& start) const {
  RigidTransform pose = start;
  for (double beta = options_.initial_beta_per_px2; beta < options_.final_beta_per_px2; beta *= options_.beta_factor) {
    const auto projection = Project(pose);
    if (!projection) return std::nullopt;
    const auto next = Posit(pose, *projection, SoftAssignment(*projection, beta));
    if (!next) return std::nullopt;
    pose = *next;
  }
  return pose;
}

}  // namespace

absl::Status SoftPositOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("SoftPositOptions.max_starts", max_starts, 1, 1'000'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SoftPositOptions.good_ratio", good_ratio, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SoftPositOptions.initial_beta_per_px2", initial_beta_per_px2, 1e-9, 1.0));
  EVPOSE_RETURN_IF_ERROR(
      CheckRange("SoftPositOptions.final_beta_per_px2", final_beta_per_px2, initial_beta_per_px2, 1e3));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SoftPositOptions.beta_factor", beta_factor, 1.001, 10.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SoftPositOptions.max_distance_px", max_distance_px, 0.01, 1000.0));
  return CheckRange("SoftPositOptions.threshold_px", threshold_px, 0.01, 1000.0);
}

absl::StatusOr<RigidTransform> EstimatePoseBySoftPosit(const ObjectModel& model, const CameraModel& camera,
                                                       absl::Span<const ImageSegment> segments, const PosePrior& prior,
                                                       const SoftPositOptions& options, uint64_t seed) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  const SoftPosit softposit(model, camera, segments, options);
  if (model.lines.empty() || !softposit.IsSolid()) {
    return absl::NotFoundError("SoftPOSIT: the model lies in a plane, for which POSIT has no solution");
  }
  const PoseScorer scorer(model, camera, segments, options.threshold_px);
  Random random(seed);
  BestPose best;
  for (int start = 0; start < options.max_starts; ++start) {
    const auto pose = softposit.Run(start == 0 ? prior.camera_from_object : prior.Draw(random));
    if (!pose || !best.Offer(*pose, scorer.Score(*pose))) continue;
    if (best.score.inliers >= options.good_ratio * static_cast<double>(segments.size())) break;
  }
  if (!best.pose) return absl::NotFoundError("SoftPOSIT: no start explains four segments");
  return *best.pose;
}

}  // namespace evpose
