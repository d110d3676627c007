// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <semaphore>

#include "core/base/byte_order.h"
#include "core/numerics/hash.h"
#include "server/runtime/errors.h"
#include "server/sessions/session_testing.h"
#include "server/stores/memory/memory_store.h"

namespace evpose::server {
namespace {

class SessionTest : public testing::Test {
 protected:
  SessionTest() {
    SessionParts parts;
    parts.name = "sessions/test";
    parts.config = SomeConfig({"cube", "box"});
    parts.limits = {.credit_bytes = 4096,
                    .max_chunk_bytes = 1024,
                    .pose_log_capacity = 100'000,
                    .expiry = absl::Minutes(1),
                    .writes_checkpoints = false};
    parts.model_uses.push_back(model_use_);
    parts.pipeline = SessionPipeline::Create(parts.config, {nullptr, nullptr}, FakeTrackers(gate_)).value();
    parts.resume_token = "first";
    parts.create_time = now_;
    parts.clocks.wall = [this] { return now_; };
    parts.beginning.lifecycle = {.token_digest = TokenDigest("first"), .detached_at = now_};
    parts.lease = store_->CreateSession({.name = parts.name}, "").value();
    session_ = Session::Start(std::move(parts), pool_);
  }
  ~SessionTest() override {
    gate_->Open();
    pool_.Join();
  }

  Attachment Attach(const std::string& token = "first") { return session_->Attach(token, 0, listener_).value(); }

  absl::Status Push(uint64_t stream, uint64_t seq, const std::vector<Event>& events) {
    return session_->PushEvents(stream, {.seq = seq, .payload = Flat64(events)});
  }
  void WaitUntilIdle(uint64_t stream) {
    listener_->WaitUntil([&] { return session_->View(stream).is_idle; });
  }
  // Returns when all work that was posted before is done: the pool has one thread, which processes the oldest work
  // first.
  void PassThroughPool() {
    std::binary_semaphore done(0);
    pool_.AddSession("")->Post([&done] { done.release(); }, std::chrono::steady_clock::now());
    done.acquire();
  }

