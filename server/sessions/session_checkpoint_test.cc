// SPDX-License-Identifier: Apache-2.0

// Checkpoints of a session: their contents and times, and how a session is resumed from them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <future>

#include "server/runtime/errors.h"
#include "server/sessions/durability/pose_codec.h"
#include "server/sessions/durability/session_codec.h"
#include "server/sessions/session.h"
#include "server/sessions/session_testing.h"
#include "server/sessions/store_testing.h"
#include "server/stores/memory/memory_store.h"

namespace evpose::server {
namespace {

class SessionCheckpointTest : public testing::Test {
 protected:
  SessionCheckpointTest() { Create(); }
  ~SessionCheckpointTest() override {
    session_->Close(absl::CancelledError("the test is over"));
    pool_.Join();
  }

  void Create() {
    SessionBeginning beginning;
    beginning.lifecycle = {.token_digest = TokenDigest("first"), .detached_at = now_};
    auto lease = store_->CreateSession({.name = kName}, EncodeLifecycle(beginning.lifecycle)).value();
    session_ = Start(std::move(beginning), std::move(lease), std::nullopt);
  }
  void CreateAgain() {
    store_->DeleteSession(kName).IgnoreError();
    session_->Close(absl::CancelledError("the next one"));
    Create();
  }

  std::shared_ptr<Session> Start(SessionBeginning beginning, std::unique_ptr<SessionLease> lease,
                                 const std::optional<PipelineState>& state,
                                 std::vector<PoseSegment> stored_poses = {}) {
    SessionParts parts;
    parts.name = kName;
    parts.config = SomeConfig(objects_);
    parts.limits = {.pose_log_capacity = 100'000,
                    .pose_log_bytes = pose_log_bytes_,
                    .expiry = absl::Minutes(1),
                    .backoff = {.first = absl::Microseconds(10), .longest = absl::Microseconds(100)}};
    parts.pipeline = SessionPipeline::Create(parts.config, {nullptr}, make_tracker_).value();
    if (state.has_value()) {
      EXPECT_TRUE(parts.pipeline->LoadPosition(state->position).ok());
      EXPECT_TRUE(parts.pipeline->LoadTracker(state->tracker).ok());
    }
    parts.create_time = now_;
    parts.clocks.wall = [this] { return now_; };
    parts.clocks.steady = [] { return SteadyTime(); };  // no work takes time: that alone makes no checkpoint due
    parts.beginning = std::move(beginning);
    parts.stored_poses = std::move(stored_poses);
    parts.lease = std::make_unique<FaultInjectingLease>(std::move(lease), fault_);
    return Session::Start(std::move(parts), pool_);
  }

  // Replaces the session as a restart of the server does: uncommitted data are lost.
  void RestartServer() {
    session_->Close(absl::CancelledError("killed"));
    fault_->Set(absl::OkStatus());
    auto acquired = store_->AcquireSession(kName).value();
    SessionBeginning beginning;
    beginning.lifecycle = DecodeLifecycle(acquired.session.lifecycle).value();
    std::optional<PipelineState> state;
    if (!acquired.session.checkpoint.empty()) {
      beginning.checkpoint = DecodeCheckpoint(acquired.session.checkpoint, 1).value();
      state = beginning.checkpoint.pipeline;
    }
    for (const PoseSegment& segment : acquired.session.poses) {
      const std::vector<StoredPose> poses = DecodePoses(segment, 1).value();
      beginning.poses.insert(beginning.poses.end(), poses.begin(), poses.end());
    }
    session_ = Start(std::move(beginning), std::move(acquired.lease), state, std::move(acquired.session.poses));
  }

