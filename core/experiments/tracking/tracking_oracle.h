// SPDX-License-Identifier: Apache-2.0

// Lower bound of the errors for the events of single windows: every window is fitted from the true state.
#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "core/geometry/camera.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"
#include "core/tracking/object/tracker_options.h"
#include "core/tracking/tracker.h"

namespace evpose {

// Creates an oracle. It estimates every window with the association, the mixture estimator, the edge correction and the
// options of the tracker, and with windows like those of the tracker at ordinary speed (they do not adapt to the image
// speed). Every window starts at the true pose and twist of its middle, with the lines that are visible at the true
// pose. Instead of the prediction from earlier windows it has the wide prior of a given first pose (InitialPoseOptions:
// 2 px laterally, 1 % of the depth, 1 deg; 2000 px/s, 6 rad/s).
//
// The oracle can therefore neither lose the object nor drift, and it does not profit from earlier windows: a tracker
// with a motion prior may have less noise. Errors common to the oracle and the tracker are due to the events or the
// sensor model, not to the tracking. A window with events that leave more than a quarter of the variance of the prior
// in any direction has no pose, because its pose would be that of the start.
//
// `truth` must outlive the oracle. Errors: those of Tracker::Create().
absl::StatusOr<std::unique_ptr<PoseSource>> MakeTrackingOracle(std::shared_ptr<const ObjectModel> model,
                                                               const CameraModel& camera, const TrackerOptions& options,
                                                               const Trajectory& truth);

}  // namespace evpose
