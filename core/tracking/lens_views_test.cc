// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/lens_views.h"

#include <gtest/gtest.h>

#include <cmath>

#include "core/geometry/undistortion_table.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

// 150 degrees along the longer side.
CameraModel WideCamera(int width_px, int height_px) {
  const double focal_px = 0.5 * width_px / (75.0 / kDegreesPerRadian);
  return {width_px, height_px,          focal_px, focal_px, 0.5 * (width_px - 1), 0.5 * (height_px - 1),
          {},       LensModel::kFisheye};
}

TEST(LensViewsTest, EveryDirectionOfTheLensIsNearTheAxisOfAView) {
  for (const CameraModel& camera : {WideCamera(1280, 720), WideCamera(640, 480)}) {
    const std::vector<LensView> views = MakeLensViews(camera);
    EXPECT_EQ(views.size(), camera.width_px == 1280 ? 5u : 15u);
    EXPECT_EQ(views.front().view_from_camera, Eigen::Matrix3d::Identity());
    const auto table = UndistortionTable::Create(camera);
    ASSERT_TRUE(table.ok());
    for (int v = 0; v < camera.height_px; v += 9) {
      for (int u = 0; u < camera.width_px; u += 9) {
        const Eigen::Vector2d bearing = table->Bearing(u, v).cast<double>();
        if (bearing.norm() > std::tan(75.0 / kDegreesPerRadian)) continue;
        double nearest = -1.0;
        bool is_in_image = false;
        for (const LensView& view : views) {
          const Eigen::Vector3d direction = view.view_from_camera * Eigen::Vector3d(bearing.x(), bearing.y(), 1.0);
          nearest = std::max(nearest, direction.normalized().z());
          is_in_image |= direction.z() > 0.0 && view.camera.IsInImage(view.camera.Project(direction));
        }
        EXPECT_GT(nearest, std::cos(52.0 / kDegreesPerRadian)) << u << " " << v;
        const bool is_border = u < 30 || v < 30 || u > camera.width_px - 30 || v > camera.height_px - 30;
        EXPECT_TRUE(is_in_image || is_border) << u << " " << v;
      }
    }
  }
}

// Along the horizontal axis, so that one pixel of noise on the sensor is about one pixel in the view.
TEST(LensViewsTest, PixelsHaveAboutTheSizeOfThoseOfTheSensor) {
  const CameraModel camera = WideCamera(1280, 720);
  for (const LensView& view : MakeLensViews(camera)) {
    for (double offset = -25.0; offset <= 25.0; offset += 5.0) {
      const auto direction = [&](double pan, double tilt) {
        return Eigen::Vector3d(std::tan(pan), std::tan(tilt) / std::cos(pan), 1.0);
      };
      const auto sensor_px = [&](const Eigen::Vector3d& in_view) {
        return camera.Distort(camera.Project(view.view_from_camera.transpose() * in_view));
      };
      constexpr double kStep = 1e-4;
      const double pan = offset / kDegreesPerRadian;
      const Eigen::Vector3d at = direction(pan, 0.0);
      for (const Eigen::Vector3d& beside : {direction(pan + kStep, 0.0), direction(pan, kStep)}) {
        const double of_view = (view.camera.Project(beside) - view.camera.Project(at)).norm();
        const double of_sensor = (sensor_px(beside) - sensor_px(at)).norm();
        EXPECT_GT(of_view / of_sensor, 0.6) << offset;
        EXPECT_LT(of_view / of_sensor, 1.6) << offset;
      }
    }
  }
}

TEST(LensViewsTest, ALensWithASmallViewHasOneView) {
  CameraModel camera = WideCamera(640, 480);
  camera.fx_px = camera.fy_px = 500.0;
  const std::vector<LensView> views = MakeLensViews(camera);
  ASSERT_EQ(views.size(), 1u);
  EXPECT_NEAR(views[0].camera.fx_px, 500.0, 1e-9);
  EXPECT_NEAR(views[0].camera.cx_px - 0.5 * views[0].camera.width_px, camera.cx_px - 0.5 * camera.width_px, 1.0);
  EXPECT_EQ(views[0].camera.lens_model, LensModel::kBrown);
}

}  // namespace
}  // namespace evpose