  Attachment Attach(const std::string& token, uint64_t last_pose_seq = 0) {
    const Attachment attachment = session_->Attach(token, last_pose_seq, listener_).value();
    Until(attachment.stream, [](const StreamView& view) { return view.is_attached; });
    return attachment;
  }
  // Chunk number `seq`, with the events of [10 * seq, 10 * seq + 10) ms.
  void Push(uint64_t stream, uint64_t seq, int64_t chunk_ms = 10) {
    const auto begin_ms = chunk_ms * static_cast<int64_t>(seq);
    ASSERT_TRUE(
        session_->PushEvents(stream, {.seq = seq, .payload = Flat64(SomeEvents(begin_ms, begin_ms + chunk_ms))}).ok());
  }
  template <typename Predicate>
  void Until(uint64_t stream, Predicate is_true) {
    const auto waiting = std::make_shared<WaitingListener>();
    session_->AddWatcher(waiting);
    waiting->WaitUntil([&] { return is_true(session_->View(stream)); });
  }
  void UntilDurable(uint64_t stream, uint64_t seq) {
    Until(stream, [seq](const StreamView& view) { return view.ack.durable_seq >= seq; });
  }
  SessionCheckpoint Stored() { return DecodeCheckpoint(store_->ReadSession(kName)->checkpoint, 1).value(); }

