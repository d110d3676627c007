// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/recording_input.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

TEST(RecordingInputTest, NamesBothTimesIfNoneIsCommon) {
  const TimeSpan events = {16'000'000, 16'500'000};
  for (const TimeSpan& poses : {TimeSpan{0, 15'999'999}, TimeSpan{16'500'001, 17'000'000}}) {
    const std::string text = DescribeNoCommonTime("poses.tum", poses, "recording.raw", events);
    EXPECT_THAT(text, HasSubstr("poses.tum: its poses are " + FormatTimeSpan(poses)));
    EXPECT_THAT(text, HasSubstr("but the events of recording.raw are from 16.000000 s to 16.500000 s: no pose can be"));
    EXPECT_THAT(text, HasSubstr("--time-zero sensor"));
  }
}

TEST(RecordingInputTest, ACommonInstantSuffices) {
  const TimeSpan events = {16'000'000, 16'500'000};
  for (const TimeSpan& poses : {TimeSpan{0, 16'000'000}, TimeSpan{16'500'000, 17'000'000}, TimeSpan{0, 17'000'000}}) {
    EXPECT_EQ(DescribeNoCommonTime("poses.tum", poses, "recording.raw", events), "");
  }
}

}  // namespace
}  // namespace evpose::client
