// SPDX-License-Identifier: Apache-2.0
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "core/base/output_file.h"
#include "core/base/temporary_directory_testing.h"
#include "core/camera_files/camera_file.h"

namespace evpose {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

std::string MessageOf(const std::string& text, const std::string& selection = "") {
  const auto file = ParseCameraFile(text, "my file", selection);
  EXPECT_EQ(file.status().code(), absl::StatusCode::kInvalidArgument) << text;
  EXPECT_THAT(file.status().message(), HasSubstr("my file"));
  return std::string(file.status().message());
}

std::string Changed(const std::string& text, const std::string& from, const std::string& to) {
  EXPECT_THAT(text, HasSubstr(from));
  return absl::StrReplaceAll(text, {{from, to}});
}

struct Mistake {
  const char* from;
  const char* to;
  const char* says;
};

// Each replacement of `from` by `to` in a valid file is an error whose message has `says`.
void ExpectMistakes(const std::string& text, const std::vector<Mistake>& mistakes) {
  for (const Mistake& mistake : mistakes) {
    EXPECT_THAT(MessageOf(Changed(text, mistake.from, mistake.to)), HasSubstr(mistake.says)) << mistake.from;
  }
}

CameraFile Parsed(const std::string& text, const std::string& selection = "") {
  const auto file = ParseCameraFile(text, "my file", selection);
  EXPECT_TRUE(file.ok()) << file.status();
  return file.value_or(CameraFile());
}

void ExpectCamera(const CameraModel& camera, int width_px, int height_px, double fx_px, double fy_px, double cx_px,
                  double cy_px, LensModel lens_model, const Distortion& distortion) {
  const CameraModel expected = {width_px, height_px, fx_px, fy_px, cx_px, cy_px, distortion, lens_model};
  EXPECT_EQ(camera, expected) << camera.fx_px << " " << camera.cx_px << " " << camera.cy_px;
}

// `ros2 topic echo --once`.
constexpr char kRos2Message[] = R"(header:
  stamp:
    sec: 1700000000
    nanosec: 5
  frame_id: camera
height: 720
width: 1280
distortion_model: plumb_bob
d:
- -0.11
- 0.09
- 0.0004
- -0.0003
- 0.0
k: [1712.4, 0.0, 642.1, 0.0, 1711.8, 358.9, 0.0, 0.0, 1.0]
r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
p: [1712.4, 0.0, 642.1, 0.0, 0.0, 1711.8, 358.9, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 1
roi:
  x_offset: 0
  y_offset: 0
  height: 720
  width: 1280
  do_rectify: false
---
)";
// `rostopic echo -n1`.
constexpr char kRos1Message[] = R"(height: 480
width: 640
distortion_model: "equidistant"
D: [0.01, -0.002, 0.0003, -0.00004]
K: [300.5, 0.0, 321.5, 0.0, 301.5, 238.5, 0.0, 0.0, 1.0]
R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
P: [300.5, 0.0, 321.5, 0.0, 0.0, 301.5, 238.5, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 1
binning_y: 1
roi:
  x_offset: 0
  y_offset: 0
  height: 0
  width: 0
  do_rectify: False
---
)";

TEST(CameraFormatsTest, RosMessages) {
  const CameraFile ros2 = Parsed(kRos2Message);
  ExpectCamera(ros2.camera, 1280, 720, 1712.4, 1711.8, 642.1, 358.9, LensModel::kBrown,
               {-0.11, 0.09, 0.0004, -0.0003, 0.0});
  EXPECT_EQ(ros2.format, "ros-message");
  const CameraFile ros1 = Parsed(kRos1Message);
  ExpectCamera(ros1.camera, 640, 480, 300.5, 301.5, 321.5, 238.5, LensModel::kFisheye,
               {0.01, -0.002, 0.0003, -0.00004});
}

TEST(CameraFormatsTest, MistakesInRosMessagesAreNamed) {
  const std::string text = kRos2Message;
  const std::vector<Mistake> mistakes = {
      {"binning_x: 0", "binning_x: 2", "binning_x: is 2"},
      {"x_offset: 0", "x_offset: 320", "roi.x_offset: is 320"},
      {"  width: 1280", "  width: 640", "roi.width: is 640"},
      {"height: 720\nwidth", "width", "height: is missing"},
      {"k: [1712.4, ", "k: [", "k: has 8 numbers"},
      {"k: [1712.4,", "kk: [1712.4,", "k: is missing"},
      {"r: [1.0,", "K: [1.0,", "K: is given as k, too"},
      {"k: [1712.4, 0.0, 642.1, 0.0, 1711.8, 358.9, 0.0, 0.0, 1.0]", "k: [0, 0, 0, 0, 0, 0, 0, 0, 0]",
       "k: is 0: the camera is not calibrated"},
      {"- 0.0\nk", "- 0.0\n- 0.0\nk", "d: has 6 numbers"},
  };
  ExpectMistakes(text, mistakes);
  EXPECT_THAT(MessageOf(text, "cam0"), HasSubstr("#cam0: the file has one camera, without a name"));
}

constexpr char kKalibr[] = R"(cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.29, 0.08, 0.0001, 0.00002]
  distortion_model: radtan
  intrinsics: [458.6, 457.3, 367.2, 248.4]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.1]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.01, 0.02, -0.03, 0.01]
  distortion_model: equidistant
  intrinsics: [190.1, 190.2, 254.3, 256.4]
  resolution: [512, 512]
  rostopic: /cam1/image_raw
)";

