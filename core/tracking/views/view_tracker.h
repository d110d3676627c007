// SPDX-License-Identifier: Apache-2.0

// Tracks objects in the turned views of a fisheye lens (core/tracking/README.md, section 7).
#pragma once

#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "core/geometry/camera.h"
#include "core/tracking/tracker.h"

namespace evpose {

// Arguments and errors as for Tracker::Create(). The objects are tracked independently of each other.
absl::StatusOr<std::unique_ptr<Tracker>> MakeViewTracker(std::vector<ObjectToTrack> objects, const CameraModel& camera,
                                                         const TrackerOptions& options);

}  // namespace evpose
