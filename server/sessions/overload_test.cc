// SPDX-License-Identifier: Apache-2.0

// Sessions with a tracker that is slower than the arrival of events. The clock advances by the simulated tracking time.
#include "server/sessions/types/overload.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <functional>
#include <semaphore>
#include <utility>

#include "server/sessions/session.h"
#include "server/sessions/session_testing.h"
#include "server/stores/memory/memory_store.h"

namespace evpose::server {
namespace {

using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::Le;

SessionConfig LatestConfig() {
  SessionConfig config = SomeConfig();
  config.overload_policy = OverloadPolicy::kLatest;
  config.max_lag = absl::Milliseconds(20);
  return config;
}

TEST(OverloadGateTest, DropsFromTheLimitUntilHalfOfTheLimit) {
  OverloadGate gate(LatestConfig());
  EXPECT_FALSE(gate.MustSkip({.age_ratio = 1.0}));
  EXPECT_TRUE(gate.MustSkip({.age_ratio = 1.01}));
  gate.AddDropped({100, 200, 7});
  EXPECT_TRUE(gate.MustSkip({.age_ratio = 0.51}));
  gate.AddDropped({200, 250, 3});
  EXPECT_FALSE(gate.MustSkip({.age_ratio = 0.5}));
  const std::optional<EventsDropped> dropped = gate.EndGap();
  ASSERT_TRUE(dropped.has_value());
  EXPECT_EQ(dropped->num_events, 10u);
  EXPECT_EQ(dropped->from_t_us, 100);
  EXPECT_EQ(dropped->to_t_us, 250);
  EXPECT_EQ(dropped->reason, DropReason::kLag);
  EXPECT_FALSE(gate.EndGap().has_value()) << "reported once";
  EXPECT_FALSE(gate.MustSkip({.age_ratio = 0.9})) << "the lower limit applies only after a gap";
}

TEST(OverloadGateTest, ReportsTheReasonAtTheStartOfTheGap) {
  const std::pair<Backlog, DropReason> cases[] = {{{.age_ratio = 2.0, .bytes_ratio = 2.0}, DropReason::kLag},
                                                  {{.bytes_ratio = 2.0, .reader_ratio = 2.0}, DropReason::kMemory},
                                                  {{.reader_ratio = 2.0}, DropReason::kReader}};
  OverloadGate gate(LatestConfig());
  for (const auto& [backlog, reason] : cases) {
    EXPECT_TRUE(gate.MustSkip(backlog));
    EXPECT_TRUE(gate.MustSkip({.age_ratio = 0.7}));
    gate.AddDropped({1, 2, 3});
    EXPECT_FALSE(gate.MustSkip({}));
    EXPECT_EQ(gate.EndGap()->reason, reason);
  }
}

TEST(OverloadGateTest, BlockSkipsNothing) {
  OverloadGate gate(SomeConfig());
  EXPECT_FALSE(gate.MustSkip({.age_ratio = 1e9, .bytes_ratio = 1e9, .reader_ratio = 1e9}));
}

// Simulated load: the clock, the tracking time per event, and the number of tracked events.
struct Load {
  std::atomic<int64_t> now_us = 0;
  int64_t tracking_us_per_event = 0;
  uint64_t tracked_events = 0;
  std::function<void(int64_t until_us)> pass_time = [this](int64_t until_us) { now_us = until_us; };
};

class SlowTracker : public FakeTracker {
 public:
  SlowTracker(Load& load, const SessionConfig& config)
      : FakeTracker(std::make_shared<FakeTrackerGate>(), config), load_(load) {}
  void AddEvents(absl::Span<const Event> events, std::vector<PoseEstimate>& estimates) override {
    FakeTracker::AddEvents(events, estimates);
    if (events.empty()) return;
    load_.tracked_events += events.size();
    load_.pass_time(load_.now_us + load_.tracking_us_per_event * static_cast<int64_t>(events.size()));
  }
  EventGap Skip(absl::Span<const Event> events, int64_t t_us) override {
    const EventGap gap = FakeTracker::Skip(events, t_us);
    load_.tracked_events -= gap.num_events - events.size();
    return gap;
  }