TEST(CameraFormatsTest, KalibrChain) {
  ExpectCamera(Parsed(kKalibr, "cam0").camera, 752, 480, 458.6, 457.3, 367.2, 248.4, LensModel::kBrown,
               {-0.29, 0.08, 0.0001, 0.00002});
  const CameraFile second = Parsed(kKalibr, "cam1");
  ExpectCamera(second.camera, 512, 512, 190.1, 190.2, 254.3, 256.4, LensModel::kFisheye, {-0.01, 0.02, -0.03, 0.01});
  EXPECT_EQ(second.format, "kalibr");
  EXPECT_THAT(second.description, HasSubstr("cam1"));
  const std::string one = std::string(kKalibr).substr(0, std::string(kKalibr).find("cam1:"));
  EXPECT_EQ(Parsed(one).camera.width_px, 752) << "the only one needs no selection";
  EXPECT_EQ(Parsed(Changed(one, "distortion_coeffs: [-0.29, 0.08, 0.0001, 0.00002]\n  distortion_model: radtan",
                           "distortion_model: none"))
                .camera.distortion,
            Distortion{});
}

TEST(CameraFormatsTest, SeveralCamerasNeedASelection) {
  EXPECT_THAT(MessageOf(kKalibr), AllOf(HasSubstr("cam0, cam1"), HasSubstr("my file#cam0")));
  EXPECT_THAT(MessageOf(kKalibr, "cam2"), AllOf(HasSubstr("#cam2"), HasSubstr("cam0, cam1")));
  const TemporaryDirectory directory;
  const std::string path = directory.File("camchain.yaml");
  ASSERT_TRUE(WriteFile(path, kKalibr).ok());
  const auto file = ReadCameraFile(path + "#cam1");
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(file->camera.width_px, 512);
  EXPECT_EQ(LoadCameraModel(path + "#cam1")->width_px, 512);
  EXPECT_THAT(LoadCameraModel(path + "#cam7").status().message(), HasSubstr(path + "#cam7"));
  EXPECT_EQ(LoadCameraModel(directory.File("none.yaml") + "#cam1").status().code(), absl::StatusCode::kNotFound);
  // A file whose own name has the mark.
  const std::string marked = directory.File("rig#2.yaml");
  ASSERT_TRUE(WriteFile(marked, kRos2Message).ok());
  EXPECT_EQ(LoadCameraModel(marked)->width_px, 1280);
}

TEST(CameraFormatsTest, MistakesInKalibrChainsAreNamed) {
  const std::string text = std::string(kKalibr).substr(0, std::string(kKalibr).find("cam1:"));
  const std::vector<Mistake> mistakes = {
      {"pinhole", "omni", "cam0.camera_model: 'omni' is not supported"},
      {"  camera_model: pinhole\n", "", "cam0.camera_model: is missing"},
      {"radtan", "fov", "cam0.distortion_model: 'fov' is not supported"},
      {"radtan", "none", "cam0.distortion_model: is none, but"},
      {"  distortion_model: radtan\n", "", "distortion_model: is missing"},
      {", 0.00002]", "]", "cam0.distortion_coeffs: has 3 numbers"},
      {"intrinsics: [458.6, ", "intrinsics: [", "cam0.intrinsics: has 3"},
      {"  resolution: [752, 480]\n", "", "cam0.resolution: is missing"},
      {"[752, 480]", "[752.5, 480]", "cam0.resolution: is not"},
      {"[752, 480]", "[752]", "cam0.resolution: is not"},
  };
  ExpectMistakes(text, mistakes);
}

