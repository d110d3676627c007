// SPDX-License-Identifier: Apache-2.0
#include "core/camera_files/camera_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "core/geometry/cameras_testing.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

// A file of the ROS calibrator.
constexpr char kYaml[] = R"(image_width: 1280
image_height: 720
camera_name: evk4
camera_matrix:
  rows: 3
  cols: 3
  data: [1021.5, 0.0, 640.25, 0.0, 1019.75, 355.5, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.1, 0.08, 0.001, -0.0005, -0.02]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
projection_matrix:
  rows: 3
  cols: 4
  data: [1000.0, 0.0, 640.0, 0.0, 0.0, 1000.0, 355.0, 0.0, 0.0, 0.0, 1.0, 0.0]
)";

std::string Replaced(const std::string& from, const std::string& to) {
  EXPECT_THAT(kYaml, HasSubstr(from));
  return absl::StrReplaceAll(kYaml, {{from, to}});
}

TEST(CameraFileTest, ReadsCameraInfo) {
  const auto camera = ParseCameraModel(kYaml, "camera.yaml");
  ASSERT_TRUE(camera.ok()) << camera.status();
  EXPECT_EQ(camera->width_px, 1280);
  EXPECT_EQ(camera->height_px, 720);
  EXPECT_EQ(camera->fx_px, 1021.5);
  EXPECT_EQ(camera->fy_px, 1019.75);
  EXPECT_EQ(camera->cx_px, 640.25);
  EXPECT_EQ(camera->cy_px, 355.5);
  EXPECT_EQ(camera->distortion, (Distortion{-0.1, 0.08, 0.001, -0.0005, -0.02}));
}

TEST(CameraFileTest, FourCoefficients) {
  const auto camera = ParseCameraModel(
      Replaced("cols: 5\n  data: [-0.1, 0.08, 0.001, -0.0005, -0.02]", "cols: 4\n  data: [-0.1, 0.08, 0, 0]"), "c");
  ASSERT_TRUE(camera.ok()) << camera.status();
  EXPECT_EQ(camera->distortion, (Distortion{-0.1, 0.08, 0, 0, 0}));
}

TEST(CameraFileTest, FourOrFiveCoefficientsWithoutAModelAreBrown) {
  const auto five = ParseCameraModel(Replaced("distortion_model: plumb_bob\n", ""), "c");
  ASSERT_TRUE(five.ok()) << five.status();
  EXPECT_EQ(five->lens_model, LensModel::kBrown);
  EXPECT_EQ(five->distortion[4], -0.02);
  const std::string without = Replaced("distortion_model: plumb_bob\n", "");
  const auto four =
      ParseCameraModel(absl::StrReplaceAll(without, {{"cols: 5\n  data: [-0.1, 0.08, 0.001, -0.0005, -0.02]",
                                                      "cols: 4\n  data: [-0.1, 0.08, 0.001, -0.0005]"}}),
                       "c");
  ASSERT_TRUE(four.ok()) << four.status();
  EXPECT_EQ(four->distortion, (Distortion{-0.1, 0.08, 0.001, -0.0005}));
}

TEST(CameraFileTest, RationalAndFisheyeLenses) {
  const auto with = [](const char* model, const char* cols, const char* data) {
    return ParseCameraModel(absl::StrReplaceAll(kYaml, {{"plumb_bob", model},
                                                        {"cols: 5\n  data: [-0.1, 0.08, 0.001, -0.0005, -0.02]",
                                                         absl::StrCat("cols: ", cols, "\n  data: [", data, "]")}}),
                            "c");
  };
  const auto rational = with("rational_polynomial", "8", "1, 2, 3, 4, 5, 6, 7, 8");
  ASSERT_TRUE(rational.ok()) << rational.status();
  EXPECT_EQ(rational->lens_model, LensModel::kRational);
  EXPECT_EQ(rational->distortion, (Distortion{1, 2, 3, 4, 5, 6, 7, 8}));
  const auto fisheye = with("equidistant", "4", "1, 2, 3, 4");
  ASSERT_TRUE(fisheye.ok()) << fisheye.status();
  EXPECT_EQ(fisheye->lens_model, LensModel::kFisheye);
  EXPECT_EQ(fisheye->distortion, (Distortion{1, 2, 3, 4}));
  // OpenCV's calibration writes 14 numbers for a rational lens.
  EXPECT_TRUE(with("rational_polynomial", "14", "1, 2, 3, 4, 5, 6, 7, 8, 0, 0, 0, 0, 0, 0").ok());
  EXPECT_THAT(with("rational_polynomial", "12", "1, 2, 3, 4, 5, 6, 7, 8, 0, 0, 0, 9").status().message(),
              HasSubstr("thin prism"));
}

