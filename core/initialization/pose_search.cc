// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/pose_search.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_format.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/initialization/pose_fitter.h"
#include "core/initialization/position_search.h"
#include "core/initialization/rotation_search.h"
#include "core/initialization/search_model.h"
#include "core/initialization/search_segment.h"

namespace evpose {
namespace {

constexpr size_t kMinSegments = 3;
constexpr size_t kCandidates = 48;  // candidates that are refined
// A candidate that leaves two more segments unexplained than the best one is discarded.
constexpr double kMarginOfUnexplained = 2.0;
constexpr size_t kMaxScored = 8;  // candidates that are scored with ray casting
constexpr double kMinRotations = 10;
constexpr double kMaxRotations = 600;
constexpr size_t kRotationsAtOnce = 4;
constexpr int kScoredAtOnce = 200;
constexpr size_t kMaxMinimised = 2;
constexpr int kMinMatched = 3;
constexpr double kSamePoseRad = 0.02;
constexpr double kSamePoseRatio = 0.01;  // as a share of the distance

class LinePoseSearch : public PoseSearch {
 public:
  LinePoseSearch(std::shared_ptr<const ObjectModel> model, const CameraModel& camera, const PoseSearchOptions& options,
                 std::shared_ptr<const SearchModel> search_model)
      : model_(std::move(model)),
        camera_(Undistorted(camera)),
        options_(options),
        search_model_(std::move(search_model)) {}

  std::vector<PoseHypothesis> Search(absl::Span<const ImageSegment> segments) const override {
    const std::vector<SearchSegment> lines =
        MakeSearchSegments(camera_, segments, options_.end_point_sigma_px, options_.max_segments);
    if (lines.size() < kMinSegments) return {};
    const PoseFitter fitter(*search_model_, camera_, lines, options_);
    const double cost_of_nothing = options_.unexplained_cost * static_cast<double>(lines.size());
    std::vector<PoseHypothesis> hypotheses;
    const auto add_scored = [&](const RigidTransform& pose, bool is_lookalike) {
      PoseHypothesis hypothesis = fitter.ScoreVisible(pose, segments.size());
      hypothesis.is_lookalike = is_lookalike;
      if (hypothesis.num_matched < kMinMatched || !(is_lookalike || hypothesis.cost < cost_of_nothing)) return;
      AddDistinct(std::move(hypothesis), hypotheses);
    };
    for (const PoseHypothesis& refined : MatchAndRefine(fitter, FindCandidates(lines), segments.size())) {
      add_scored(refined.camera_from_object, false);
    }
    if (hypotheses.empty()) return hypotheses;
    const RigidTransform best = hypotheses[0].camera_from_object;
    for (const RigidTransform& lookalike : search_model_->lookalikes()) add_scored(best * lookalike, true);
    RigidTransform reflected = best;
    if (fitter.ReflectDepths(reflected)) add_scored(reflected, false);
    DropDearest(hypotheses);
    // The best pose and its near symmetry. The final refinement may exchange their order.
    const size_t num_minimised = std::min<size_t>(kMaxMinimised, hypotheses.size());
    for (size_t i = 0; i < num_minimised; ++i) {
      PoseHypothesis minimised = fitter.ScoreMinimum(hypotheses[i].camera_from_object, segments.size());
      minimised.is_lookalike = hypotheses[i].is_lookalike;
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

  std::vector<PoseCandidate> FindCandidates(const std::vector<SearchSegment>& lines) const {
    const std::vector<Eigen::Matrix3d>& labellings = search_model_->labellings();
    PositionSearch positions(*search_model_, camera_, lines, options_);
    RotationSearchOptions rotation_options;
    rotation_options.max_line_cost = options_.max_across_cost();
    rotation_options.unexplained_cost = options_.unexplained_cost;
    rotation_options.max_rotations = options_.max_rotations;
    const double votes_per_candidate = positions.ExpectedVotes() * static_cast<double>(labellings.size());
    rotation_options.max_candidates =
        static_cast<int>(std::clamp(options_.max_votes / votes_per_candidate, kMinRotations, kMaxRotations));
    const std::vector<RotationCandidate> rotations = FindRotations(*search_model_, lines, rotation_options);
    BestCandidates best(kCandidates, kMarginOfUnexplained * options_.unexplained_cost);
    // Rotations are processed in small groups: the candidates of one group let most of the next be discarded early.
    for (size_t i = 0; i < rotations.size() && positions.num_votes() < options_.max_votes;) {
      for (const size_t end = i + kRotationsAtOnce; i < std::min(end, rotations.size()); ++i) {
        if (rotations[i].cost > best.cap()) return best.candidates();
        for (const Eigen::Matrix3d& labelling : labellings) positions.Vote(rotations[i].rotation * labelling);
      }
      positions.Score(kScoredAtOnce, best);
    }
    return best.candidates();
  }

  // Returns the best candidates after a first refinement.
  std::vector<PoseHypothesis> MatchAndRefine(const PoseFitter& fitter, absl::Span<const PoseCandidate> candidates,
                                             size_t num_segments) const {
    std::vector<PoseHypothesis> refined;
    for (const PoseCandidate& candidate : candidates) {
      RigidTransform pose = candidate.camera_from_object;
      if (fitter.MatchAndRefine(pose)) AddDistinct(fitter.Score(pose, fitter.LikelyParts(pose), num_segments), refined);
    }
    if (refined.size() > kMaxScored) refined.resize(kMaxScored);
    return refined;
  }

  bool AreSame(const RigidTransform& a, const RigidTransform& b) const {
    const auto near = [&](const RigidTransform& c) {
      return RotationAngle(a.rotation, c.rotation) < kSamePoseRad &&
             (a.translation_m - c.translation_m).norm() < kSamePoseRatio * a.translation_m.norm();
    };
    return near(b) || std::any_of(model_->symmetries.begin(), model_->symmetries.end(),
                                  [&](const RigidTransform& symmetry) { return near(b * symmetry); });
  }

  // Reduces the list to max_hypotheses. Near symmetries do not count, because they are few.
  void DropDearest(std::vector<PoseHypothesis>& hypotheses) const {
    int count = 0;
    std::erase_if(hypotheses, [&](const PoseHypothesis& hypothesis) {
      return !hypothesis.is_lookalike && ++count > options_.max_hypotheses;
    });
  }

  // The list is sorted by cost; of two equal poses the cheaper one remains.
  void AddDistinct(PoseHypothesis hypothesis, std::vector<PoseHypothesis>& hypotheses) const {
    const auto place = std::upper_bound(hypotheses.begin(), hypotheses.end(), hypothesis,
                                        [](const auto& a, const auto& b) { return a.cost < b.cost; });
    const auto is_same = [&](const PoseHypothesis& other) {
      return AreSame(hypothesis.camera_from_object, other.camera_from_object);
    };
    if (const auto cheaper = std::find_if(hypotheses.begin(), place, is_same); cheaper != place) {
      cheaper->is_lookalike |= hypothesis.is_lookalike;
      return;
    }
    for (auto dearer = place; dearer != hypotheses.end(); ++dearer) {
      if (is_same(*dearer)) hypothesis.is_lookalike |= dearer->is_lookalike;
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
  return CheckRange("PoseSearchOptions.max_votes", max_votes, 1000, 100'000'000);
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
