// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/pose_search.h"

#include <algorithm>

#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/base/yield_point.h"
#include "core/geometry/lines_of_a_pose.h"
#include "core/initialization/pose_fitter.h"
#include "core/initialization/position_search.h"
#include "core/initialization/rotation_search.h"
#include "core/initialization/search_model.h"
#include "core/initialization/search_segment.h"
#include "core/models/continuous_symmetry.h"

namespace evpose {
namespace {

// A candidate that leaves two more segments unexplained than the best one is discarded.
constexpr double kMarginOfUnexplained = 2.0;
// Bounds of the number of rotations for which positions are searched. Within them the number follows from max_votes: an
// object with few directions and lines needs few votes per rotation.
constexpr double kMinRotations = 10;
constexpr double kMaxRotations = 600;
// Number of rotations that vote before their positions are scored, and number of positions scored for them. The
// candidates of one group bound the cost of the next, so that most positions are discarded early.
constexpr size_t kRotationsAtOnce = 4;
constexpr int kScoredAtOnce = 200;
// Number of hypotheses refined to the minimum: the best pose and the next one, often its near-symmetry. Each takes a
// few tenths of a millisecond.
constexpr size_t kMaxMinimised = 2;
// Poses closer than this are duplicates: rotation in radians, distance as a share of the distance from the camera.
// Poses that refinement leaves farther apart than this have different minima.
constexpr double kSamePoseRad = 0.02;
constexpr double kSamePoseRatio = 0.01;

class LinePoseSearch : public PoseSearch {
 public:
  LinePoseSearch(std::shared_ptr<const ObjectModel> model, const CameraModel& camera, const PoseSearchOptions& options,
                 std::shared_ptr<const SearchModel> search_model)
      : model_(std::move(model)),
        camera_(Undistorted(camera)),
        options_(options),
        search_model_(std::move(search_model)) {}

  // The numbers are those of the stages in pose_search.h.
  std::vector<PoseHypothesis> Search(absl::Span<const ImageSegment> segments) const override {
    // 1.
    const std::vector<SearchSegment> longest =
        MakeSearchSegments(camera_, segments, options_.end_point_sigma_px, options_.max_segments);
    if (longest.size() < kLinesOfAPose) return {};
    const PoseFitter fitter(*search_model_, camera_, longest, options_);
    const double cost_of_nothing = options_.unexplained_cost * static_cast<double>(longest.size());
    std::vector<PoseHypothesis> hypotheses;
    const auto add_scored = [&](const RigidTransform& pose, bool is_near_symmetric) {
      PoseHypothesis hypothesis = fitter.ScoreVisible(pose, segments.size());
      hypothesis.is_near_symmetric = is_near_symmetric;
      if (hypothesis.num_matched < kLinesOfAPose || !(is_near_symmetric || hypothesis.cost < cost_of_nothing)) return;
      AddDistinct(std::move(hypothesis), hypotheses);
    };
    // 2 to 5.
    for (const PoseHypothesis& refined : RefineCandidates(fitter, FindCandidates(longest), segments.size())) {
      add_scored(refined.camera_from_object, false);
    }
    if (hypotheses.empty()) return hypotheses;
    // 6.
    const RigidTransform best = hypotheses[0].camera_from_object;
    for (const RigidTransform& near_symmetry : search_model_->near_symmetries()) add_scored(best * near_symmetry, true);
    RigidTransform reflected = best;
    if (fitter.ReflectDepths(reflected)) add_scored(reflected, false);
    LimitNumber(hypotheses);
    // 7. The refinement may exchange the order of the hypotheses.
    const size_t num_minimised = std::min<size_t>(kMaxMinimised, hypotheses.size());
    for (size_t i = 0; i < num_minimised; ++i) {
      YieldPoint();
      PoseHypothesis minimised = fitter.ScoreMinimum(hypotheses[i].camera_from_object, segments.size());
      minimised.is_near_symmetric = hypotheses[i].is_near_symmetric;
      hypotheses[i] = std::move(minimised);
    }
    std::stable_sort(hypotheses.begin(), hypotheses.end(),
                     [](const PoseHypothesis& a, const PoseHypothesis& b) { return a.cost < b.cost; });
    return hypotheses;
  }

 private:
  static CameraModel Undistorted(CameraModel camera) {
    camera.distortion = {};
    return camera;
  }

  // Stages 2 and 3. Returns the poses with the lowest approximate cost.
  std::vector<PoseCandidate> FindCandidates(const std::vector<SearchSegment>& longest) const {
    const std::vector<Eigen::Matrix3d>& labellings = search_model_->labellings();
    PositionSearch positions(*search_model_, camera_, longest, options_);
    const double votes_per_candidate = positions.ExpectedVotes() * static_cast<double>(labellings.size());
    const double max_candidates = std::clamp(options_.max_votes / votes_per_candidate, kMinRotations, kMaxRotations);
    const RotationSearchOptions rotation_options = {.max_segment_cost = options_.max_across_cost(),
                                                    .unexplained_cost = options_.unexplained_cost,
                                                    .max_rotations = options_.max_rotations,
                                                    .max_candidates = static_cast<int>(max_candidates)};
    const std::vector<RotationCandidate> rotations = FindRotations(*search_model_, longest, rotation_options);
    BestCandidates best(static_cast<size_t>(options_.max_candidates), kMarginOfUnexplained * options_.unexplained_cost);
    for (size_t i = 0; i < rotations.size() && positions.num_votes() < options_.max_votes;) {
      for (const size_t end = i + kRotationsAtOnce; i < std::min(end, rotations.size()); ++i) {
        if (rotations[i].cost > best.cap()) return best.candidates();
        for (const Eigen::Matrix3d& labelling : labellings) positions.Vote(rotations[i].rotation * labelling);
      }
      positions.Score(kScoredAtOnce, best);
    }
    return best.candidates();
  }

