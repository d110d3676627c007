// SPDX-License-Identifier: Apache-2.0

// The error-state filter's sweep over labelled events; FitPoseToLines is the way to call it.
#pragma once

#include "core/baselines/estimators/line_fit.h"

namespace evpose {

// Options and events must be valid. Errors: FAILED_PRECONDITION as FitPoseToLines.
absl::StatusOr<LineFit> FilterPose(const CameraModel& camera, absl::Span<const LineEnds> lines,
                                   absl::Span<const LabelledEvent> events, const RigidTransform& initial,
                                   const LineFitOptions& options);

}  // namespace evpose
