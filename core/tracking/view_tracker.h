// SPDX-License-Identifier: Apache-2.0

// Tracks objects in the turned views of a fisheye lens (core/tracking/README.md, section 7).
#pragma once

#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "core/geometry/camera.h"
#include "core/geometry/undistortion_table.h"
#include "core/tracking/tracker.h"

namespace evpose {

// The arguments must be valid, as for Tracker::Create(); `table` is that of the camera. The objects are tracked
// independently of each other. An object without its tables would compute them for each view.
absl::StatusOr<std::unique_ptr<Tracker>> MakeViewTracker(std::vector<ObjectToTrack> objects, const CameraModel& camera,
                                                         const TrackerOptions& options, const UndistortionTable& table);

}  // namespace evpose
