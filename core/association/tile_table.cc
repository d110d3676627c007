// SPDX-License-Identifier: Apache-2.0
#include "core/association/tile_table.h"

#include "core/base/yield_point.h"

namespace evpose {

TileTable::TileTable(const CameraModel& camera, const UndistortionTable& undistortion) {
  const TileGrid grid(camera);
  const auto u_px = [&](int x, int y) { return camera.fx_px * undistortion.Bearing(x, y).x() + camera.cx_px; };
  const auto v_px = [&](int x, int y) { return camera.fy_px * undistortion.Bearing(x, y).y() + camera.cy_px; };
  // The first column and row of tiles begin here, and their numbers there are the parts of a sum.
  constexpr double kFirstPx = -TileGrid::kMarginPx;
  const int width_px = undistortion.width_px(), height_px = undistortion.height_px();
  for (int x = 0; x < width_px; ++x) columns_.push_back(grid.TileOf(u_px(x, 0), kFirstPx));
  for (int y = 0; y < height_px; ++y) rows_.push_back(grid.TileOf(kFirstPx, v_px(0, y)));
  if (!undistortion.HasBearingOfEachPixel()) return;
  tiles_.reserve(columns_.size() * rows_.size());
  for (int y = 0; y < height_px; ++y) {
    YieldPoint();
    for (int x = 0; x < width_px; ++x) tiles_.push_back(grid.TileOf(u_px(x, y), v_px(x, y)));
  }
}

}  // namespace evpose
