// SPDX-License-Identifier: Apache-2.0

// Sessions and models of a store that several servers use: sessions move between the servers.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "absl/strings/str_cat.h"
#include "server/sessions/session_restore_testing.h"

namespace evpose::server {
namespace {

class SessionMoveTest : public SharedStoreTest {};

TEST_F(SessionMoveTest, AClientMovesItsSessionToAnotherServer) {
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

  // A client returns to the first server with the token of the second: this server has not received the token. It has
  // detected that it is fenced only if a checkpoint was due since then.
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

TEST_F(SessionMoveTest, AnExpiredCopyDoesNotDeleteASessionThatHasMoved) {
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
  AwaitSlowWork();
  ASSERT_TRUE(store_->ReadSession(name).ok());
  Track(at_two, second, 2);
  EXPECT_TRUE(at_two->Watch().status.ok());

  // The server that holds the session deletes it.
  now_ += absl::Minutes(2);
  two->DeleteExpired();
  AwaitSlowWork();
  EXPECT_TRUE(absl::IsNotFound(store_->ReadSession(name).status()));
  Kill(one);
  Kill(two);
}

TEST_F(SessionMoveTest, OrphanedSessionsAreDeletedByAnotherServer) {
  Server dead = Open(/*shares_store=*/true);
  const auto orphan = Create(dead);
  (void)Attach(orphan, orphan->resume_token());
  Kill(dead);
  Server busy = Open(/*shares_store=*/true);
  const auto session = Create(busy);
  const Attachment attachment = Attach(session, session->resume_token());  // without events
  Server other = Open(/*shares_store=*/true);
  const auto maintain = [&] {
    now_ += absl::Seconds(30);
    busy->MaintainStore();
    Until(session, [&session] { return session->IsFlushed(); });
    other->MaintainStore();
    AwaitSlowWork();
  };
  for (int i = 0; i < 4; ++i) maintain();
  EXPECT_TRUE(store_->ReadSession(orphan->name()).ok());
  for (int i = 0; i < 8; ++i) maintain();
  EXPECT_TRUE(absl::IsNotFound(store_->ReadSession(orphan->name()).status()));
  EXPECT_TRUE(store_->ReadSession(session->name()).ok()) << "a stream is attached to it";
  Track(session, attachment, 1);
  EXPECT_TRUE(session->Watch().status.ok());
  Kill(busy);
  Kill(other);
}

TEST_F(SessionMoveTest, SessionsOfOtherServersAreDescribedWithoutAcquiringThem) {
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
  EXPECT_EQ(info.snapshot.health.reattaches, 0u);
  const Attachment again = Attach(session, attachment.resume_token);
  EXPECT_EQ(two->Describe(kTenant, session->name())->snapshot.health.reattaches, 1u);
  session->Detach(again.stream);
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

// A store that counts the calls which read sessions.
class StoreThatCountsReads : public FaultInjectingStore {
 public:
  using FaultInjectingStore::FaultInjectingStore;
  absl::StatusOr<StoredSession> ReadSession(absl::string_view name, uint64_t after_pose_seq) const override {
    ++num_single;
    return FaultInjectingStore::ReadSession(name, after_pose_seq);
  }
  absl::StatusOr<std::vector<StoredSession>> ReadWithoutPoses(const std::vector<std::string>& names) const override {
    num_together.push_back(names.size());
    return FaultInjectingStore::ReadWithoutPoses(names);
  }
  mutable int num_single = 0;
  mutable std::vector<size_t> num_together;
};

TEST_F(SessionMoveTest, AListReadsTheSessionsOfOtherServersTogether) {
  const auto fault = std::make_shared<InjectedFault>();
  StoreThatCountsReads store(store_, fault);
  Server server = Open(/*shares_store=*/true, store);
  const auto here = Create(server);
  const std::string config = EncodeConfig(here->config());
  const auto store_session = [&](const std::string& name, const std::string& tenant, const std::string& stored_config) {
    ASSERT_TRUE(store_
                    ->CreateSession({.name = name, .tenant = tenant, .config = stored_config},
                                    EncodeLifecycle({.token_digest = TokenDigest("token"), .detached_at = now_}))
                    .ok());
  };
  for (char c = 'a'; c <= 'z'; ++c) store_session(absl::StrCat("sessions/z", std::string(1, c)), kTenant, config);
  store_session("sessions/y", kTenant, "no configuration");
  store_session("sessions/x", "other", config);
  store.num_together.clear();
  const std::vector<SessionInfo> all = server->List(kTenant, "", 100).value();
  ASSERT_EQ(all.size(), 27u) << "the damaged one is omitted";
  EXPECT_EQ(all[0].name, here->name()) << "its name has hexadecimal digits";
  EXPECT_EQ(all[1].name, "sessions/za");
  EXPECT_EQ(all[1].snapshot.state, SessionState::kDetached);
  EXPECT_EQ(all[26].name, "sessions/zz");
  EXPECT_THAT(store.num_together, testing::ElementsAre(15, 12)) << "16 names each, of which one is here";
  EXPECT_EQ(store.num_single, 0);
  EXPECT_EQ(server->List(kTenant, "sessions/zd", 3)->back().name, "sessions/zg");
  EXPECT_EQ(server->List(kTenant, "sessions/y", 1)->front().name, "sessions/za");
  fault->Set(absl::UnavailableError("away"));
  EXPECT_EQ(ReasonOf(server->List(kTenant, "", 100).status()), "STORE_UNAVAILABLE");
  fault->Set(absl::OkStatus());
  Kill(server);
}

TEST_F(SessionMoveTest, AModelThatASessionUsesElsewhereIsNotDeleted) {
  Server one = Open(/*shares_store=*/true);
  Server two = Open(/*shares_store=*/true);
  const auto session = Create(one);  // its model is uploaded to the first server only
  const std::string model = session->config().objects[0].model;
  EXPECT_EQ(ReasonOf(two.models->Delete(kTenant, model)), "MODEL_IN_USE");
  EXPECT_EQ(ReasonOf(two.models->Delete("other", model)), "MODEL_NOT_FOUND");
  const Attachment attachment = Attach(session, session->resume_token());
  ASSERT_TRUE(session->PushEnd(attachment.stream).ok());
  Until(session, [&] { return session->View(attachment.stream).has_ended; });
  EXPECT_EQ(ReasonOf(two.models->Delete(kTenant, model)), "MODEL_IN_USE") << "while the session exists";
  EXPECT_TRUE(one->Delete(kTenant, session->name()).ok());
  EXPECT_TRUE(two.models->Delete(kTenant, model).ok()) << "a model that another server received can be deleted";
  EXPECT_TRUE(absl::IsNotFound(store_->ReadModel(kTenant, model).status()));
  Kill(one);
  Kill(two);
}

// A store that counts how often a model is read, and lets a test act before and after that.
class StoreWithRace : public FaultInjectingStore {
 public:
  using FaultInjectingStore::FaultInjectingStore;
  absl::StatusOr<ModelRecord> ReadModel(absl::string_view tenant, absl::string_view name) const override {
    ++num_models_read;
    if (before_read_model) std::exchange(before_read_model, nullptr)();
    auto model = FaultInjectingStore::ReadModel(tenant, name);
    if (after_read_model) std::exchange(after_read_model, nullptr)();
    return model;
  }
  mutable std::function<void()> before_read_model, after_read_model;
  mutable int num_models_read = 0;
};

TEST_F(SessionMoveTest, AModelThatIsLoadedIsNotReadAgain) {
  StoreWithRace store(store_, std::make_shared<InjectedFault>());
  Server server = Open(/*shares_store=*/true, store);
  const auto first = Create(server);
  EXPECT_EQ(store.num_models_read, 1);
  const auto second = Create(server);  // uploads the file again, and searches for the model in the store
  EXPECT_EQ(store.num_models_read, 1);
  Kill(server);
}

TEST_F(SessionMoveTest, WhileAModelIsReadOthersCanBeDeleted) {
  StoreWithRace store(store_, std::make_shared<InjectedFault>());
  const auto one = ModelRegistry::Create({.shares_store = true}, store).value();
  Server two = Open(/*shares_store=*/true);
  const std::string model = Config(two).objects[0].model;
  const std::string of_other = two.models->Upload("other", {}, "", CubeBytes()).value().name;
  // A mutex of all tenants would be locked twice.
  store.before_read_model = [&] { EXPECT_TRUE(one->Delete("other", of_other).ok()); };
  EXPECT_TRUE(one->UseStored(kTenant, model).ok());
  Kill(two);
}

TEST_F(SessionMoveTest, AModelThatIsDeletedWhileItIsReadIsNotFound) {
  StoreWithRace store(store_, std::make_shared<InjectedFault>());
  const auto one = ModelRegistry::Create({.shares_store = true}, store).value();
  Server two = Open(/*shares_store=*/true);
  const std::string model = Config(two).objects[0].model;
  store.after_read_model = [&] { EXPECT_TRUE(one->Delete(kTenant, model).ok()); };
  EXPECT_EQ(ReasonOf(one->UseStored(kTenant, model).status()), "MODEL_NOT_FOUND");
  EXPECT_FALSE(one->Get(kTenant, model).ok());
  Kill(two);
}

TEST_F(SessionMoveTest, AModelThatAnotherServerDeletedIsForgotten) {
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

TEST_F(SessionMoveTest, AModelIsPutBackWhenAnotherServerMakesASessionWithItMeanwhile) {
  Server two = Open(/*shares_store=*/true);
  const SessionConfig config = Config(two);
  const std::string& model = config.objects[0].model;
  StoreWithRace store(store_, std::make_shared<InjectedFault>());
  const auto models = ModelRegistry::Create({.shares_store = true}, store).value();
  // Delete() has found no session and reads the model; at this moment another server creates a session.
  store.before_read_model = [&] { EXPECT_TRUE(two->Create(kTenant, config, "").ok()); };
  EXPECT_EQ(ReasonOf(models->Delete(kTenant, model)), "MODEL_IN_USE");
  EXPECT_TRUE(store_->ReadModel(kTenant, model).ok());
  EXPECT_TRUE(models->Use(kTenant, model).ok());
  Kill(two);
}

}  // namespace
}  // namespace evpose::server
