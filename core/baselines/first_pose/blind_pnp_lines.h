// SPDX-License-Identifier: Apache-2.0

// Baseline without correspondences, with a first guess: BlindPnP, for lines.
#pragma once

#include <cstdint>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/baselines/first_pose/pose_prior.h"
#include "core/geometry/camera.h"
#include "core/geometry/image_segment.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

struct BlindPnpOptions {
  // Gaussians that the search starts from, each linearised at its own middle; the paper's number.
  int num_components = 20;
  // Standard deviations of a component, of the prior's. Components that were narrower would leave gaps: twenty cannot
  // fill six dimensions.
  double component_scale = 1.0;
  // Pixels: standard deviation of a segment's end point across its line. The noise of 0.8 px and what the linearised
  // projection is off by.
  double sigma_px = 1.5;
  // Squared Mahalanobis distance of two numbers beyond which a segment is no candidate: 99 % of the true ones are
  // within.
  double gate = 9.21;
  // Matches that are hypothesised before the pose is judged: each fixes two of the six unknowns.
  int matches_per_hypothesis = 3;
  // Poses that are judged, at most.
  int max_hypotheses = 2000;
  // Share of the segments that ends the search.
  double good_ratio = 0.8;
  // Pixels: an end point this near to a projected line is on it, when poses are judged.
  double threshold_px = 6.0;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// Moreno-Noguer, Lepetit, Fua, "Pose priors for simultaneously solving alignment and correspondence", ECCV 2008: the
// prior is a mixture of Gaussians; from each, the feature whose projection is the most certain is matched with every
// candidate in its gate in turn, the pose updated as by a Kalman filter, which narrows the next gates, and so on depth
// first; after three matches the pose is judged by all features. Adapted here from points to lines: what is measured of
// a match is the signed distance of the segment's two ends from the projected line; the next line is the one with the
// fewest candidates; the Gaussians are drawn from the prior (the first is its middle); poses are judged by segments on
// projected lines, and the winner is refined by the same update over its inliers.
// Errors: INVALID_ARGUMENT for options; NOT_FOUND when no hypothesis explains four segments.
absl::StatusOr<RigidTransform> EstimatePoseByBlindPnp(const ObjectModel& model, const CameraModel& camera,
                                                      absl::Span<const ImageSegment> segments, const PosePrior& prior,
                                                      const BlindPnpOptions& options, uint64_t seed);

}  // namespace evpose
