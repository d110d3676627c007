// SPDX-License-Identifier: Apache-2.0

// From which views and how small in the image an object can be found, and with which other pose of itself it can be
// confused there (core/evaluation/README.md, section 5).
#pragma once

#include <limits>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/evaluation/model_views.h"

namespace evpose {

// The defaults are limits of the searches, which the comments name. They are validated by findability_test on a cube,
// on its edges as dashes and on nearly symmetric boxes; no benchmark compares the prediction with searches.
struct FindabilityOptions {
  ModelViewOptions views;  // `object_px` is the size at which edges are counted and rivals are compared
  // Visible length, pixels, of edges that a view needs: three edges, which determine the six unknowns of a pose, of
  // `min_line_px`.
  double min_edge_px = 60.0;
  // Least length, pixels, that the line detector accepts (LineSetOptions::min_length_px). A model without curved edges
  // is found by its lines alone: three of them must be as long.
  double min_line_px = 20.0;
  // Displacement of the object, pixels, after which it is to be found. Each pixel of edge has about one event for each
  // pixel of motion.
  double motion_px = 2.0;
  // Largest rotation, radians, by which the least certain motion may be wrong: beyond it a tracker cannot associate its
  // lines (EvaluationOptions::good_rotation_rad).
  double max_deviation_rad = 0.1745;
  // Diameters of the object in the image, pixels, that are tested to find the smallest one: from `min_object_px` in
  // steps of the factor `size_step`, up to `max_object_px` and the shorter side of the image. Smaller steps would be
  // finer than the prediction is accurate. In an object smaller than `min_object_px` an error of one pixel, as edges in
  // few events have, exceeds the three cells of a distance map (core/initialization/templates/README.md, section 4),
  // and three lines of 20 px do not fit.
  double min_object_px = 40.0;
  double max_object_px = 1024.0;
  double size_step = 1.25;
  // Two edges are the same in the image if they are nearer than this, pixels, and turned by less than this, radians: a
  // hypothesis attributes events to an edge up to this distance.
  double same_px = 3.0;
  double same_rad = 0.35;

  absl::Status Validate() const;
};

// The pose that is turned by half a turn, compared with the true one.
struct HalfTurnRival {
  Eigen::Vector3d axis = Eigen::Vector3d::Zero();  // principal axis, object frame, unit
  // Visible length of the edges of either pose that have no counterpart in the other, pixels, after the best shift in
  // the image, and its share of the length of both.
  double differing_px = 0.0;
  double differing_share = 0.0;
};

struct ViewFindability {
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();  // object frame, from the object to the camera
  double edge_px = 0.0;                                 // visible length of edges at ModelViewOptions::object_px
  // Smallest diameter of the object in the image with which it can be found; infinite if it cannot be found with the
  // largest one.
  double smallest_px = std::numeric_limits<double>::infinity();
  std::vector<HalfTurnRival> rivals;  // without those that are symmetries of the object
};

// Returns the views of ViewModel(). Errors: INVALID_ARGUMENT for invalid options or an invalid camera.
absl::StatusOr<std::vector<ViewFindability>> PredictFindability(const ObjectModel& model, const CameraModel& camera,
                                                                const FindabilityOptions& options = {});

}  // namespace evpose
