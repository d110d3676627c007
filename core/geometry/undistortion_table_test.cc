// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/undistortion_table.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <string>

namespace evpose {
namespace {

using ::testing::HasSubstr;

CameraModel SmallCamera() {
  CameraModel camera;
  camera.width_px = 320;
  camera.height_px = 240;
  camera.fx_px = 300.0;
  camera.fy_px = 290.0;
  camera.cx_px = 161.3;
  camera.cy_px = 118.7;
  return camera;
}

TEST(UndistortionTableTest, UndistortionWithoutDistortionIsExact) {
  const CameraModel camera = SmallCamera();
  const auto table = UndistortionTable::Create(camera);
  ASSERT_TRUE(table.ok()) << table.status();
  for (int v = 0; v < camera.height_px; ++v) {
    for (int u = 0; u < camera.width_px; ++u) {
      const Eigen::Vector2f& bearing = table->Bearing(u, v);
      ASSERT_EQ(bearing.x(), static_cast<float>((u - camera.cx_px) / camera.fx_px));
      ASSERT_EQ(bearing.y(), static_cast<float>((v - camera.cy_px) / camera.fy_px));
    }
  }
  const Eigen::Vector2d pixel(12.3, 45.6);
  EXPECT_EQ(camera.Distort(pixel), pixel);
}

TEST(UndistortionTableTest, UndistortionInvertsDistort) {
  CameraModel camera = SmallCamera();
  for (const auto& distortion : {Distortion{-0.35, 0.15, 0.001, -0.0007, -0.03},
                                 Distortion{0.25, -0.1, -0.002, 0.001, 0.0}, Distortion{0.0, 0.0, 0.003, 0.0, 0.0}}) {
    camera.distortion = distortion;
    const auto table = UndistortionTable::Create(camera);
    ASSERT_TRUE(table.ok()) << table.status();
    double largest_error_px = 0.0, largest_shift_px = 0.0;
    for (int v = 0; v < camera.height_px; ++v) {
      for (int u = 0; u < camera.width_px; ++u) {
        const Eigen::Vector2f& bearing = table->Bearing(u, v);
        const Eigen::Vector2d undistorted = camera.Project({bearing.x(), bearing.y(), 1.0});
        largest_error_px = std::max(largest_error_px, (camera.Distort(undistorted) - Eigen::Vector2d(u, v)).norm());
        largest_shift_px = std::max(largest_shift_px, (undistorted - Eigen::Vector2d(u, v)).norm());
      }
    }
    EXPECT_LT(largest_error_px, 1e-4);
    EXPECT_GT(largest_shift_px, 0.2);
  }
}

TEST(UndistortionTableTest, DistortionThatCannotBeInverted) {
  CameraModel camera = SmallCamera();
  // The image of r (1 - r^2) ends at r = 0.577, well inside the corners.
  for (const auto& distortion : {Distortion{-1.0, 0, 0, 0, 0}, Distortion{-3.0, 1.0, 0, 0, 0},
                                 Distortion{0, 0, 5.0, 0, 0}, Distortion{1e300, 0, 0, 0, 0}}) {
    camera.distortion = distortion;
    const auto table = UndistortionTable::Create(camera);
    ASSERT_EQ(table.status().code(), absl::StatusCode::kInvalidArgument);
    EXPECT_THAT(std::string(table.status().message()), HasSubstr("cannot be inverted at pixel"));
  }
}

TEST(UndistortionTableTest, UndistortionOfAnInvalidCamera) {
  CameraModel camera = SmallCamera();
  camera.width_px = 0;
  EXPECT_EQ(UndistortionTable::Create(camera).status().code(), absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace evpose