TEST(CameraFileTest, NoDistortion) {
  const std::string start = std::string(kYaml).substr(0, std::string(kYaml).find("distortion_model"));
  for (const char* end :
       {"", "distortion_model: none\n", "distortion_model: \"\"\n", "distortion_model:\n",
        "distortion_model: none\ndistortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n",
        "distortion_coefficients: {rows: 0, cols: 0, data: []}\n",
        "distortion_model: plumb_bob\ndistortion_coefficients: {rows: 1, cols: 0, data: []}\n"}) {
    const auto camera = ParseCameraModel(absl::StrCat(start, end), "c");
    ASSERT_TRUE(camera.ok()) << end << camera.status();
    EXPECT_EQ(camera->distortion, (Distortion{})) << end;
  }
}

TEST(CameraFileTest, YamlRoundTripGivesTheSameBits) {
  CameraModel camera = PlainCamera();
  camera.fx_px = 1000.0 / 3.0;
  camera.cy_px = 0.1 + 0.2;
  camera.distortion = {-1.0 / 3.0, 1e-17, 1.0 / 7.0, -0.0, 5e-324};
  const auto back = ParseCameraModel(CameraModelToYaml(camera), "c");
  ASSERT_TRUE(back.ok()) << back.status();
  EXPECT_EQ(back->width_px, camera.width_px);
  EXPECT_EQ(back->height_px, camera.height_px);
  EXPECT_EQ(back->fx_px, camera.fx_px);
  EXPECT_EQ(back->fy_px, camera.fy_px);
  EXPECT_EQ(back->cx_px, camera.cx_px);
  EXPECT_EQ(back->cy_px, camera.cy_px);
  EXPECT_EQ(back->distortion, camera.distortion);
}

struct BadFile {
  const char* from;
  const char* to;
  const char* says;
};

class BadCameraFileTest : public ::testing::TestWithParam<BadFile> {};

TEST_P(BadCameraFileTest, NamesTheFileAndTheField) {
  const auto camera = ParseCameraModel(Replaced(GetParam().from, GetParam().to), "my.yaml");
  ASSERT_EQ(camera.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(camera.status().message()), HasSubstr("my.yaml: "));
  EXPECT_THAT(std::string(camera.status().message()), HasSubstr(GetParam().says));
}

