// SPDX-License-Identifier: Apache-2.0

// Error-state filter over labelled events, as one method of FitPoseToLines(), which checks the arguments.
#pragma once

#include "core/baselines/estimators/line_fit.h"

namespace evpose {

// Returns the pose after one update per event. Options and events must be valid. Errors: FAILED_PRECONDITION as for
// FitPoseToLines().
absl::StatusOr<LineFit> FilterPose(const CameraModel& camera, absl::Span<const LineEnds> lines,
                                   absl::Span<const LabelledEvent> events, const RigidTransform& initial,
                                   const LineFitOptions& options);

}  // namespace evpose
