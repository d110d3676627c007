// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/published_bnb.h"

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
#include "core/initialization/direction_symmetries.h"

namespace evpose {
namespace {

struct Triple {
  std::array<int, 3> segments;
  double weight = 0.0;
};

// Selects the triples with the best determined translation, long segments first, such that no segment occurs in many
// more of them than the others: it may be spurious.
std::vector<Triple> ChooseTriples(absl::Span<const ImageSegment> segments, const std::vector<Eigen::Vector3d>& normals,
                                  int max_triples) {
  const int n = static_cast<int>(segments.size());
  if (n < 3) return {};
  std::vector<Triple> all;
  for (int i = 0; i < n; ++i) {
    for (int j = i + 1; j < n; ++j) {
      for (int k = j + 1; k < n; ++k) {
        const double volume = std::abs(normals[i].dot(normals[j].cross(normals[k])));
        const double length = std::min({segments[i].length_px(), segments[j].length_px(), segments[k].length_px()});
        if (volume > 1e-4) all.push_back({{i, j, k}, volume * length});
      }
    }
  }
  std::stable_sort(all.begin(), all.end(), [](const Triple& a, const Triple& b) { return a.weight > b.weight; });
  const int max_uses = 1 + (3 * max_triples + n - 1) / n;
  std::vector<int> uses(n, 0);
  std::vector<Triple> chosen;
  for (const Triple& triple : all) {
    if (static_cast<int>(chosen.size()) == max_triples) break;
    const auto& s = triple.segments;
    if (std::max({uses[s[0]], uses[s[1]], uses[s[2]]}) >= max_uses) continue;
    for (const int segment : s) ++uses[segment];
    chosen.push_back(triple);
  }
  return chosen;
}

class TranslationSearch {
 public:
  TranslationSearch(const ObjectModel& model, const CameraModel& camera, absl::Span<const ImageSegment> segments,
                    const PublishedBnbOptions& options)
      : options_(options), scorer_(model, camera, segments, options.threshold_px) {
    for (const ImageSegment& segment : segments) normals_.push_back(BackProjectedNormal(camera, segment));
    triples_ = ChooseTriples(segments, normals_, options.max_triples);
  }

  const std::vector<Eigen::Vector3d>& normals() const { return normals_; }
  void Try(const Eigen::Matrix3d& rotation);
  absl::StatusOr<RigidTransform> Finish() const;

 private:
  // A model line to which a segment may belong, and the plane of the translation in this case: n . T = offset.
  struct Candidate {
    double offset_m;
    int line;
  };
  void TryTriple(const Eigen::Matrix3d& rotation, const Triple& triple,
                 const std::vector<std::vector<Candidate>>& candidates);
  bool IsPlausible(const Eigen::Vector3d& translation_m) const;