INSTANTIATE_TEST_SUITE_P(
    All, BadCameraFileTest,
    ::testing::Values(
        BadFile{"image_width: 1280\n", "", "image_width: is missing"},
        BadFile{"image_width: 1280\n", "image_width:\n", "image_width: is missing"},
        BadFile{"image_width: 1280", "image_width: wide", "image_width: is not a whole number"},
        BadFile{"image_width: 1280", "image_width: 1280.5", "image_width: is not a whole number"},
        BadFile{"image_width: 1280", "image_width: [1280]", "image_width: is not a whole number"},
        BadFile{"image_width: 1280", "image_width: 0", "image_width is 0"},
        BadFile{"image_height: 720", "image_height: -720", "image_height is -720"},
        BadFile{"image_height: 720", "image_height: 1000000", "image_height is 1000000"},
        BadFile{"image_height: 720", "image_height: 99999999999", "image_height: is not a whole number"},
        BadFile{"camera_matrix", "projection", "camera_matrix: is missing"},
        BadFile{"camera_matrix:\n  rows: 3\n  cols: 3\n  data: [1021.5,", "camera_matrix: [1021.5,",
                "camera_matrix: is not a map"},
        BadFile{"rows: 3\n  cols: 3\n  data: [1021.5,", "rows: 2\n  cols: 3\n  data: [1021.5,",
                "camera_matrix: has 2 rows and 3 cols, but 9 numbers"},
        BadFile{"rows: 3\n  cols: 3\n  data: [1021.5,", "cols: 3\n  data: [1021.5,", "camera_matrix.rows: is missing"},
        BadFile{"data: [1021.5, 0.0, 640.25, 0.0, 1019.75, 355.5, 0.0, 0.0, 1.0]", "data: 5", "camera_matrix.data"},
        BadFile{"355.5, 0.0, 0.0, 1.0]", "355.5, 0.0, 0.0]", "camera_matrix: has 3 rows"},
        BadFile{"rows: 3\n  cols: 3\n  data: [1021.5, 0.0, 640.25, 0.0, 1019.75, 355.5, 0.0, 0.0, 1.0]",
                "rows: 1\n  cols: 1\n  data: [1]", "camera_matrix: has 1 numbers"},
        BadFile{"1021.5", "focal", "camera_matrix.data[0]: is not a number"},
        BadFile{"1021.5", "[1021.5]", "camera_matrix.data[0]: is not a number"}, BadFile{"1021.5", "0.0", "fx is 0"},
        BadFile{"1021.5", "-1021.5", "fx is -1021.5"}, BadFile{"1019.75", ".nan", "fy is nan"},
        BadFile{"1019.75", ".inf", "fy is inf"}, BadFile{"640.25", ".nan", "cx is not a finite"},
        BadFile{"355.5", "-.inf", "cy is not a finite"}, BadFile{"[1021.5, 0.0", "[1021.5, 0.5", "without skew"},
        BadFile{"distortion_model: plumb_bob", "distortion_model: equidistant",
                "distortion_coefficients: has 5 numbers, but a fisheye lens has 4"},
        BadFile{"distortion_model: plumb_bob", "distortion_model: rational_polynomial",
                "distortion_coefficients: has 5 numbers, but a rational lens has 8"},
        BadFile{"distortion_model: plumb_bob", "distortion_model: omni", "'omni' is not supported"},
        BadFile{"image_width: 1280\n", "image_width: 1280\nimage_width: 640\n", "image_width: is given twice"},
        BadFile{"distortion_model: plumb_bob", "distortion_model: [a]", "distortion_model: is not a word"},
        BadFile{"distortion_model: plumb_bob", "distortion_model: none", "set it to plumb_bob"},
        BadFile{"distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [",
                "distortion_coefficients:\n  rows: 1\n  cols: 8\n  data: [0, 0, 0, ",
                "distortion_model: is missing, and distortion_coefficients has 8 numbers"},
        BadFile{"distortion_coefficients", "coefficients", "distortion_coefficients: is missing"},
        BadFile{"cols: 5\n  data: [-0.1, 0.08, 0.001, -0.0005, -0.02]", "cols: 3\n  data: [1, 2, 3]",
                "distortion_coefficients: has 3 numbers"},
        BadFile{"0.08", ".nan", "distortion_coefficients: every number must be finite"},
        BadFile{"0.08", "x", "distortion_coefficients.data[1]: is not a number"},
        BadFile{"camera_name: evk4", "camera_name: [evk4", "line "}));

