// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/replay_report.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sstream>
#include <string>

namespace evpose::client {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

std::string Printed(const ReplayReport& report) {
  std::ostringstream stream;
  report.Print(stream);
  return stream.str();
}

TEST(ReplayReportTest, NamesEveryRestartOfTheTracking) {
  ReplayReport report;
  EXPECT_THAT(Printed(report), Not(HasSubstr("restarted")));
  EXPECT_EQ(report.ToJson()["tracking_restarts"], 0);
  report.Add(TrackingRestarted{7, "written by another version"});
  EXPECT_THAT(Printed(report), HasSubstr("tracking: restarted after chunk 7, every object was searched for again: "
                                         "written by another version\n"));
  EXPECT_EQ(report.ToJson()["tracking_restarts"], 1);
}

TEST(ReplayReportTest, SumsDecodeFaultsAndNamesTheFirst) {
  ReplayReport report;
  report.Add(DecodeFault{3, 2, "a vector without a base"});
  report.Add(DecodeFault{5, 4, "a word of an unknown type"});
  EXPECT_THAT(Printed(report), HasSubstr("decoder: skipped 6 words or events, the first in chunk 3: a vector without"));
}

TEST(ReplayReportTest, GivesTheTimeSinceWhichAnObjectIsLost) {
  ReplayReport report;
  ObjectHealth object;
  object.object_id = "object";
  object.state = TrackState::kLost;
  object.detail = "no pose fits";
  report.summary.health.objects = {object};
  report.Add(StateChange{"object", 2'500'000, TrackState::kLost});
  EXPECT_THAT(Printed(report), HasSubstr("LOST: the object is lost since 2.500000 s"));
}

}  // namespace
}  // namespace evpose::client
