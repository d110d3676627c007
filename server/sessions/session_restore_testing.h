// SPDX-License-Identifier: Apache-2.0

// Servers, in one process, that take their sessions from one store.
#pragma once

#include <gtest/gtest.h>

#include <functional>
#include <future>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "server/runtime/errors.h"
#include "server/sessions/durability/session_codec.h"
#include "server/sessions/session_manager.h"
#include "server/sessions/session_testing.h"
#include "server/sessions/store_testing.h"
#include "server/stores/memory/memory_store.h"
#include "server/stores/store_suite_testing.h"

namespace evpose::server {

// A store of sessions and the servers that use it.
class SharedStoreTest : public testing::Test {
 protected:
  static constexpr char kTenant[] = "";

  struct Server {
    std::unique_ptr<ModelRegistry> models;
    std::unique_ptr<SessionManager> sessions;

    SessionManager* operator->() const { return sessions.get(); }
  };

  ~SharedStoreTest() override { pool_.Join(); }

  static std::string ReasonOf(const absl::Status& status) { return GetErrorDetails(status).reason; }

  Server Open(bool shares_store = false) { return Open(shares_store, *store_); }
  Server Open(bool shares_store, Store& store, uint32_t max_sessions = 4) {
    Server server;
    server.models = ModelRegistry::Create({.shares_store = shares_store}, store).value();
    SessionManager::Options options;
    options.max_sessions = max_sessions;
    options.max_tenant_sessions = 3;
    options.limits.expiry = absl::Minutes(1);
    options.make_tracker = FakeTrackers();
    options.shares_store = shares_store;
    options.now = [this] { return now_; };
    options.memory = memory_;
    options.steady_now = [] { return SteadyTime(); };  // no work takes time: that alone makes no checkpoint due
    server.sessions = std::make_unique<SessionManager>(options, store, *server.models, pool_);
    EXPECT_TRUE(server->FindStored().ok());
    RestoreAll(*server.sessions, store);
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

  Attachment Attach(const std::shared_ptr<Session>& session, const std::string& token, uint64_t last_pose_seq = 0) {
    const Attachment attachment = session->Attach(token, last_pose_seq, listener_).value();
    Until(session, [&] { return session->View(attachment.stream).is_attached; });
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
    auto acquired = store_->AcquireSession(name).value();
    SessionCheckpoint checkpoint = DecodeCheckpoint(acquired.session.checkpoint, 1).value();
    checkpoint.pipeline->tracker.version = 1'000'000;
    ASSERT_TRUE(CommitNow(*acquired.lease, {.checkpoint = EncodeCheckpoint(checkpoint)}).ok());
  }

  // Returns when the slow work that was posted before has ended.
  void AwaitSlowWork() {
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

}  // namespace evpose::server
