// SPDX-License-Identifier: Apache-2.0
#include "core/association/tile_table.h"

#include <gtest/gtest.h>

#include "core/estimation/ideal_events_testing.h"

namespace evpose {
namespace {

// Compares the table with the tile of the bearing of each pixel, and returns the number of pixels without a tile.
int CompareAllPixels(const CameraModel& camera) {
  const UndistortionTable undistortion = UndistortionTable::Create(camera).value();
  const TileTable table(camera, undistortion);
  const TileGrid grid(camera);
  int num_outside = 0, num_different = 0;
  for (int y = 0; y < camera.height_px; ++y) {
    for (int x = 0; x < camera.width_px; ++x) {
      const Eigen::Vector2f bearing = undistortion.Bearing(x, y);
      const uint32_t expected =
          grid.TileOf(camera.fx_px * bearing.x() + camera.cx_px, camera.fy_px * bearing.y() + camera.cy_px);
      num_outside += expected == TileGrid::kNoTile ? 1 : 0;
      num_different += table.TileOf(x, y) == expected ? 0 : 1;
    }
  }
  EXPECT_EQ(num_different, 0);
  return num_outside;
}

TEST(TileTableTest, WithoutDistortionIsTheTileOfTheBearing) {
  CameraModel camera = testing::MakeCamera(650, 333, 480.0);
  camera.cx_px = 300.25;
  camera.fy_px = 477.0;
  EXPECT_EQ(CompareAllPixels(camera), 0);
}

TEST(TileTableTest, WithDistortionIsTheTileOfTheBearing) {
  CameraModel camera = testing::MakeCamera(650, 333, 330.0);
  camera.distortion[0] = -0.1;
  EXPECT_GT(CompareAllPixels(camera), 0) << "the lens moves pixels beyond the grid";
}

TEST(TileTableTest, OfALargeCameraIsTheTileOfTheBearing) {
  CameraModel camera = testing::MakeCamera(2100, 2000, 1500.0);
  ASSERT_GT(static_cast<size_t>(camera.width_px * camera.height_px), TileTable::kMaxPixels);
  camera.distortion[0] = -0.1;
  CompareAllPixels(camera);
}

}  // namespace
}  // namespace evpose