  static constexpr char kName[] = "sessions/test";
  absl::Time now_ = absl::FromUnixSeconds(1'000'000);
  std::vector<std::string> objects_ = {"cube"};
  uint64_t pose_log_bytes_ = uint64_t{1} << 40;
  TrackerFactory make_tracker_ = FakeTrackers();
  const std::shared_ptr<InjectedFault> fault_ = std::make_shared<InjectedFault>();
  const std::shared_ptr<WaitingListener> listener_ = std::make_shared<WaitingListener>();
  WorkerPool pool_{1};  // outlives the store: its thread may release the last reference to a session
  const std::unique_ptr<Store> store_ = MakeMemoryStore();
  std::shared_ptr<Session> session_;
};

TEST_F(SessionCheckpointTest, DurableIsWhatWasCommitted) {
  const uint64_t stream = Attach("first").stream;
  Push(stream, 1);
  Push(stream, 2);
  Until(stream, [](const StreamView& view) { return view.ack.processed_seq == 2; });
  EXPECT_EQ(session_->View(stream).ack.durable_seq, 0u) << "no checkpoint is due yet";
  EXPECT_TRUE(store_->ReadSession(kName)->checkpoint.empty());
  session_->Detach(stream);
  UntilDurable(stream, 2);
  EXPECT_EQ(Stored().processed_seq, 2u);
  EXPECT_EQ(Stored().health.poses, 19u);
  EXPECT_EQ(store_->ReadSession(kName)->poses.back().last_pose_seq, 19u);
  const auto waiting = std::make_shared<WaitingListener>();
  session_->AddWatcher(waiting);
  session_->Flush();
  waiting->WaitUntil([this] { return session_->IsFlushed(); });
  EXPECT_EQ(DecodeLifecycle(store_->ReadSession(kName)->lifecycle)->detached_at, now_);
}

TEST_F(SessionCheckpointTest, ManyPosesMakeACheckpointDue) {
  const uint64_t stream = Attach("first").stream;
  for (uint64_t seq = 1; seq <= 60; ++seq) {
    Push(stream, seq, 40);
    session_->ReportSent(stream, 1'000'000);
  }
  UntilDurable(stream, 20);
  EXPECT_GE(Stored().health.poses, 1000u - 80);
}

// As FakeTracker, with the most alternatives that a pose can have.
class AmbiguousTracker : public FakeTracker {
 public:
  using FakeTracker::FakeTracker;
  void AddEvents(absl::Span<const Event> events, std::vector<PoseEstimate>& estimates) override {
    const size_t num_before = estimates.size();
    FakeTracker::AddEvents(events, estimates);
    for (size_t i = num_before; i < estimates.size(); ++i) {
      estimates[i].state = TrackState::kAmbiguous;
      for (size_t j = 0; j < PoseAlternatives::kMaxSize; ++j) estimates[i].alternatives.Add({});
    }
  }
};

class PoseLogBytesTest : public SessionCheckpointTest, public testing::WithParamInterface<bool> {
 protected:
  // Tracks chunks of 40 poses from `seq` on, until the session has made `num_poses`, in segments of 800 poses. Returns
  // the token for the next attachment.
  std::string TrackTo(std::string token, uint64_t num_poses, uint64_t& seq) {
    while (session_->Watch().last_pose_seq < num_poses) {
      const Attachment attachment = Attach(token);
      session_->ReportSent(attachment.stream, 1'000'000);
      for (int i = 0; i < 20; ++i) Push(attachment.stream, seq++, 40);
      session_->Detach(attachment.stream);
      UntilDurable(attachment.stream, seq - 1);
      token = attachment.resume_token;
    }
    return token;
  }
};

INSTANTIATE_TEST_SUITE_P(All, PoseLogBytesTest, testing::Bool());

TEST_P(PoseLogBytesTest, TheOldestPosesAreDeleted) {
  constexpr uint64_t kPoses = 13'000;
  const bool is_ambiguous = GetParam();
  pose_log_bytes_ = 4'400'000;
  if (is_ambiguous) {
    make_tracker_ = [](const SessionConfig& config, const auto&) -> absl::StatusOr<std::unique_ptr<Tracker>> {
      return std::make_unique<AmbiguousTracker>(std::make_shared<FakeTrackerGate>(), config);
    };
  }
  CreateAgain();
  uint64_t seq = 1;
  std::string token = TrackTo("first", kPoses, seq);
  for (const uint64_t num_poses : {kPoses, kPoses + 1000}) {
    const StoredSession stored = store_->ReadSession(kName).value();
    const uint64_t last = session_->Watch().last_pose_seq;
    const uint64_t num_stored = last + 1 - stored.poses.front().first_pose_seq;
    EXPECT_GE(last, num_poses);
    EXPECT_LE(SizeBytes(stored.poses), pose_log_bytes_);
    EXPECT_GE(SizeBytes(stored.poses), pose_log_bytes_ / 4 * 3) << "segments are deleted as a whole";
    EXPECT_EQ(stored.poses.front().first_pose_seq, session_->pose_log().first_pose_seq());
    EXPECT_EQ(stored.poses.back().last_pose_seq, last);
    EXPECT_GE(num_stored, SegmentSizes::kMinPoses);
    EXPECT_EQ(num_stored < 6000, is_ambiguous) << num_stored << " poses; four alternatives take more than a pose";
    if (num_poses > kPoses) continue;
    RestartServer();
    token = TrackTo(token, kPoses + 1000, seq);
  }
}

TEST_F(SessionCheckpointTest, TheEndIsAnsweredWhenItIsDurable) {
  const uint64_t stream = Attach("first").stream;
  Push(stream, 1);
  fault_->Set(absl::UnavailableError("unreachable"));
  ASSERT_TRUE(session_->PushEnd(stream).ok());
  const auto waiting = std::make_shared<WaitingListener>();
  session_->AddWatcher(waiting);
  waiting->WaitUntil([this] { return session_->Watch().has_ended && fault_->NumCalls() > 2; });
  EXPECT_FALSE(session_->View(stream).has_ended);
  fault_->Set(absl::OkStatus());
  Until(stream, [](const StreamView& view) { return view.has_ended; });
  EXPECT_TRUE(Stored().has_ended);
  EXPECT_EQ(Stored().health.poses, 10u);
  EXPECT_EQ(session_->View(stream).ack.durable_seq, 1u);
}

TEST_F(SessionCheckpointTest, AnAttachmentIsAnsweredWhenItsTokenIsDurable) {
  fault_->Set(absl::UnavailableError("unreachable"));
  const Attachment attachment = session_->Attach("first", 0, listener_).value();
  EXPECT_FALSE(session_->View(attachment.stream).is_attached);
  fault_->Set(absl::OkStatus());
  Until(attachment.stream, [](const StreamView& view) { return view.is_attached; });
  RestartServer();
  EXPECT_TRUE(session_->IsTokenValid(attachment.resume_token)) << "a token in a response has been persisted";
  EXPECT_TRUE(session_->IsTokenValid("first")) << "the client may not have received the new token";
  EXPECT_FALSE(session_->IsTokenValid("guess"));
  EXPECT_EQ(session_->resume_token(), "") << "the store has only the digest of the token";
}

TEST_F(SessionCheckpointTest, TheUseOfATokenIsPersisted) {
  const Attachment attachment = Attach("first");
  Push(attachment.stream, 1);
  session_->Detach(attachment.stream);
  UntilDurable(attachment.stream, 1);
  RestartServer();
  EXPECT_FALSE(session_->IsTokenValid("first")) << "the client has used the new token";
  EXPECT_TRUE(session_->IsTokenValid(attachment.resume_token));
  const Attachment again = Attach(attachment.resume_token);
  EXPECT_EQ(again.stream, attachment.stream + 1);
  EXPECT_EQ(again.next_seq, 2u);
  EXPECT_EQ(session_->Snapshot().health.reattaches, 1u);
}

TEST_F(SessionCheckpointTest, ARenewedTokenIsDurable) {
  std::promise<std::string> renewed_token;
  session_->RenewToken(
      [&renewed_token](absl::StatusOr<std::string> token) { renewed_token.set_value(*std::move(token)); });
  const std::string renewed = renewed_token.get_future().get();
  RestartServer();
  EXPECT_TRUE(session_->IsTokenValid(renewed));
  EXPECT_TRUE(session_->IsTokenValid("first")) << "until the new one is used";
  absl::Status refused;
  session_->Close(absl::NotFoundError("deleted"));
  session_->RenewToken([&refused](const absl::StatusOr<std::string>& token) { refused = token.status(); });
  EXPECT_EQ(refused.code(), absl::StatusCode::kNotFound);
}

TEST_F(SessionCheckpointTest, ContinuesFromItsCheckpointWithTheSamePoses) {
  constexpr uint64_t kChunks = 6;
  std::vector<std::string> poses;
  std::string summary;
  for (const uint64_t killed_after : {kChunks, uint64_t{1}, uint64_t{3}, uint64_t{5}}) {
    CreateAgain();
    Attachment attachment = Attach("first");
    uint64_t seen = 0;
    for (uint64_t seq = 1; seq <= kChunks; ++seq) {
      Push(attachment.stream, seq);
      if (seq != killed_after) continue;
      // Checkpoint here; two more chunks are tracked, and seen by the client, but not kept.
      session_->Detach(attachment.stream);
      UntilDurable(attachment.stream, seq);
      attachment = Attach(attachment.resume_token);
      fault_->Set(absl::UnavailableError("unreachable"));
      for (uint64_t more = seq + 1; more <= std::min(seq + 2, kChunks); ++more) Push(attachment.stream, more);
      Until(attachment.stream, [](const StreamView& view) { return view.is_idle; });
      seen = session_->Watch().last_pose_seq;
      RestartServer();
      attachment = Attach(attachment.resume_token, seen);
      EXPECT_EQ(attachment.next_seq, seq + 1);
      EXPECT_EQ(attachment.first_pose_seq, seen + 1) << "each pose once";
    }
    ASSERT_TRUE(session_->PushEnd(attachment.stream).ok());
    Until(attachment.stream, [](const StreamView& view) { return view.has_ended; });
    std::vector<StoredPose> all = session_->pose_log().Read(0, 1000);
    for (StoredPose& pose : all) pose.latency_us = 0;
    poses.push_back(EncodePoses(all).bytes);
    EXPECT_TRUE(poses.back() == poses.front()) << "killed after " << killed_after;
    EXPECT_EQ(session_->Snapshot().health.counts.cd_events, 180u);
    EXPECT_EQ(session_->Snapshot().health.received_bytes, 180u * 8);
  }
}

TEST_F(SessionCheckpointTest, AnEndedSessionIsRestoredAsEnded) {
  const Attachment attachment = Attach("first");
  Push(attachment.stream, 1);
  ASSERT_TRUE(session_->PushEnd(attachment.stream).ok());
  Until(attachment.stream, [](const StreamView& view) { return view.has_ended; });
  RestartServer();
  EXPECT_TRUE(session_->Watch().has_ended);
  EXPECT_EQ(session_->Snapshot().state, SessionState::kEnded);
  const uint64_t stream = Attach(attachment.resume_token).stream;
  ASSERT_TRUE(session_->PushEnd(stream).ok()) << "the summary can be requested again";
  EXPECT_TRUE(session_->View(stream).has_ended);
  EXPECT_EQ(GetErrorDetails(session_->PushEvents(stream, {.seq = 2})).reason, "SESSION_ENDED");
  EXPECT_EQ(session_->pose_log().last_pose_seq(), 10u);
}

TEST_F(SessionCheckpointTest, TheExpiryTimeCountsFromTheEndOfTheStream) {
  const Attachment attachment = Attach("first");
  session_->Detach(attachment.stream);
  const auto waiting = std::make_shared<WaitingListener>();
  session_->AddWatcher(waiting);
  session_->Flush();
  waiting->WaitUntil([this] { return session_->IsFlushed(); });
  const absl::Time left = now_;
  now_ += absl::Seconds(30);
  RestartServer();
  EXPECT_EQ(session_->expire_time(), left + absl::Minutes(1));
  (void)Attach(attachment.resume_token);
  now_ += absl::Seconds(30);
  RestartServer();
  EXPECT_EQ(session_->expire_time(), now_ + absl::Minutes(1)) << "the stream ended with the server";
}

TEST_F(SessionCheckpointTest, WaitsWhileTheStoreIsUnreachableAndLosesNothing) {
  const uint64_t stream = Attach("first").stream;
  session_->ReportSent(stream, 1'000'000);
  fault_->Set(absl::UnavailableError("unreachable"));
  uint64_t seq = 0;
  while (session_->Watch().last_pose_seq < kMaxUncommittedPoses) {
    Push(stream, ++seq, 40);
    const uint64_t pushed = seq;
    Until(stream, [&](const StreamView& view) {
      return view.ack.processed_seq == pushed || session_->Watch().last_pose_seq >= kMaxUncommittedPoses;
    });
  }
  const uint64_t stopped_at = session_->Watch().last_pose_seq;
  EXPECT_LT(stopped_at, kMaxUncommittedPoses + 100);
  Push(stream, ++seq, 40);
  const int before = fault_->NumCalls();
  const auto waiting = std::make_shared<WaitingListener>();
  session_->AddWatcher(waiting);
  waiting->WaitUntil([&] { return fault_->NumCalls() > before + 3; });
  EXPECT_EQ(session_->Watch().last_pose_seq, stopped_at) << "the session waits for the store";
  EXPECT_EQ(session_->View(stream).ack.durable_seq, 0u);
  fault_->Set(absl::OkStatus());
  session_->Detach(stream);
  UntilDurable(stream, seq);
  uint64_t expected = 1;
  const StoredSession stored = store_->ReadSession(kName).value();
  for (const PoseSegment& segment : stored.poses) {
    EXPECT_EQ(segment.first_pose_seq, expected);
    expected = segment.last_pose_seq + 1;
  }
  EXPECT_EQ(expected, session_->Watch().last_pose_seq + 1);
}

TEST_F(SessionCheckpointTest, NoPoseIsSentThatIsTooFarBeyondTheStore) {
  objects_ = {"1", "2", "3", "4", "5"};
  CreateAgain();
  const uint64_t stream = Attach("first").stream;
  fault_->Set(absl::UnavailableError("unreachable"));
  // One step of work, which makes more poses than may be sent.
  std::vector<Event> events;
  for (int64_t ms = 1; ms <= 2048; ++ms) events.push_back({ms * 1000, 1, 1, 0});
  ASSERT_TRUE(session_->PushEvents(stream, {.seq = 1, .payload = Flat64(events)}).ok());
  Until(stream, [](const StreamView& view) { return view.ack.processed_seq == 1; });
  EXPECT_EQ(session_->Watch().last_pose_seq, 2047u * 5);
  EXPECT_EQ(session_->View(stream).last_pose_seq, kMaxPosesBeyondStore);
  EXPECT_FALSE(session_->View(stream).is_idle) << "unsent poses are left";
  fault_->Set(absl::OkStatus());
  Until(stream, [](const StreamView& view) { return view.is_idle; });
  EXPECT_EQ(session_->View(stream).last_pose_seq, 2047u * 5);
}

TEST_F(SessionCheckpointTest, AClientMayHaveReceivedPosesBeyondTheCheckpoint) {
  const Attachment first = Attach("first");
  Push(first.stream, 1);
  session_->Detach(first.stream);
  UntilDurable(first.stream, 1);
  ASSERT_EQ(store_->ReadSession(kName)->poses.back().last_pose_seq, 9u);
  RestartServer();
  constexpr uint64_t kMost = 9 + kMaxPosesBeyondStore;
  for (const uint64_t beyond : {kMost + 1, uint64_t{1} << 50, UINT64_MAX}) {
    const absl::Status refused = session_->Attach(first.resume_token, beyond, listener_).status();
    EXPECT_EQ(refused.code(), absl::StatusCode::kInvalidArgument) << beyond;
    EXPECT_EQ(GetErrorDetails(refused).field, "attach.last_pose_seq");
    EXPECT_EQ(session_->Snapshot().state, SessionState::kDetached);
  }
  const Attachment second = Attach(first.resume_token, kMost);
  EXPECT_EQ(second.first_pose_seq, kMost + 1) << "the earlier poses are computed again, but not sent";
  const Attachment third = Attach(second.resume_token, 9);
  Push(third.stream, 2);
  Until(third.stream, [](const StreamView& view) { return view.is_idle; });
  EXPECT_EQ(session_->View(third.stream).last_pose_seq, 19u) << "the session is unchanged";
}

TEST_F(SessionCheckpointTest, EndsWhenAnotherServerHasTakenIt) {
  const uint64_t stream = Attach("first").stream;
  const auto acquired = store_->AcquireSession(kName).value();
  Push(stream, 1);
  Until(stream, [](const StreamView& view) { return !view.status.ok(); });
  EXPECT_EQ(session_->View(stream).status.code(), absl::StatusCode::kAborted);
  EXPECT_EQ(GetErrorDetails(session_->View(stream).status).reason, "FENCED");
}

TEST_F(SessionCheckpointTest, EndsWhenTheStoreIsFull) {
  const uint64_t stream = Attach("first").stream;
  fault_->Set(absl::ResourceExhaustedError("disk full"));
  Push(stream, 1);
  Until(stream, [](const StreamView& view) { return !view.status.ok(); });
  EXPECT_EQ(session_->View(stream).status.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(GetErrorDetails(session_->View(stream).status).reason, "STORE_FULL");
}

TEST_F(SessionCheckpointTest, AFlushStopsBeforeTheNextItemAndKeepsIt) {
  const uint64_t stream = Attach("first").stream;
  for (uint64_t seq = 1; seq <= 50; ++seq) Push(stream, seq);
  Until(stream, [](const StreamView& view) { return view.ack.processed_seq > 0; });
  const auto waiting = std::make_shared<WaitingListener>();
  session_->AddWatcher(waiting);
  session_->Flush();
  waiting->WaitUntil([this] { return session_->IsFlushed(); });
  EXPECT_EQ(session_->View(stream).ack.durable_seq, session_->View(stream).ack.processed_seq);
  EXPECT_EQ(Stored().processed_seq, session_->View(stream).ack.processed_seq);
}

}  // namespace
}  // namespace evpose::server
