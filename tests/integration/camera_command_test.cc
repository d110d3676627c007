// SPDX-License-Identifier: Apache-2.0

// Tests evpose camera, and cameras of several formats in the other commands.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <opencv2/imgcodecs.hpp>
#include <string>

#include "core/base/output_file.h"
#include "core/camera_files/camera_file.h"
#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

class CameraCommandTest : public CliTest {
 protected:
  // A fisheye lens of 150 degrees on a VGA sensor.
  const CameraModel fisheye_ = {640, 480, 244.0, 244.5, 319.5, 239.5, {-0.01, 0.002, 0, 0}, LensModel::kFisheye};

  std::string Written(const std::string& name, const CameraModel& camera, CameraFormat format = CameraFormat::kRos) {
    EXPECT_TRUE(WriteFile(Path(name), *FormatCamera(camera, format)).ok());
    return Path(name);
  }
};

TEST_F(CameraCommandTest, PrintsJson) {
  const CliResult result = Run({"camera", Written("camera.json", fisheye_, CameraFormat::kMetavision), "--json"});
  ASSERT_EQ(result.status, 0) << result.err;
  const nlohmann::json json = result.Json();
  EXPECT_EQ(json.size(), 9u);
  EXPECT_EQ(json["width"], 640);
  EXPECT_EQ(json["height"], 480);
  EXPECT_EQ(json["lens_model"], "fisheye");
  EXPECT_EQ(json["fx_px"], 244.0);
  EXPECT_EQ(json["fy_px"], 244.5);
  EXPECT_EQ(json["cx_px"], 319.5);
  EXPECT_EQ(json["cy_px"], 239.5);
  EXPECT_EQ(json["distortion"], nlohmann::json({-0.01, 0.002, 0.0, 0.0}));
  EXPECT_EQ(json["format"], "metavision");
}

TEST_F(CameraCommandTest, ConvertsBetweenAllFormats) {
  std::string last = Written("camera", fisheye_);
  for (const char* format : {"kalibr", "metavision", "opencv", "ros"}) {
    const std::string next = Path(format);
    const CliResult result = Run({"camera", last, "--to", format, "-o", next});
    ASSERT_EQ(result.status, 0) << result.err;
    EXPECT_THAT(result.out, AllOf(HasSubstr("read as"), HasSubstr("fisheye")));
    last = next;
  }
  EXPECT_EQ(LoadCameraModel(last).value(), fisheye_);
  const CliResult printed = Run({"camera", last, "--to", "kalibr"});
  EXPECT_EQ(ParseCameraModel(printed.out, "out").value(), fisheye_);
}

TEST_F(CameraCommandTest, DrawsTheLens) {
  const CliResult result = Run({"camera", Written("camera.yaml", fisheye_), "--picture", Path("lens.png")});
  ASSERT_EQ(result.status, 0) << result.err;
  const cv::Mat picture = cv::imread(Path("lens.png"));
  EXPECT_EQ(picture.cols, 1280);
  EXPECT_EQ(picture.rows, 960);
  EXPECT_GT(cv::countNonZero(picture.reshape(1) < 200), 10'000) << "curves";
  // A straight line at 60 degrees beside the axis crosses the axis' row at f * 60 degrees, not at f * tan 60.
  const double theta = 60.0 / 180.0 * M_PI;
  const double x_px = 319.5 + 244.0 * theta * (1 - 0.01 * theta * theta + 0.002 * theta * theta * theta * theta);
  const int column = static_cast<int>((x_px + 0.5) * 2.0);
  EXPECT_GT(cv::countNonZero(picture.row(550).colRange(column - 12, column + 1).reshape(1) < 200), 0);
}

TEST_F(CameraCommandTest, MistakesAreNamed) {
  CameraModel folded = {640, 480, 500.0, 500.0, 319.5, 239.5, {-1.5}};
  EXPECT_THAT(Run({"camera", Written("folded.yaml", folded)}).err,
              AllOf(HasSubstr("folded.yaml"), HasSubstr("cannot be inverted at pixel")));
  CameraModel tiny = {640, 480, 5.0, 5.0, 319.5, 239.5};
  EXPECT_THAT(Run({"camera", Written("tiny.yaml", tiny)}).err, HasSubstr("field of view"));
  CameraModel crop = {640, 480, 500.0, 500.0, 700.0, 239.5};
  const CliResult cropped = Run({"camera", Written("crop.yaml", crop)});
  EXPECT_EQ(cropped.status, 0);
  EXPECT_THAT(cropped.err, HasSubstr("the principal point (700, 239.5) lies outside the image of 640x480"));
  CameraModel rational = {640, 480, 500.0, 500.0, 319.5, 239.5, {0.1, 0, 0, 0, 0, 0.1}, LensModel::kRational};
  const CliResult impossible =
      Run({"camera", Written("rational.yaml", rational), "--to", "kalibr", "-o", Path("camchain.yaml")});
  EXPECT_NE(impossible.status, 0);
  EXPECT_THAT(impossible.err, HasSubstr("no rational lens"));
  EXPECT_FALSE(std::filesystem::exists(Path("camchain.yaml")));
  EXPECT_EQ(Run({"camera", Path("rational.yaml"), "--to", "ros", "--json"}).status, 2);
}

TEST_F(CameraCommandTest, ARecordingOfAFisheyeLensIsSimulated) {
  const std::string camera = Written("fisheye.yaml", fisheye_);
  const CliResult result = Run(
      {"simulate", "--camera", camera, "--view-angle", "50", "--duration", "0.05", "--out", Path("wide"), "--json"});
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_GT(result.Json()["events"], 1000);
  EXPECT_EQ(LoadCameraModel(Path("wide/camera.yaml")).value(), fisheye_);
}

TEST_F(CameraCommandTest, ACameraOfAnotherSizeNamesBothSizes) {
  ASSERT_EQ(Run({"simulate", "--camera", "vga", "--duration", "0.05", "--out", Path("cube")}).status, 0);
  CameraModel hd = {1280, 720, 1000.0, 1000.0, 639.5, 359.5};
  const std::string camera = Written("hd.yaml", hd, CameraFormat::kKalibr);
  const std::vector<std::string> inputs = {Path("cube/recording.raw"), "--model", Path("cube/model.obj"), "--camera",
                                           camera};
  const std::vector<std::vector<std::string>> commands = {
      {"replay", "--out", Path("poses.tum")},
      {"render", "--poses", Path("cube/truth.tum"), "--out", Path("frame.png")},
      {"calibrate", "--truth", Path("cube/truth.tum"), "--out", Path("sensor.yaml")}};
  for (std::vector<std::string> command : commands) {
    command.insert(command.begin() + 1, inputs.begin(), inputs.end());
    const CliResult result = Run(command);
    EXPECT_NE(result.status, 0) << command[0];
    EXPECT_THAT(result.err, AllOf(HasSubstr("1280x720"), HasSubstr("640x480"), HasSubstr("hd.yaml"))) << command[0];
  }
}

}  // namespace
}  // namespace evpose
