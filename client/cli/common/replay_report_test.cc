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
  report.Add(TrackingRestarted{8, "written by another version", 70});
  EXPECT_THAT(Printed(report), HasSubstr("tracking: restarted after chunk 8 and pose 70, every object was"));
}

TEST(ReplayReportTest, SaysThatNoPoseWasConfirmedOnlyIfItKnowsAllPoses) {
  ReplayReport report;
  Pose degraded;
  degraded.state = TrackState::kDegraded;
  report.Add(degraded);
  report.summary.poses = 1;
  EXPECT_THAT(Printed(report), HasSubstr("no pose is TRACKING, 1 are DEGRADED: the events have not confirmed a pose"));
  report.summary.poses = 2;  // the first of them was received before this run continued another one
  EXPECT_THAT(Printed(report), Not(HasSubstr("no pose is TRACKING")));
  Pose tracking;
  tracking.state = TrackState::kTracking;
  report.Add(tracking);
  EXPECT_THAT(Printed(report), Not(HasSubstr("no pose is TRACKING")));
  EXPECT_EQ(report.ToJson()["tracking_poses"], 1);
}

TEST(ReplayReportTest, JsonNamesTheTraceOfADeletedSessionToo) {
  ReplayReport report;
  report.trace_id = "0af7";
  EXPECT_EQ(report.ToJson()["session"], nullptr);
  EXPECT_EQ(report.ToJson()["trace_id"], "0af7");
}

TEST(ReplayReportTest, SumsDecodeFaultsAndNamesTheFirst) {
  ReplayReport report;
  report.Add(DecodeFault{3, 2, "a vector without a base"});
  report.Add(DecodeFault{5, 4, "a word of an unknown type"});
  EXPECT_THAT(Printed(report), HasSubstr("decoder: skipped 6 words or events, the first in chunk 3: a vector without"));
}

TEST(ReplayReportTest, GivesTheReasonForEachObjectWithoutAConfirmedPose) {
  ReplayReport report;
  ObjectHealth object;
  object.object_id = "object";
  object.detail = "the reason";
  object.latest_loss = {2'500'000, LossCause::kOutOfView};
  for (const auto& [state, text] : {std::pair{TrackState::kInitializing, "no pose found: the reason\n"},
                                    {TrackState::kLost, "LOST: the reason\n"},
                                    {TrackState::kAmbiguous, "AMBIGUOUS: the reason\n"}}) {
    object.state = state;
    report.summary.health.objects = {object};
    EXPECT_THAT(Printed(report), HasSubstr(text));
  }
  EXPECT_EQ(report.ToJson()["lost_at_us"], 2'500'000);
  EXPECT_EQ(report.ToJson()["loss_cause"], "OUT_OF_VIEW");
  object.state = TrackState::kTracking;
  report.summary.health.objects = {object};
  EXPECT_THAT(Printed(report), Not(HasSubstr("the reason")));
}

TEST(ReplayReportTest, ListsTheLossesOfAnObjectThatWasFoundAgain) {
  ReplayReport report;
  ObjectHealth object;
  object.object_id = "object";
  object.state = TrackState::kTracking;
  const auto print = [&] {
    report.summary.health.objects = {object};
    return Printed(report);
  };
  Pose pose;
  pose.object_id = "object";
  report.Add(pose);
  EXPECT_THAT(print(), Not(HasSubstr("lost")));
  for (const int64_t t_us : {2'500'000, 2'500'000, 4'000'000}) {
    pose.latest_loss = {t_us, LossCause::kOutOfView};
    report.Add(pose);
  }
  object.losses = 2;
  object.latest_loss = pose.latest_loss;
  EXPECT_THAT(print(), HasSubstr("lost 2 times: at 2.500000 s (OUT_OF_VIEW), at 4.000000 s (OUT_OF_VIEW)\n"));
  // No pose follows the last one.
  object.losses = 3;
  object.latest_loss = {5'000'000, LossCause::kContradicted};
  object.state = TrackState::kLost;
  EXPECT_THAT(print(), HasSubstr("at 4.000000 s (OUT_OF_VIEW), at 5.000000 s (CONTRADICTED)\n"));
  EXPECT_EQ(report.ToJson()["all_losses"].size(), 3u);
  EXPECT_EQ(report.ToJson()["all_losses"][2], Json({{"t_us", 5'000'000}, {"cause", "CONTRADICTED"}}));
  object.losses = 10;
  for (const int64_t t_us : {5'000'000, 6'000'000, 7'000'000, 8'000'000}) {
    pose.latest_loss = {t_us, LossCause::kUncertain};
    report.Add(pose);
  }
  EXPECT_THAT(print(), HasSubstr("at 7.000000 s (UNCERTAIN), and 5 more\n"));
}

TEST(ReplayReportTest, TheOnlyLossIsInTheReasonForTheMissingPose) {
  ReplayReport report;
  ObjectHealth object;
  object.state = TrackState::kLost;
  object.losses = 1;
  object.detail = "lost at 2.500000 s because of something";
  object.latest_loss = {2'500'000, LossCause::kOutOfView};
  report.summary.health.objects = {object};
  EXPECT_THAT(Printed(report), Not(HasSubstr("lost 1 time")));
  EXPECT_EQ(report.ToJson()["all_losses"].size(), 1u);
}