constexpr char kMetavision[] = R"({
    "n_kept_views": 42,
    "image_size": [ 1280, 720 ],
    "pattern": { "n_rows": 6, "n_cols": 9, "square_height": 0.02, "square_width": 0.02 },
    "camera_matrix": {
        "type_id": "opencv-matrix",
        "rows": 3,
        "cols": 3,
        "dt": "d",
        "data": [ 1030.5, 0.0, 643.25, 0.0, 1030.5, 356.75, 0.0, 0.0, 1.0 ]
    },
    "distortion_coefficients": {
        "type_id": "opencv-matrix",
        "rows": 1,
        "cols": 5,
        "dt": "d",
        "data": [ -0.1, 0.05, 0.0003, -0.0002, 0.0 ]
    },
    "overall_rms_reprojection_error": 0.2134
}
)";

TEST(CameraFormatsTest, MetavisionIntrinsics) {
  const CameraFile brown = Parsed(kMetavision);
  ExpectCamera(brown.camera, 1280, 720, 1030.5, 1030.5, 643.25, 356.75, LensModel::kBrown,
               {-0.1, 0.05, 0.0003, -0.0002, 0.0});
  EXPECT_EQ(brown.format, "metavision");
  EXPECT_THAT(brown.description, HasSubstr("RMS 0.213 px"));
  const std::string fisheye =
      absl::StrReplaceAll(kMetavision, {{"\"rows\": 1,\n        \"cols\": 5", "\"rows\": 4,\n        \"cols\": 1"},
                                        {", -0.0002, 0.0 ]", ", -0.0002 ]"}});
  EXPECT_EQ(Parsed(fisheye).camera.lens_model, LensModel::kFisheye);
  EXPECT_EQ(Parsed(absl::StrReplaceAll(kMetavision, {{"    ", "\t"}})).camera, brown.camera) << "tabs";
  EXPECT_THAT(MessageOf(Changed(kMetavision, "[ 1280, 720 ]", "[ 1280 ]")), HasSubstr("image_size: is not"));
  EXPECT_THAT(
      MessageOf(absl::StrReplaceAll(kMetavision, {{"\"cols\": 5", "\"cols\": 8"},
                                                  {"0.0 ]\n    },\n    \"over", "0, 0, 0, 0 ]\n    },\n    \"over"}})),
      HasSubstr("distortion_coefficients: has 8 numbers; Metavision"));
}

// A file as OpenCV writes it, in the syntax of its extension.
std::string OpenCvFile(const char* extension, int num_coefficients, bool is_fisheye) {
  cv::FileStorage storage(extension, cv::FileStorage::WRITE | cv::FileStorage::MEMORY);
  storage << "calibration_time"
          << "Thu 26 Nov 2026"
          << "image_width" << 640 << "image_height" << 480;
  storage << "flags" << 0 << "fisheye_model" << (is_fisheye ? 1 : 0);
  storage << "camera_matrix" << cv::Mat(cv::Matx33d(500.25, 0, 320.5, 0, 501.75, 240.5, 0, 0, 1));
  cv::Mat coefficients(num_coefficients, 1, CV_64F);
  for (int i = 0; i < num_coefficients; ++i) coefficients.at<double>(i) = 0.1 / (3 + i);
  storage << "distortion_coefficients" << coefficients << "avg_reprojection_error" << 0.25;
  return storage.releaseAndGetString();
}

class OpenCvFilesTest : public ::testing::TestWithParam<const char*> {};

TEST_P(OpenCvFilesTest, AreReadInEverySyntax) {
  for (const auto& [count, lens_model] :
       {std::pair{4, LensModel::kBrown}, {5, LensModel::kBrown}, {8, LensModel::kRational}, {4, LensModel::kFisheye}}) {
    const CameraFile file = Parsed(OpenCvFile(GetParam(), count, lens_model == LensModel::kFisheye));
    Distortion distortion = {};
    for (int i = 0; i < count; ++i) distortion[i] = 0.1 / (3 + i);
    ExpectCamera(file.camera, 640, 480, 500.25, 501.75, 320.5, 240.5, lens_model, distortion);
    EXPECT_EQ(file.format, "opencv");
    EXPECT_THAT(file.description, HasSubstr("RMS 0.25 px"));
  }
}

