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
// distortion. That is half of the memory of the bearings. The tile of every event of a window is looked up, and the
// smaller table causes fewer cache misses. The tiles of a camera with distortion and more than kMaxPixels are computed
// from the bearings instead.
class TileTable {
 public:
  static constexpr size_t kMaxPixels = size_t{1} << 22;  // a table of 16 MB
  // Number of bytes for each pixel of a camera with distortion.
  static size_t BytesPerPixel(const CameraModel& camera) { return IsTabulated(camera) ? sizeof(uint32_t) : 0; }

  // `camera` has the undistorted image of `undistortion`, which must outlive the table: its own camera, or a view into
  // which the table was turned. Has yield points.
  TileTable(const CameraModel& camera, const UndistortionTable& undistortion);

  // Returns the tile of a pixel inside the sensor; TileGrid::kNoTile if it lies outside the grid.
  uint32_t TileOf(int x, int y) const {
    if (!tiles_.empty()) return tiles_[static_cast<size_t>(y) * columns_.size() + x];
    if (is_computed_) return Compute(x, y);
    if (columns_[x] == TileGrid::kNoTile || rows_[y] == TileGrid::kNoTile) return TileGrid::kNoTile;
    return columns_[x] + rows_[y];
  }
  // Prefetches the entry of TileOf(x, y). The pixel may lie outside the sensor.
  void Prefetch(int x, int y) const {
    if (is_computed_) return bearings_.Prefetch(x, y);
    PrefetchEntry(tiles_, static_cast<size_t>(y) * columns_.size() + x);
  }

 private:
  static bool IsTabulated(const CameraModel& camera) {
    return static_cast<size_t>(camera.width_px) * static_cast<size_t>(camera.height_px) <= kMaxPixels;
  }
  uint32_t Compute(int x, int y) const {
    const Eigen::Vector2f bearing = bearings_.Bearing(x, y);
    return grid_.TileOf(camera_.fx_px * bearing.x() + camera_.cx_px, camera_.fy_px * bearing.y() + camera_.cy_px);
  }

  const CameraModel camera_;
  const UndistortionTable& bearings_;
  const TileGrid grid_;       // without lines
  bool is_computed_ = false;  // for each event, from its bearing
  // Without distortion: the number of a tile is the sum of those of the first tiles in its column and in its row.
  std::vector<uint32_t> columns_;
  std::vector<uint32_t> rows_;
  std::vector<uint32_t> tiles_;  // with distortion, row by row; else empty
};

}  // namespace evpose
