// SPDX-License-Identifier: Apache-2.0

// Sessions that outlive the server that created them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <utility>

#include "server/runtime/slow_work_beside_testing.h"
#include "server/sessions/session_restore_testing.h"
#include "server/telemetry/log_testing.h"

namespace evpose::server {
namespace {

class SessionRestoreTest : public SharedStoreTest {};

TEST_F(SessionRestoreTest, ARestoredSessionIsChargedEvenBeyondTheLimit) {
  Server server = Open();
  const auto session = Create(server);
  const std::string name = session->name();
  Track(session, Attach(session, session->resume_token()), 1);
  const uint64_t bytes = memory_->charged_bytes();
  EXPECT_GT(bytes, 0u);
  Kill(server);

  memory_ = MemoryBudget::Create({.max_bytes = bytes / 2});
  server = Open();
  EXPECT_TRUE(server->Get(kTenant, name).ok());
  EXPECT_EQ(memory_->charged_bytes(), bytes);
  EXPECT_EQ(ReasonOf(server->Create(kTenant, Config(server), "").status()), "SESSION_MEMORY");
}

TEST_F(SessionRestoreTest, SessionsAreRestoredCompletely) {
  Server server = Open();
  const auto session = Create(server, "request");
  const std::string name = session->name();
  const Attachment attachment = Attach(session, session->resume_token());
  Track(session, attachment, 1);
  const SessionHealth before = session->Snapshot().health;
  Kill(server);

  server = Open();
  const auto restored = server->Get(kTenant, name).value();
  EXPECT_NE(restored, session);
  EXPECT_EQ(restored->create_time(), now_);
  EXPECT_TRUE(restored->config() == Config(server));
  const SessionHealth after = restored->Snapshot().health;
  EXPECT_EQ(after.poses, before.poses);
  EXPECT_EQ(after.counts, before.counts);
  EXPECT_EQ(after.processed_bytes, before.processed_bytes);
  EXPECT_EQ(restored->pose_log().last_pose_seq(), before.poses);
  EXPECT_EQ(Create(server, "request"), restored) << "the request is still known";
  SessionConfig other = Config(server);
  other.camera.fx_px = 301;
  EXPECT_EQ(ReasonOf(server->Create(kTenant, other, "request").status()), "REQUEST_ID_REUSED");

  const auto found = server->FindForAttach(kTenant, name, attachment.resume_token);
  ASSERT_EQ(found, restored);
  const Attachment again = Attach(found, attachment.resume_token);
  EXPECT_EQ(again.next_seq, 2u);
  Track(found, again, 2);
  EXPECT_EQ(found->Snapshot().health.poses, 19u) << "one for each millisecond, but for the last, which is open";
}

TEST_F(SessionRestoreTest, AClientMayHaveReceivedPosesBeforeTheFirstCheckpoint) {
  Server server = Open();
  const auto session = Create(server);
  const Attachment attachment = Attach(session, session->resume_token());
  EXPECT_FALSE(session->Attach(session->resume_token(), 143, listener_).ok()) << "no pose has been computed";
  Kill(server);
  server = Open();
  const auto restored = server->Get(kTenant, session->name()).value();
  const auto again = restored->Attach(attachment.resume_token, 143, listener_);
  ASSERT_TRUE(again.ok()) << again.status();
  EXPECT_EQ(again->next_seq, 1u);
  EXPECT_EQ(again->first_pose_seq, 144u) << "the first 143 are computed again, but not sent";
  Kill(server);
}

TEST_F(SessionRestoreTest, DamagedSessionsAreSkippedAndReported) {
  const std::string name = "sessions/damaged";
  ASSERT_TRUE(store_->CreateSession({.name = name, .config = "no configuration"}, "").ok());
  Server server = Open();
  EXPECT_EQ(ReasonOf(server->Get(kTenant, name).status()), "SESSION_NOT_FOUND");
  for (const absl::Status& status :
       {server->Describe(kTenant, name).status(), server->ResumeForAttach(kTenant, name, "token").status()}) {
    EXPECT_EQ(status.code(), absl::StatusCode::kDataLoss);
    EXPECT_EQ(ReasonOf(status), "SESSION_DAMAGED");
    EXPECT_THAT(std::string(status.message()), testing::HasSubstr("configuration"));
  }
  EXPECT_TRUE(server->Delete(kTenant, name).ok());
  EXPECT_EQ(ReasonOf(server->Describe(kTenant, name).status()), "SESSION_NOT_FOUND");
}

TEST_F(SessionRestoreTest, ATrackersStateOfAnotherVersionLeadsToANewSearch) {
  Server server = Open();
  const auto session = Create(server);
  const std::string name = session->name();
  const Attachment attachment = Attach(session, session->resume_token());
  Track(session, attachment, 1);
  const SessionHealth before = session->Snapshot().health;
  ASSERT_GT(before.poses, 0u);
  Kill(server);
  MakeTrackerStateUnreadable(name);

  captured_log.Take();
  server = Open();
  const auto restored = server->Get(kTenant, name).value();
  EXPECT_EQ(restored->ReadPoses(0, 100).size(), before.poses);
  EXPECT_EQ(restored->Snapshot().health.counts, before.counts);
  EXPECT_THAT(captured_log.Take(),
              testing::AllOf(testing::HasSubstr("tracker_state_unreadable"), testing::HasSubstr("version 1000000"),
                             testing::HasSubstr("next_chunk")));
  // The writer has poses that were not stored. It receives those that have their numbers.
  const Attachment again = Attach(restored, attachment.resume_token, before.poses + 5);
  EXPECT_EQ(again.first_pose_seq, before.poses + 1);
  EXPECT_EQ(again.next_seq, 2u);
  const std::vector<SessionNotice> notices = restored->TakeNotices(again.stream);
  ASSERT_EQ(notices.size(), 1u);
  EXPECT_EQ(std::get<TrackingRestarted>(notices[0].what).after_seq, 1u);
  EXPECT_EQ(std::get<TrackingRestarted>(notices[0].what).after_pose_seq, before.poses);

  // The tracker starts without a pose, and the numbers of its poses continue.
  ASSERT_TRUE(restored->PushEvents(again.stream, {.seq = 2, .payload = Flat64(SomeEvents(20, 30))}).ok());
  Until(restored, [&] { return restored->View(again.stream).ack.processed_seq == 2; });
  EXPECT_EQ(restored->Snapshot().health.objects[0].state, TrackState::kInitializing);
  EXPECT_EQ(restored->Snapshot().health.poses, before.poses);
  ASSERT_TRUE(restored->PushResetPose(again.stream, 3, "cube", RigidTransform()).ok());
  Track(restored, again, 4);
  const std::vector<StoredPose> poses = restored->ReadPoses(before.poses, 100);
  ASSERT_FALSE(poses.empty());
  EXPECT_EQ(poses.front().pose_seq, before.poses + 1);
  Kill(server);
  server = Open();
  EXPECT_EQ(server->Get(kTenant, name).value()->ReadPoses(before.poses, 100).size(), poses.size())
      << "the later checkpoint is readable";
  Kill(server);
}

TEST_F(SessionRestoreTest, ASessionWhoseModelIsGoneIsDamaged) {
  Server server = Open();
  const auto session = Create(server);
  Kill(server);
  const std::string model = session->config().objects[0].model;
  ASSERT_TRUE(store_->DeleteModel(kTenant, model).ok());
  server = Open();
  const absl::Status status = server->ResumeForAttach(kTenant, session->name(), session->resume_token()).status();
  EXPECT_EQ(ReasonOf(status), "SESSION_DAMAGED");
  EXPECT_THAT(std::string(status.message()), testing::HasSubstr(model));
}

TEST_F(SessionRestoreTest, AModelThatCannotBeLoadedDoesNotKeepTheServerFromStarting) {
  const auto bytes = std::make_shared<const std::vector<uint8_t>>(3, 'x');
  ASSERT_TRUE(store_->PutModel({.name = "models/broken", .bytes = bytes}).ok());
  Server server = Open();
  EXPECT_FALSE(server.models->UseStored(kTenant, "models/broken").ok());
  (void)Create(server);
}

TEST_F(SessionRestoreTest, ASessionThatHasEndedUsesItsModelAfterARestartToo) {
  Server server = Open();
  const auto session = Create(server);
  const std::string model = session->config().objects[0].model;
  const Attachment attachment = Attach(session, session->resume_token());
  ASSERT_TRUE(session->PushEnd(attachment.stream).ok());
  Until(session, [&] { return session->View(attachment.stream).has_ended; });
  EXPECT_EQ(ReasonOf(server.models->Delete(kTenant, model)), "MODEL_IN_USE");
  Kill(server);
  server = Open();
  EXPECT_TRUE(server->Get(kTenant, session->name()).value()->Watch().has_ended);
  EXPECT_EQ(ReasonOf(server.models->Delete(kTenant, model)), "MODEL_IN_USE");
  Kill(server);
  ASSERT_TRUE(store_->DeleteModel(kTenant, model).ok());
  server = Open();
  EXPECT_TRUE(server->Get(kTenant, session->name()).ok()) << "its poses can be read without it";
  Kill(server);
}

// A session is only in the store, for example, after it was closed because the store was full: its client may
// reconnect, and its user may list the sessions to delete some.
TEST_F(SessionRestoreTest, ASessionThatIsOnlyInTheStoreIsListedKeepsItsModelsAndExpires) {
  Server server = Open();
  const auto session = Create(server);
  const std::string name = session->name();
  const std::string model = session->config().objects[0].model;
  session->Close(absl::ResourceExhaustedError("no room"));
  const auto sessions = server->List(kTenant, "", 10);
  ASSERT_TRUE(sessions.ok());
  ASSERT_EQ(sessions->size(), 1u);
  EXPECT_EQ(sessions->front().name, name);
  EXPECT_EQ(server->num_sessions(), 0u) << "the session is not in memory";
  EXPECT_EQ(ReasonOf(server.models->Delete(kTenant, model)), "MODEL_IN_USE");
  const auto maintain = [&](int times) {
    for (int i = 0; i < times; ++i) {
      now_ += absl::Seconds(30);
      server->MaintainStore();
      AwaitSlowWork();
    }
  };
  maintain(2);
  EXPECT_TRUE(store_->ReadSession(name).ok());
  maintain(1);
  EXPECT_TRUE(absl::IsNotFound(store_->ReadSession(name).status()));
  EXPECT_TRUE(server.models->Delete(kTenant, model).ok());
  Kill(server);
}

TEST_F(SessionRestoreTest, ASessionWithoutAFreeSlotIsNotResumed) {
  Server one = Open(/*shares_store=*/true);
  const auto session = Create(one);
  Server two = Open(/*shares_store=*/true);
  for (int i = 0; i < 3; ++i) (void)Create(two);
  const auto resume = [&] {
    return ReasonOf(two->ResumeForAttach(kTenant, session->name(), session->resume_token()).status());
  };
  EXPECT_EQ(resume(), "TENANT_QUOTA");
  two.models->Upload("lab", {}, "", CubeBytes()).value();
  ASSERT_TRUE(two->Create("lab", Config(two), "").ok());
  EXPECT_EQ(resume(), "TOO_MANY_SESSIONS");
  EXPECT_TRUE(session->Watch().status.ok());
  Kill(one);
  Kill(two);
}

// A store that lets a test act while a session is acquired or deleted, or after the session of a request has been
// found.
class StoreWithHooks : public FaultInjectingStore {
 public:
  using FaultInjectingStore::FaultInjectingStore;
  absl::StatusOr<AcquiredSession> AcquireSession(absl::string_view name) override {
    if (while_acquiring) std::exchange(while_acquiring, nullptr)();
    return FaultInjectingStore::AcquireSession(name);
  }
  absl::StatusOr<SessionRecord> FindRequest(absl::string_view tenant, absl::string_view request_id) const override {
    auto record = FaultInjectingStore::FindRequest(tenant, request_id);
    if (after_finding) std::exchange(after_finding, nullptr)();
    return record;
  }
  absl::Status DeleteSession(absl::string_view name) override {
    if (while_deleting) std::exchange(while_deleting, nullptr)();
    return FaultInjectingStore::DeleteSession(name);
  }
  std::function<void()> while_acquiring, while_deleting;
  mutable std::function<void()> after_finding;
};

TEST_F(SessionRestoreTest, ASessionThatIsBeingResumedHasItsSlot) {
  Server one = Open(/*shares_store=*/true);
  const auto first = Create(one);
  one.models->Upload("lab", {}, "", CubeBytes()).value();
  const auto second = one->Create("lab", Config(one), "").value();
  StoreWithHooks store(store_, std::make_shared<InjectedFault>());
  Server two = Open(/*shares_store=*/true, store, /*max_sessions=*/1);
  const auto resume = [&](const std::string& tenant, const std::shared_ptr<Session>& session) {
    return two->ResumeForAttach(tenant, session->name(), session->resume_token()).status();
  };
  store.while_acquiring = [&] { EXPECT_EQ(ReasonOf(resume("lab", second)), "TOO_MANY_SESSIONS"); };
  EXPECT_TRUE(resume(kTenant, first).ok());
  EXPECT_EQ(two->num_sessions(), 1u);
  // If a session cannot be acquired from the store, its slot becomes free.
  ASSERT_TRUE(two->Delete(kTenant, first->name()).ok());
  store.while_acquiring = [&] { EXPECT_TRUE(store_->DeleteSession(second->name()).ok()); };
  EXPECT_EQ(ReasonOf(resume("lab", second)), "SESSION_NOT_FOUND");
  EXPECT_TRUE(two->Create(kTenant, Config(two), "").ok());
  Kill(one);
  Kill(two);
}

TEST_F(SessionRestoreTest, SessionsOfATenantAreResumedAtTheSameTime) {
  Server one = Open(/*shares_store=*/true);
  const auto first = Create(one);
  const auto second = Create(one);
  StoreWithHooks store(store_, std::make_shared<InjectedFault>());
  Server two = Open(/*shares_store=*/true, store);
  const auto resume = [&](const std::shared_ptr<Session>& session) {
    return two->ResumeForAttach(kTenant, session->name(), session->resume_token()).value();
  };
  // A mutex of the tenant would be locked twice.
  store.while_acquiring = [&] { EXPECT_EQ(resume(second)->name(), second->name()); };
  EXPECT_EQ(resume(first)->name(), first->name());
  EXPECT_EQ(two->num_sessions(), 2u);
  Kill(one);
  Kill(two);
}

TEST_F(SessionRestoreTest, ASessionIsResumedOnceByStreamsThatAttachAtTheSameTime) {
  Server one = Open(/*shares_store=*/true);
  const auto session = Create(one);
  StoreWithHooks store(store_, std::make_shared<InjectedFault>());
  Server two = Open(/*shares_store=*/true, store);
  const auto resume = [&] { return two->ResumeForAttach(kTenant, session->name(), session->resume_token()).value(); };
  std::shared_ptr<Session> other;
  SlowWorkBeside stream;
  store.while_acquiring = [&] { stream.BeginUntilItWaits([&] { other = resume(); }); };
  const auto acquired = resume();
  stream.Join();
  EXPECT_EQ(other, acquired);
  EXPECT_TRUE(acquired->Watch().status.ok());
  Kill(one);
  Kill(two);
}

TEST_F(SessionRestoreTest, AStreamThatWaitedForASessionEndsWithItsCallAndWithTheServer) {
  Server one = Open(/*shares_store=*/true);
  const auto session = Create(one);
  // Returns the status of a stream that waits while another one resumes the session, and after `meanwhile`.
  const auto status_after = [&](const std::function<void(Server&, Cancellation&)>& meanwhile) {
    StoreWithHooks store(store_, std::make_shared<InjectedFault>());
    Server two = Open(/*shares_store=*/true, store);
    const auto resume = [&] {
      return two->ResumeForAttach(kTenant, session->name(), session->resume_token()).status();
    };
    absl::Status waited;
    SlowWorkBeside stream;
    const auto cancellation = std::make_shared<Cancellation>();
    store.while_acquiring = [&] {
      stream.BeginUntilItWaits([&] { waited = resume(); }, cancellation);
      meanwhile(two, *cancellation);
    };
    EXPECT_TRUE(resume().ok());
    stream.Join();
    Kill(two);
    return waited;
  };
  const auto nothing = [](Server&, Cancellation&) {};
  EXPECT_TRUE(status_after(nothing).ok());
  EXPECT_TRUE(absl::IsCancelled(status_after([](Server&, Cancellation& call) { call.Cancel(); })));
  EXPECT_EQ(ReasonOf(status_after([](Server& server, Cancellation&) { server->Drain(); })), "DRAINING");
  Kill(one);
}

TEST_F(SessionRestoreTest, ARepeatedRequestFindsTheSessionThatAStreamHasResumedMeanwhile) {
  Server one = Open(/*shares_store=*/true);
  const auto session = Create(one, "request");
  StoreWithHooks store(store_, std::make_shared<InjectedFault>());
  Server two = Open(/*shares_store=*/true, store);
  std::shared_ptr<Session> acquired;
  store.after_finding = [&] {
    acquired = two->ResumeForAttach(kTenant, session->name(), session->resume_token()).value();
  };
  EXPECT_EQ(Create(two, "request"), acquired);
  EXPECT_TRUE(acquired->Watch().status.ok());
  EXPECT_EQ(two->num_sessions(), 1u);
  Kill(one);
  Kill(two);
}

TEST_F(SessionRestoreTest, AStreamThatAttachesDuringADeletionFindsNoSession) {
  StoreWithHooks store(store_, std::make_shared<InjectedFault>());
  Server server = Open(/*shares_store=*/true, store);
  const auto session = Create(server);
  SlowWorkBeside stream;
  absl::Status attached;
  store.while_deleting = [&] {
    stream.BeginUntilItWaits(
        [&] { attached = server->ResumeForAttach(kTenant, session->name(), session->resume_token()).status(); });
  };
  EXPECT_TRUE(server->Delete(kTenant, session->name()).ok());
  stream.Join();
  EXPECT_EQ(ReasonOf(attached), "SESSION_NOT_FOUND") << attached;
  EXPECT_EQ(server->num_sessions(), 0u);
  Kill(server);
}

TEST_F(SessionRestoreTest, FlushAllWaitsUntilEverythingIsDurable) {
  Server server = Open();
  const auto session = Create(server);
  const Attachment attachment = Attach(session, session->resume_token());
  ASSERT_TRUE(session->PushEvents(attachment.stream, {.seq = 1, .payload = Flat64(SomeEvents(1, 11))}).ok());
  Until(session, [&] { return session->View(attachment.stream).is_idle; });
  EXPECT_EQ(session->View(attachment.stream).ack.durable_seq, 0u);
  EXPECT_TRUE(server->FlushAll(absl::Now() + absl::Hours(1)));
  EXPECT_EQ(session->View(attachment.stream).ack.durable_seq, 1u);
}

}  // namespace
}  // namespace evpose::server
