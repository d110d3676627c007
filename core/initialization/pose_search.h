// SPDX-License-Identifier: Apache-2.0

// The pose of an object from image segments without known correspondences (core/initialization/README.md). The stages
// of a search, in order:
//
// 1. MakeSearchSegments(): the longest segments, as interpretation planes with uncertainties (search_segment.h).
// 2. FindRotations(): rotations under which the segments can be model lines, from directions alone
//    (rotation_search.h).
// 3. PositionSearch::Vote(): positions for each rotation, by votes of segments. PositionSearch::Score(): their
//    approximate cost. The cheapest poses are the candidates (position_search.h).
// 4. PoseFitter::MatchAndRefine(): each candidate is matched with the segments and refined, with gates that narrow; the
//    lines that may be visible come from a table of views (pose_fitter.h).
// 5. PoseFitter::ScoreVisible(): the cheapest ones become hypotheses, with the visible lines found by ray casting and
//    the final cost.
// 6. The near-symmetric poses of the best hypothesis (line_near_symmetries.h) and its depth reflection are refined and
//    scored in the same way and added.
// 7. PoseFitter::ScoreMinimum(): the best hypotheses are refined to the minimum of their cost.
//
// The SearchModel (search_model.h) has what all searches for one object share.
#pragma once

#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/image_segment.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

class SearchModel;

// A pose with an association of the segments.
struct PoseHypothesis {
  RigidTransform camera_from_object;
  // Cost of the unexplained segments and of the visible model lines without a segment, in squared standard deviations
  // of a segment's end point. Less is better.
  double cost = 0.0;
  std::vector<int> model_line;  // for each segment the index into ObjectModel::lines, or -1 for clutter
  int num_matched = 0;          // number of segments with a model line
  // True if this pose and the best one differ by a near-symmetry (line_near_symmetries.h). Such a pose is kept
  // regardless of its cost, because the few lines by which the two differ may not have produced events yet.
  bool is_near_symmetric = false;
  // Expected number of poses that would explain as much if all segments were clutter (false_alarms.h).
  double expected_false_alarms = 0.0;
};

// Immutable after construction; deterministic. Keeps the model.
class PoseSearch {
 public:
  virtual ~PoseSearch() = default;

  // `segments` are in undistorted pixels. Returns the hypotheses, the one with the lowest cost first, distinct modulo
  // the model's symmetries; the depth reflection of a planar object is therefore a second hypothesis. Empty if no pose
  // fits: too few segments, or only clutter. The time is bounded for any input: only the longest segments are used, and
  // the number of steps is limited.
  virtual std::vector<PoseHypothesis> Search(absl::Span<const ImageSegment> segments) const = 0;
};

// The defaults are validated by pose_search_trials_test, also with segments that are displaced, shortened and split,
// and by `evpose bench initialization` (core/experiments/RESULTS.md, The first pose); `evpose bench initialization
// --from-events` runs with max_hypotheses, too.
struct PoseSearchOptions {
  // Standard deviation of a segment's end point across the segment, pixels. 1 px combines 0.8 px of detection noise and
  // the half pixel by which the sensor shifts edges (core/estimation/README.md, section 3).
  double end_point_sigma_px = 1.0;
  // Standard deviation of an end point along the segment. It is larger, because corners are rounded and a detector
  // stops early.
  double end_point_along_sigma_px = 3.0;
  // Upper bound of the cost of an end that stops before its line does, in squared standard deviations: twice the log
  // odds that a detector follows a line to its end. 4 corresponds to a probability of 7/8.
  double short_cost = 4.0;
  // Cost of a clutter segment: twice the log likelihood ratio against a well-fitting segment of the object. Of it,
  // 16 remain after `2 short_cost` is subtracted. They bound the squared distances of both ends, which a true segment
  // exceeds in 3 of 10,000 cases.
  double unexplained_cost = 24.0;
  // Twice the log odds that a visible line is detected: 4 corresponds to a probability of 7/8.
  double missing_cost = 4.0;
  // Number of returned hypotheses. Real ambiguities have two to four poses; near-symmetric poses are additional.
  int max_hypotheses = 6;
  // Number of segments used, the longest first. Time grows with its square; a detailed object has 30.
  int max_segments = 32;
  // Standard deviation of the error of a rotation from directions alone, radians. Added to that of each segment when
  // directions are assigned to segments.
  double rotation_sigma_rad = 0.01;
  // Number of segments that vote for positions, the longest first; at most 16. If fewer than half of ten segments show
  // whole lines of the object, the search is unlikely to succeed.
  int max_voters = 10;
  // Largest relative difference in depth, and largest lateral distance as a share of the object's radius, of two votes
  // that support each other: the error of a position from one segment and a rotation with an error of 0.01 rad.
  double vote_depth_ratio = 0.06;
  double vote_lateral_of_radius = 0.05;
  // Number of candidates that are refined. The cheapest one before refinement need not be the cheapest one after it,
  // because the approximate cost has inflated standard deviations.
  int max_candidates = 48;
  // Number of refined candidates that are scored with ray casting. The others are scored only with the table of views.
  int max_ray_cast = 8;
  // Limits of the work after which the search returns its best result: rotations that are scored, and position votes.
  // The defaults take about 3 ms and 10 ms on a processor core of 2020.
  int max_rotations = 24'000;
  int max_votes = 120'000;

  // Upper bound of the cost of the distance between the segment's ends and its line.
  double max_across_cost() const { return unexplained_cost - 2.0 * short_cost; }

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// The distortion of `camera` is not used, because segments are undistorted. `search_model` is the search model of
// `model`; null: it is computed here. Errors: INVALID_ARGUMENT for options, or for a model whose lines determine no
// pose (CheckLinesDeterminePose).
absl::StatusOr<std::unique_ptr<PoseSearch>> MakePoseSearch(std::shared_ptr<const ObjectModel> model,
                                                           const CameraModel& camera,
                                                           const PoseSearchOptions& options = {},
                                                           std::shared_ptr<const SearchModel> search_model = nullptr);

}  // namespace evpose