  // Stage 4. Returns the refined candidates with the lowest cost, at most max_ray_cast.
  std::vector<PoseHypothesis> RefineCandidates(const PoseFitter& fitter, absl::Span<const PoseCandidate> candidates,
                                               size_t num_segments) const {
    std::vector<PoseHypothesis> refined;
    for (const PoseCandidate& candidate : candidates) {
      YieldPoint();
      RigidTransform pose = candidate.camera_from_object;
      if (fitter.MatchAndRefine(pose)) AddDistinct(fitter.Score(pose, fitter.LikelyParts(pose), num_segments), refined);
    }
    if (refined.size() > static_cast<size_t>(options_.max_ray_cast)) refined.resize(options_.max_ray_cast);
    return refined;
  }

  // Returns whether two poses are equal modulo the model's symmetries.
  bool AreSame(const RigidTransform& a, const RigidTransform& b) const {
    const auto near = [&](const RigidTransform& c) {
      return RotationAngle(a.rotation, c.rotation) < kSamePoseRad &&
             (a.translation_m - c.translation_m).norm() < kSamePoseRatio * a.translation_m.norm();
    };
    if (model_->continuous_symmetry) return near(NearestEquivalent(b, *model_->continuous_symmetry, a));
    return near(b) || std::any_of(model_->symmetries.begin(), model_->symmetries.end(),
                                  [&](const RigidTransform& symmetry) { return near(b * symmetry); });
  }

  // Removes the hypotheses with the highest costs beyond max_hypotheses. Near-symmetric ones do not count, because they
  // are few.
  void LimitNumber(std::vector<PoseHypothesis>& hypotheses) const {
    int count = 0;
    std::erase_if(hypotheses, [&](const PoseHypothesis& hypothesis) {
      return !hypothesis.is_near_symmetric && ++count > options_.max_hypotheses;
    });
  }

  // Inserts a hypothesis into the list, which is sorted by cost. Of two equal poses the cheaper one remains.
  void AddDistinct(PoseHypothesis hypothesis, std::vector<PoseHypothesis>& hypotheses) const {
    const auto place = std::upper_bound(hypotheses.begin(), hypotheses.end(), hypothesis,
                                        [](const auto& a, const auto& b) { return a.cost < b.cost; });
    const auto is_same = [&](const PoseHypothesis& other) {
      return AreSame(hypothesis.camera_from_object, other.camera_from_object);
    };
    if (const auto cheaper = std::find_if(hypotheses.begin(), place, is_same); cheaper != place) {
      cheaper->is_near_symmetric |= hypothesis.is_near_symmetric;
      return;
    }
    for (auto dearer = place; dearer != hypotheses.end(); ++dearer) {
      if (is_same(*dearer)) hypothesis.is_near_symmetric |= dearer->is_near_symmetric;
    }
    const auto dearer = hypotheses.insert(place, hypothesis) + 1;
    hypotheses.erase(std::remove_if(dearer, hypotheses.end(), is_same), hypotheses.end());
  }

  const std::shared_ptr<const ObjectModel> model_;
  const CameraModel camera_;
  const PoseSearchOptions options_;
  const std::shared_ptr<const SearchModel> search_model_;
};

}  // namespace

absl::Status PoseSearchOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("PoseSearchOptions.end_point_sigma_px", end_point_sigma_px, 0.01, 100.0));
  EVPOSE_RETURN_IF_ERROR(
      CheckRange("PoseSearchOptions.end_point_along_sigma_px", end_point_along_sigma_px, 0.01, 1000.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("PoseSearchOptions.short_cost", short_cost, 0.1, 1000.0));
  EVPOSE_RETURN_IF_ERROR(
      CheckRange("PoseSearchOptions.unexplained_cost", unexplained_cost, 2.0 * short_cost + 1.0, 10000.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("PoseSearchOptions.missing_cost", missing_cost, 0.0, 1000.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("PoseSearchOptions.max_hypotheses", max_hypotheses, 1, 100));
  EVPOSE_RETURN_IF_ERROR(CheckRange("PoseSearchOptions.max_segments", max_segments, 3, 64));
  EVPOSE_RETURN_IF_ERROR(CheckRange("PoseSearchOptions.max_rotations", max_rotations, 1000, 100'000'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("PoseSearchOptions.max_votes", max_votes, 1000, 100'000'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("PoseSearchOptions.rotation_sigma_rad", rotation_sigma_rad, 0.0, 0.5));
  EVPOSE_RETURN_IF_ERROR(CheckRange("PoseSearchOptions.max_voters", max_voters, 1, 16));
  EVPOSE_RETURN_IF_ERROR(CheckRange("PoseSearchOptions.vote_depth_ratio", vote_depth_ratio, 1e-3, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("PoseSearchOptions.vote_lateral_of_radius", vote_lateral_of_radius, 1e-3, 10.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("PoseSearchOptions.max_candidates", max_candidates, 1, 10'000));
  return CheckRange("PoseSearchOptions.max_ray_cast", max_ray_cast, 1, 10'000);
}

absl::StatusOr<std::unique_ptr<PoseSearch>> MakePoseSearch(std::shared_ptr<const ObjectModel> model,
                                                           const CameraModel& camera, const PoseSearchOptions& options,
                                                           std::shared_ptr<const SearchModel> search_model) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_RETURN_IF_ERROR(camera.Validate());
  if (search_model == nullptr) {
    EVPOSE_ASSIGN_OR_RETURN(search_model, MakeSearchModel(model));
  }
  return std::make_unique<LinePoseSearch>(std::move(model), camera, options, std::move(search_model));
}

}  // namespace evpose
