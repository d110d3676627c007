// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/undistortion_table.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "core/base/yields_testing.h"
#include "core/geometry/cameras_testing.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

TEST(UndistortionTableTest, UndistortionWithoutDistortionIsExact) {
  const CameraModel camera = PlainCamera();
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
  CameraModel camera = PlainCamera();
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

TEST(UndistortionTableTest, AFisheyeLensOfMoreThan170Degrees) {
  CameraModel camera = {320, 240, 100.0, 101.0, 159.5, 119.5, {0.01}, LensModel::kFisheye};
  const auto table = UndistortionTable::Create(camera);
  ASSERT_TRUE(table.ok()) << table.status();
  int beyond = 0;
  for (int v = 0; v < camera.height_px; ++v) {
    for (int u = 0; u < camera.width_px; ++u) {
      const Eigen::Vector2d bearing = table->Bearing(u, v).cast<double>();
      if (bearing.norm() > kMaxFisheyeTangent) {
        ++beyond;
        EXPECT_GT(bearing.norm(), 1e5);
        EXPECT_GT(std::hypot((u - 159.5) / 100.0, (v - 119.5) / 101.0), 85.0 / 180.0 * M_PI);
        continue;
      }
      const Eigen::Vector2d back = camera.Distort(camera.Project({bearing.x(), bearing.y(), 1.0}));
      ASSERT_LT((back - Eigen::Vector2d(u, v)).norm(), 1e-3) << u << " " << v;
    }
  }
  EXPECT_GT(beyond, 1000);
  EXPECT_LT(beyond, 320 * 240 / 4);
}

TEST(UndistortionTableTest, CanBePaused) {
  CameraModel camera = PlainCamera();
  for (const LensModel model : {LensModel::kBrown, LensModel::kFisheye}) {
    camera.lens_model = model;
    camera.distortion = {0.01};
    EXPECT_GE(CountYields([&] { ASSERT_TRUE(UndistortionTable::Create(camera).ok()); }), 240u);
  }
}

TEST(UndistortionTableTest, ATurnedView) {
  for (const bool is_fisheye : {false, true}) {
    CameraModel camera = PlainCamera();
    if (is_fisheye) camera.lens_model = LensModel::kFisheye;
    const Eigen::Matrix3d view_from_camera = ExpSo3({0.1, -0.5, 0.05});
    const auto table = UndistortionTable::Create(camera);
    ASSERT_TRUE(table.ok()) << table.status();
    const UndistortionTable turned = table->Turned(view_from_camera);
    for (int v = 0; v < camera.height_px; v += 7) {
      for (int u = 0; u < camera.width_px; u += 5) {
        const Eigen::Vector3d direction = view_from_camera * table->Bearing(u, v).cast<double>().homogeneous();
        EXPECT_LT((turned.Bearing(u, v).cast<double>() - direction.head<2>() / direction.z()).norm(), 1e-5);
      }
    }
    const UndistortionTable behind = table->Turned(ExpSo3({0.0, 1.6, 0.0}));
    EXPECT_GT(behind.Bearing(camera.width_px - 1, 120).norm() + behind.Bearing(0, 120).norm(), 1e5F);
  }
}

TEST(UndistortionTableTest, DistortionThatCannotBeInverted) {
  CameraModel camera = PlainCamera();
  // The image of r (1 - r^2) ends at r = 0.577, well inside the corners.
  for (const auto& distortion : {Distortion{-1.0, 0, 0, 0, 0}, Distortion{-3.0, 1.0, 0, 0, 0},
                                 Distortion{0, 0, 5.0, 0, 0}, Distortion{1e300, 0, 0, 0, 0}}) {
    camera.distortion = distortion;
    const auto table = UndistortionTable::Create(camera);
    ASSERT_EQ(table.status().code(), absl::StatusCode::kInvalidArgument);
    EXPECT_THAT(std::string(table.status().message()), HasSubstr("cannot be inverted at pixel"));
  }
}

TEST(UndistortionTableTest, NoPixelIsOfASecondBranch) {
  // The distorted radius grows up to 0.6, at r = 1, decreases up to r = sqrt(2) and grows again: a corner of the image
  // at 0.7 is a point with r = 1.7 of the polynomial, but of no lens. At 0.59 it is one before the fold.
  CameraModel camera = {281, 1, 200.0, 200.0, 140.0, 0.0, {-0.5, 0.1}};
  const auto table = UndistortionTable::Create(camera);
  ASSERT_EQ(table.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(table.status().message()), HasSubstr("cannot be inverted at pixel"));
  camera.fx_px = camera.fy_px = 140.0 / 0.55;
  EXPECT_TRUE(UndistortionTable::Create(camera).ok());
  // The radius of this fisheye lens grows, decreases and grows again before 85 degrees.
  camera.lens_model = LensModel::kFisheye;
  camera.distortion = {-0.9, 0.3};
  camera.fx_px = camera.fy_px = 140.0;
  EXPECT_EQ(UndistortionTable::Create(camera).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(UndistortionTableTest, UndistortionOfAnInvalidCamera) {
  CameraModel camera = PlainCamera();
  camera.width_px = 0;
  EXPECT_EQ(UndistortionTable::Create(camera).status().code(), absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace evpose
