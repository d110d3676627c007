// SPDX-License-Identifier: Apache-2.0

// The error floor that a window's events allow: every window is fitted from the truth.
#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "core/geometry/camera.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"
#include "core/tracking/tracker.h"
#include "core/tracking/tracker_options.h"

namespace evpose {

// Makes an oracle: the tracker's windows at ordinary speed (they do not adapt to the image speed), its association,
// mixture estimator, edge correction and options. Every window starts at the true pose and twist of its middle, with
// the lines that are visible at the true pose, under the wide prior of a user's first pose (InitialPoseOptions: 2 px
// sideways, 1 % of the depth, 1 deg; 2000 px/s, 6 rad/s) instead of a prior from earlier windows. The oracle therefore
// neither drifts nor loses the object, and it does not gain from earlier windows: a tracker with a motion prior can
// have less noise. Errors common to the oracle and the tracker are due to the events or the sensor model, not to the
// tracking. A window has no estimate if its events leave more than a quarter of the prior's variance in any direction:
// the estimate would be the truth that the window started from.
//
// `truth` must outlive the oracle. Errors: those of Tracker::Create().
absl::StatusOr<std::unique_ptr<PoseSource>> MakeTrackingOracle(std::shared_ptr<const ObjectModel> model,
                                                               const CameraModel& camera, const TrackerOptions& options,
                                                               const Trajectory& truth);

}  // namespace evpose
