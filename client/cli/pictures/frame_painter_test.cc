// SPDX-License-Identifier: Apache-2.0
#include "client/cli/pictures/frame_painter.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "client/cli/pictures/png.h"
#include "core/models/cube_files_testing.h"
#include "core/simulation/simulator.h"

namespace evpose::client {
namespace {

// The preset's camera for a sensor of another size, with the same field of view.
CameraModel CameraOfSize(const CameraModel& camera, int width_px, int height_px) {
  CameraModel resized = camera;
  const double factor = static_cast<double>(width_px) / camera.width_px;
  resized.width_px = width_px;
  resized.height_px = height_px;
  resized.fx_px *= factor;
  resized.fy_px *= factor;
  resized.cx_px = 0.5 * (width_px - 1);
  resized.cy_px = 0.5 * (height_px - 1);
  return resized;
}

class FramePainterTest : public ::testing::TestWithParam<std::pair<cv::Size, int>> {
 protected:
  FramePainterTest() {
    const auto preset = SimulationPreset("cube", "vga", 1.0);
    const auto model = Parse(Cube());  // 1 m
    EXPECT_TRUE(preset.ok() && model.ok());
    model_ = *model;
    camera_ = CameraOfSize(preset->camera, GetParam().first.width, GetParam().first.height);
    pose_.translation_m = Eigen::Vector3d(-0.5, -0.5, 5.0);
  }

  ObjectModel model_;
  CameraModel camera_;
  RigidTransform pose_;
};

TEST_P(FramePainterTest, EnlargesSmallSensorsByAWholeFactor) {
  const auto& [size, scale] = GetParam();
  FramePainter painter(camera_, model_);
  EXPECT_EQ(painter.scale(), scale);
  EXPECT_EQ(painter.image().size(), cv::Size(scale * size.width, scale * size.height));
  EXPECT_GE(painter.image().rows, 480);
  const cv::Mat background = painter.image().clone();
  painter.DrawEvent({.t_us = 0, .x = 3, .y = 5, .polarity = 1});
  painter.DrawEvent({.t_us = 0, .x = static_cast<uint16_t>(size.width), .y = 0, .polarity = 1});  // outside
  cv::Mat changed;
  cv::absdiff(painter.image(), background, changed);
  cv::cvtColor(changed, changed, cv::COLOR_BGR2GRAY);
  EXPECT_EQ(cv::boundingRect(changed > 0), cv::Rect(3 * scale, 5 * scale, scale, scale));
}

TEST_P(FramePainterTest, TextAndLinesHideLittleOfThePicture) {
  FramePainter painter(camera_, model_);
  const cv::Mat background = painter.image().clone();
  painter.DrawLegend(1'000'000, 10.0, pose_);
  cv::Mat text;
  cv::absdiff(painter.image(), background, text);
  cv::cvtColor(text, text, cv::COLOR_BGR2GRAY);
  const cv::Rect box = cv::boundingRect(text > 0);
  EXPECT_LT(box.br().x, painter.image().cols) << "the text ends inside the picture";
  EXPECT_LT(box.br().y, painter.image().rows / 10);
  painter.Clear();
  painter.DrawModel(pose_);
  cv::Mat lines;
  cv::absdiff(painter.image(), background, lines);
  cv::cvtColor(lines, lines, cv::COLOR_BGR2GRAY);
  EXPECT_GT(cv::countNonZero(lines > 0), 0);
  const cv::Rect object = cv::boundingRect(lines > 0);
  EXPECT_LT(cv::countNonZero(lines > 0), object.area() / 3);
  // The object is in the middle.
  const double width = painter.image().cols;
  EXPECT_NEAR(object.x + 0.5 * object.width, 0.5 * width, 0.1 * width);
}

INSTANTIATE_TEST_SUITE_P(Sensors, FramePainterTest,
                         ::testing::Values(std::pair(cv::Size(128, 128), 4), std::pair(cv::Size(240, 180), 3),
                                           std::pair(cv::Size(346, 260), 2), std::pair(cv::Size(640, 480), 1),
                                           std::pair(cv::Size(480, 640), 1), std::pair(cv::Size(1280, 720), 1)));

TEST(PngTest, RefusesAnEmptyImage) {
  EXPECT_EQ(EncodePng(cv::Mat()).status().code(), absl::StatusCode::kInternal);
  EXPECT_TRUE(EncodePng(cv::Mat(2, 2, CV_8UC3)).ok());
}

}  // namespace
}  // namespace evpose::client
