// SPDX-License-Identifier: Apache-2.0
#include "core/association/camera_tables.h"

#include <utility>

#include "core/base/status_macros.h"

namespace evpose {

absl::StatusOr<std::shared_ptr<const CameraTables>> MakeCameraTables(const CameraModel& camera) {
  EVPOSE_ASSIGN_OR_RETURN(UndistortionTable undistortion, UndistortionTable::Create(camera));
  PixelTiles pixel_tiles(camera, undistortion);
  return std::make_shared<const CameraTables>(CameraTables{std::move(undistortion), std::move(pixel_tiles)});
}

}  // namespace evpose