 private:
  Load& load_;
};

// A live camera: a chunk of 20 events every millisecond, whether or not there is credit.
class LiveTest : public testing::Test {
 protected:
  static constexpr int kEventsPerMs = 20;
  static constexpr uint64_t kCreditBytes = uint64_t{64} * 1024;

  ~LiveTest() override { pool_.Join(); }

  void Start(const SessionConfig& config, int64_t tracking_us_per_event) {
    load_.tracking_us_per_event = tracking_us_per_event;
    SessionParts parts;
    parts.name = "sessions/live";
    parts.config = config;
    parts.limits = {.credit_bytes = kCreditBytes,
                    .max_chunk_bytes = 32 * 1024,
                    .pose_log_capacity = 100'000,
                    .expiry = absl::Minutes(1),
                    .writes_checkpoints = false};
    const TrackerFactory make_tracker = [this](const SessionConfig& its_config, const auto&) {
      return absl::StatusOr<std::unique_ptr<Tracker>>(std::make_unique<SlowTracker>(load_, its_config));
    };
    parts.pipeline = SessionPipeline::Create(parts.config, {nullptr}, make_tracker).value();
    parts.resume_token = "first";
    parts.clocks.wall = [] { return absl::UnixEpoch(); };
    parts.beginning.lifecycle = {.token_digest = TokenDigest("first"), .detached_at = absl::UnixEpoch()};
    parts.lease = store_->CreateSession({.name = parts.name}, "").value();
    parts.clocks.steady = [this] { return SteadyTime(std::chrono::microseconds(load_.now_us)); };
    parts.metrics = metrics_;
    session_ = Session::Start(std::move(parts), pool_);
    stream_ = session_->Attach("first", 0, listener_).value().stream;
  }