  absl::Time now_ = absl::UnixEpoch();
  const std::shared_ptr<const int> model_use_ = std::make_shared<const int>(1);
  const std::shared_ptr<FakeTrackerGate> gate_ = std::make_shared<FakeTrackerGate>();
  const std::shared_ptr<WaitingListener> listener_ = std::make_shared<WaitingListener>();
  WorkerPool pool_{1};  // outlives the store: its thread may release the last reference to a session
  const std::unique_ptr<Store> store_ = MakeMemoryStore();
  std::shared_ptr<Session> session_;
};

TEST_F(SessionTest, TracksThePushedEventsAndEnds) {
  const Attachment attachment = Attach();
  EXPECT_EQ(attachment.next_seq, 1u);
  EXPECT_EQ(attachment.first_pose_seq, 1u);
  EXPECT_EQ(attachment.send_limit_bytes, 4096u);
  const uint64_t stream = attachment.stream;
  ASSERT_TRUE(Push(stream, 1, SomeEvents(1, 11)).ok());
  ASSERT_TRUE(Push(stream, 2, SomeEvents(11, 21)).ok());
  ASSERT_TRUE(session_->PushEnd(stream).ok());
  listener_->WaitUntil([&] { return session_->View(stream).has_ended; });

  const auto poses = session_->pose_log().Read(0, 1000);
  ASSERT_EQ(poses.size(), 40u) << "one per millisecond and object";
  EXPECT_EQ(poses[0].object_index, 0u);
  EXPECT_EQ(poses[1].object_index, 1u);
  EXPECT_EQ(poses[39].pose_seq, 40u);
  const SessionSnapshot snapshot = session_->Snapshot();
  EXPECT_EQ(snapshot.state, SessionState::kEnded);
  EXPECT_EQ(snapshot.health.poses, 40u);
  EXPECT_EQ(snapshot.health.counts.cd_events, 60u);
  EXPECT_EQ(snapshot.health.received_bytes, 480u);
  EXPECT_EQ(snapshot.health.processed_bytes, 480u);
  EXPECT_EQ(snapshot.health.objects[0].explained_ratio, 0.75f);
  EXPECT_EQ(snapshot.health.objects[0].initialization.status, InitializationStatus::kNotNeeded);
  const StreamView view = session_->View(stream);
  EXPECT_EQ(view.ack.processed_seq, 2u);
  EXPECT_EQ(view.ack.send_limit_bytes, 4096u + 480u);
  EXPECT_EQ(view.ack.last_pose_seq, 40u);
}

TEST_F(SessionTest, OnlyARepeatedEndFollowsTheEnd) {
  const uint64_t stream = Attach().stream;
  ASSERT_TRUE(session_->PushEnd(stream).ok());
  EXPECT_TRUE(session_->PushEnd(stream).ok());
  const absl::Status events = Push(stream, 1, SomeEvents(1, 2));
  EXPECT_EQ(events.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(GetErrorDetails(events).reason, "SESSION_ENDED");
  EXPECT_EQ(GetErrorDetails(session_->PushResetPose(stream, 1, "cube", RigidTransform())).reason, "SESSION_ENDED");
}

TEST_F(SessionTest, RepeatedChunksAreIgnoredAndGapsRefused) {
  const uint64_t stream = Attach().stream;
  ASSERT_TRUE(Push(stream, 1, SomeEvents(1, 3)).ok());
  ASSERT_TRUE(Push(stream, 1, SomeEvents(7, 9)).ok());
  WaitUntilIdle(stream);
  EXPECT_EQ(session_->Snapshot().health.counts.cd_events, 6u);
  EXPECT_EQ(session_->Snapshot().health.received_bytes, 48u);
  EXPECT_EQ(session_->View(stream).ack.send_limit_bytes, 4096u + 96u) << "both were taken from the stream";

  const absl::Status gap = Push(stream, 3, SomeEvents(3, 4));
  EXPECT_EQ(gap.code(), absl::StatusCode::kFailedPrecondition);
  const ErrorDetails details = GetErrorDetails(gap);
  EXPECT_EQ(details.reason, "SEQ_GAP");
  EXPECT_THAT(details.metadata, testing::ElementsAre(testing::Pair("expected_seq", "2"), testing::Pair("seq", "3")));
  EXPECT_TRUE(Push(stream, 2, SomeEvents(3, 4)).ok()) << "the session continues";
}

TEST_F(SessionTest, RefusesInvalidChunks) {
  const uint64_t stream = Attach().stream;
  EXPECT_EQ(GetErrorDetails(Push(stream, 0, SomeEvents(1, 2))).field, "events.seq");
  EXPECT_EQ(GetErrorDetails(session_->PushEvents(stream, {.seq = 1, .payload = "1234567"})).field, "events.payload");
  EXPECT_EQ(GetErrorDetails(session_->PushEvents(stream, {.seq = 1, .payload = std::string(1032, '\0')})).field,
            "events.payload");
  const absl::Status broken = session_->PushEvents(stream, {.seq = 1, .crc32c = 1, .payload = Flat64({{1, 2, 3, 0}})});
  EXPECT_EQ(broken.code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(GetErrorDetails(broken).metadata, testing::ElementsAre(testing::Pair("seq", "1")));
  EXPECT_EQ(GetErrorDetails(session_->PushResetPose(stream, 1, "cone", RigidTransform())).field,
            "reset_pose.object_id");
  EXPECT_EQ(GetErrorDetails(session_->PushResetPose(stream, 0, "cube", RigidTransform())).field, "reset_pose.seq");

  const std::string payload = Flat64(SomeEvents(1, 2));
  const uint32_t crc = Crc32c(AsBytes(payload));
  EXPECT_TRUE(session_->PushEvents(stream, {.seq = 1, .crc32c = crc, .payload = payload}).ok());
}

TEST_F(SessionTest, EachAttachIssuesATokenAndThePreviousOneIsValidUntilItsUse) {
  const Attachment first = Attach();
  EXPECT_NE(first.resume_token, "first");
  // The response was lost: the client has the old token only.
  const Attachment second = Attach("first");
  ASSERT_TRUE(Push(second.stream, 1, SomeEvents(1, 2)).ok());
  const auto stale = session_->Attach("first", 0, listener_);
  EXPECT_EQ(stale.status().code(), absl::StatusCode::kPermissionDenied);
  EXPECT_EQ(GetErrorDetails(stale.status()).reason, "WRONG_TOKEN");
  EXPECT_FALSE(session_->Attach(first.resume_token, 0, listener_).ok()) << "a token that was never used is replaced";
  EXPECT_TRUE(session_->Attach(second.resume_token, 0, listener_).ok());
  EXPECT_EQ(session_->Snapshot().health.reattaches, 2u);
}

TEST_F(SessionTest, ALaterStreamFencesTheOlderOneAndContinuesItsPosition) {
  const Attachment first = Attach();
  ASSERT_TRUE(Push(first.stream, 1, SomeEvents(1, 5)).ok());
  WaitUntilIdle(first.stream);
  gate_->Close();
  ASSERT_TRUE(Push(first.stream, 2, SomeEvents(5, 7)).ok());
  const Attachment second = session_->Attach(first.resume_token, 1, listener_).value();
  EXPECT_EQ(second.next_seq, 3u) << "received chunks are not sent again";
  EXPECT_EQ(second.first_pose_seq, 2u);
  EXPECT_EQ(second.send_limit_bytes, 4096u - 48u) << "the older stream's chunk still waits";
  EXPECT_EQ(GetErrorDetails(session_->View(first.stream).status).reason, "FENCED");
  EXPECT_EQ(Push(first.stream, 3, SomeEvents(7, 8)).code(), absl::StatusCode::kAborted);
  EXPECT_EQ(session_->PushEnd(first.stream).code(), absl::StatusCode::kAborted);
  session_->Detach(first.stream);
  EXPECT_EQ(session_->Snapshot().state, SessionState::kAttached)
      << "the end of a fenced stream does not detach the new one";
  gate_->Open();
  WaitUntilIdle(second.stream);
  EXPECT_EQ(session_->View(second.stream).ack.send_limit_bytes, 4096u);
  EXPECT_EQ(session_->Snapshot().health.counts.cd_events, 18u);
}

TEST_F(SessionTest, RefusesTheNumberOfAFuturePose) {
  const auto attachment = session_->Attach("first", 7, listener_);
  EXPECT_EQ(GetErrorDetails(attachment.status()).field, "attach.last_pose_seq");
}

TEST_F(SessionTest, HasNoRoomWhileItsCreditWaits) {
  const uint64_t stream = Attach().stream;
  gate_->Close();
  uint64_t seq = 0;
  while (session_->View(stream).has_room) {
    ++seq;
    const auto begin_ms = static_cast<int64_t>(40 * seq);
    ASSERT_TRUE(Push(stream, seq, SomeEvents(begin_ms, begin_ms + 40)).ok());
  }
  EXPECT_EQ(seq, 5u) << "960 bytes each, 4096 in all";
  EXPECT_EQ(session_->View(stream).ack.send_limit_bytes, 4096u);
  gate_->Open();
  WaitUntilIdle(stream);
  EXPECT_TRUE(session_->View(stream).has_room);
  EXPECT_EQ(session_->View(stream).ack.send_limit_bytes, 4096u + 5 * 960u);
}

TEST_F(SessionTest, WaitsOnlyForAReaderThatIsFarBehind) {
  const Attachment attachment = Attach();
  uint64_t seq = 0;
  for (int64_t ms = 1; ms < 1200; ms += 40) {
    ASSERT_TRUE(Push(attachment.stream, ++seq, SomeEvents(ms, std::min<int64_t>(ms + 40, 1201))).ok());
  }
  for (int i = 0; i < 100; ++i) PassThroughPool();
  const uint64_t poses = session_->Watch().last_pose_seq;
  EXPECT_GT(poses, kMaxUnsentPoses);
  EXPECT_LT(poses, kMaxUnsentPoses + 100) << "at most one chunk more";
  EXPECT_FALSE(session_->View(attachment.stream).is_idle);

  session_->ReportSent(attachment.stream, 100);
  for (int i = 0; i < 100; ++i) PassThroughPool();
  EXPECT_GT(session_->Watch().last_pose_seq, poses);
  EXPECT_FALSE(session_->View(attachment.stream).is_idle);

  session_->Detach(attachment.stream);
  for (int i = 0; i < 100; ++i) PassThroughPool();
  EXPECT_TRUE(session_->View(attachment.stream).is_idle);
  EXPECT_EQ(session_->Watch().last_pose_seq, 2 * 1199u) << "two objects; the last window is open";
}

TEST_F(SessionTest, ReportsChangesAndFaultsInOrder) {
  const uint64_t stream = Attach().stream;
  std::vector<Event> events = SomeEvents(1, 4);
  events.push_back({4100, 0, 0, 1});      // loses the object
  events.push_back({4200, 4000, 10, 1});  // outside the sensor
  events.push_back({5100, 1, 1, 1});
  ASSERT_TRUE(Push(stream, 1, events).ok());
  WaitUntilIdle(stream);
  const std::vector<SessionNotice> notices = session_->TakeNotices(stream);
  ASSERT_EQ(notices.size(), 3u);
  for (uint32_t object = 0; object < 2; ++object) {
    const auto& change = std::get<StateChange>(notices[object].what);
    EXPECT_EQ(change.object_index, object);
    EXPECT_EQ(change.state, TrackState::kLost);
    EXPECT_EQ(change.t_us, 5000);
    EXPECT_EQ(notices[object].after_pose_seq, 6u);
  }
  const auto& fault = std::get<DecodeFault>(notices[2].what);
  EXPECT_EQ(fault.seq, 1u);
  EXPECT_EQ(fault.count, 1u);
  EXPECT_THAT(fault.detail, testing::HasSubstr("1 events outside the sensor"));
  EXPECT_TRUE(session_->TakeNotices(stream).empty());
  EXPECT_EQ(session_->Snapshot().health.objects[1].losses, 1u);
}

TEST_F(SessionTest, ResetsAPoseInTheOrderOfTheStream) {
  const uint64_t stream = Attach().stream;
  ASSERT_TRUE(Push(stream, 1, {{1100, 0, 0, 1}, {2100, 5, 5, 1}}).ok());
  ASSERT_TRUE(session_->PushResetPose(stream, 2, "box", RigidTransform()).ok());
  ASSERT_TRUE(session_->PushResetPose(stream, 2, "cube", RigidTransform()).ok()) << "a repeated one is ignored";
  EXPECT_EQ(GetErrorDetails(session_->PushResetPose(stream, 4, "cube", RigidTransform())).reason, "SEQ_GAP");
  ASSERT_TRUE(Push(stream, 3, {{3100, 5, 5, 1}, {4100, 5, 5, 1}, {5100, 5, 5, 1}, {6100, 5, 5, 1}}).ok());
  WaitUntilIdle(stream);
  const auto poses = session_->pose_log().Read(0, 10);
  ASSERT_EQ(poses.size(), 4u) << "the open window is the first";
  for (const StoredPose& pose : poses) EXPECT_EQ(pose.object_index, 1u);
  EXPECT_EQ(poses[0].estimate.t_us, 2500);
  EXPECT_EQ(session_->View(stream).ack.processed_seq, 3u);
  EXPECT_EQ(session_->Snapshot().health.objects[0].state, TrackState::kLost);
  EXPECT_EQ(session_->Snapshot().health.objects[0].initialization.status, InitializationStatus::kTooFewLines);
  EXPECT_EQ(session_->Snapshot().health.objects[1].state, TrackState::kTracking);
}

TEST_F(SessionTest, ExpiresOnlyWhileNoStreamIsAttached) {
  EXPECT_EQ(session_->expire_time(), absl::UnixEpoch() + absl::Minutes(1));
  const uint64_t stream = Attach().stream;
  EXPECT_EQ(session_->expire_time(), std::nullopt);
  now_ += absl::Hours(1);
  session_->Detach(stream);
  EXPECT_EQ(session_->expire_time(), now_ + absl::Minutes(1));
}

TEST_F(SessionTest, ClosingEndsItForEveryone) {
  const Attachment attachment = Attach();
  gate_->Close();
  ASSERT_TRUE(Push(attachment.stream, 1, SomeEvents(1, 3)).ok());
  EXPECT_EQ(model_use_.use_count(), 2);
  session_->Close(absl::NotFoundError("deleted"));
  session_->Close(absl::UnavailableError("too late"));
  EXPECT_EQ(model_use_.use_count(), 1) << "its models may be deleted at once";
  EXPECT_EQ(session_->View(attachment.stream).status.code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(session_->Watch().status.code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(Push(attachment.stream, 2, SomeEvents(3, 4)).code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(session_->Attach(attachment.resume_token, 0, listener_).status().code(), absl::StatusCode::kNotFound);
}

}  // namespace
}  // namespace evpose::server
