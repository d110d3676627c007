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
  Eigen::Matrix3d rotation;  // camera_from_object, stands for all rotation * Q, Q in SearchModel::labellings()
  // Sum over the lines of the least squared deviation from any direction, in squared standard deviations, or of
  // unexplained_cost. No pose with this rotation costs less.
  double cost = 0.0;
};

struct RotationSearchOptions {
  double max_line_cost = 16.0;     // a line that is farther off has none of the directions
  double unexplained_cost = 24.0;  // what it costs then
  int max_rotations = 24'000;      // scored
  int max_candidates = 40;         // returned
};

// A pair of image lines on a pair of directions leaves the rotation one degree of freedom; it is swept, the lines score
// what comes, and the best are refined. Best first, distinct modulo the directions' symmetries.
std::vector<RotationCandidate> FindRotations(const SearchModel& model, absl::Span<const SearchSegment> lines,
                                             const RotationSearchOptions& options);

}  // namespace evpose