  // Streams the events up to `end_ms`, each millisecond when the clock reaches its end. Tracking advances the clock,
  // too.
  void StreamUntil(int64_t end_ms) {
    end_ms_ = end_ms;
    load_.pass_time = [this](int64_t until_us) { PassTime(until_us); };
    while (true) {
      WaitUntilIdle();
      if (next_ms_ >= end_ms_) return;
      // The clock is advanced on the only thread of the pool, on which tracking advances it, too, so that both never
      // run at the same time.
      std::binary_semaphore has_passed(0);
      pool_.AddSession("")->Post(
          [&] {
            PassTime(1000 * (next_ms_ + 1));
            has_passed.release();
          },
          SteadyTime());
      has_passed.acquire();
    }
  }
  void PassTime(int64_t until_us) {
    while (next_ms_ < end_ms_ && 1000 * (next_ms_ + 1) <= until_us) {
      load_.now_us = std::max<int64_t>(load_.now_us, 1000 * (next_ms_ + 1));
      PushMs();
    }
    load_.now_us = std::max<int64_t>(load_.now_us, until_us);
  }
  void PushMs() {
    const std::string payload = Flat64(SomeEvents(next_ms_, next_ms_ + 1, kEventsPerMs));
    ++next_ms_;
    const StreamView view = session_->View(stream_);
    num_stalls_ += !view.has_room || view.ack.send_limit_bytes < sent_bytes_ + payload.size();
    sent_bytes_ += payload.size();
    max_waiting_bytes_ = std::max(max_waiting_bytes_, sent_bytes_ - session_->Snapshot().health.processed_bytes);
    ASSERT_TRUE(session_->PushEvents(stream_, {.seq = static_cast<uint64_t>(next_ms_), .payload = payload}).ok());
    if (reads_poses_) session_->ReportSent(stream_, view.last_pose_seq);
  }
  void WaitUntilIdle() {
    listener_->WaitUntil([&] {
      const StreamView view = session_->View(stream_);
      if (reads_poses_) session_->ReportSent(stream_, view.last_pose_seq);
      return view.is_idle;
    });
  }
  SessionHealth End() {
    EXPECT_TRUE(session_->PushEnd(stream_).ok());
    listener_->WaitUntil([&] { return session_->View(stream_).has_ended; });
    return session_->Snapshot().health;
  }
  std::vector<EventsDropped> Dropped() {
    std::vector<EventsDropped> dropped;
    for (const SessionNotice& notice : session_->TakeNotices(stream_)) {
      EXPECT_GE(notice.after_pose_seq, notice_at_);
      notice_at_ = notice.after_pose_seq;
      if (const auto* what = std::get_if<EventsDropped>(&notice.what)) dropped.push_back(*what);
      if (const auto* what = std::get_if<LagChange>(&notice.what)) falls_behind_.push_back(what->is_behind);
    }
    return dropped;
  }
  std::vector<StoredPose> Poses() { return session_->pose_log().Read(0, 100'000); }

  Load load_;
  const std::shared_ptr<ServerMetrics> metrics_ = std::make_shared<ServerMetrics>();
  const std::shared_ptr<WaitingListener> listener_ = std::make_shared<WaitingListener>();
  WorkerPool pool_{1};  // outlives the store: its thread may release the last reference to a session
  const std::unique_ptr<Store> store_ = MakeMemoryStore();
  std::shared_ptr<Session> session_;
  uint64_t stream_ = 0;
  bool reads_poses_ = true;
  int64_t next_ms_ = 0;
  int64_t end_ms_ = 0;
  uint64_t sent_bytes_ = 0;
  uint64_t max_waiting_bytes_ = 0;
  int num_stalls_ = 0;
  uint64_t notice_at_ = 0;
  std::vector<bool> falls_behind_;  // of the notices that Dropped() has taken
};

TEST_F(LiveTest, AFastTrackerSkipsNothing) {
  Start(LatestConfig(), 40);  // 0.8 ms of work per millisecond
  StreamUntil(500);
  const SessionHealth health = End();
  EXPECT_EQ(health.skipped_events, 0u);
  EXPECT_EQ(health.skipped_us, 0);
  EXPECT_EQ(health.poses, 500u);
  EXPECT_TRUE(Dropped().empty());
  EXPECT_TRUE(falls_behind_.empty());
}

TEST_F(LiveTest, ASlowTrackerDropsEventsAndItsPosesHaveALowLatency) {
  Start(LatestConfig(), 150);  // 3 ms of work per millisecond
  StreamUntil(2000);
  const SessionHealth health = End();

  uint64_t num_dropped = 0;
  int64_t dropped_us = 0, end_us = 0;
  const std::vector<EventsDropped> dropped = Dropped();
  EXPECT_GT(dropped.size(), 10u);
  const std::vector<StoredPose> poses = Poses();
  for (const EventsDropped& gap : dropped) {
    EXPECT_EQ(gap.reason, DropReason::kLag);
    EXPECT_GE(gap.from_t_us, end_us) << "gaps do not overlap";
    end_us = gap.to_t_us;
    EXPECT_GT(gap.to_t_us, gap.from_t_us);
    num_dropped += gap.num_events;
    dropped_us += gap.to_t_us - gap.from_t_us;
    for (const StoredPose& pose : poses) {
      EXPECT_FALSE(pose.estimate.t_us > gap.from_t_us && pose.estimate.t_us < gap.to_t_us / 1000 * 1000);
    }
  }
  // The stream, health and the server's total agree, and nothing is counted twice or not at all.
  EXPECT_EQ(health.skipped_events, num_dropped);
  EXPECT_EQ(health.skipped_us, dropped_us);
  EXPECT_EQ(metrics_->skipped_events[DropReason::kLag].value(), num_dropped);
  EXPECT_EQ(metrics_->all_skipped_events(), num_dropped);
  EXPECT_EQ(metrics_->decoded_events.value(), health.counts.cd_events);
  EXPECT_EQ(health.counts.cd_events, 2000u * kEventsPerMs);
  EXPECT_EQ(load_.tracked_events + num_dropped, health.counts.cd_events);
  EXPECT_EQ(health.processed_bytes, sent_bytes_);

  // The tracker is fast enough for a third of the events, and tracks nearly that many.
  EXPECT_GT(load_.tracked_events, health.counts.cd_events / 4);
  std::vector<int64_t> latencies_us;
  for (const StoredPose& pose : poses) latencies_us.push_back(pose.latency_us);
  EXPECT_THAT(latencies_us, Each(Le(20'000 + 3000))) << "max_lag and one slice of work";
  EXPECT_EQ(num_stalls_, 0);
  EXPECT_LT(max_waiting_bytes_, 25u * kEventsPerMs * 8);
}

TEST_F(LiveTest, BlockTracksEverythingAndStopsTheSender) {
  Start(SomeConfig(), 150);
  StreamUntil(2000);
  const SessionHealth health = End();
  EXPECT_EQ(health.skipped_events, 0u);
  EXPECT_EQ(health.poses, 2000u);
  EXPECT_TRUE(Dropped().empty());
  EXPECT_GT(num_stalls_, 0) << "a client that keeps to its credit waits";
  EXPECT_THAT(falls_behind_, ElementsAre(true, false));
  EXPECT_EQ(metrics_->falls_behind.value(), 1u);
}

TEST_F(LiveTest, BytesBeyondTheCreditAreDroppedWhateverTheirAge) {
  Start(LatestConfig(), 0);
  // The worker is blocked and the clock does not advance.
  std::binary_semaphore go(0), stopped(0);
  pool_.AddSession("")->Post(
      [&] {
        stopped.release();
        go.acquire();
      },
      SteadyTime());
  stopped.acquire();
  uint64_t seq = 0, bytes = 0;
  const std::string payload = Flat64(SomeEvents(0, 100));
  while (session_->View(stream_).has_room) {
    ASSERT_TRUE(session_->PushEvents(stream_, {.seq = ++seq, .payload = payload}).ok());
    bytes += payload.size();
    EXPECT_EQ(session_->View(stream_).ack.send_limit_bytes, bytes + kCreditBytes) << "credit follows receipt";
  }
  EXPECT_GE(bytes, 2 * kCreditBytes);
  EXPECT_LT(bytes, 2 * kCreditBytes + payload.size());
  go.release();
  WaitUntilIdle();
  const SessionHealth health = End();
  const std::vector<EventsDropped> dropped = Dropped();
  ASSERT_EQ(dropped.size(), 1u);
  EXPECT_EQ(dropped[0].reason, DropReason::kMemory);
  EXPECT_EQ(dropped[0].num_events, health.skipped_events);
  EXPECT_GT(load_.tracked_events, 0u);
  EXPECT_EQ(load_.tracked_events + health.skipped_events, health.counts.cd_events);
}

TEST_F(LiveTest, AStalledReaderStopsThePosesButNotTheCamera) {
  Start(LatestConfig(), 0);
  reads_poses_ = false;
  StreamUntil(3000);  // returns: the session does not wait for its reader
  EXPECT_EQ(session_->Snapshot().health.poses, kMaxUnsentPoses + 1);
  EXPECT_TRUE(Dropped().empty()) << "reported when tracking continues";
  reads_poses_ = true;
  session_->ReportSent(stream_, kMaxUnsentPoses + 1);
  StreamUntil(3100);
  const SessionHealth health = End();
  EXPECT_GE(health.poses, kMaxUnsentPoses + 100);
  const std::vector<EventsDropped> dropped = Dropped();
  ASSERT_EQ(dropped.size(), 1u);
  EXPECT_EQ(dropped[0].reason, DropReason::kReader);
  EXPECT_EQ(dropped[0].num_events, health.skipped_events);
  EXPECT_EQ(num_stalls_, 0);
}

TEST_F(LiveTest, TheLastGapIsReportedBeforeTheEnd) {
  Start(LatestConfig(), 0);
  reads_poses_ = false;
  StreamUntil(3000);
  const SessionHealth health = End();
  const std::vector<EventsDropped> dropped = Dropped();
  ASSERT_EQ(dropped.size(), 1u);
  EXPECT_EQ(dropped[0].num_events, health.skipped_events);
  EXPECT_EQ(dropped[0].to_t_us, health.t_us);
}

// Sessions on one thread. The processor time of a slice is that of a turn, and the only time that passes.
class WorkerFairnessTest : public ::testing::Test {
 protected:
  SteadyTime Now() const { return SteadyTime(std::chrono::hours(1) + std::chrono::milliseconds(cpu_ms_.load())); }

  // Attaches to a new session, whose slices are recorded as `index`; returns the stream.
  uint64_t AddSession(int index) {
    Load& load = *loads_.emplace_back(std::make_unique<Load>());
    load.pass_time = [this, index](int64_t) {
      ++cpu_ms_;
      slices_.push_back(index);
      on_slice_();
    };
    SessionParts parts;
    parts.name = "sessions/" + std::to_string(index);
    parts.config = SomeConfig();
    parts.limits.writes_checkpoints = false;
    const TrackerFactory make_tracker = [&load](const SessionConfig& config, const auto&) {
      return absl::StatusOr<std::unique_ptr<Tracker>>(std::make_unique<SlowTracker>(load, config));
    };
    parts.pipeline = SessionPipeline::Create(parts.config, {nullptr}, make_tracker).value();
    parts.resume_token = "first";
    parts.clocks = {.wall = [] { return absl::UnixEpoch(); }, .steady = [this] { return Now(); }};
    parts.beginning.lifecycle = {.token_digest = TokenDigest("first"), .detached_at = absl::UnixEpoch()};
    parts.lease = store_->CreateSession({.name = parts.name}, "").value();
    sessions_.push_back(Session::Start(std::move(parts), pool_));
    return sessions_.back()->Attach("first", 0, {}).value().stream;
  }

  std::vector<int> slices_;  // the session of each slice, in their order
  std::function<void()> on_slice_ = [] {};
  std::vector<std::unique_ptr<Load>> loads_;
  std::atomic<int64_t> cpu_ms_ = 0;
  // Outlives the store.
  WorkerPool pool_{
      1, 1, {.now = [this] { return Now(); }, .cpu_now = [this] { return std::chrono::milliseconds(cpu_ms_.load()); }}};
  const std::unique_ptr<Store> store_ = MakeMemoryStore();
  std::vector<std::shared_ptr<Session>> sessions_;
};

// Eight replays with full queues and one live camera.
TEST_F(WorkerFairnessTest, ACameraComesBeforeReplaysAndTheyShareTheRest) {
  constexpr int kBusy = 8;
  constexpr size_t kChunks = 250;
  // 16 KiB, one millisecond: one slice, and one call of the tracker.
  const std::string slice = Flat64(std::vector<Event>(2048, {500, 9, 9, 1}));
  std::binary_semaphore go(0);
  pool_.AddSession("")->Post([&go] { go.acquire(); }, SteadyTime());
  for (int i = 0; i < kBusy; ++i) {
    const uint64_t stream = AddSession(i);
    for (uint64_t seq = 1; seq <= kChunks; ++seq) {
      ASSERT_TRUE(sessions_[i]->PushEvents(stream, {.seq = seq, .payload = slice}).ok());
    }
  }
  // After the slices in which the replays have lost their priority, 100 of each, because the time of their events does
  // not show that they are replays, a chunk of the camera arrives in every 7th slice.
  constexpr size_t kBegin = 900, kEnd = kBegin + 600;
  const uint64_t camera = AddSession(kBusy);
  uint64_t camera_seq = 0;
  std::binary_semaphore all_slices(0);
  on_slice_ = [&] {
    if (slices_.size() == kChunks * kBusy + camera_seq) all_slices.release();
    if (slices_.size() < kBegin || slices_.size() % 7 != 0 || slices_.size() > kEnd || slices_.back() == kBusy) return;
    ASSERT_TRUE(sessions_[kBusy]->PushEvents(camera, {.seq = ++camera_seq, .payload = slice}).ok());
  };
  go.release();
  all_slices.acquire();
  pool_.Join();
  ASSERT_EQ(slices_.size(), kChunks * kBusy + camera_seq);
  ASSERT_GT(camera_seq, 50u);
  std::vector<int> replays;
  for (size_t i = kBegin; i < slices_.size(); ++i) {
    if (slices_[i] != kBusy) replays.push_back(slices_[i]);
    if (i % 7 == 0 && i <= kEnd && slices_[i - 1] != kBusy) {
      EXPECT_EQ(slices_[i], kBusy) << "slice " << i;
    }
  }
  for (size_t round = 0; round + 1 < 60; ++round) {
    const auto begin = replays.begin() + ptrdiff_t{kBusy} * static_cast<ptrdiff_t>(round);
    std::vector<int> turn(begin, begin + kBusy);
    std::sort(turn.begin(), turn.end());
    EXPECT_THAT(turn, ElementsAre(0, 1, 2, 3, 4, 5, 6, 7)) << "each replay runs once in round " << round;
  }
}

}  // namespace
}  // namespace evpose::server
