// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session_report.h"

#include <gtest/gtest.h>

#include "server/sessions/session_limits.h"
#include "server/telemetry/metrics_testing.h"

namespace evpose::server {
namespace {

// Poses first..last of one object.
std::vector<StoredPose> Poses(uint64_t first, uint64_t last, int64_t latency_us) {
  std::vector<StoredPose> poses;
  for (uint64_t seq = first; seq <= last; ++seq) poses.push_back({.pose_seq = seq, .latency_us = latency_us});
  return poses;
}

// A slice with poses 1 to 3 that finishes item 5.
WorkResult SomeResult() {
  WorkResult result = {.poses = Poses(1, 3, 2000)};
  result.counts.cd_events = 100;
  result.counts.unknown_words = 2;
  result.t_us = 8000;
  result.sensor_time_us = 7000;
  result.processing_us = 60;
  result.objects = {{.state = TrackState::kTracking, .losses = 1}};
  result.finished = WorkResult::Item{.stream = 1, .seq = 5, .bytes = 64};
  return result;
}

class SessionReportTest : public testing::Test {
 protected:
  ServerMetrics metrics_;
  SessionReport report_{SessionBeginning(), {ObjectHealth()}};
};

TEST_F(SessionReportTest, StartsEmptyOrFromACheckpoint) {
  EXPECT_EQ(report_.poses(), 0u);
  EXPECT_EQ(report_.processed_seq(), 0u);
  EXPECT_EQ(report_.health().objects.size(), 1u);
  EXPECT_EQ(report_.health().reattaches, 0u);

  SessionBeginning beginning = {.lifecycle = {.num_attaches = 3}};
  beginning.checkpoint.processed_seq = 9;
  beginning.checkpoint.health.poses = 40;
  beginning.checkpoint.health.received_bytes = 1;
  beginning.checkpoint.health.processed_bytes = 100;
  beginning.checkpoint.latencies.Add(5000);
  const SessionReport resumed(beginning, {});
  EXPECT_EQ(resumed.poses(), 40u);
  EXPECT_EQ(resumed.acked_pose_seq(), 40u);
  EXPECT_EQ(resumed.processed_seq(), 9u);
  EXPECT_EQ(resumed.health().received_bytes, 100u) << "the client sends the rest again";
  EXPECT_EQ(resumed.health().reattaches, 2u);
  EXPECT_GT(resumed.HealthWithLatencies().latency_p50_us, 0);
}

TEST_F(SessionReportTest, AddsASlice) {
  report_.AddReceived(64);
  report_.AddReattach();
  report_.Add(SomeResult(), true, metrics_);
  const SessionHealth health = report_.HealthWithLatencies();
  EXPECT_EQ(health.received_bytes, 64u);
  EXPECT_EQ(health.processed_bytes, 64u);
  EXPECT_EQ(health.reattaches, 1u);
  EXPECT_EQ(health.poses, 3u);
  EXPECT_EQ(health.t_us, 8000);
  EXPECT_EQ(health.sensor_time_us, 7000);
  EXPECT_EQ(health.processing_us, 60);
  EXPECT_EQ(health.counts.cd_events, 100u);
  EXPECT_EQ(health.objects[0].losses, 1u);
  EXPECT_GT(health.latency_p50_us, 1000);
  EXPECT_EQ(report_.processed_seq(), 5u);
  EXPECT_EQ(report_.acked_pose_seq(), 3u);
}

TEST_F(SessionReportTest, AcksOnlyFinishedItems) {
  WorkResult part = SomeResult();
  part.finished.reset();
  report_.Add(part, true, metrics_);
  EXPECT_EQ(report_.poses(), 3u);
  EXPECT_EQ(report_.processed_seq(), 0u);
  EXPECT_EQ(report_.acked_pose_seq(), 0u);
  EXPECT_EQ(report_.health().processed_bytes, 0u);
  WorkResult end = SomeResult();
  end.poses_before = 3;
  end.poses.clear();
  end.finished = WorkResult::Item{.stream = 1, .is_end = true};
  report_.Add(SomeResult(), true, metrics_);
  report_.Add(end, true, metrics_);
  EXPECT_EQ(report_.processed_seq(), 5u) << "the end has no number";
}

TEST_F(SessionReportTest, CountsOnlyWhatIsNew) {
  report_.Add(SomeResult(), true, metrics_);
  WorkResult next = SomeResult();
  next.poses_before = 3;
  next.poses = Poses(4, 4, 10);
  next.counts.cd_events = 130;
  next.counts.unknown_words = 0;  // the decoder was reset
  next.sensor_time_us = 7500;
  next.objects[0].losses = 3;
  report_.Add(next, true, metrics_);
  EXPECT_EQ(metrics_.decoded_events.value(), 130u);
  EXPECT_EQ(metrics_.unknown_words.value(), 2u);
  EXPECT_EQ(metrics_.sensor_time_us.value(), 7500u);
  EXPECT_EQ(metrics_.track_losses.value(), 3u);
  EXPECT_EQ(metrics_.poses.value(), 4u);
  EXPECT_EQ(NumIn(metrics_.pose_latency), 4u);
}

TEST_F(SessionReportTest, SumsDroppedEvents) {
  WorkResult dropped = SomeResult();
  dropped.dropped_now = {1000, 1400, 20};
  report_.Add(dropped, false, metrics_);
  dropped.dropped_now = {1400, 1500, 5};
  report_.Add(dropped, false, metrics_);
  EXPECT_EQ(report_.health().skipped_events, 25u);
  EXPECT_EQ(report_.health().skipped_us, 500);
}

TEST_F(SessionReportTest, PlacesNoticesAmongThePoses) {
  WorkResult result = SomeResult();
  result.poses_before = 10;
  result.poses = Poses(11, 13, 0);
  result.gap = EventsDropped{.num_events = 4};
  result.state_changes = {{.object_index = 0, .t_us = 8, .state = TrackState::kLost, .num_poses_before = 2}};
  result.finished->fault = DecodeFault{.seq = 5, .count = 1};
  result.finished->triggers = ChunkTriggers{.seq = 5, .triggers = {{900, 1, 1}}};
  report_.Add(result, true, metrics_);
  EXPECT_EQ(report_.num_notices(), 4u);
  const std::vector<SessionNotice> notices = report_.TakeNotices();
  ASSERT_EQ(notices.size(), 4u);
  EXPECT_EQ(notices[0].after_pose_seq, 10u);
  EXPECT_TRUE(std::holds_alternative<EventsDropped>(notices[0].what));
  EXPECT_EQ(notices[1].after_pose_seq, 12u);
  EXPECT_TRUE(std::holds_alternative<StateChange>(notices[1].what));
  EXPECT_EQ(notices[2].after_pose_seq, 13u);
  EXPECT_TRUE(std::holds_alternative<DecodeFault>(notices[2].what));
  EXPECT_EQ(notices[3].after_pose_seq, 13u);
  EXPECT_EQ(std::get<ChunkTriggers>(notices[3].what).triggers[0].t_us, 900);
  EXPECT_EQ(report_.num_notices(), 0u) << "taken once";
}

TEST_F(SessionReportTest, TriggersTakeAtMostHalfOfTheNotices) {
  WorkResult result = SomeResult();
  result.finished->triggers = ChunkTriggers{.seq = 1, .triggers = {{900, 1, 1}, {901, 1, 0}}, .num_skipped = 1};
  for (size_t i = 0; i < kMaxUntakenNotices; ++i) report_.Add(result, true, metrics_);
  EXPECT_EQ(report_.num_notices(), kMaxUntakenNotices / 2);
  report_.TakeNotices();
  report_.Add(result, true, metrics_);
  const std::vector<SessionNotice> notices = report_.TakeNotices();
  ASSERT_EQ(notices.size(), 1u);
  EXPECT_EQ(std::get<ChunkTriggers>(notices[0].what).num_skipped, 3 * kMaxUntakenNotices / 2 + 1);
}

TEST_F(SessionReportTest, KeepsNoNoticesWithoutAStream) {
  WorkResult result = SomeResult();
  result.gap = EventsDropped{.num_events = 4};
  report_.Add(result, false, metrics_);
  EXPECT_EQ(report_.num_notices(), 0u);
  report_.Add(result, true, metrics_);
  EXPECT_EQ(report_.num_notices(), 1u);
  report_.ClearNotices();
  EXPECT_EQ(report_.num_notices(), 0u);
}

TEST(SessionReportRestartTest, EachStreamReceivesTheRestartUntilOneHasTakenIt) {
  const SessionBeginning beginning = {.restarted = TrackingRestarted{.after_seq = 3, .after_pose_seq = 7}};
  SessionReport report(beginning, {});
  EXPECT_EQ(report.num_notices(), 0u) << "no stream yet";
  report.StartNotices(7);
  EXPECT_EQ(report.num_notices(), 1u);
  report.StartNotices(9);
  const std::vector<SessionNotice> notices = report.TakeNotices();
  ASSERT_EQ(notices.size(), 1u);
  EXPECT_EQ(notices[0].after_pose_seq, 9u);
  report.StartNotices(9);
  EXPECT_EQ(report.num_notices(), 0u);
}

TEST(SessionReportRestartTest, PosesThatWereNotStoredAreNotThoseOfTheNewTracker) {
  const SessionBeginning beginning = {.restarted = TrackingRestarted{.after_seq = 3, .after_pose_seq = 7}};
  SessionReport report(beginning, {});
  EXPECT_EQ(report.LastValidPose(5), 5u);
  EXPECT_EQ(report.LastValidPose(9), 7u);
  report.StartNotices(7);
  (void)report.TakeNotices();
  EXPECT_EQ(report.LastValidPose(9), 9u) << "the writer knows";
  EXPECT_EQ(SessionReport(SessionBeginning(), {}).LastValidPose(9), 9u) << "the same poses are computed again";
}

}  // namespace
}  // namespace evpose::server
