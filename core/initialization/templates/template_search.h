// SPDX-License-Identifier: Apache-2.0

// First poses of objects with any edges, from events: templates of all views are compared with the edges in the events
// (core/initialization/templates/README.md).
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "core/detection/line_detector.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/initialization/templates/event_edges.h"
#include "core/initialization/templates/template_alignment.h"
#include "core/initialization/templates/template_model.h"
#include "core/initialization/templates/template_scan.h"
#include "core/initialization/templates/twist_equations.h"

namespace evpose {

// The defaults are validated by template_search_test (four shapes, a hidden third of an object, noise, and the rotation
// of a nearly round object about its axis) and first_pose_bench_test; `evpose bench models --first-pose` runs with them
// on 29 shapes.
struct TemplateSearchOptions {
  EventEdgeOptions edges;
  TwistPrior twist_prior;
  // Smallest motion of the edges, pixels, with which a search starts, as InitializerOptions::min_motion_px.
  double min_motion_px = 1.0;
  // Number of boxes in the image that are searched: the object, and two things that are as large.
  int max_boxes = 3;
  // The time of a search is proportional to these numbers. Placements of each box that are aligned with the edges of
  // their template; poses of all boxes that are aligned with the edges that are visible at them; and poses that are
  // aligned so a second time.
  int max_placements = 64;
  int max_coarse = 24;
  int max_fine = 12;
  // The same for the edges off lines that are longer than everything else, if there are such lines. Boxes: the largest
  // visible part of an object behind a bar, and all of them together.
  int max_boxes_off_lines = 2;
  int max_coarse_off_lines = 12;
  // Numbers for a nearly round object: candidates that are rotated about its axis in steps of 2 pi / kTemplateTurns,
  // and poses that are kept of all their rotations. Each of them takes as long as another candidate; with fewer the
  // right rotation may be left out (README, section 4).
  int max_rotated_candidates = 3;
  int max_rotations = 12;
  // Number of returned poses: an object with three near-symmetries looks alike in eight poses.
  int max_matches = 8;
  // Least share of the visible edges with events (hit ratio), least share of the events on edges of the box that the
  // pose explains (explained ratio), and least sum of both. With 35 % of the object hidden, the right pose has a hit
  // ratio of 2/3 and explains most events; in clutter it has a hit ratio of 1 and explains a third of the events. A
  // wrong object has about 1/2 of each.
  double min_hit_ratio = 0.5;
  double min_explained_ratio = 0.3;
  double min_sum = 1.2;

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// A pose that another search has found, which is scored together with the templates.
struct PoseProposal {
  int64_t t_us = 0;
  RigidTransform camera_from_object;
  Vector6d twist = Vector6d::Zero();
};

// A pose at the middle of the events that were used.
struct TemplateMatch {
  RigidTransform camera_from_object;
  TwistEstimate motion;
  AlignmentScore score;
};

struct TemplateMatches {
  int64_t t_us = 0;
  double motion_px = 0.0;              // median motion of the edges in the events that were used
  bool has_moved = false;              // it was enough for a search
  std::vector<TemplateMatch> matches;  // the best one first; distinct modulo the symmetries of the object
};

// Deterministic; not thread-safe. Calls YieldPoint().
class TemplateSearch {
 public:
  // `options` must be valid.
  TemplateSearch(std::shared_ptr<const TemplateModel> model, const CameraModel& camera,
                 const TemplateSearchOptions& options = {});

  // `events` are as LineDetector::Detect requires. The work is bounded for any content of the events.
  TemplateMatches Find(absl::Span<const PixelEvent> events, absl::Span<const PoseProposal> proposals = {});

 private:
  struct Candidate {
    RigidTransform camera_from_object;
    size_t box = 0;
    double score = 0.0;
    AlignmentScore alignment;
    TwistEstimate motion;
  };
  using Maps = std::vector<std::unique_ptr<EdgeDistanceMap>>;

  SensorGeometry sensor() const { return {camera_.width_px, camera_.height_px}; }
  // Returns the best candidates in boxes about groups of `points`. Appends the distance map of each box to `maps`.
  std::vector<Candidate> FindInBoxes(absl::Span<const EventEdgePoint> points, int max_boxes, int max_candidates,
                                     Maps& maps) const;
  // Appends the poses of the placements in a box, aligned with the edges of their templates.
  void AppendCandidates(const EdgeDistanceMap& map, size_t box, std::vector<Candidate>& candidates) const;
  // Appends the proposals, moved to t_us, as candidates of all boxes.
  static void AppendProposals(absl::Span<const PoseProposal> proposals, int64_t t_us, size_t num_boxes,
                              std::vector<Candidate>& candidates);
  // Aligns a pose with the edges that are visible at it.
  void Refine(const EdgeDistanceMap& map, int num_samples, double gate, double duration_s, Candidate& candidate) const;
  // Appends the best poses that differ from one of the best candidates by a rotation about the axis of a nearly round
  // object: the parts that distinguish these poses are small.
  void AppendRotations(const Maps& maps, double duration_s, std::vector<Candidate>& candidates) const;
  // Sorts by score and keeps the best `count` that differ, modulo symmetries.
  void KeepDistinct(size_t count, std::vector<Candidate>& candidates) const;

  const std::shared_ptr<const TemplateModel> model_;
  const CameraModel camera_;
  const TemplateSearchOptions options_;
  const TemplateScanner scanner_;
  EventEdgeDetector detector_;
};

}  // namespace evpose
