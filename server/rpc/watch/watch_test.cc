// SPDX-License-Identifier: Apache-2.0

// Tests SessionService.WatchPoses and WatchHealth through raw stubs.
#include <cmath>
#include <deque>

#include "server/rpc/common/conversion.h"
#include "server/rpc/server_testing.h"

namespace evpose::server {
namespace {

using Kind = v1::TrackResponse;

class WatchTest : public RpcTest {};

TEST_F(WatchTest, WatchersReadStoredPosesAndThenLiveOnes) {
  const CreatedSession session = CreateSession();
  const auto track = Attached(session);
  track->Events(1, Flat64(SomeEvents(1, 11)));
  v1::TrackResponse response;
  ASSERT_TRUE(track->ReadUntil(Kind::kAck, response));

  grpc::ClientContext context;
  v1::WatchPosesRequest request;
  request.set_session(session.name());
  request.set_after_pose_seq(2);
  const auto watcher = sessions_->WatchPoses(&context, request);
  v1::WatchPosesResponse poses;
  ASSERT_TRUE(watcher->Read(&poses));
  ASSERT_EQ(poses.poses_size(), 7);
  EXPECT_EQ(poses.poses(0).pose_seq(), 3u);
  uint64_t last = poses.poses(6).pose_seq();
  track->Events(2, Flat64(SomeEvents(11, 21)));
  track->End();
  while (watcher->Read(&poses)) {
    for (const auto& pose : poses.poses()) EXPECT_EQ(pose.pose_seq(), ++last);
    EXPECT_EQ(poses.num_skipped(), 0u);
  }
  EXPECT_EQ(last, 20u);
  EXPECT_EQ(Describe(watcher->Finish()), "OK") << "the session has ended";
}

TEST_F(WatchTest, ASlowWatcherReceivesTheNumberOfLostPoses) {
  const CreatedSession session = CreateSession();
  grpc::ClientContext context;
  v1::WatchPosesRequest request;
  request.set_session(session.name());
  const auto watcher = sessions_->WatchPoses(&context, request);
  const auto track = Attached(session);
  v1::TrackResponse response;
  for (uint64_t seq = 1; seq <= 30; ++seq) {
    const auto begin_ms = static_cast<int64_t>(200 * seq);
    track->Events(seq, Flat64(SomeEvents(begin_ms, begin_ms + 200)));
    ASSERT_TRUE(track->ReadUntil(Kind::kAck, response));
  }
  track->End();
  ASSERT_TRUE(track->ReadUntil(Kind::kSummary, response));
  const uint64_t total = response.summary().health().poses();
  EXPECT_EQ(total, 6000u);

  uint64_t seen = 0;
  uint64_t skipped = 0;
  uint64_t last = 0;
  v1::WatchPosesResponse poses;
  while (watcher->Read(&poses)) {
    skipped += poses.num_skipped();
    last += poses.num_skipped();
    for (const auto& pose : poses.poses()) EXPECT_EQ(pose.pose_seq(), ++last);
    seen += static_cast<uint64_t>(poses.poses_size());
  }
  EXPECT_EQ(Describe(watcher->Finish()), "OK");
  EXPECT_GT(skipped, 0u);
  EXPECT_EQ(seen + skipped, total);
}

TEST_F(WatchTest, AWatcherMayLimitThePoseRate) {
  const CreatedSession session = CreateSession();
  const auto track = Attached(session);
  track->Events(1, Flat64(SomeEvents(1, 101)));
  track->End();
  EXPECT_EQ(Describe(track->Finish()), "OK");
  grpc::ClientContext context;
  v1::WatchPosesRequest request;
  request.set_session(session.name());
  request.set_max_rate_hz(100);
  const auto watcher = sessions_->WatchPoses(&context, request);
  std::vector<int64_t> times_us;
  v1::WatchPosesResponse poses;
  while (watcher->Read(&poses)) {
    for (const auto& pose : poses.poses()) times_us.push_back(pose.t_us());
    EXPECT_EQ(poses.num_skipped(), 0u);
  }
  EXPECT_EQ(Describe(watcher->Finish()), "OK");
  ASSERT_EQ(times_us.size(), 10u);
  EXPECT_EQ(times_us[1] - times_us[0], 10'000);
}

TEST_F(WatchTest, WatchersThatCannotBeServedReceiveAnError) {
  const CreatedSession session = CreateSession();
  const auto watch_poses = [this](const v1::WatchPosesRequest& request) {
    grpc::ClientContext context;
    v1::WatchPosesResponse response;
    const auto watcher = sessions_->WatchPoses(&context, request);
    EXPECT_FALSE(watcher->Read(&response));
    return Describe(watcher->Finish());
  };
  const auto watch_health = [this](const v1::WatchHealthRequest& request) {
    grpc::ClientContext context;
    v1::WatchHealthResponse response;
    const auto watcher = sessions_->WatchHealth(&context, request);
    EXPECT_FALSE(watcher->Read(&response));
    return Describe(watcher->Finish());
  };
  v1::WatchPosesRequest poses;
  EXPECT_EQ(watch_poses(poses), "NOT_FOUND SESSION_NOT_FOUND");
  poses.set_session(session.name());
  for (const double rate_hz : {0.0, -1.0, std::nan(""), HUGE_VAL}) {
    poses.set_max_rate_hz(rate_hz);
    EXPECT_EQ(watch_poses(poses), "INVALID_ARGUMENT max_rate_hz");
  }
  v1::WatchHealthRequest health;
  EXPECT_EQ(watch_health(health), "NOT_FOUND SESSION_NOT_FOUND");
  health.set_session(session.name());
  health.mutable_period()->set_nanos(9'999'999);
  EXPECT_EQ(watch_health(health), "INVALID_ARGUMENT period");
}

TEST_F(WatchTest, HealthComesAtOnceThenPeriodicallyAndOnceMoreAtTheEnd) {
  const CreatedSession session = CreateSession();
  grpc::ClientContext context;
  v1::WatchHealthRequest request;
  request.set_session(session.name());
  request.mutable_period()->set_nanos(10'000'000);
  const auto watcher = sessions_->WatchHealth(&context, request);
  v1::WatchHealthResponse response;
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(watcher->Read(&response));
  EXPECT_EQ(response.health().poses(), 0u);
  const auto track = Attached(session);
  track->Events(1, Flat64(SomeEvents(1, 11)));
  track->End();
  EXPECT_EQ(Describe(track->Finish()), "OK");
  while (watcher->Read(&response)) continue;
  EXPECT_EQ(Describe(watcher->Finish()), "OK");
  EXPECT_EQ(response.health().poses(), 10u);
  EXPECT_EQ(response.health().objects(0).state(), v1::TRACK_STATE_TRACKING);
}

TEST_F(WatchTest, TheMessagesWithHealthOfATenantAreLimited) {
  ServerOptions options = Options();
  options.tenant.max_health_per_s = 1;
  options.stream_idle_timeout = absl::Milliseconds(200);
  Connect(options);
  const CreatedSession session = CreateSession();
  v1::WatchHealthRequest request;
  request.set_session(session.name());
  request.mutable_period()->set_nanos(10'000'000);
  std::deque<grpc::ClientContext> contexts;
  std::vector<std::unique_ptr<grpc::ClientReader<v1::WatchHealthResponse>>> watchers;
  v1::WatchHealthResponse health;
  for (int i = 0; i < 30; ++i) {
    watchers.push_back(sessions_->WatchHealth(&contexts.emplace_back(), request));
    EXPECT_TRUE(watchers.back()->Read(&health)) << "the first message comes at once";
  }
  // Many of the requested periods pass until the silent stream ends.
  EXPECT_EQ(Describe(Attached(session)->Finish()), "DEADLINE_EXCEEDED STREAM_IDLE");
  EXPECT_EQ(Describe(Delete(session.name())), "OK");
  for (size_t i = 0; i < watchers.size(); ++i) {
    int num_more = 0;
    while (watchers[i]->Read(&health)) ++num_more;
    // The period of a watcher depends on the watchers that existed before it.
    if (i >= 10) {
      EXPECT_EQ(num_more, 0) << i;
    }
    EXPECT_EQ(Describe(watchers[i]->Finish()), "NOT_FOUND SESSION_DELETED");
  }
}

TEST_F(WatchTest, ACancelledWatcherIsRemoved) {
  const CreatedSession session = CreateSession();
  for (int i = 0; i < 3; ++i) {
    grpc::ClientContext context;
    v1::WatchHealthRequest request;
    request.set_session(session.name());
    const auto watcher = sessions_->WatchHealth(&context, request);
    v1::WatchHealthResponse health;
    ASSERT_TRUE(watcher->Read(&health));
    context.TryCancel();
    EXPECT_EQ(Describe(watcher->Finish()), "CANCELLED");
  }
  server_->Shutdown(absl::InfiniteDuration());  // returns, because no stream is left
}

TEST(PoseMessageTest, APoseHasTheLatestLossOfItsObject) {
  SessionConfig config;
  config.objects.emplace_back();
  StoredPose pose;
  EXPECT_FALSE(ToProto(pose, config).has_latest_loss());
  pose.estimate.loss_cause = LossCause::kOutOfView;
  pose.estimate.lost_at_us = -7;
  EXPECT_EQ(ToProto(pose, config).latest_loss().cause(), v1::LOSS_CAUSE_OUT_OF_VIEW);
  EXPECT_EQ(ToProto(pose, config).latest_loss().t_us(), -7);
}

}  // namespace
}  // namespace evpose::server
