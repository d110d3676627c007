// SPDX-License-Identifier: Apache-2.0

// Lookup tables of a camera, which trackers read for each event.
#pragma once

#include <memory>
#include <utility>

#include "absl/status/statusor.h"
#include "core/association/tile_table.h"
#include "core/base/status_macros.h"
#include "core/geometry/camera.h"
#include "core/geometry/undistortion_table.h"

namespace evpose {

// Depends only on the camera, so that all trackers of one camera can share it.
struct CameraTables {
  // `bearings` must be those of `camera`, or turned into this view.
  CameraTables(const CameraModel& camera, UndistortionTable bearings)
      : undistortion(std::move(bearings)), tiles(camera, undistortion) {}

  CameraTables(const CameraTables&) = delete;  // `tiles` refers to `undistortion`
  CameraTables& operator=(const CameraTables&) = delete;

  UndistortionTable undistortion;
  TileTable tiles;
};

// Errors: INVALID_ARGUMENT naming the field of the camera that is wrong.
inline absl::StatusOr<std::shared_ptr<const CameraTables>> MakeCameraTables(const CameraModel& camera) {
  EVPOSE_ASSIGN_OR_RETURN(UndistortionTable undistortion, UndistortionTable::Create(camera));
  return std::make_shared<const CameraTables>(camera, std::move(undistortion));
}

}  // namespace evpose