// The time of a look-up grows with the number of keys.
TEST(CameraFileTest, MapsOfManyKeysAreRefused) {
  const auto map_of = [](int keys, const char* indent, const char* value) {
    std::string text;
    for (int i = 0; i < keys; ++i) absl::StrAppend(&text, indent, "k", i, ": ", value, "\n");
    return text;
  };
  const auto error_of = [](const std::string& text) {
    return std::string(ParseCameraModel(text, "my.yaml").status().message());
  };
  EXPECT_THAT(error_of(absl::StrCat(kYaml, map_of(1000, "", "0"))), HasSubstr("has more than 1000 keys"));
  EXPECT_THAT(error_of(absl::StrCat(kYaml, "more:\n", map_of(1001, "  ", "0"))), HasSubstr("has more than 1000 keys"));
  EXPECT_THAT(error_of(absl::StrCat("a: &a\n", map_of(900, "  ", "0"), map_of(20, "", "*a"))),
              HasSubstr("has more than 10000 keys"));
  EXPECT_TRUE(ParseCameraModel(absl::StrCat(kYaml, map_of(900, "", "0")), "my.yaml").ok());
}

TEST(CameraFileTest, WordsOfTheFileAreShortenedInErrors) {
  const std::string word(10000, 'w');
  for (const std::string& text :
       {absl::StrCat("distortion_model: ", word, "\n", std::string(kYaml).substr(0, std::string(kYaml).find("disto"))),
        absl::StrCat("1 ", std::string(10000, 'M'), " 64 48 10 11"), absl::StrCat("1 PINHOLE 64 48 10 11 32 ", word),
        absl::StrCat(word, ": 1\n", word, ": 2\n"), absl::StrCat("1 PINHOLE 64 48 1 1 1 1\n", word, " 1 1 1 1 1")}) {
    const absl::Status status = ParseCameraModel(text, "my.yaml").status();
    ASSERT_FALSE(status.ok()) << text.substr(0, 50);
    EXPECT_LT(status.message().size(), 500u) << status;
  }
  const absl::Status status = ParseCameraModel("1 PINHOLE 64 48 10 11 32 \x1b[31m", "my.yaml").status();
  EXPECT_THAT(std::string(status.message()), HasSubstr("\\x1b[31m"));
}

TEST(CameraFileTest, FilesThatAreNotCameraFiles) {
  for (const std::string& text : {std::string(), std::string("just words"), std::string("- 1\n- 2\n"),
                                  std::string("\0\x01\xff\xfe", 4), std::string("&a [*a, *a]"), std::string(50000, '['),
                                  std::string(50000, '{'), std::string("%EVT 3.0\n"), std::string(100000, 'a')}) {
    const auto camera = ParseCameraModel(text, "my.yaml");
    EXPECT_EQ(camera.status().code(), absl::StatusCode::kInvalidArgument);
    EXPECT_THAT(std::string(camera.status().message()), HasSubstr("my.yaml: "));
  }
}

TEST(CameraFileTest, EveryTruncationIsAnErrorOrAWholeCamera) {
  const std::string yaml = CameraModelToYaml(PlainCamera());
  for (size_t length = 0; length < yaml.size(); ++length) {
    const auto camera = ParseCameraModel(yaml.substr(0, length), "my.yaml");
    if (camera.ok()) {
      EXPECT_TRUE(camera->Validate().ok());
      EXPECT_EQ(camera->fx_px, 300.0);
    } else {
      EXPECT_THAT(std::string(camera.status().message()), HasSubstr("my.yaml: "));
    }
  }
}

TEST(CameraFileTest, LoadsFromDisk) {
  const std::string path = testing::TempDir() + "/evpose_camera_test.yaml";
  std::ofstream(path) << kYaml;
  const auto camera = LoadCameraModel(path);
  ASSERT_TRUE(camera.ok()) << camera.status();
  EXPECT_EQ(camera->fx_px, 1021.5);
  std::ofstream(path) << std::string(2'000'000, ' ');
  EXPECT_THAT(std::string(LoadCameraModel(path).status().message()), HasSubstr("larger than"));
  std::filesystem::remove(path);

  const auto missing = LoadCameraModel(path);
  EXPECT_EQ(missing.status().code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(std::string(missing.status().message()), HasSubstr(path));
  const auto directory = LoadCameraModel(testing::TempDir());
  EXPECT_EQ(directory.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(directory.status().message()), HasSubstr("is a directory"));
}

}  // namespace
}  // namespace evpose
