// SPDX-License-Identifier: Apache-2.0

// Tests that files of other software are read (tests/data/cameras). OpenCV's own reader gives the expected numbers.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <opencv2/core.hpp>
#include <string>

#include "absl/strings/str_replace.h"
#include "core/camera_files/camera_file.h"
#include "tests/data/test_data.h"

namespace evpose {
namespace {

std::string PathOf(const std::string& file) { return FindTestData("cameras") + "/" + file; }

// The camera of a file of OpenCV, by OpenCV.
CameraModel ReadWithOpenCv(const std::string& file, LensModel lens_model) {
  const cv::FileStorage storage(PathOf(file), cv::FileStorage::READ);
  cv::Mat matrix, coefficients;
  storage["camera_matrix"] >> matrix;
  storage["distortion_coefficients"] >> coefficients;
  CameraModel camera;
  camera.lens_model = lens_model;
  camera.width_px = static_cast<int>(storage["image_width"]);
  camera.height_px = static_cast<int>(storage["image_height"]);
  camera.fx_px = matrix.at<double>(0, 0);
  camera.fy_px = matrix.at<double>(1, 1);
  camera.cx_px = matrix.at<double>(0, 2);
  camera.cy_px = matrix.at<double>(1, 2);
  const int count = std::min(static_cast<int>(coefficients.total()), kMaxDistortion);
  for (int i = 0; i < count; ++i) camera.distortion[i] = coefficients.at<double>(i);
  return camera;
}

struct ForeignCamera {
  const char* file;
  const char* format;
  const char* opencv_file;  // with the same camera
  LensModel lens_model;
  int num_coefficients;    // that the format has; the others are 0
  double pixel_tolerance;  // half of the last digit that the program writes
  double number_tolerance;
};

class ForeignCameraTest : public ::testing::TestWithParam<ForeignCamera> {};

TEST_P(ForeignCameraTest, HasTheNumbersOfItsCalibration) {
  const ForeignCamera& test = GetParam();
  CameraModel expected = ReadWithOpenCv(test.opencv_file, test.lens_model);
  std::fill(expected.distortion.begin() + test.num_coefficients, expected.distortion.end(), 0.0);
  ASSERT_GT(expected.fx_px, 1000.0);
  const absl::StatusOr<CameraFile> read = ReadCameraFile(PathOf(test.file));
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(read->format, test.format);
  const CameraModel& camera = read->camera;
  EXPECT_EQ(camera.lens_model, expected.lens_model);
  EXPECT_EQ(camera.width_px, 1280);
  EXPECT_EQ(camera.height_px, 720);
  EXPECT_NEAR(camera.fx_px, expected.fx_px, test.pixel_tolerance);
  EXPECT_NEAR(camera.fy_px, expected.fy_px, test.pixel_tolerance);
  EXPECT_NEAR(camera.cx_px, expected.cx_px, test.pixel_tolerance);
  EXPECT_NEAR(camera.cy_px, expected.cy_px, test.pixel_tolerance);
  for (int i = 0; i < kMaxDistortion; ++i) {
    EXPECT_NEAR(camera.distortion[i], expected.distortion[i], test.number_tolerance) << i;
  }
}

constexpr LensModel kBrown = LensModel::kBrown, kFisheye = LensModel::kFisheye;

INSTANTIATE_TEST_SUITE_P(
    Files, ForeignCameraTest,
    ::testing::Values(
        ForeignCamera{"opencv_brown.yml", "opencv", "opencv_brown.yml", kBrown, 5, 0.0, 0.0},
        ForeignCamera{"opencv_rational.xml", "opencv", "opencv_rational.xml", LensModel::kRational, 8, 0.0, 0.0},
        ForeignCamera{"opencv_fisheye.json", "opencv", "opencv_fisheye.json", kFisheye, 4, 0.0, 0.0},
        ForeignCamera{"ros_calibrator.yaml", "ros", "opencv_brown.yml", kBrown, 5, 5.1e-6, 5.1e-7},
        ForeignCamera{"ros_message.txt", "ros-message", "opencv_brown.yml", kBrown, 5, 0.0, 0.0},
        ForeignCamera{"kalibr_camchain.yaml#cam0", "kalibr", "opencv_brown.yml", kBrown, 4, 0.0, 0.0},
        ForeignCamera{"kalibr_camchain.yaml#cam1", "kalibr", "opencv_fisheye.json", kFisheye, 4, 0.0, 0.0},
        // The rounding of the half pixel between the conventions.
        ForeignCamera{"colmap_cameras.txt", "colmap", "opencv_brown.yml", kBrown, 4, 1e-12, 1e-15}),
    [](const auto& test) {
      return absl::StrReplaceAll(test.param.file, {{".", "_"}, {"#", "_"}});
    });

}  // namespace
}  // namespace evpose