TEST_P(OpenCvFilesTest, MistakesAreNamed) {
  EXPECT_THAT(MessageOf(OpenCvFile(GetParam(), 5, true)),
              HasSubstr("distortion_coefficients: has 5 numbers, but a fisheye lens has 4"));
  EXPECT_THAT(MessageOf(absl::StrReplaceAll(OpenCvFile(GetParam(), 5, false), {{"image_width", "image_breadth"}})),
              HasSubstr("image_width: is missing"));
  EXPECT_THAT(MessageOf(absl::StrReplaceAll(OpenCvFile(GetParam(), 5, false), {{"distortion_coefficients", "some"}})),
              HasSubstr("distortion_coefficients: is missing"));
}

TEST_P(OpenCvFilesTest, EveryTruncationIsAnErrorOrTheCamera) {
  const std::string text = OpenCvFile(GetParam(), 5, false);
  for (size_t length = 0; length < text.size(); ++length) {
    const auto camera = ParseCameraModel(text.substr(0, length), "my file");
    EXPECT_TRUE(!camera.ok() || camera->fx_px == 500.25) << length;
  }
}

INSTANTIATE_TEST_SUITE_P(All, OpenCvFilesTest, ::testing::Values(".yml", ".xml", ".json"));

TEST(CameraFormatsTest, OldNamesOfOpenCvAndSettingsOfOrbSlam) {
  const std::string old =
      absl::StrReplaceAll(OpenCvFile(".yml", 5, false), {{"image_width", "image_Width"},
                                                         {"image_height", "image_Height"},
                                                         {"camera_matrix", "Camera_Matrix"},
                                                         {"distortion_coefficients", "Distortion_Coefficients"}});
  EXPECT_EQ(Parsed(old).camera, Parsed(OpenCvFile(".yml", 5, false)).camera);
  const std::string settings =
      "%YAML:1.0\nCamera.type: \"PinHole\"\nCamera.fx: 435.2\nCamera.fy: 436.2\nCamera.cx: 367.4\nCamera.cy: 252.2\n"
      "Camera.k1: -0.1\nCamera.k2: 0.2\nCamera.p1: 0.001\nCamera.p2: 0.002\nCamera.width: 752\nCamera.height: 480\n";
  ExpectCamera(Parsed(settings).camera, 752, 480, 435.2, 436.2, 367.4, 252.2, LensModel::kBrown,
               {-0.1, 0.2, 0.001, 0.002});
  EXPECT_THAT(MessageOf(Changed(settings, "Camera.cx: 367.4\n", "")), HasSubstr("Camera.cx: is missing"));
  EXPECT_THAT(MessageOf(Changed(settings, "PinHole", "Rectified")), HasSubstr("Camera.type: 'Rectified'"));
}

constexpr char kDv[] = R"(<?xml version="1.0"?>
<opencv_storage>
<DVXplorer_DXA00080>
  <camera_matrix type_id="opencv-matrix">
    <rows>3</rows>
    <cols>3</cols>
    <dt>d</dt>
    <data>
      520.5 0. 319.5 0. 521.5 239.5 0. 0. 1.</data></camera_matrix>
  <distortion_coefficients type_id="opencv-matrix">
    <rows>1</rows>
    <cols>5</cols>
    <dt>d</dt>
    <data>
      -3.5e-01 1.5e-01 1.e-03 -2.e-03 0.</data></distortion_coefficients>
  <image_width>640</image_width>
  <image_height>480</image_height>
</DVXplorer_DXA00080>
<use_fisheye_model>0</use_fisheye_model>
<type>camera</type>
<pattern_width>9</pattern_width>
</opencv_storage>
)";

TEST(CameraFormatsTest, DvCalibrations) {
  const CameraFile brown = Parsed(kDv);
  ExpectCamera(brown.camera, 640, 480, 520.5, 521.5, 319.5, 239.5, LensModel::kBrown,
               {-0.35, 0.15, 0.001, -0.002, 0.0});
  EXPECT_EQ(brown.format, "dv");
  const std::string fisheye = absl::StrReplaceAll(
      kDv, {{"<use_fisheye_model>0", "<use_fisheye_model>1"}, {"<cols>5", "<cols>4"}, {"-2.e-03 0.<", "-2.e-03<"}});
  EXPECT_EQ(Parsed(fisheye).camera.lens_model, LensModel::kFisheye);
  const std::string contradictory =
      Changed(fisheye, "<type>camera", "<distortion_model>\"RadialTangential\"</distortion_model><type>camera");
  EXPECT_THAT(MessageOf(contradictory), HasSubstr("contradicts use_fisheye_model"));
  EXPECT_THAT(MessageOf(Changed(kDv, "<image_height>480</image_height>", "")),
              HasSubstr("DVXplorer_DXA00080.image_height: is missing"));
  const std::string cameras = absl::StrReplaceAll(kDv, {{"</opencv_storage>", ""}});
  const std::string second = absl::StrReplaceAll(
      cameras.substr(cameras.find("<DVX"), cameras.find("<use_") - cameras.find("<DVX")), {{"DXA00080", "DXA00081"}});
  EXPECT_THAT(MessageOf(absl::StrCat(cameras, second, "</opencv_storage>")),
              HasSubstr("DVXplorer_DXA00080, DVXplorer_DXA00081"));
}

