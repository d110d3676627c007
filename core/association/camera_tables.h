// SPDX-License-Identifier: Apache-2.0

// What trackers look up of a camera for each event.
#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "core/association/association.h"
#include "core/geometry/camera.h"

namespace evpose {

// Depends on the camera alone, so trackers of one camera can share it: at 1280x720, 11 MB and a tenth of a second to
// make.
struct CameraTables {
  UndistortionTable undistortion;
  PixelTiles pixel_tiles;
};

// Errors: INVALID_ARGUMENT naming the camera's field that is wrong.
absl::StatusOr<std::shared_ptr<const CameraTables>> MakeCameraTables(const CameraModel& camera);

}  // namespace evpose
