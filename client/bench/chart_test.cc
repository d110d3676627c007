// SPDX-License-Identifier: Apache-2.0
#include "client/bench/chart.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "absl/strings/match.h"
#include "client/bench/gnuplot.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

class ChartTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = testing::TempDir() + "chart-XXXXXX";
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    directory_ = name;
  }
  void TearDown() override {
    if (!path_.empty()) setenv("PATH", path_.c_str(), 1);
    std::filesystem::remove_all(directory_);
  }

  std::string Path(const std::string& name) const { return (directory_ / name).string(); }

  // Programs are found in the test's directory alone.
  void HidePrograms() {
    path_ = getenv("PATH");
    setenv("PATH", directory_.c_str(), 1);
  }
  void WriteProgram(const std::string& name, const std::string& text) const {
    std::ofstream(Path(name)) << text;
    chmod(Path(name).c_str(), 0700);
  }

  absl::Status Draw(const ChartPage& page, const std::string& name) const {
    absl::StatusOr<ChartFile> file = ChartFile::Create(Path(name));
    return file.ok() ? file->Write(page) : file.status();
  }
  cv::Mat Picture(const ChartPage& page) const {
    const absl::Status status = Draw(page, "picture.png");
    EXPECT_TRUE(status.ok()) << status;
    return cv::imread(Path("picture.png"));
  }
  std::string Text(const ChartPage& page) const {
    const absl::Status status = Draw(page, "picture.svg");
    EXPECT_TRUE(status.ok()) << status;
    std::ifstream stream(Path("picture.svg"));
    return {std::istreambuf_iterator<char>(stream), {}};
  }

  std::filesystem::path directory_;
  std::string path_;
};

ChartSeries Series(const std::string& name, ChartStyle style) {
  ChartSeries series;
  series.name = name;
  series.style = style;
  series.x = {0.0, 1.0, 2.0, 3.0};
  if (style != ChartStyle::kBand) series.y = {1.0, 2.0, 4.0, 8.0};
  if (style == ChartStyle::kBand || style == ChartStyle::kBoxes) {
    series.low = {0.5, 1.0, 2.0, 4.0};
    series.high = {2.0, 4.0, 8.0, 16.0};
  }
  return series;
}

ChartPage PageOf(const ChartSeries& series) {
  ChartPage page;
  page.panels.push_back({.title = "A panel", .x_axis = {.label = "time, s"}, .y_axis = {.label = "x, m"}});
  page.panels[0].series = {series};
  return page;
}

// How many pixels have the colour, red, green, blue.
int CountPixels(const cv::Mat& picture, int red, int green, int blue) {
  cv::Mat mask;
  const cv::Scalar color(blue, green, red);
  cv::inRange(picture, color, color, mask);
  return cv::countNonZero(mask);
}

TEST_F(ChartTest, PictureHasThePagesSize) {
  ChartPage page;
  page.title = "Five panels in two rows";
  page.num_columns = 3;
  page.panel_width_px = 300;
  page.panel_height_px = 220;
  for (const ChartStyle style :
       {ChartStyle::kLines, ChartStyle::kPoints, ChartStyle::kLinesAndPoints, ChartStyle::kBand, ChartStyle::kBoxes}) {
    page.panels.push_back(PageOf(Series("one", style)).panels[0]);
  }
  const cv::Mat picture = Picture(page);
  EXPECT_EQ(picture.cols, 900);
  EXPECT_EQ(picture.cols, page.WidthPx());
  EXPECT_GT(picture.rows, 440) << "title and legend have their own strips";
  EXPECT_EQ(picture.rows, page.HeightPx());
}

TEST_F(ChartTest, EachStyleDraws) {
  for (const ChartStyle style :
       {ChartStyle::kLines, ChartStyle::kPoints, ChartStyle::kLinesAndPoints, ChartStyle::kBoxes}) {
    ChartSeries series = Series("one", style);
    series.color = 1;
    EXPECT_GT(CountPixels(Picture(PageOf(series)), 0xD5, 0x5E, 0x00), 20) << static_cast<int>(style);
  }
  // A shade is three quarters transparent.
  ChartSeries band = Series("one", ChartStyle::kBand);
  band.color = 6;
  EXPECT_GT(CountPixels(Picture(PageOf(band)), 0xBF, 0xBF, 0xBF), 1000);
}

TEST_F(ChartTest, TextsStandAsTheyAre) {
  ChartPage page = PageOf(Series("it's `touch oops` $x \"q\" a_b^c {/Bold}\n<&> %d \\n", ChartStyle::kLines));
  page.title = "Größe";
  page.panels[0].x_axis.names = {"one", "two's"};
  const std::string text = Text(page);
  EXPECT_TRUE(absl::StrContains(text, "it's `touch oops` $x \"q\" a_b^c {/Bold} &lt;&amp;> %d \\n"));
  EXPECT_TRUE(absl::StrContains(text, "Größe"));
  EXPECT_TRUE(absl::StrContains(text, "two's"));
  EXPECT_TRUE(absl::StrContains(text, "time, s"));
  EXPECT_FALSE(std::filesystem::exists("oops"));
}

