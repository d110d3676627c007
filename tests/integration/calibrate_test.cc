// SPDX-License-Identifier: Apache-2.0

// evpose target and evpose calibrate.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

TEST_F(CliTest, TargetWritesADrawingAndItsModel) {
  const CliResult result = Run({"target", "--page", "600x400mm", "-o", Path("sheet.pdf"), "--json"});
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(result.Json()["model"], Path("sheet.obj"));
  EXPECT_EQ(result.Json()["width_mm"], 600.0);
  EXPECT_EQ(ReadText("sheet.pdf").substr(0, 5), "%PDF-");
  EXPECT_THAT(ReadText("sheet.obj"), HasSubstr("\nl "));
}

TEST_F(CliTest, TargetOfAScreenIsAnImageOfItsSize) {
  const CliResult result = Run({"target", "--screen", "640x400", "--screen-mm", "320", "-o", Path("screen.png")});
  ASSERT_EQ(result.status, 0) << result.err;
  const cv::Mat image = cv::imread(Path("screen.png"), cv::IMREAD_GRAYSCALE);
  ASSERT_EQ(image.cols, 640);
  ASSERT_EQ(image.rows, 400);
  EXPECT_EQ(image.at<uint8_t>(2, 2), 255);
  // The middle of the first polygon, at (0.17, 0.8) of the pattern.
  EXPECT_EQ(image.at<uint8_t>(77, 122), 0);
  EXPECT_THAT(ReadText("screen.obj"), HasSubstr("320 x 200 mm"));
}

TEST_F(CliTest, TargetRefusesWrongArguments) {
  const auto expect = [&](const std::vector<std::string>& more, const std::string& message) {
    std::vector<std::string> arguments = {"target"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, 2) << message;
    EXPECT_THAT(result.err, HasSubstr(message));
    EXPECT_TRUE(FilesBeginning("out").empty());
  };
  expect({"-o", Path("out.png")}, "must end in .pdf");
  expect({"--screen", "640x400", "--screen-mm", "320", "-o", Path("out.pdf")}, "must end in .png");
  expect({"--page", "B17", "-o", Path("out.pdf")}, "A4, A3, letter");
  expect({"--page", "10x10", "-o", Path("out.pdf")}, "80 to 5000 mm");
  expect({"--screen", "640", "--screen-mm", "320", "-o", Path("out.png")}, "WIDTHxHEIGHT");
  expect({"--screen", "640x400", "--screen-mm", "3", "-o", Path("out.png")}, "--screen-mm");
  expect({"--screen", "640x400", "-o", Path("out.png")}, "--screen-mm");
}

}  // namespace
}  // namespace evpose