  const PublishedBnbOptions& options_;
  const PoseScorer scorer_;
  std::vector<Eigen::Vector3d> normals_;
  std::vector<Triple> triples_;
  BestPose best_;
};

void TranslationSearch::Try(const Eigen::Matrix3d& rotation) {
  const double max_cosine = std::sin(options_.rotation.inlier_rad);
  std::vector<std::vector<Candidate>> candidates(normals_.size());
  for (size_t j = 0; j < normals_.size(); ++j) {
    for (size_t k = 0; k < scorer_.model().lines.size(); ++k) {
      const ModelLine& line = scorer_.model().lines[k];
      const Eigen::Vector3d direction = rotation * (line.p2 - line.p1).normalized();
      if (std::abs(normals_[j].dot(direction)) > max_cosine) continue;
      const double offset_m = -normals_[j].dot(rotation * (0.5 * (line.p1 + line.p2)));
      candidates[j].push_back({offset_m, static_cast<int>(k)});
    }
  }
  for (const Triple& triple : triples_) TryTriple(rotation, triple, candidates);
}

// Test before the projection: the origin of the object lies in front of the camera, farther than the size of the
// object.
bool TranslationSearch::IsPlausible(const Eigen::Vector3d& translation_m) const {
  return translation_m.z() > 0.5 * scorer_.model().diameter_m && translation_m.z() < 100.0 * scorer_.model().diameter_m;
}

void TranslationSearch::TryTriple(const Eigen::Matrix3d& rotation, const Triple& triple,
                                  const std::vector<std::vector<Candidate>>& candidates) {
  const auto& [i, j, k] = triple.segments;
  Eigen::Matrix3d rows;
  rows << normals_[i].transpose(), normals_[j].transpose(), normals_[k].transpose();
  const Eigen::Matrix3d inverse = rows.inverse();
  for (const Candidate& a : candidates[i]) {
    for (const Candidate& b : candidates[j]) {
      for (const Candidate& c : candidates[k]) {
        if (a.line == b.line || a.line == c.line || b.line == c.line) continue;
        const Eigen::Vector3d translation_m = inverse * Eigen::Vector3d(a.offset_m, b.offset_m, c.offset_m);
        if (!IsPlausible(translation_m)) continue;
        const RigidTransform pose{rotation, translation_m};
        best_.Offer(pose, scorer_.QuickScore(pose, best_.score.inliers));
      }
    }
  }
}

absl::StatusOr<RigidTransform> TranslationSearch::Finish() const {
  if (!best_.pose) return absl::NotFoundError("published BnB: no translation explains four segments");
  const std::vector<LineMatch> matches = scorer_.Matches(scorer_.Score(*best_.pose));
  const auto translation_m = SolveTranslation(matches, scorer_.camera(), best_.pose->rotation);
  return RigidTransform{best_.pose->rotation, translation_m.value_or(best_.pose->translation_m)};
}

// One symmetry of the directions of each class that the symmetries of the model do not map onto each other.
std::vector<Eigen::Matrix3d> SymmetriesOfDirectionsAlone(absl::Span<const Eigen::Vector3d> directions,
                                                         const ObjectModel& model) {
  constexpr double kSame = 1e-3;  // Frobenius norm; two different symmetries differ by far more
  std::vector<Eigen::Matrix3d> chosen;
  for (const Eigen::Matrix3d& q : DirectionSymmetries(directions)) {
    const bool is_known = std::any_of(chosen.begin(), chosen.end(), [&](const Eigen::Matrix3d& other) {
      return std::any_of(model.symmetries.begin(), model.symmetries.end(),
                         [&](const RigidTransform& s) { return (other * s.rotation - q).norm() < kSame; });
    });
    if (!is_known) chosen.push_back(q);
  }
  return chosen;
}

}  // namespace

absl::Status PublishedBnbOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(rotation.Validate());
  EVPOSE_RETURN_IF_ERROR(CheckRange("PublishedBnbOptions.threshold_px", threshold_px, 0.0, 1000.0, OpenEnds::kLow));
  return CheckRange("PublishedBnbOptions.max_triples", static_cast<double>(max_triples), 1, 100'000);
}

absl::StatusOr<RigidTransform> EstimatePoseByPublishedBnb(const ObjectModel& model, const CameraModel& camera,
                                                          absl::Span<const ImageSegment> segments,
                                                          const PublishedBnbOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  TranslationSearch translations(model, camera, segments, options);
  const std::vector<Eigen::Vector3d> directions = UniqueDirections(model);
  EVPOSE_ASSIGN_OR_RETURN(const RotationBnbResult result,
                          MaximisePerpendicular(translations.normals(), directions, options.rotation));
  const std::vector<Eigen::Matrix3d> symmetries = SymmetriesOfDirectionsAlone(directions, model);
  for (const Eigen::Matrix3d& rotation : result.rotations) {
    for (const Eigen::Matrix3d& q : symmetries) translations.Try(rotation * q);
  }
  return translations.Finish();
}

absl::StatusOr<RotationCertificate> CertifyPose(const ObjectModel& model, const CameraModel& camera,
                                                absl::Span<const ImageSegment> segments,
                                                const RigidTransform& camera_from_object,
                                                const RotationBnbOptions& options) {
  std::vector<Eigen::Vector3d> normals;
  for (const ImageSegment& segment : segments) {
    const Eigen::Vector3d normal = BackProjectedNormal(camera, segment);
    if (!normal.isZero()) normals.push_back(normal);
  }
  return CertifyRotation(normals, UniqueDirections(model), camera_from_object.rotation, options);
}

}  // namespace evpose
