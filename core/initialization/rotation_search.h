// SPDX-License-Identifier: Apache-2.0

// Rotations under which image segments can be model lines, from directions alone (core/initialization/README.md,
// section 2): n_j . R v_k = 0.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "absl/types/span.h"
#include "core/initialization/search_model.h"
#include "core/initialization/search_segment.h"

namespace evpose {

struct RotationCandidate {
  Eigen::Matrix3d rotation;  // camera_from_object; represents all rotation * Q, Q in SearchModel::labellings()
  // Equation (5) of the README: the sum, over the segments, of the smallest squared deviation from any direction, in
  // squared standard deviations, or of unexplained_cost. It is a lower bound of the cost of every pose with this
  // rotation.
  double cost = 0.0;
};

// The pose search sets the first four fields (PoseSearchOptions); the others are validated by the trials of
// core/experiments/first_pose.
struct RotationSearchOptions {
  double max_segment_cost = 16.0;  // squared sigmas; a segment with a larger deviation is assigned to no direction
  double unexplained_cost = 24.0;  // squared sigmas; the cost of such a segment
  int max_rotations = 24'000;      // limit of the number of scored rotations
  // Number of returned candidates. The pose search sets it to 10 to 600, by the number of votes that each of them
  // takes.
  int max_candidates = 40;
  // Standard deviation of the difference between a rotation of the sweep and the best rotation beside it, radians: half
  // a step of 1.5 degrees plus the error of the two segments of the pair. Added to that of each segment.
  double sweep_sigma_rad = 0.01;
  // The same after refinement, radians. With 0, a line parallel to the line of sight, which determines a rotation to a
  // thousandth of a radian, would have no influence until all other lines agree.
  double refined_sigma_rad = 0.005;
  // Standard deviation of the prior that keeps a refined rotation near the rotation of the sweep, radians. It admits
  // the minimum beside that rotation, at most half a step of 0.026 rad away, and keeps apart the rotations of a valley,
  // which are kept every two steps.
  double prior_rad = 0.02;
  // Rotations closer than this, radians, are duplicates; the pose refinement converges from a greater distance.
  double same_rotation_rad = 0.03;
  // Besides the minima of a sweep, rotations are kept with a cost that exceeds the best one by at most this multiple of
  // max_segment_cost: under weak perspective, two directions leave one degree of freedom undetermined. The second value
  // is for an object with only two directions (a flat object), which always leaves it undetermined.
  double valley_cost_ratio = 1.0;
  double flat_valley_cost_ratio = 2.0;
};

// Finds rotations. A pair of segments on a pair of directions leaves one degree of freedom of the rotation. It is
// swept, each rotation is scored by all segments, and the best ones are refined. Returns the candidate with the lowest
// cost first, distinct modulo the symmetries of the directions; empty with fewer than two segments or directions.
// Deterministic.
std::vector<RotationCandidate> FindRotations(const SearchModel& model, absl::Span<const SearchSegment> segments,
                                             const RotationSearchOptions& options);

}  // namespace evpose
