// SPDX-License-Identifier: Apache-2.0

// Finds the templates that look like the edges in a box of the image (core/initialization/templates/README.md,
// section 3).
#pragma once

#include <Eigen/Core>
#include <vector>

#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/initialization/templates/edge_distance_map.h"
#include "core/initialization/templates/template_model.h"

namespace evpose {

// A template at a place in the map.
struct TemplatePlacement {
  int view = 0;                                      // index into TemplateModel::views
  int turn = 0;                                      // about the line of sight, in steps of 2 pi / kTemplateTurns
  Eigen::Vector2f centre = Eigen::Vector2f::Zero();  // image of the object's centre, cells
  float cells_per_radius = 0.0f;
  float score = 0.0f;  // mean nearness of the points to edges of their directions, in [0, 1]
};

// Immutable after construction. Keeps a reference: `model` must outlive it.
class TemplateScanner {
 public:
  explicit TemplateScanner(const TemplateModel& model) : model_(model) {}

  // Returns the `count` best placements, the best one first. The whole object fills the box, or a side of it is hidden:
  // then its image is larger than the box and aligned with the opposite side.
  std::vector<TemplatePlacement> Scan(const EdgeDistanceMap& map, size_t count) const;

  // camera_from_object at a placement.
  RigidTransform PoseOf(const TemplatePlacement& placement, const EdgeDistanceMap& map,
                        const CameraModel& camera) const;

 private:
  // Appends the placements of a view and turn, with the score of each `stride`-th point.
  void AppendPlacements(const EdgeDistanceMap& map, int view, int turn, size_t stride,
                        std::vector<TemplatePlacement>& placements) const;
  float ScoreOf(const EdgeDistanceMap& map, const TemplatePlacement& placement, size_t stride) const;

  const TemplateModel& model_;
};

}  // namespace evpose
