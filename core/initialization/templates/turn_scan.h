// SPDX-License-Identifier: Apache-2.0

// The turn of a nearly round object about its axis, from the events near the few edges that show it
// (core/initialization/templates/README.md, section 6).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/detection/line_detector.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/initialization/templates/edge_distance_map.h"
#include "core/initialization/templates/edge_samples.h"
#include "core/initialization/templates/template_model.h"

namespace evpose {

struct ScannedTurn {
  RigidTransform camera_from_object;
  // Standard deviations by which the events near the edges that show the turn exceed those of uniform clutter.
  double sigma = 0.0;
};

// Immutable after construction. Keeps references: `model` must outlive it. Calls YieldPoint().
class TurnScanner {
 public:
  // `events` in [t_begin_us, t_end_us] are used, the latest 40,000 of them at most; undistorted, in order of time. The
  // model must have a near_axis().
  TurnScanner(const TemplateModel& model, const CameraModel& camera, absl::Span<const PixelEvent> events,
              int64_t t_begin_us, int64_t t_end_us);

  // Returns the best turns of the pose at the middle of the interval, at most `max_turns`, best first; none where no
  // edge shows the turn. `map`: of the box of the object. The work is bounded for any content of the events.
  std::vector<ScannedTurn> Scan(const EdgeDistanceMap& map, const RigidTransform& camera_from_object,
                                const Vector6d& twist, size_t max_turns) const;

 private:
  // The edges at each of the turns for which they are extracted, and which of the map's places most turns have in
  // common.
  struct TurnedEdges {
    std::vector<std::vector<EdgeSample>> of_turn;  // those that most turns do not have in common
    std::vector<uint8_t> is_common;                // by EdgeDistanceMap::Place
  };
  struct Counts {
    double near = 0.0, gated = 0.0;
  };

  TurnedEdges ExtractEdges(const EdgeDistanceMap& map, const RigidTransform& camera_from_object) const;
  // `turn`: in steps between the turns for which edges are extracted.
  RigidTransform Turned(const RigidTransform& camera_from_object, double turn) const;
  // Number of turns that are tried for each of those.
  int NumFineTurns(const TurnedEdges& edges, const RigidTransform& camera_from_object) const;
  // Adds the events of a slice beside the segment from `p1` to `p2`. `budget` decreases by the events that are looked
  // at.
  void AddEventsBeside(const Eigen::Vector2d& p1, const Eigen::Vector2d& p2, int slice, const EdgeDistanceMap& map,
                       const std::vector<uint8_t>& is_common, int64_t& budget, Counts& counts) const;

  // Parts of the interval in which the edges count as at rest: they move by 3 px in all of it.
  static constexpr int kSlices = 4;
  static constexpr int kTilePx = 16;

  const TemplateModel& model_;
  const CameraModel camera_;
  const int columns_;
  const int rows_;
  std::array<double, kSlices> after_middle_s_;  // of the middle of each slice
  std::vector<Eigen::Vector2f> events_;         // by slice and tile
  std::vector<uint32_t> first_of_tile_;         // index into events_ of the first one of each slice and tile
};

}  // namespace evpose
