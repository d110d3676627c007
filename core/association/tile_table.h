// SPDX-License-Identifier: Apache-2.0

// The tile of the undistorted image (TileGrid) in which each pixel of a camera lies.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/association/association.h"
#include "core/geometry/camera.h"
#include "core/geometry/undistortion_table.h"
#include "core/numerics/prefetch.h"

namespace evpose {

// Memory: 4 bytes for each column and row of a camera without distortion, 4 bytes for each pixel of a camera with
// distortion: half of what the bearings take, so that the lookup of the tiles of all events of a window, of which most
// are not used further, misses the caches less often.
class TileTable {
 public:
  // `camera` has the undistorted image of `undistortion`: its own camera, or a view into which the table was turned.
  // Has yield points.
  TileTable(const CameraModel& camera, const UndistortionTable& undistortion);

  // Returns the tile of a pixel inside the sensor; TileGrid::kNoTile if it lies outside the grid.
  uint32_t TileOf(int x, int y) const {
    if (!tiles_.empty()) return tiles_[static_cast<size_t>(y) * columns_.size() + x];
    if (columns_[x] == TileGrid::kNoTile || rows_[y] == TileGrid::kNoTile) return TileGrid::kNoTile;
    return columns_[x] + rows_[y];
  }
  // Prefetches the entry of TileOf(x, y). The pixel may lie outside the sensor.
  void Prefetch(int x, int y) const { PrefetchEntry(tiles_, static_cast<size_t>(y) * columns_.size() + x); }

 private:
  // Without distortion: the number of a tile is the sum of those of the first tiles in its column and in its row.
  std::vector<uint32_t> columns_;
  std::vector<uint32_t> rows_;
  std::vector<uint32_t> tiles_;  // with distortion, row by row; empty for a camera without distortion
};

}  // namespace evpose
