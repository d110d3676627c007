// SPDX-License-Identifier: Apache-2.0

// The pose with the least cost for given matches, by Ceres.
#pragma once

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/initialization/search_segment.h"
#include "core/initialization/segment_fit.h"

namespace evpose {

// Minimises, from `pose`, the cost that segment_fit.h assigns to the matches (across the line: squares; along it:
// EndCost). The cost is implemented here a second time, with automatic differentiation: it is the reference for the
// steps of PoseFitter and refines the few poses that a search returns. Takes a few tenths of a millisecond.
// Returns false and leaves `pose` unchanged if a line extends behind the camera there or if Ceres fails.
//
// The result has the same bits on every machine: Powell's dogleg calls no function of the C library except sqrt
// (Levenberg-Marquardt calls pow), and the pose is rotated by rational functions.
bool RefineToMinimum(const CameraModel& camera, absl::Span<const SearchSegment> lines,
                     absl::Span<const SegmentMatch> matches, const FitWeights& weights, RigidTransform& pose);

}  // namespace evpose