TEST(ReplayReportTest, NamesTheObjectsWithoutAPose) {
  ReplayReport report;
  report.models = {{.object_id = "left"}, {.object_id = "right"}};
  report.summary.health.objects = {{.object_id = "left"}, {.object_id = "right"}};
  Pose pose;
  pose.object_id = "right";
  pose.state = TrackState::kDegraded;
  report.Add(pose);
  report.summary.poses = 1;
  EXPECT_EQ(report.ObjectsWithoutPose(), std::vector<std::string>{"left"});
  EXPECT_THAT(Printed(report), HasSubstr("right: no pose is TRACKING, 1 are DEGRADED"));
  report.summary.poses = 2;
  EXPECT_TRUE(report.ObjectsWithoutPose().empty()) << "an earlier process may have received a pose of it";
  pose.object_id = "left";
  pose.state = TrackState::kTracking;
  report.Add(pose);
  EXPECT_TRUE(report.ObjectsWithoutPose().empty());
  EXPECT_THAT(Printed(report), HasSubstr("right: no pose is TRACKING")) << "the poses of left confirm nothing of right";
}

TEST(ReplayReportTest, CountsTriggersAndPrintsTheClocks) {
  ReplayReport report;
  EXPECT_THAT(Printed(report), Not(HasSubstr("triggers")));
  EXPECT_EQ(report.ToJson()["host_minus_sensor_s"], nullptr);
  report.Add(Triggers{.triggers = {{1, 0, true}, {2, 0, false}}, .num_skipped = 3});
  report.host_minus_sensor = absl::Milliseconds(1500);
  EXPECT_THAT(Printed(report), HasSubstr("triggers: 5 edges"));
  EXPECT_THAT(Printed(report), HasSubstr("at most 1.500000 s"));
  EXPECT_EQ(report.ToJson()["triggers"], 5);
  EXPECT_EQ(report.ToJson()["host_minus_sensor_s"], 1.5);
}

TEST(ReplayReportTest, StatesThatTheServerWasSlowerThanRealTime) {
  ReplayReport report;
  report.summary.health.decoded_events = 2'000'000;
  report.summary.health.event_rate_hz = 1e6;
  report.summary.health.real_time_ratio = 0.99;
  EXPECT_THAT(Printed(report), Not(HasSubstr("real time")));
  report.summary.health.real_time_ratio = 2.5;
  report.summary.health.event_rate_hz = 1e8;
  EXPECT_THAT(Printed(report), Not(HasSubstr("real time"))) << "20 ms, whose time is that of the first search";
  report.summary.health.event_rate_hz = 1e6;
  EXPECT_THAT(Printed(report), HasSubstr("slower than real time: the server needed 2.50 s for a second of events"));
  EXPECT_EQ(report.ToJson()["real_time_ratio"], 2.5);
}

TEST(ReplayReportTest, StatesTheLagOfTheEvents) {
  ReplayReport report;
  EXPECT_THAT(Printed(report), Not(HasSubstr("slower")));
  report.longest_lag = absl::Milliseconds(2'340);
  report.pace = "--rate 0.5";
  EXPECT_THAT(Printed(report), HasSubstr("slower than --rate 0.5: events were processed up to 2.3 s late; "));
  EXPECT_EQ(report.ToJson()["longest_lag_s"], 2.34);
}

TEST(ReplayReportTest, CountsAmbiguousPoses) {
  ReplayReport report;
  report.files = {{.path = "poses.tum", .num_poses = 1}};
  report.summary.poses = 2;
  Pose pose;
  pose.state = TrackState::kTracking;
  report.Add(pose);
  EXPECT_THAT(Printed(report), HasSubstr("poses.tum: 1 pose\n"));
  pose.state = TrackState::kAmbiguous;
  report.Add(pose);
  EXPECT_THAT(Printed(report), HasSubstr("poses.tum: 1 pose\n1 pose is AMBIGUOUS: a .tum file does not have them"));
  EXPECT_EQ(report.ToJson()["ambiguous_poses"], 1);
  EXPECT_EQ(report.ToJson()["transform"], "camera_from_object");
  report.transform = "base_from_object";
  EXPECT_THAT(Printed(report), HasSubstr("poses.tum: 1 pose, base_from_object\n"));
}

TEST(ReplayReportTest, ListsWrittenFilesAndOlderFilesThatStaySeparately) {
  ReplayReport report;
  report.summary.poses = 5;
  report.files = {
      {.path = "left.tum", .num_poses = 3}, {.path = "right.tum", .keeps_older = true}, {.path = "top.tum"}};
  EXPECT_THAT(Printed(report),
              HasSubstr("left.tum: 3 poses\nright.tum: not written, because there is no pose for it; the earlier file "
                        "stays as it was\ntop.tum: 0 poses\n"));
  EXPECT_EQ(report.ToJson()["files"], Json({"left.tum", "top.tum"}));
  EXPECT_EQ(report.ToJson()["kept_files"], Json({"right.tum"}));
  EXPECT_TRUE(report.KeepsOlderFiles());
  EXPECT_FALSE(report.HasOnlyFilesWithoutPose());
  report.files = {{.path = "top.tum"}};
  EXPECT_FALSE(report.KeepsOlderFiles());
  EXPECT_TRUE(report.HasOnlyFilesWithoutPose());
}

}  // namespace
}  // namespace evpose::client