TEST(CameraFormatsTest, ColmapCameras) {
  const std::string head =
      "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n";
  const CameraFile opencv = Parsed(head + "3 OPENCV 1280 720 1000.5 1001.5 640.5 360.25 -0.1 0.2 0.001 -0.002\n");
  ExpectCamera(opencv.camera, 1280, 720, 1000.5, 1001.5, 640.0, 359.75, LensModel::kBrown, {-0.1, 0.2, 0.001, -0.002});
  EXPECT_EQ(opencv.format, "colmap");
  ExpectCamera(Parsed("1 FULL_OPENCV 64 48 10 11 32 24 1 2 3 4 5 6 7 8").camera, 64, 48, 10, 11, 31.5, 23.5,
               LensModel::kRational, {1, 2, 3, 4, 5, 6, 7, 8});
  ExpectCamera(Parsed("1 OPENCV_FISHEYE 64 48 10 11 32 24 1 2 3 4").camera, 64, 48, 10, 11, 31.5, 23.5,
               LensModel::kFisheye, {1, 2, 3, 4});
  ExpectCamera(Parsed("1 SIMPLE_RADIAL 64 48 10 32 24 0.5").camera, 64, 48, 10, 10, 31.5, 23.5, LensModel::kBrown,
               {0.5});
  ExpectCamera(Parsed("1 PINHOLE 64 48 10 11 32 24").camera, 64, 48, 10, 11, 31.5, 23.5, LensModel::kBrown, {});
  const std::string two = "1 PINHOLE 64 48 10 11 32 24\n2 PINHOLE 65 48 10 11 32 24\n";
  EXPECT_THAT(MessageOf(two), HasSubstr("has the cameras 1, 2"));
  EXPECT_EQ(Parsed(two, "2").camera.width_px, 65);
  EXPECT_THAT(MessageOf("1 FOV 64 48 10 11 32 24 0.9"), HasSubstr("the model FOV is not supported"));
  EXPECT_THAT(MessageOf("1 PINHOLE 64 48 10 11 32"), HasSubstr("PINHOLE has 4 parameters, but 3"));
  EXPECT_THAT(MessageOf("1 PINHOLE 64 48 10 11 x 24"), HasSubstr("parameter 3, x, is not a number"));
}

TEST(CameraFormatsTest, HostileFilesAreErrors) {
  std::string deep = "<?xml version=\"1.0\"?><opencv_storage>";
  for (int i = 0; i < 20000; ++i) deep += "<a>";
  const std::string texts[] = {
      deep,
      "<opencv_storage/>",
      "<opencv_storage><camera_matrix>1</camera_matrix></opencv_storage>",
      "<svg/>",
      "<",
      "{",
      "{}",
      std::string(900'000, '['),
      std::string(900'000, '{'),
      std::string(900'000, '-'),
      "{\"camera_matrix\": {\"rows\": 2000000000, \"cols\": 2000000000, \"data\": []}}",
      "{\"image_size\": [1e300, -1], \"camera_matrix\": {}}",
      "cam0: {camera_model: pinhole, intrinsics: [1, 2, 3, [4]]}",
      "a: &a [*a, *a]\ncam0: *a\n",
      "? [a]\n: b\ncam0: {}\n",
      "1 PINHOLE 99999999999 1 1 1 1 1",
      "1 PINHOLE 64 48 10 11 32 1e999",
      "%YAML:1.0\n---\n",
      "width: 3\nk: {a: b}\n",
  };
  for (const std::string& text : texts) MessageOf(text);
  EXPECT_THAT(MessageOf("<svg/>"), HasSubstr("opencv_storage"));
  EXPECT_THAT(MessageOf("<opencv_storage>\n<a></b>"), HasSubstr("line 2: not XML"));
}

}  // namespace
}  // namespace evpose
