// SPDX-License-Identifier: Apache-2.0

// Near-symmetries: rotations after which an object has almost the same edges and surface, so that a pose can be
// mistaken for another one (core/evaluation/README.md, section 6).
#pragma once

#include <Eigen/Core>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

// The tolerance is validated by near_symmetries_test of this folder: marks with 2 to 7 % of the edges are
// near-symmetries; an L profile has none, and neither has a prism of twelve sides between the twelfths of a turn. No
// test has a share near the other default.
struct NearSymmetryOptions {
  // Distance, relative to the diameter, beyond which an edge or a part of the surface has no counterpart: 3 px of an
  // object of 300 px, FindabilityOptions::same_px, up to which a hypothesis attributes events to an edge.
  double tolerance_ratio = 0.01;
  // Largest NearSymmetry::differing_share. From many sides about half of what differs is hidden: a fifth is then a
  // tenth of the visible edges, below which two poses have nearly the same events (section 5).
  double max_differing_share = 0.2;

  absl::Status Validate() const;
};

struct NearSymmetry {
  RigidTransform object_from_object;               // rotation by `angle_rad` about `axis`
  Eigen::Vector3d axis = Eigen::Vector3d::Zero();  // object frame, unit; its largest component is positive
  double angle_rad = 0.0;                          // (0, pi]; the inverse rotation is as near, and not in the list
  // Rotations by all other angles about the axis are near-symmetries, too, as those of a shaft with a keyway. They are
  // not in the list, and the shares below are those of the least similar of four.
  bool is_any_angle = false;
  // Share of the length of lines and curves, and of the contours over all views, that has no counterpart within the
  // tolerance and 20 degrees: the mean of the turned object compared with the object, and the reverse. 0 without
  // edges, or without contours; exact to 0.005. Whether other parts hide them in a view is not considered.
  double differing_edges = 0.0;
  double differing_contours = 0.0;
  // The mean of both, weighted by the shares of edges and contours in the visible length.
  double differing_share = 0.0;
  // Root mean square distance of the parts that have a counterpart from it, relative to the diameter.
  double displacement_ratio = 0.0;
};

// Returns the near-symmetries of a model, the most similar first, at most 16. Tested are rotations by 30, 36, 45, 60,
// 72, 90, 108, 120, 135, 144, 150 and 180 degrees about the principal axes of edges and surface, the directions of its
// largest flat parts and longest lines, and the diagonals between these; each is refined (README, section 6).
// Symmetries of the model (ObjectModel::symmetries, ::continuous_symmetry) are not among them, and of rotations that
// differ by such a symmetry only the first is. `contour_share`: share of contours in the visible length of all edges,
// ModelView::contour_px over ModelView::length_px. Errors: INVALID_ARGUMENT for invalid options or an invalid share.
absl::StatusOr<std::vector<NearSymmetry>> FindNearSymmetries(const ObjectModel& model, double contour_share,
                                                             const NearSymmetryOptions& options = {});

}  // namespace evpose
