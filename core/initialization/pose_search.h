// SPDX-License-Identifier: Apache-2.0

// The pose of an object from image segments of which nobody knows whose they are (core/initialization/README.md).
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

// One way in which the segments can be the object's.
struct PoseHypothesis {
  RigidTransform camera_from_object;
  // Less is better: what the segments leave unexplained, and what the model should show and no segment does. In units
  // of squared standard deviations of a segment's end point.
  double cost = 0.0;
  // By how much the segments cost more when none of them is the object's: twice a log likelihood ratio.
  double evidence = 0.0;
  std::vector<int> model_line;  // for each segment, index into ObjectModel::lines, or -1: not the object's
  int num_matched = 0;          // segments with a line
  double matched_ratio = 0.0;   // share of the visible model's projected length that the segments cover
  // What the best of the poses found is mistaken for (lookalikes.h), or the other way round: the few lines by which the
  // two differ may not have been seen yet, whatever that costs.
  bool is_lookalike = false;
};

// Immutable after construction; deterministic. Keeps the model.
class PoseSearch {
 public:
  virtual ~PoseSearch() = default;

  // Best first; distinct modulo the model's symmetries, so that a planar object's mirror pose is a second hypothesis.
  // Empty when nothing fits: too few segments, or none that could be the object's. Time is bounded whatever the
  // segments are: the longest are used when there are many, and a budget of work, counted in steps, is kept.
  virtual std::vector<PoseHypothesis> Search(absl::Span<const ImageSegment> segments) const = 0;
};

struct PoseSearchOptions {
  // Standard deviation of a segment's end point across the segment, pixels. 1: detection noise of 0.8 px, and edges
  // that the sensor shifts by half a pixel (core/estimation/README.md, section 3).
  double end_point_sigma_px = 1.0;
  // Along the segment its ends are less certain: corners are rounded, and a detector stops early.
  double end_point_along_sigma_px = 3.0;
  // The most that an end costs which stops before its line does, in squared standard deviations: twice the log odds
  // that a detector follows a line to its end. 4: 7 of 8.
  double short_cost = 4.0;
  // What a segment costs that is no line of the object: twice the log likelihood ratio to one that is and fits well.
  // Beyond twice `short_cost`, 16 is for its distance: a true segment is farther off in 3 of 10000 cases.
  double unexplained_cost = 24.0;
  // Twice the log odds that a visible line is detected: 4 is 7 of 8.
  double missing_cost = 4.0;
  int max_hypotheses = 6;  // more than a caller can follow up; real ambiguities are two to four; and lookalikes
  // Segments used, the longest first. Time grows with the square; 30 is a dense object's.
  int max_segments = 32;
  // Work before the search takes the best that it has: rotations that are scored, and positions that are voted for. The
  // defaults take about 3 and 10 ms on a core of 2020.
  int max_rotations = 24'000;
  int max_votes = 120'000;

  // The most that the distance of a segment's ends from its line may cost.
  double max_across_cost() const { return unexplained_cost - 2.0 * short_cost; }

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// `camera`'s distortion plays no part: segments are undistorted. Errors, INVALID_ARGUMENT: options; a model from whose
// lines no pose can follow (CheckLinesDeterminePose). `search_model` is that of the model; null: made here.
absl::StatusOr<std::unique_ptr<PoseSearch>> MakePoseSearch(std::shared_ptr<const ObjectModel> model,
                                                           const CameraModel& camera,
                                                           const PoseSearchOptions& options = {},
                                                           std::shared_ptr<const SearchModel> search_model = nullptr);

// Why no pose can follow from the model's lines: fewer than three (collinear pieces count as one), all parallel, or all
// through one point. OK when one can.
absl::Status CheckLinesDeterminePose(const ObjectModel& model);

}  // namespace evpose
