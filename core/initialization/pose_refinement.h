// SPDX-License-Identifier: Apache-2.0

// The pose at which matched segments cost least, by Ceres.
#pragma once

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/initialization/search_segment.h"
#include "core/initialization/segment_fit.h"

namespace evpose {

// Goes on from `pose` to the minimum of the cost that segment_fit.h gives the matches (ends across: squares; ends
// along: EndCost), written down here once more by itself, with automatic differentiation: the reference that the steps
// of PoseJudge must equal, and the last word on the few poses that a search returns. Some tenths of a millisecond.
// False, `pose` unchanged, when a line reaches behind the camera there or Ceres gives up.
//
// The same bits on every machine: of Ceres' strategies Powell's dogleg takes no function of the C library but sqrt
// (Levenberg-Marquardt takes pow), and the pose is turned by rational functions.
bool RefineToMinimum(const CameraModel& camera, absl::Span<const SearchSegment> lines,
                     absl::Span<const SegmentMatch> matches, const FitWeights& weights, RigidTransform& pose);

}  // namespace evpose
