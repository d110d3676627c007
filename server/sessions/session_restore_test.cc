// SPDX-License-Identifier: Apache-2.0

// Sessions that outlive the server that created them, and move between servers.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <future>
#include <utility>

#include "server/runtime/errors.h"
#include "server/sessions/durability/session_codec.h"
#include "server/sessions/session_manager.h"
#include "server/sessions/session_testing.h"
#include "server/sessions/store_testing.h"
#include "server/stores/memory/memory_store.h"
#include "server/stores/store_suite_testing.h"
#include "server/telemetry/log_testing.h"

namespace evpose::server {
namespace {

constexpr char kTenant[] = "";

std::string ReasonOf(const absl::Status& status) { return GetErrorDetails(status).reason; }

class SessionRestoreTest : public testing::Test {
 protected:
  struct Server {
    std::unique_ptr<ModelRegistry> models;
    std::unique_ptr<SessionManager> sessions;

    SessionManager* operator->() const { return sessions.get(); }
  };

  ~SessionRestoreTest() override { pool_.Join(); }

  Server Open(bool shares_store = false) {
    Server server;
    server.models = ModelRegistry::Create({.shares_store = shares_store}, *store_).value();
    SessionManager::Options options;
    options.max_sessions = 4;
    options.max_tenant_sessions = 3;
    options.limits.expiry = absl::Minutes(1);
    options.make_tracker = FakeTrackers();
    options.shares_store = shares_store;
    options.now = [this] { return now_; };
    options.memory = memory_;
    options.steady_now = [] { return SteadyTime(); };  // no work takes time: that alone makes no checkpoint due
    server.sessions = std::make_unique<SessionManager>(options, *store_, *server.models, pool_);
    EXPECT_TRUE(server->FindStored().ok());
    RestoreAll(*server.sessions, *store_);
    return server;
  }
  // Uncommitted data are lost.
  static void Kill(Server& server) {
    server->CloseAll(absl::CancelledError("killed"));
    server.sessions.reset();
  }

  SessionConfig Config(Server& server) {
    return SomeConfig({"cube"}, server.models->Upload(kTenant, {}, "", CubeBytes()).value().name);
  }
  static std::shared_ptr<const std::vector<uint8_t>> CubeBytes() {
    return std::make_shared<const std::vector<uint8_t>>(kCubeObj, kCubeObj + sizeof(kCubeObj) - 1);
  }
  std::shared_ptr<Session> Create(Server& server, const std::string& request_id = "") {
    return server->Create(kTenant, Config(server), request_id).value();
  }

  void Until(const std::shared_ptr<Session>& session, const std::function<bool()>& is_true) {
    const auto waiting = std::make_shared<WaitingListener>();
    session->AddWatcher(waiting);
    waiting->WaitUntil(is_true);
  }
  Attachment Attach(const std::shared_ptr<Session>& session, const std::string& token, uint64_t last_pose_seq = 0) {
    const Attachment attachment = session->Attach(token, last_pose_seq, listener_).value();
    Until(session, [&] { return session->View(attachment.stream).attached; });
    return attachment;
  }
  // Pushes chunk `seq` with the events of [10 * seq, 10 * seq + 10) ms, and waits until it has been persisted.
  void Track(const std::shared_ptr<Session>& session, const Attachment& attachment, uint64_t seq) {
    const auto begin_ms = static_cast<int64_t>(10 * seq);
    ASSERT_TRUE(
        session->PushEvents(attachment.stream, {.seq = seq, .payload = Flat64(SomeEvents(begin_ms, begin_ms + 10))})
            .ok());
    session->Detach(attachment.stream);
    Until(session, [&] { return session->View(attachment.stream).ack.durable_seq == seq; });
  }

  void MakeTrackerStateUnreadable(const std::string& name) {
    auto taken = store_->TakeSession(name).value();
    SessionCheckpoint checkpoint = DecodeCheckpoint(taken.session.checkpoint, 1).value();
    checkpoint.pipeline->tracker.version = 1'000'000;
    ASSERT_TRUE(CommitNow(*taken.lease, {.checkpoint = EncodeCheckpoint(checkpoint)}).ok());
  }

  void SlowWorkIsDone() {
    std::promise<void> done;
    pool_.slow().PostOwn([&done] { done.set_value(); });
    done.get_future().wait();
  }

