// SPDX-License-Identifier: Apache-2.0

// First pose from lines without correspondences, with a prior: BlindPnP for lines.
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

// The defaults are validated by blind_pnp_lines_test, which requires a number of right poses; `evpose bench
// initialization` runs with them (core/experiments/RESULTS.md, The first pose).
struct BlindPnpOptions {
  // Gaussians from which the search starts, each linearised at its own mean; value of the paper.
  int num_components = 20;
  // Standard deviations of a component relative to those of the prior. Narrower components would leave gaps: twenty
  // cannot fill six dimensions.
  double component_scale = 1.0;
  // Pixels: standard deviation of an end point of a segment across its line: noise of 0.8 px and the error of the
  // linearised projection.
  double sigma_px = 1.5;
  // Squared Mahalanobis distance, with two degrees of freedom, up to which a segment is a candidate: 99 % of the true
  // ones.
  double gate = 9.21;
  // Matches after which the pose is scored: each one determines two of the six unknowns.
  int matches_per_hypothesis = 3;
  // Maximum number of poses that are scored.
  int max_hypotheses = 2000;
  // Share of explained segments at which the search ends.
  double good_ratio = 0.8;
  // Pixels: largest distance of an end point from a projected line when poses are scored.
  double threshold_px = 6.0;

  // INVALID_ARGUMENT names the field.
  absl::Status Validate() const;
};

// Moreno-Noguer, Lepetit, Fua, "Pose priors for simultaneously solving alignment and correspondence", ECCV 2008. The
// prior is a mixture of Gaussians. For each of them, the feature with the most certain projection is matched in turn
// with every candidate in its gate; each match updates the pose as a Kalman filter and narrows the next gates, depth
// first. After three matches the pose is scored by all features.
//
// Differences for lines instead of points: the measurement of a match is the signed distance of both ends of the
// segment from the projected line, and the next line is the one with the fewest candidates. The Gaussians are drawn
// from the prior (the first is its mean). Poses are scored by the segments on projected lines, and the best one is
// refined by the same update over its inliers.
//
// `segments` are undistorted, in pixels; equal seeds give equal poses. Errors: INVALID_ARGUMENT for the options;
// NOT_FOUND if no hypothesis explains four segments.
absl::StatusOr<RigidTransform> EstimatePoseByBlindPnp(const ObjectModel& model, const CameraModel& camera,
                                                      absl::Span<const ImageSegment> segments, const PosePrior& prior,
                                                      const BlindPnpOptions& options, uint64_t seed);

}  // namespace evpose
