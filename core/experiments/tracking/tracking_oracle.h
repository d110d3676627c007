// SPDX-License-Identifier: Apache-2.0

// The floor of what a window's events allow: every window fitted from the truth.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/events/event.h"
#include "core/geometry/camera.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"
#include "core/tracking/tracker.h"
#include "core/tracking/tracker_options.h"

namespace evpose {

// What it is exactly: windows as the tracker's are at ordinary speed (they do not follow the image's), its association,
// its mixture estimator of pose and twist, its edge correction and its options; but every window starts at the true
// pose and twist of its middle, with the lines that are visible at the true pose, and under the wide prior of a first
// pose that somebody gave (InitialPoseOptions: 2 px sideways, 1 % of the depth, 1 deg; 2000 px/s, 6 rad/s) in place of
// what the windows before it told. So it cannot be lost, and cannot drift; and it does not gain from the windows
// before: a tracker whose motion prior does may have the smaller noise. What the oracle and the tracker share is what
// the events, or the model of the sensor, do not tell. A window whose events leave more than a quarter of the prior's
// variance in any direction has no pose: it would be the truth that the window started from.
class TrackingOracle {
 public:
  // `truth` must outlive it. Errors: those of Tracker::Create().
  static absl::StatusOr<std::unique_ptr<TrackingOracle>> Create(std::shared_ptr<const ObjectModel> model,
                                                                const CameraModel& camera,
                                                                const TrackerOptions& options, const Trajectory& truth);
  virtual ~TrackingOracle() = default;

  // As Tracker.
  virtual void AddEvents(absl::Span<const Event> events, std::vector<PoseEstimate>& estimates) = 0;
  virtual void Finish(std::vector<PoseEstimate>& estimates) = 0;
};

}  // namespace evpose