  absl::Time now_ = absl::FromUnixSeconds(1'000'000);
  WorkerPool pool_{2};  // outlives the store: its thread may release the last reference to a session
  const std::shared_ptr<Store> store_ = MakeMemoryStore();
  const std::shared_ptr<WaitingListener> listener_ = std::make_shared<WaitingListener>();
  std::shared_ptr<MemoryBudget> memory_ = MemoryBudget::Create({});
};

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

TEST_F(SessionRestoreTest, AClientMovesItsSessionToAnotherServer) {
  Server one = Open(/*shares_store=*/true);
  const auto at_one = Create(one);
  const std::string name = at_one->name();
  const Attachment first = Attach(at_one, at_one->resume_token());
  Track(at_one, first, 1);

  Server two = Open(/*shares_store=*/true);
  EXPECT_EQ(two->num_sessions(), 0u) << "not before a client attaches";
  EXPECT_EQ(two->FindForAttach(kTenant, name, first.resume_token), nullptr);
  EXPECT_EQ(ReasonOf(two->ResumeForAttach(kTenant, name, "guess").status()), "WRONG_TOKEN");
  EXPECT_EQ(ReasonOf(two->ResumeForAttach("other", name, first.resume_token).status()), "SESSION_NOT_FOUND");
  const auto at_two = two->ResumeForAttach(kTenant, name, first.resume_token).value();
  const Attachment second = Attach(at_two, first.resume_token);
  EXPECT_EQ(second.next_seq, 2u);
  Track(at_two, second, 2);

  // A client returns to the first server with the token of the second: this server has not received the token, and has
  // not detected that it is fenced.
  EXPECT_TRUE(at_one->Watch().status.ok());
  EXPECT_EQ(one->FindForAttach(kTenant, name, second.resume_token), nullptr);
  const auto back = one->ResumeForAttach(kTenant, name, second.resume_token).value();
  EXPECT_EQ(ReasonOf(at_one->Watch().status), "FENCED");
  const Attachment third = Attach(back, second.resume_token);
  EXPECT_EQ(third.next_seq, 3u);
  Track(back, third, 3);
  EXPECT_EQ(back->Snapshot().health.poses, 29u);
  EXPECT_EQ(back->pose_log().Read(0, 100).size(), 29u);

  // The second server detects the loss of its lease when it writes.
  (void)at_two->Attach(second.resume_token, 0, listener_);
  Until(at_two, [&] { return !at_two->Watch().status.ok(); });
  EXPECT_EQ(ReasonOf(at_two->Watch().status), "FENCED");
  EXPECT_EQ(ReasonOf(two->Get(kTenant, name).status()), "SESSION_NOT_FOUND") << "another server holds the session";
  EXPECT_EQ(two->num_sessions(), 0u);
  Kill(one);
  Kill(two);
}

TEST_F(SessionRestoreTest, AnExpiredCopyDoesNotDeleteASessionThatHasMoved) {
  Server one = Open(/*shares_store=*/true);
  const auto at_one = Create(one);
  const std::string name = at_one->name();
  const Attachment first = Attach(at_one, at_one->resume_token());
  Track(at_one, first, 1);
  Server two = Open(/*shares_store=*/true);
  const auto at_two = two->ResumeForAttach(kTenant, name, first.resume_token).value();
  const Attachment second = Attach(at_two, first.resume_token);

  // The first server has not detected the move: its copy of the session has been detached for longer than the limit.
  now_ += absl::Minutes(2);
  one->DeleteExpired();
  EXPECT_EQ(one->num_sessions(), 0u);
  SlowWorkIsDone();
  ASSERT_TRUE(store_->ReadSession(name).ok());
  Track(at_two, second, 2);
  EXPECT_TRUE(at_two->Watch().status.ok());

  // The server that holds the session deletes it.
  now_ += absl::Minutes(2);
  two->DeleteExpired();
  SlowWorkIsDone();
  EXPECT_TRUE(absl::IsNotFound(store_->ReadSession(name).status()));
  Kill(one);
  Kill(two);
}

TEST_F(SessionRestoreTest, OrphanedSessionsAreDeletedByAnotherServer) {
  Server dead = Open(/*shares_store=*/true);
  const auto orphan = Create(dead);
  (void)Attach(orphan, orphan->resume_token());
  Kill(dead);
  Server busy = Open(/*shares_store=*/true);
  const auto session = Create(busy);
  const Attachment attachment = Attach(session, session->resume_token());  // without events
  Server other = Open(/*shares_store=*/true);
  const auto tend = [&] {
    now_ += absl::Seconds(30);
    busy->MaintainStore();
    Until(session, [&session] { return session->IsFlushed(); });
    other->MaintainStore();
    SlowWorkIsDone();
  };
  for (int i = 0; i < 4; ++i) tend();
  EXPECT_TRUE(store_->ReadSession(orphan->name()).ok());
  for (int i = 0; i < 8; ++i) tend();
  EXPECT_TRUE(absl::IsNotFound(store_->ReadSession(orphan->name()).status()));
  EXPECT_TRUE(store_->ReadSession(session->name()).ok()) << "a stream is attached to it";
  Track(session, attachment, 1);
  EXPECT_TRUE(session->Watch().status.ok());
  Kill(busy);
  Kill(other);
}

TEST_F(SessionRestoreTest, SessionsOfOtherServersAreDescribedWithoutTakingThem) {
  Server one = Open(/*shares_store=*/true);
  Server two = Open(/*shares_store=*/true);
  const auto session = Create(one, "request");
  const Attachment attachment = Attach(session, session->resume_token());
  EXPECT_EQ(two->Describe(kTenant, session->name())->snapshot.state, SessionState::kAttached);
  Track(session, attachment, 1);
  // The detachment is committed separately from the chunk.
  Until(session, [&] { return two->Describe(kTenant, session->name())->snapshot.state == SessionState::kDetached; });
  const SessionInfo info = two->Describe(kTenant, session->name()).value();
  EXPECT_EQ(info.snapshot.expire_time, now_ + absl::Minutes(1));
  EXPECT_EQ(info.snapshot.health.poses, 9u);
  EXPECT_TRUE(info.config == session->config());
  const auto elsewhere = Create(two);
  EXPECT_EQ(two->List(kTenant, "", 10)->size(), 2u);
  EXPECT_EQ(two->List("other", "", 10)->size(), 0u);
  EXPECT_EQ(two->num_sessions(), 1u);
  EXPECT_TRUE(session->Watch().status.ok());
  // The same request at another server is for the same session, which moves there.
  EXPECT_EQ(Create(two, "request")->name(), session->name());
  // A server can delete a session that another server holds.
  EXPECT_TRUE(one->Delete(kTenant, elsewhere->name()).ok());
  EXPECT_EQ(ReasonOf(one->Describe(kTenant, elsewhere->name()).status()), "SESSION_NOT_FOUND");
  Kill(one);
  Kill(two);
}

TEST_F(SessionRestoreTest, ASessionThatHasEndedUsesItsModelAfterARestartToo) {
  Server server = Open();
  const auto session = Create(server);
  const std::string model = session->config().objects[0].model;
  const Attachment attachment = Attach(session, session->resume_token());
  ASSERT_TRUE(session->PushEnd(attachment.stream).ok());
  Until(session, [&] { return session->View(attachment.stream).ended; });
  EXPECT_EQ(ReasonOf(server.models->Delete(kTenant, model)), "MODEL_IN_USE");
  Kill(server);
  server = Open();
  EXPECT_TRUE(server->Get(kTenant, session->name()).value()->Watch().ended);
  EXPECT_EQ(ReasonOf(server.models->Delete(kTenant, model)), "MODEL_IN_USE");
  Kill(server);
  ASSERT_TRUE(store_->DeleteModel(kTenant, model).ok());
  server = Open();
  EXPECT_TRUE(server->Get(kTenant, session->name()).ok()) << "its poses can be read without it";
  Kill(server);
}

TEST_F(SessionRestoreTest, AModelThatASessionUsesElsewhereIsNotDeleted) {
  Server one = Open(/*shares_store=*/true);
  Server two = Open(/*shares_store=*/true);
  const auto session = Create(one);  // its model is uploaded to the first server only
  const std::string model = session->config().objects[0].model;
  EXPECT_EQ(ReasonOf(two.models->Delete(kTenant, model)), "MODEL_IN_USE");
  EXPECT_EQ(ReasonOf(two.models->Delete("other", model)), "MODEL_NOT_FOUND");
  const Attachment attachment = Attach(session, session->resume_token());
  ASSERT_TRUE(session->PushEnd(attachment.stream).ok());
  Until(session, [&] { return session->View(attachment.stream).ended; });
  EXPECT_EQ(ReasonOf(two.models->Delete(kTenant, model)), "MODEL_IN_USE") << "while the session exists";
  EXPECT_TRUE(one->Delete(kTenant, session->name()).ok());
  EXPECT_TRUE(two.models->Delete(kTenant, model).ok()) << "a model that another server received can be deleted";
  EXPECT_TRUE(absl::IsNotFound(store_->ReadModel(kTenant, model).status()));
  Kill(one);
  Kill(two);
}

// For example a session that was closed because the store was full: its client may reconnect, and its user may list the
// sessions to delete some.
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
  const auto tend = [&](int times) {
    for (int i = 0; i < times; ++i) {
      now_ += absl::Seconds(30);
      server->MaintainStore();
      SlowWorkIsDone();
    }
  };
  tend(2);
  EXPECT_TRUE(store_->ReadSession(name).ok());
  tend(1);
  EXPECT_TRUE(absl::IsNotFound(store_->ReadSession(name).status()));
  EXPECT_TRUE(server.models->Delete(kTenant, model).ok());
  Kill(server);
}

// A store that lets a test act for another server just before a model is read.
class StoreWithRace : public TroubledStore {
 public:
  using TroubledStore::TroubledStore;
  absl::StatusOr<ModelRecord> ReadModel(absl::string_view tenant, absl::string_view name) const override {
    if (before_read_model) std::exchange(before_read_model, nullptr)();
    return TroubledStore::ReadModel(tenant, name);
  }
  mutable std::function<void()> before_read_model;
};

TEST_F(SessionRestoreTest, AModelThatAnotherServerDeletedIsForgotten) {
  Server one = Open(/*shares_store=*/true);
  Server two = Open(/*shares_store=*/true);
  const SessionConfig config = Config(two);
  ASSERT_TRUE(one.models->Delete(kTenant, config.objects[0].model).ok());
  EXPECT_EQ(ReasonOf(two->Create(kTenant, config, "").status()), "MODEL_NOT_FOUND");
  EXPECT_TRUE(store_->ListOwners()->empty()) << "the failed creation leaves no session";
  EXPECT_FALSE(two.models->Get(kTenant, config.objects[0].model).ok());
  EXPECT_EQ(Config(two), config);  // uploads it again
  EXPECT_TRUE(two->Create(kTenant, config, "").ok());

  // An upload alone also restores the model.
  Server three = Open(/*shares_store=*/true);
  const std::vector<SessionInfo> made = two->List(kTenant, "", 10).value();
  for (const SessionInfo& session : made) ASSERT_TRUE(two->Delete(kTenant, session.name).ok());
  ASSERT_TRUE(two.models->Delete(kTenant, config.objects[0].model).ok());
  EXPECT_EQ(Config(three), config);
  EXPECT_TRUE(store_->ReadModel(kTenant, config.objects[0].model).ok());
  Kill(one);
  Kill(two);
  Kill(three);
}

TEST_F(SessionRestoreTest, AModelIsPutBackWhenAnotherServerMakesASessionWithItMeanwhile) {
  Server two = Open(/*shares_store=*/true);
  const SessionConfig config = Config(two);
  const std::string& model = config.objects[0].model;
  StoreWithRace store(store_, std::make_shared<Trouble>());
  const auto models = ModelRegistry::Create({.shares_store = true}, store).value();
  // Delete() has found no session and reads the model; at this moment another server creates a session.
  store.before_read_model = [&] { EXPECT_TRUE(two->Create(kTenant, config, "").ok()); };
  EXPECT_EQ(ReasonOf(models->Delete(kTenant, model)), "MODEL_IN_USE");
  EXPECT_TRUE(store_->ReadModel(kTenant, model).ok());
  EXPECT_TRUE(models->Use(kTenant, model).ok());
  Kill(two);
}

TEST_F(SessionRestoreTest, ASessionWithoutAFreeSlotIsNotTaken) {
  Server one = Open(/*shares_store=*/true);
  const auto session = Create(one);
  Server two = Open(/*shares_store=*/true);
  for (int i = 0; i < 3; ++i) (void)Create(two);
  const auto take = [&] {
    return ReasonOf(two->ResumeForAttach(kTenant, session->name(), session->resume_token()).status());
  };
  EXPECT_EQ(take(), "TENANT_QUOTA");
  two.models->Upload("lab", {}, "", CubeBytes()).value();
  ASSERT_TRUE(two->Create("lab", Config(two), "").ok());
  EXPECT_EQ(take(), "TOO_MANY_SESSIONS");
  EXPECT_TRUE(session->Watch().status.ok());
  Kill(one);
  Kill(two);
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
