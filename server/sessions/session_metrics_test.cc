// SPDX-License-Identifier: Apache-2.0

// Metrics of sessions, compared with their health.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <string>

#include "server/runtime/errors.h"
#include "server/sessions/session_manager.h"
#include "server/sessions/session_testing.h"
#include "server/sessions/tenant_quotas.h"
#include "server/stores/memory/memory_store.h"
#include "server/telemetry/metrics_testing.h"
#include "server/telemetry/stage_timer.h"

namespace evpose::server {
namespace {

using std::chrono::microseconds;

constexpr char kLabTenant[] = "lab";

class SessionMetricsTest : public testing::Test {
 protected:
  SessionMetricsTest() { Restart(); }
  ~SessionMetricsTest() override {
    gate_->Open();
    pool_.Join();
  }

  // A server that starts on the store; uncommitted data are lost.
  void Restart() {
    if (sessions_ != nullptr) sessions_->CloseAll(absl::CancelledError("killed"));
    sessions_.reset();
    metrics_ = std::make_shared<ServerMetrics>();
    models_ = ModelRegistry::Create({.limits = {.max_tenant_bytes = 10'000, .metrics = metrics_}}, *store_).value();
    SessionManager::Options options;
    options.max_sessions = 3;
    options.max_tenant_sessions = 2;
    options.make_tracker = FakeTrackers(gate_);
    options.now = [] { return absl::UnixEpoch(); };
    options.steady_now = [this] { return SteadyTime(microseconds(now_us_)); };
    options.metrics = metrics_;
    sessions_ = std::make_unique<SessionManager>(options, *store_, *models_, pool_);
    EXPECT_TRUE(sessions_->FindStored().ok());
    RestoreAll(*sessions_, *store_);
  }

  std::shared_ptr<Session> Create(const std::string& tenant = kLabTenant) {
    const auto bytes = std::make_shared<const std::vector<uint8_t>>(kCubeObj, kCubeObj + sizeof(kCubeObj) - 1);
    const SessionConfig config = SomeConfig({"cube"}, models_->Upload(tenant, {}, "", bytes).value().name);
    return sessions_->Create(tenant, config, "").value();
  }
  template <typename Predicate>
  void Until(Session& session, Predicate is_true) {
    const auto waiting = std::make_shared<WaitingListener>();
    session.AddWatcher(waiting);
    waiting->WaitUntil(is_true);
  }
  // Attaches, pushes a chunk and detaches; waits until all of it has been persisted. Returns the next token.
  std::string Track(Session& session, const std::string& token, uint64_t seq, const std::vector<Event>& events) {
    const Attachment attachment = session.Attach(token, 0, listener_).value();
    EXPECT_TRUE(session.PushEvents(attachment.stream, {.seq = seq, .payload = Flat64(events)}).ok());
    session.Detach(attachment.stream);
    Until(session, [&] { return session.View(attachment.stream).ack.durable_seq == seq; });
    return attachment.resume_token;
  }

  std::atomic<int64_t> now_us_ = 0;
  const std::shared_ptr<FakeTrackerGate> gate_ = std::make_shared<FakeTrackerGate>();
  const std::shared_ptr<WaitingListener> listener_ = std::make_shared<WaitingListener>();
  WorkerPool pool_{1};  // outlives the store: its thread may release the last reference to a session
  const std::unique_ptr<Store> store_ = MakeMemoryStore();
  std::shared_ptr<ServerMetrics> metrics_;
  std::unique_ptr<ModelRegistry> models_;
  std::unique_ptr<SessionManager> sessions_;
};

TEST_F(SessionMetricsTest, CountersEqualTheHealthOfTheSession) {
  const auto session = Create();
  std::vector<Event> events = SomeEvents(1, 11);
  events.push_back({11'000, 5000, 7, 1});  // outside the sensor
  std::string token = Track(*session, session->resume_token(), 1, events);
  token = Track(*session, token, 2, {{12'000, 0, 0, 1}, {13'000, 3, 4, 1}});  // lost
  const Attachment attachment = session->Attach(token, 0, listener_).value();
  ASSERT_TRUE(session->PushResetPose(attachment.stream, 3, "cube", RigidTransform()).ok());
  ASSERT_TRUE(session->PushEvents(attachment.stream, {.seq = 4, .payload = Flat64(SomeEvents(14, 20))}).ok());
  ASSERT_TRUE(session->PushEvents(attachment.stream, {.seq = 4, .payload = Flat64(SomeEvents(14, 20))}).ok());
  ASSERT_TRUE(session->PushEnd(attachment.stream).ok());
  Until(*session, [&] { return session->View(attachment.stream).has_ended; });

  const SessionHealth health = session->Snapshot().health;
  EXPECT_EQ(metrics_->decoded_events.value(), health.counts.cd_events);
  EXPECT_EQ(metrics_->decoded_events.value(), 30u + 2u + 18u);
  EXPECT_EQ(metrics_->events_outside_sensor.value(), 1u);
  EXPECT_EQ(metrics_->received_bytes.value(), health.received_bytes) << "a repeated chunk is counted once";
  EXPECT_EQ(metrics_->poses.value(), health.poses);
  EXPECT_EQ(NumIn(metrics_->pose_latency), health.poses);
  EXPECT_EQ(metrics_->sensor_time_us.value(), static_cast<uint64_t>(health.sensor_time_us));
  EXPECT_EQ(metrics_->track_losses.value(), 1u);
  EXPECT_EQ((metrics_->object_transitions[ObjectPhase::kPublished][ObjectPhase::kSearching].value()), 1u);
  EXPECT_EQ(metrics_->reinitializations.value(), 1u);
  EXPECT_EQ(metrics_->reattaches.value(), 2u);
  EXPECT_EQ(NumIn(metrics_->decode_time), 3u) << "one for each chunk of at most 16 KiB";
  EXPECT_EQ(NumIn(metrics_->track_time), 4u) << "the end, too";
  EXPECT_GE(NumIn(metrics_->checkpoint_time), 3u);
  const StoredSession stored = store_->ReadSession(session->name()).value();
  EXPECT_EQ(metrics_->commit_bytes[CommitPart::kPoses].value(), SizeBytes(stored.poses)) << "each pose is written once";
  EXPECT_GE(metrics_->commit_bytes[CommitPart::kCheckpoint].value(), stored.checkpoint.size());
  EXPECT_GE(metrics_->commit_bytes[CommitPart::kLifecycle].value(), stored.lifecycle.size());
  EXPECT_EQ(metrics_->all_skipped_events(), 0u);
}

TEST_F(SessionMetricsTest, WorkBeforeARestartIsNotCountedAgain) {
  auto session = Create();
  std::string token = Track(*session, session->resume_token(), 1, SomeEvents(1, 11));
  token = Track(*session, token, 2, {{12'000, 0, 0, 1}, {13'000, 3, 4, 1}});
  const std::string name = session->name();
  Restart();
  session = sessions_->Get(kLabTenant, name).value();
  EXPECT_EQ(session->Snapshot().health.counts.cd_events, 32u);
  EXPECT_EQ(metrics_->decoded_events.value(), 0u);
  EXPECT_EQ(metrics_->track_losses.value(), 0u);

  Track(*session, token, 3, SomeEvents(14, 20));
  EXPECT_EQ(session->Snapshot().health.counts.cd_events, 50u);
  EXPECT_EQ(metrics_->decoded_events.value(), 18u);
  EXPECT_EQ(metrics_->sensor_time_us.value(), 19'600u - 13'000u);
  EXPECT_EQ(metrics_->track_losses.value(), 0u);
  EXPECT_EQ(metrics_->reattaches.value(), 1u);
  EXPECT_EQ(metrics_->poses.value(), session->Snapshot().health.poses - 10);
}

TEST_F(SessionMetricsTest, TotalsContainWaitingWork) {
  const auto first = Create();
  const auto second = Create();
  const auto third = Create("another tenant");
  SessionTotals totals = sessions_->totals();
  EXPECT_EQ(totals.detached, 3u);
  EXPECT_EQ(totals.objects[static_cast<size_t>(TrackState::kTracking)], 3u);
  EXPECT_EQ(totals.queued_bytes, 0u);
  EXPECT_EQ(totals.oldest_queue_age_us, 0);

  gate_->Close();
  const std::string payload = Flat64(SomeEvents(1, 11));
  for (const auto& session : {first, second}) {
    const uint64_t stream = session->Attach(session->resume_token(), 0, listener_)->stream;
    ASSERT_TRUE(session->PushEvents(stream, {.seq = 1, .payload = payload}).ok());
    now_us_ += 1'000'000;
  }
  totals = sessions_->totals();
  EXPECT_EQ(totals.attached, 2u);
  EXPECT_EQ(totals.detached, 1u);
  EXPECT_EQ(totals.queued_bytes, 2 * payload.size());
  EXPECT_EQ(totals.oldest_queue_age_us, 2'000'000);
  gate_->Open();
  Until(*first, [&] { return first->Watch().last_pose_seq == 9; });
  Until(*second, [&] { return second->Watch().last_pose_seq == 9; });

  const uint64_t stream = third->Attach(third->resume_token(), 0, listener_)->stream;
  ASSERT_TRUE(third->PushEnd(stream).ok());
  Until(*third, [&] { return third->View(stream).has_ended; });
  second->Close(absl::ResourceExhaustedError("the store is full"));
  totals = sessions_->totals();
  EXPECT_EQ(totals.attached, 1u);
  EXPECT_EQ(totals.ended, 1u);
  EXPECT_EQ(totals.closed, 1u);
  EXPECT_EQ(totals.objects[static_cast<size_t>(TrackState::kTracking)], 1u);
}

TEST_F(SessionMetricsTest, RejectionsAreCountedByLimit) {
  const auto refusals = [this](QuotaLimit limit) { return metrics_->quota_refusals[limit].value(); };
  const SessionConfig config = Create()->config();
  Create();
  EXPECT_TRUE(absl::IsResourceExhausted(sessions_->Create(kLabTenant, config, "").status()));
  EXPECT_EQ(refusals(QuotaLimit::kTenantSessions), 1u);
  const SessionConfig of_another = Create("another tenant")->config();
  EXPECT_TRUE(absl::IsResourceExhausted(sessions_->Create("another tenant", of_another, "").status()));
  EXPECT_EQ(refusals(QuotaLimit::kMaxSessions), 1u);
  EXPECT_EQ(refusals(QuotaLimit::kTenantSessions), 1u);

  const auto upload = models_->limits().BeginUpload(kLabTenant).value();
  EXPECT_TRUE(absl::IsResourceExhausted(upload->Declare(9999)));
  EXPECT_EQ(refusals(QuotaLimit::kTenantModelBytes), 1u);
  const auto small =
      ModelRegistry::Create({.limits = {.max_store_bytes = 1000, .max_uploads = 1, .metrics = metrics_}}, *store_)
          .value();
  const auto other = small->limits().BeginUpload("other").value();
  EXPECT_TRUE(absl::IsResourceExhausted(other->Declare(999)));
  EXPECT_EQ(refusals(QuotaLimit::kMaxModelStoreBytes), 1u);
  EXPECT_TRUE(absl::IsResourceExhausted(small->limits().BeginUpload("other").status()));
  EXPECT_EQ(refusals(QuotaLimit::kMaxUploads), 1u);

  TenantQuotas::Options options = {.max_watchers = 1, .max_bytes_per_s = 10, .burst_bytes = 10};
  options.now = [] { return absl::UnixEpoch(); };
  options.metrics = metrics_;
  TenantQuotas quotas(options);
  const auto watcher = quotas.AddWatcher(kLabTenant);
  ASSERT_TRUE(watcher.ok());
  EXPECT_FALSE(quotas.AddWatcher(kLabTenant).ok());
  EXPECT_EQ(refusals(QuotaLimit::kTenantWatchers), 1u);
  EXPECT_EQ(quotas.ChargeBytes(kLabTenant, 10), absl::ZeroDuration());
  EXPECT_EQ(metrics_->quota_delays.value(), 0u);
  EXPECT_EQ(quotas.ChargeBytes(kLabTenant, 10), absl::Seconds(1));
  EXPECT_EQ(metrics_->quota_delays.value(), 1u);
}

TEST(StageTimerTest, SearchesAreTheirOwnStage) {
  const auto metrics = std::make_shared<ServerMetrics>();
  int64_t now_us = 0;
  StageTimer timer(metrics, [&now_us] { return StageTimer::Time(microseconds(now_us)); });
  timer.Decode([&now_us] { now_us += 3; });

  SessionConfig config = SomeConfig();
  FakeTracker tracker(std::make_shared<FakeTrackerGate>(), config);
  std::vector<PoseEstimate> poses;
  const auto step = [&](FakeTracker& of, int64_t duration_us) {
    timer.Track(of, [&] {
      of.AddEvents(SomeEvents(1, 2), poses);
      now_us += duration_us;
    });
  };
  step(tracker, 100);
  step(tracker, 20);
  timer.EndTracking();
  config.objects[0].initial_camera_from_object.reset();
  FakeTracker searching(std::make_shared<FakeTrackerGate>(), config);
  step(searching, 7000);
  step(tracker, 5);
  timer.EndTracking();

  EXPECT_EQ(NumIn(metrics->decode_time), 1u);
  EXPECT_DOUBLE_EQ(metrics->decode_time.Read().sum_s, 3e-6);
  EXPECT_EQ(NumIn(metrics->track_time), 2u);
  EXPECT_DOUBLE_EQ(metrics->track_time.Read().sum_s, 125e-6);
  EXPECT_EQ(NumIn(metrics->initialization_time), 1u);
  EXPECT_DOUBLE_EQ(metrics->initialization_time.Read().sum_s, 7e-3);
}

}  // namespace
}  // namespace evpose::server
