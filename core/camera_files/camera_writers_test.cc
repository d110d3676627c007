// SPDX-License-Identifier: Apache-2.0
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <string>

#include "core/camera_files/camera_file.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

CameraModel SomeCamera(LensModel lens_model) {
  CameraModel camera = {640, 480, 1000.0 / 3.0, 0.1 + 0.2 + 300.0, 320.7, 240.1, {}, lens_model};
  for (int i = 0; i < NumCoefficients(lens_model); ++i) camera.distortion[i] = 0.01 / (3 + i);
  return camera;
}

struct Conversion {
  CameraFormat format;
  const char* name;
  LensModel lens_model;
};

class CameraWritersTest : public ::testing::TestWithParam<Conversion> {};

TEST_P(CameraWritersTest, TheSameCameraIsRead) {
  CameraModel camera = SomeCamera(GetParam().lens_model);
  if (GetParam().format == CameraFormat::kKalibr) camera.distortion[4] = 0.0;
  const auto text = FormatCamera(camera, GetParam().format);
  ASSERT_TRUE(text.ok()) << text.status();
  const auto file = ParseCameraFile(*text, "written");
  ASSERT_TRUE(file.ok()) << file.status() << *text;
  EXPECT_EQ(file->camera, camera);
  EXPECT_EQ(file->format, GetParam().name);
}

INSTANTIATE_TEST_SUITE_P(All, CameraWritersTest,
                         ::testing::Values(Conversion{CameraFormat::kRos, "ros", LensModel::kBrown},
                                           Conversion{CameraFormat::kRos, "ros", LensModel::kRational},
                                           Conversion{CameraFormat::kRos, "ros", LensModel::kFisheye},
                                           Conversion{CameraFormat::kKalibr, "kalibr", LensModel::kBrown},
                                           Conversion{CameraFormat::kKalibr, "kalibr", LensModel::kFisheye},
                                           Conversion{CameraFormat::kMetavision, "metavision", LensModel::kBrown},
                                           Conversion{CameraFormat::kMetavision, "metavision", LensModel::kFisheye},
                                           Conversion{CameraFormat::kOpenCv, "opencv", LensModel::kBrown},
                                           Conversion{CameraFormat::kOpenCv, "opencv", LensModel::kRational},
                                           Conversion{CameraFormat::kOpenCv, "opencv", LensModel::kFisheye}));

TEST(CameraWritersTest, AFormatWithoutTheLensIsAnError) {
  EXPECT_THAT(FormatCamera(SomeCamera(LensModel::kRational), CameraFormat::kKalibr).status().message(),
              HasSubstr("no rational lens"));
  EXPECT_THAT(FormatCamera(SomeCamera(LensModel::kRational), CameraFormat::kMetavision).status().message(),
              HasSubstr("no rational lens"));
  EXPECT_THAT(FormatCamera(SomeCamera(LensModel::kBrown), CameraFormat::kKalibr).status().message(),
              HasSubstr("no k3"));
}

TEST(CameraWritersTest, OpenCvReadsItsFiles) {
  const CameraModel camera = SomeCamera(LensModel::kRational);
  for (const CameraFormat format : {CameraFormat::kOpenCv, CameraFormat::kMetavision}) {
    const std::string text =
        *FormatCamera(format == CameraFormat::kOpenCv ? camera : SomeCamera(LensModel::kBrown), format);
    cv::FileStorage storage(text, cv::FileStorage::READ | cv::FileStorage::MEMORY);
    cv::Mat matrix, coefficients;
    storage["camera_matrix"] >> matrix;
    storage["distortion_coefficients"] >> coefficients;
    ASSERT_EQ(matrix.total(), 9u);
    EXPECT_EQ(matrix.at<double>(1, 1), camera.fy_px);
    EXPECT_EQ(coefficients.total(), format == CameraFormat::kOpenCv ? 8u : 5u);
  }
}

}  // namespace
}  // namespace evpose
