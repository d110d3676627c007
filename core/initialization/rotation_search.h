// SPDX-License-Identifier: Apache-2.0

// Rotations under which image lines can be model lines, from directions alone (core/initialization/README.md): n_j . R
// v = 0.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "absl/types/span.h"
#include "core/initialization/search_model.h"
#include "core/initialization/search_segment.h"

namespace evpose {

struct RotationCandidate {
  Eigen::Matrix3d rotation;  // camera_from_object; represents all rotation * Q, Q in SearchModel::labellings()
  // Sum over the lines of the least squared deviation from any direction, in squared standard deviations, or of
  // unexplained_cost. It is a lower bound of the cost of every pose with this rotation.
  double cost = 0.0;
};

struct RotationSearchOptions {
  double max_line_cost = 16.0;     // a line with a larger deviation is associated with no direction
  double unexplained_cost = 24.0;  // the cost of such a line
  int max_rotations = 24'000;      // limit of the number of scored rotations
  int max_candidates = 40;         // number of returned candidates
};

// A pair of image lines on a pair of directions leaves one degree of freedom of the rotation. It is swept, each
// rotation is scored by all lines, and the best ones are refined. Returns the best one first, distinct modulo the
// symmetries of the directions.
std::vector<RotationCandidate> FindRotations(const SearchModel& model, absl::Span<const SearchSegment> lines,
                                             const RotationSearchOptions& options);

}  // namespace evpose
