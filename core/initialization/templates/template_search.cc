// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/templates/template_search.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <numbers>
#include <utility>

#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/base/yield_point.h"
#include "core/initialization/templates/edge_blobs.h"
#include "core/initialization/templates/long_lines.h"
#include "core/models/continuous_symmetry.h"

namespace evpose {
namespace {

// Poses closer than both are one: half the distance of two views, and of the size of the object.
constexpr double kSameRotationRad = 0.08;
constexpr double kSameShiftOfRadius = 0.15;
constexpr double kSameDepthRatio = 0.04;
// Samples of the two stages with visible edges. The first one has the larger number of poses; the time of a stage is
// proportional to both numbers.
constexpr int kFewSamples = 64;
constexpr int kManySamples = 120;

}  // namespace

absl::Status TemplateSearchOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(edges.Validate());
  EVPOSE_RETURN_IF_ERROR(CheckRange("TemplateSearchOptions.min_motion_px", min_motion_px, 0.1, 100.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("TemplateSearchOptions.max_boxes", max_boxes, 1, 100));
  EVPOSE_RETURN_IF_ERROR(CheckRange("TemplateSearchOptions.max_boxes_off_lines", max_boxes_off_lines, 1, 100));
  EVPOSE_RETURN_IF_ERROR(CheckRange("TemplateSearchOptions.max_placements", max_placements, 1, 10'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("TemplateSearchOptions.max_coarse", max_coarse, 1, 1000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("TemplateSearchOptions.max_coarse_off_lines", max_coarse_off_lines, 1, 1000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("TemplateSearchOptions.max_fine", max_fine, 1, 1000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("TemplateSearchOptions.max_rotated_candidates", max_rotated_candidates, 1, 100));
  EVPOSE_RETURN_IF_ERROR(CheckRange("TemplateSearchOptions.max_rotations", max_rotations, 1, 1000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("TemplateSearchOptions.max_matches", max_matches, 1, 100));
  EVPOSE_RETURN_IF_ERROR(CheckRange("TemplateSearchOptions.min_hit_ratio", min_hit_ratio, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("TemplateSearchOptions.min_sum", min_sum, 0.0, 2.0));
  return CheckRange("TemplateSearchOptions.min_explained_ratio", min_explained_ratio, 0.0, 1.0);
}

TemplateSearch::TemplateSearch(std::shared_ptr<const TemplateModel> model, const CameraModel& camera,
                               const TemplateSearchOptions& options)
    : model_(std::move(model)),
      camera_(camera),
      options_(options),
      scanner_(*model_),
      detector_(options.edges, sensor()) {}

std::vector<TemplateSearch::Candidate> TemplateSearch::FindInBoxes(absl::Span<const EventEdgePoint> points,
                                                                   int max_boxes, int max_candidates,
                                                                   Maps& maps) const {
  std::vector<Candidate> candidates;
  for (const ImageBox& box : FindEdgeBlobs(points, sensor(), max_boxes)) {
    YieldPoint();
    maps.push_back(std::make_unique<EdgeDistanceMap>(points, box));
    AppendCandidates(*maps.back(), maps.size() - 1, candidates);
  }
  KeepDistinct(static_cast<size_t>(max_candidates), candidates);
  return candidates;
}

void TemplateSearch::AppendCandidates(const EdgeDistanceMap& map, size_t box,
                                      std::vector<Candidate>& candidates) const {
  const TemplateAligner aligner(map, camera_, model_->radius_m(), model_->centre());
  for (const TemplatePlacement& placement : scanner_.Scan(map, static_cast<size_t>(options_.max_placements))) {
    YieldPoint();
    const absl::Span<const EdgeSample> samples = model_->views()[placement.view].samples;
    Candidate candidate;
    candidate.box = box;
    // The gate begins at the reach of the map and shrinks to 5 cells; Refine() continues from 6. Of the stages, this
    // one has the most poses, so that every second sample is used.
    candidate.camera_from_object =
        aligner.Align(scanner_.PoseOf(placement, map, camera_), samples, EdgeDistanceMap::kReach, 5.0, 4, 2);
    candidate.score = aligner.Nearness(candidate.camera_from_object, samples);
    candidates.push_back(std::move(candidate));
  }
}

void TemplateSearch::AppendProposals(absl::Span<const PoseProposal> proposals, int64_t t_us, size_t num_boxes,
                                     std::vector<Candidate>& candidates) {
  for (const PoseProposal& proposal : proposals) {
    const double later_s = 1e-6 * static_cast<double>(t_us - proposal.t_us);
    for (size_t box = 0; box < num_boxes; ++box) {
      Candidate candidate;
      candidate.camera_from_object = Perturb(proposal.camera_from_object, later_s * proposal.twist);
      candidate.box = box;
      candidates.push_back(std::move(candidate));
    }
  }
}

void TemplateSearch::Refine(const EdgeDistanceMap& map, int num_samples, double gate, double duration_s,
                            Candidate& candidate) const {
  const TemplateAligner aligner(map, camera_, model_->radius_m(), model_->centre());
  std::vector<EdgeSample> samples;
  SampleVisibleEdges(model_->edges(), aligner.map_camera(), candidate.camera_from_object, num_samples, samples);
  YieldPoint();
  // The gate is halved in four steps, so that edges of other parts lose their weight as the pose approaches its edges.
  candidate.camera_from_object = aligner.Align(candidate.camera_from_object, samples, gate, 0.5 * gate, 4, 1);
  YieldPoint();
  candidate.motion = aligner.EstimateTwist(candidate.camera_from_object, samples, options_.twist_prior);
  candidate.alignment = aligner.Score(candidate.camera_from_object, samples, candidate.motion.twist, duration_s);
  candidate.score = candidate.alignment.total();
}

void TemplateSearch::AppendRotations(const Maps& maps, double duration_s, std::vector<Candidate>& candidates) const {
  if (!model_->near_axis()) return;
  std::vector<Candidate> to_rotate, rotations;
  const auto is_known = [&](const Candidate& candidate) {
    return std::any_of(to_rotate.begin(), to_rotate.end(), [&](const Candidate& other) {
      const RigidTransform& pose = other.camera_from_object;
      const RigidTransform nearest = NearestEquivalent(candidate.camera_from_object, *model_->near_axis(), pose);
      return RotationAngle(nearest.rotation, pose.rotation) < 2.0 * kSameRotationRad;
    });
  };
  for (const Candidate& candidate : candidates) {
    if (static_cast<int>(to_rotate.size()) == options_.max_rotated_candidates) break;
    if (!is_known(candidate)) to_rotate.push_back(candidate);
  }
  const Eigen::Vector3d& axis = model_->near_axis()->axis;
  for (const Candidate& candidate : to_rotate) {
    const TemplateAligner aligner(*maps[candidate.box], camera_, model_->radius_m(), model_->centre());
    for (int turn = 0; turn < model_->num_spins(); ++turn) {
      YieldPoint();
      Candidate rotated = candidate;
      const Eigen::Matrix3d rotation = ExpSo3(2.0 * std::numbers::pi / kTemplateTurns * turn * axis);
      rotated.camera_from_object = candidate.camera_from_object * AboutCentre(*model_->near_axis(), rotation);
      const absl::Span<const EdgeSample> samples =
          model_->views()[model_->NearestView(rotated.camera_from_object)].samples;
      // All but the turn is aligned already: two steps, with the first gate of the next stage.
      rotated.camera_from_object = aligner.Align(rotated.camera_from_object, samples, 4.0, 3.0, 2, 1);
      rotated.score = aligner.Score(rotated.camera_from_object, samples, rotated.motion.twist, duration_s).total();
      rotations.push_back(std::move(rotated));
    }
  }
  KeepDistinct(static_cast<size_t>(options_.max_rotations), rotations);
  candidates.insert(candidates.end(), rotations.begin(), rotations.end());
}

void TemplateSearch::KeepDistinct(size_t count, std::vector<Candidate>& candidates) const {
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.score > b.score; });
  const Eigen::Vector3d& centre = model_->centre();
  const auto are_same = [&](const RigidTransform& a, const RigidTransform& b) {
    const Eigen::Vector3d at_a = a * centre, at_b = b * centre;
    if (std::abs(at_a.norm() - at_b.norm()) > kSameDepthRatio * at_a.norm()) return false;
    if ((at_a.normalized() - at_b.normalized()).norm() * at_a.norm() > kSameShiftOfRadius * model_->radius_m()) {
      return false;
    }
    return RotationAngle(a.rotation, NearestEquivalent(b, model_->model(), a).rotation) < kSameRotationRad;
  };
  std::vector<Candidate> kept;
  for (Candidate& candidate : candidates) {
    YieldPoint();
    if (kept.size() == count) break;
    const bool is_new = std::none_of(kept.begin(), kept.end(), [&](const Candidate& other) {
      return are_same(other.camera_from_object, candidate.camera_from_object);
    });
    if (is_new) kept.push_back(std::move(candidate));
  }
  candidates = std::move(kept);
}

TemplateMatches TemplateSearch::Find(absl::Span<const PixelEvent> events, absl::Span<const PoseProposal> proposals) {
  TemplateMatches found;
  const EventEdges edges = detector_.Detect(events);
  found.t_us = edges.t_mid_us();
  found.motion_px = edges.motion_px;
  found.has_moved = edges.motion_px >= options_.min_motion_px;
  if (!found.has_moved) return found;
  const double duration_s = 1e-6 * static_cast<double>(edges.t_end_us - edges.t_begin_us);
  Maps maps;
  std::vector<Candidate> candidates = FindInBoxes(edges.points, options_.max_boxes, options_.max_coarse, maps);
  // The coarse score ignores the edges that a template does not explain. Templates on the sides of a bar therefore
  // score higher than the object, and must not take the places of its candidates.
  std::vector<Candidate> off_lines = FindInBoxes(WithoutLongLines(edges.points, sensor()), options_.max_boxes_off_lines,
                                                 options_.max_coarse_off_lines, maps);
  std::move(off_lines.begin(), off_lines.end(), std::back_inserter(candidates));
  AppendProposals(proposals, found.t_us, maps.size(), candidates);
  for (Candidate& candidate : candidates) Refine(*maps[candidate.box], kFewSamples, 6.0, duration_s, candidate);
  KeepDistinct(static_cast<size_t>(options_.max_fine), candidates);
  AppendRotations(maps, duration_s, candidates);
  for (Candidate& candidate : candidates) Refine(*maps[candidate.box], kManySamples, 4.0, duration_s, candidate);
  KeepDistinct(static_cast<size_t>(options_.max_matches), candidates);
  for (const Candidate& candidate : candidates) {
    if (candidate.alignment.hit_ratio < options_.min_hit_ratio) continue;
    if (candidate.alignment.explained_ratio < options_.min_explained_ratio) continue;
    if (candidate.alignment.hit_ratio + candidate.alignment.explained_ratio < options_.min_sum) continue;
    found.matches.push_back({candidate.camera_from_object, candidate.motion, candidate.alignment});
  }
  return found;
}

}  // namespace evpose
