// SPDX-License-Identifier: Apache-2.0
#include "core/association/tile_table.h"

#include "core/base/yield_point.h"

namespace evpose {

TileTable::TileTable(const CameraModel& camera, const UndistortionTable& undistortion)
    : camera_(camera), bearings_(undistortion), grid_(camera) {
  const int width_px = undistortion.width_px(), height_px = undistortion.height_px();
  // The first column and row of tiles begin here, and their numbers there are the parts of a sum.
  constexpr double kFirstPx = -TileGrid::kMarginPx;
  for (int x = 0; x < width_px; ++x) {
    columns_.push_back(grid_.TileOf(camera.fx_px * undistortion.Bearing(x, 0).x() + camera.cx_px, kFirstPx));
  }
  for (int y = 0; y < height_px; ++y) {
    rows_.push_back(grid_.TileOf(kFirstPx, camera.fy_px * undistortion.Bearing(0, y).y() + camera.cy_px));
  }
  if (!undistortion.HasBearingOfEachPixel()) return;
  is_computed_ = !IsTabulated(camera);
  if (is_computed_) return;
  tiles_.reserve(columns_.size() * rows_.size());
  for (int y = 0; y < height_px; ++y) {
    YieldPoint();
    for (int x = 0; x < width_px; ++x) tiles_.push_back(Compute(x, y));
  }
}

}  // namespace evpose
