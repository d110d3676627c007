// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/real_check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

namespace evpose {
namespace {

using ::testing::HasSubstr;

// Of an object that is found after 10 ms and right to the end.
RealRun GoodRun() {
  RealRun run;
  run.duration_s = 2.0;
  run.wait_s = 0.01;
  run.first_error_px = 0.5;
  run.right_ratio = 0.99;
  run.tracking_s = 1.99;
  run.motion_px = 100.0;
  return run;
}

RealBenchRow Row(const RealRun& searched, const RealRun& given) {
  return {.recording = "cube", .searched = {GoodRun(), searched}, .given = {GoodRun(), given}};
}

std::string Failure(const RealBenchRow& row) { return std::string(CheckRealRow(row, {}).message()); }

TEST(RealCheckTest, GoodRunsPass) { EXPECT_TRUE(CheckRealRow(Row(GoodRun(), GoodRun()), {}).ok()); }

TEST(RealCheckTest, AnObjectThatIsNotFoundFails) {
  RealRun absent = GoodRun();
  absent.wait_s = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(Failure(Row(absent, GoodRun())),
              HasSubstr("cube is found with a right first pose in 1 of the 2 starts in which it moves; at least 95 %"));
  EXPECT_TRUE(CheckRealRow(Row(absent, GoodRun()), {.min_found_ratio = 0.5}).ok());
  EXPECT_TRUE(CheckRealRow(Row(GoodRun(), absent), {}).ok()) << "a given pose need not be found";
}

TEST(RealCheckTest, AWrongFirstPoseIsNotFound) {
  RealRun wrong = GoodRun();
  wrong.is_first_wrong = true;
  wrong.longest_wrong_s = 0.02;
  EXPECT_THAT(Failure(Row(wrong, GoodRun())), HasSubstr("in 1 of the 2 starts"));
}

TEST(RealCheckTest, APoseThatIsSeldomRightFails) {
  RealRun drifting = GoodRun();
  drifting.right_ratio = 0.5;
  EXPECT_THAT(Failure(Row(GoodRun(), drifting)), HasSubstr("cube has a right pose for 74.5 % of the time"));
  EXPECT_TRUE(CheckRealRow(Row(GoodRun(), drifting), {.min_right_ratio = 0.7}).ok());
}

TEST(RealCheckTest, AWrongPoseWhileTrackingFails) {
  RealRun wrong = GoodRun();
  wrong.start_us = 1'500'000;
  wrong.longest_wrong_s = 0.031;
  for (const RealBenchRow& row : {Row(wrong, GoodRun()), Row(GoodRun(), wrong)}) {
    EXPECT_THAT(Failure(row), HasSubstr("cube, run from 1.500 s: TRACKING is reported with a wrong pose for 31 ms; at "
                                        "most 30 ms are permitted for an object that moves"));
  }
}

TEST(RealCheckTest, AnObjectAtRestNeedNotBeFoundAndIsNeverWrong) {
  RealRun rest;
  rest.duration_s = 2.0;
  rest.motion_px = 1.0;
  EXPECT_TRUE(CheckRealRow({.recording = "board", .searched = {rest}, .given = {rest}}, {}).ok());
  rest.longest_wrong_s = 0.001;
  EXPECT_THAT(Failure({.recording = "board", .given = {rest}}),
              HasSubstr("at most 0 ms are permitted for an object at"));
}

TEST(RealCheckTest, AnAbsentObjectIsNotTracking) {
  ForeignBenchRow row = {.recording = "board", .object = "cube"};
  EXPECT_TRUE(CheckForeignRow(row).ok());
  row.run.wait_s = 0.5;
  EXPECT_EQ(CheckForeignRow(row).message(), "cube is TRACKING in board, which does not show it");
}

}  // namespace
}  // namespace evpose
