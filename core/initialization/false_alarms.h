// SPDX-License-Identifier: Apache-2.0

// The significance of a pose among clutter (core/initialization/README.md, section 6).
#pragma once

#include <vector>

#include "absl/types/span.h"
#include "core/initialization/pose_search.h"
#include "core/initialization/search_segment.h"

namespace evpose {

// The segments that a pose explains.
struct ExplainedSegments {
  // Number of distinct model lines that segments are matched with: pieces of one edge are no independent evidence.
  int num_lines = 0;
  // Sum over these lines of the squared distances of the ends of the best segment across the line, in squared standard
  // deviations.
  double across_cost = 0.0;
};

// Returns the expected number of poses of the model that would explain at least as much if all `segments` were clutter,
// with uniform positions and directions in their region. This is the number of false alarms of an a-contrario test
// (Moisan and Stival, "A probabilistic criterion to detect rigid point matches between two images", IJCV 2004).
// Infinite for fewer than four lines: some pose fits any three. `part_lengths_px` are the projected lengths of the
// visible lines, `lines_per_part` is the number of all lines of the model per visible line, `num_symmetries` that of
// the motions that map the model onto itself, at least 1.
double ExpectedFalseAlarms(const ExplainedSegments& explained, absl::Span<const SearchSegment> segments,
                           absl::Span<const double> part_lengths_px, double lines_per_part, double num_symmetries,
                           const PoseSearchOptions& options);

}  // namespace evpose
