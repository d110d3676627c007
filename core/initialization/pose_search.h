// SPDX-License-Identifier: Apache-2.0

// The pose of an object from image segments without known correspondences (core/initialization/README.md).
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
  // The additional cost if no segment belonged to the object: twice a log likelihood ratio.
  double evidence = 0.0;
  std::vector<int> model_line;  // for each segment the index into ObjectModel::lines, or -1 for clutter
  int num_matched = 0;          // segments with a line
  double matched_ratio = 0.0;   // share of the visible model's projected length that segments cover
  // This pose and the best one differ by a near symmetry (lookalikes.h). Such a pose is kept regardless of its cost,
  // because the few lines by which the two differ may not have been observed yet.
  bool is_lookalike = false;
};

// Immutable after construction; deterministic. Keeps the model.
class PoseSearch {
 public:
  virtual ~PoseSearch() = default;

  // Returns the hypotheses, the best one first, distinct modulo the model's symmetries; the mirror pose of a planar
  // object is therefore a second hypothesis. Empty if no pose fits: too few segments, or only clutter. The time is
  // bounded for any input: only the longest segments are used, and the number of steps is limited.
  virtual std::vector<PoseHypothesis> Search(absl::Span<const ImageSegment> segments) const = 0;
};

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
  // Cost of a clutter segment: twice the log likelihood ratio against a well-fitting segment of the object. 16 of it,
  // after twice `short_cost`, bound the distance: a true segment is farther away in 3 of 10000 cases.
  double unexplained_cost = 24.0;
  // Twice the log odds that a visible line is detected: 4 corresponds to a probability of 7/8.
  double missing_cost = 4.0;
  int max_hypotheses = 6;  // real ambiguities have two to four poses; near symmetries are additional
  // Number of segments used, the longest first. Time grows with its square; a detailed object has 30.
  int max_segments = 32;
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

// Error: INVALID_ARGUMENT if the model's lines determine no pose: fewer than three lines (collinear pieces count as
// one), all parallel, or all through one point.
absl::Status CheckLinesDeterminePose(const ObjectModel& model);

}  // namespace evpose
