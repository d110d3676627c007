// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/camera.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <string>

#include "core/geometry/cameras_testing.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

TEST(CameraTest, AViewThatNoLensHasIsNamed) {
  const CameraModel plain = PlainCamera();
  EXPECT_TRUE(plain.CheckView().ok());
  const auto message = [&](auto change) {
    CameraModel camera = plain;
    change(camera);
    EXPECT_TRUE(camera.Validate().ok());
    return std::string(camera.CheckView().message());
  };
  const double side_px = std::max(plain.width_px, plain.height_px);
  EXPECT_THAT(message([](auto& c) { c.fx_px = 1e-300; }), HasSubstr("camera_matrix: fx is 1e-300 px"));
  EXPECT_THAT(message([](auto& c) { c.fy_px = 1e300; }), HasSubstr("camera_matrix: fy is 1e+300 px"));
  EXPECT_THAT(message([](auto& c) { c.cx_px = -1e300; }), HasSubstr("camera_matrix: cx"));
  EXPECT_THAT(message([](auto& c) { c.cy_px = 1e300; }), HasSubstr("camera_matrix: cy"));
  EXPECT_EQ(message([&](auto& c) { c.fx_px = c.fy_px = 0.05 * side_px; }), "") << "a view of 169 degrees";
  EXPECT_EQ(message([&](auto& c) { c.fx_px = c.fy_px = 500.0 * side_px; }), "") << "a telescope";
  EXPECT_EQ(message([&](auto& c) { c.cx_px = -0.9 * side_px; }), "") << "a crop of a larger sensor";
}

TEST(CameraTest, DistortIsThePlumbBobModel) {
  CameraModel camera = PlainCamera();
  camera.fx_px = camera.fy_px = 100.0;
  camera.cx_px = camera.cy_px = 0.0;
  // x = 0.5, y = 0: r2 = 0.25.
  const auto distort = [&](const Distortion& distortion) -> Eigen::Vector2d {
    camera.distortion = distortion;
    return camera.Distort({50.0, 0.0});
  };
  EXPECT_NEAR(distort({0.1, 0, 0, 0, 0}).x(), 50.0 * (1 + 0.1 * 0.25), 1e-12);
  EXPECT_NEAR(distort({0, 0.1, 0, 0, 0}).x(), 50.0 * (1 + 0.1 * 0.0625), 1e-12);
  EXPECT_NEAR(distort({0, 0, 0, 0, 0.1}).x(), 50.0 * (1 + 0.1 * 0.015625), 1e-12);
  EXPECT_NEAR(distort({0, 0, 0.1, 0, 0}).y(), 100.0 * 0.1 * 0.25, 1e-12);
  EXPECT_NEAR(distort({0, 0, 0, 0.1, 0}).x(), 50.0 + 100.0 * 0.1 * 0.75, 1e-12);
}

}  // namespace
}  // namespace evpose