TEST_F(ChartTest, ANameStandsInTheLegendOnceAndLooksTheSameEverywhere) {
  ChartPage page;
  page.num_columns = 2;
  ChartPanel first = PageOf(Series("first", ChartStyle::kLines)).panels[0];
  first.series.push_back(Series("second", ChartStyle::kLines));
  ChartPanel second = PageOf(Series("second", ChartStyle::kLines)).panels[0];
  page.panels = {first, second};
  const std::string text = Text(page);
  EXPECT_NE(text.find(">second<"), std::string::npos);
  EXPECT_EQ(text.find(">second<"), text.rfind(">second<"));
  // Green is the third colour: there is no third name.
  EXPECT_EQ(CountPixels(Picture(page), 0x00, 0x9E, 0x73), 0);
  EXPECT_GT(CountPixels(Picture(page).colRange(480, 960).rowRange(0, 300), 0xD5, 0x5E, 0x00), 20);
  EXPECT_EQ(CountPixels(Picture(page).colRange(480, 960).rowRange(0, 300), 0x00, 0x72, 0xB2), 0);
}

TEST_F(ChartTest, WhatCannotBeDrawnIsLeftOut) {
  ChartSeries series = Series("", ChartStyle::kPoints);
  series.color = 1;
  const int all = CountPixels(Picture(PageOf(series)), 0xD5, 0x5E, 0x00);
  series.y = {std::nan(""), 2.0, INFINITY, 8.0};
  EXPECT_LT(CountPixels(Picture(PageOf(series)), 0xD5, 0x5E, 0x00), all);
  ChartPage page = PageOf(series);
  page.panels[0].y_axis.is_logarithmic = true;
  page.panels[0].series[0].y = {0.0, -1.0, 0.0, std::nan("")};
  EXPECT_EQ(CountPixels(Picture(page), 0xD5, 0x5E, 0x00), 0) << "an empty panel";
  page.panels[0].series.clear();
  EXPECT_EQ(Picture(page).cols, page.WidthPx());
}

TEST_F(ChartTest, APageIsChecked) {
  EXPECT_THAT(ChartPage().Validate().message(), HasSubstr("panels"));
  ChartPage page = PageOf(Series("", ChartStyle::kLines));
  page.panels[0].series[0].y.pop_back();
  EXPECT_THAT(page.Validate().message(), HasSubstr("panels[0].series[0] has 4 x, 3 y"));
  page = PageOf(Series("", ChartStyle::kBand));
  page.panels[0].series[0].low.clear();
  EXPECT_THAT(page.Validate().message(), HasSubstr("0 low"));
  page = PageOf(Series("", ChartStyle::kLines));
  page.panels[0].series[0].color = 10;
  EXPECT_THAT(page.Validate().message(), HasSubstr("color"));
  page = PageOf(Series("", ChartStyle::kLines));
  page.panels[0].series[0].marker = -1;
  EXPECT_THAT(page.Validate().message(), HasSubstr("marker"));
  page = PageOf(Series("", ChartStyle::kLines));
  page.num_columns = 0;
  EXPECT_THAT(page.Validate().message(), HasSubstr("num_columns"));
  page.num_columns = 1;
  page.panel_width_px = 10;
  EXPECT_THAT(page.Validate().message(), HasSubstr("panel_width_px"));
  page.panel_width_px = 30'000;
  EXPECT_THAT(page.Validate().message(), HasSubstr("30000x"));
}

TEST_F(ChartTest, TheNameSaysTheFormat) {
  EXPECT_THAT(ChartFile::Create(Path("picture.jpg")).status().message(), HasSubstr(".png or .svg"));
  const absl::Status status = ChartFile::Create(Path("missing/picture.png")).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(status.message(), HasSubstr("missing/picture.png"));
}

TEST_F(ChartTest, WithoutGnuplotSaysWhatToInstall) {
  HidePrograms();
  const absl::Status status = ChartFile::Create(Path("picture.png")).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(status.message(), HasSubstr("gnuplot-nox"));
  EXPECT_TRUE(std::filesystem::is_empty(directory_));
}

TEST_F(ChartTest, AFailingGnuplotGivesItsMessageAndNoFile) {
  absl::StatusOr<ChartFile> file = ChartFile::Create(Path("picture.png"));
  ASSERT_TRUE(file.ok()) << file.status();
  HidePrograms();
  WriteProgram("gnuplot", "#!/bin/sh\necho 'line 3: it rains' >&2\nexit 3\n");
  const absl::Status status = file->Write(PageOf(Series("", ChartStyle::kLines)));
  EXPECT_EQ(status.code(), absl::StatusCode::kInternal);
  EXPECT_THAT(status.message(), HasSubstr("exit status 3"));
  EXPECT_THAT(status.message(), HasSubstr("line 3: it rains"));
  WriteProgram("gnuplot", "#!/bin/sh\nkill -9 $$\n");
  EXPECT_THAT(file->Write(PageOf(Series("", ChartStyle::kLines))).message(), HasSubstr("signal 9"));
  WriteProgram("gnuplot", "#!/bin/sh\nexit 0\n");
  EXPECT_THAT(file->Write(PageOf(Series("", ChartStyle::kLines))).message(), HasSubstr("drew nothing"));
  EXPECT_FALSE(std::filesystem::exists(Path("picture.png")));
}

TEST_F(ChartTest, GnuplotsOwnMessage) {
  const absl::StatusOr<std::string> output = RunGnuplot("set terminal svg\nplot nonsense(x)\n");
  EXPECT_EQ(output.status().code(), absl::StatusCode::kInternal);
  EXPECT_THAT(output.status().message(), HasSubstr("nonsense"));
}

}  // namespace
}  // namespace evpose::client
