// SPDX-License-Identifier: Apache-2.0

// Lookup tables of a camera, which trackers read for each event.
#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "core/association/association.h"
#include "core/geometry/camera.h"

namespace evpose {

// Depends only on the camera, so that all trackers of one camera can share it. At 1280 x 720 pixels it has 11 MB and
// its construction takes a tenth of a second.
struct CameraTables {
  UndistortionTable undistortion;
  PixelTiles pixel_tiles;
};

// Errors: INVALID_ARGUMENT naming the field of the camera that is wrong.
absl::StatusOr<std::shared_ptr<const CameraTables>> MakeCameraTables(const CameraModel& camera);

}  // namespace evpose
