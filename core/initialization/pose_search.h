// The pose of an object from image segments of which nobody knows whose they are (method.md 2.3).
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

// One way in which the segments can be the object's.
struct PoseHypothesis {
  RigidTransform camera_from_object;
  // Less is better: what the segments leave unexplained, and what the model should show and no segment does. In units
  // of squared standard deviations of a segment's end point.
  double cost = 0.0;
  std::vector<int> model_line;  // for each segment, index into ObjectModel::lines, or -1: not the object's
  int num_matched = 0;          // segments with a line
  double matched_ratio = 0.0;   // share of the visible model's projected length that the segments cover
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

// Why no pose can follow from the model's lines: fewer than three, or all parallel. OK when one can.
absl::Status CheckLinesDeterminePose(const ObjectModel& model);

}  // namespace evpose
