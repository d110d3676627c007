// SPDX-License-Identifier: Apache-2.0

// The parts of a server behind a Track stream, without threads: the work of each of the server's threads waits for
// Step(). So an input always gives the same sequence of steps, and inputs can choose any order of them.
#pragma once

#include <array>
#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/post.hpp>
#include <chrono>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/base/status_macros.h"
#include "server/auth/authenticator.h"
#include "server/rpc/common/service_context.h"
#include "server/sessions/session_testing.h"
#include "server/stores/common/checked_lease.h"
#include "server/stores/memory/memory_sessions.h"
#include "server/stores/memory/memory_store.h"
#include "tests/fuzz/require.h"

namespace evpose {

// Replaces a thread.
class Worker {
 public:
  boost::asio::io_context::executor_type executor() { return context_.get_executor(); }
  // Runs one waiting task. Returns false if none waits.
  bool Step() { return context_.poll_one() > 0; }

 private:
  boost::asio::io_context context_{1};
  const boost::asio::executor_work_guard<boost::asio::io_context::executor_type> open_{executor()};
};

class StepwiseLease : public server::CheckedLease {
 public:
  StepwiseLease(server::MemorySessions& sessions, Worker& committer, absl::string_view name,
                const server::FencingToken& token, uint64_t next_pose_seq)
      : CheckedLease(token, next_pose_seq), sessions_(sessions), committer_(committer), name_(name) {}

 private:
  void Write(server::SessionCommit commit, const server::CommitPlace& place, Done done) override {
    boost::asio::post(committer_.executor(), [&sessions = sessions_, name = name_, token = token(), place,
                                              commit = std::move(commit), done = std::move(done)]() mutable {
      done(sessions.Commit(name, token, place, std::move(commit)));
    });
  }
  void Refuse(absl::Status status, Done done) override {
    boost::asio::post(committer_.executor(),
                      [status = std::move(status), done = std::move(done)]() mutable { done(status); });
  }

  server::MemorySessions& sessions_;
  Worker& committer_;
  const std::string name_;
};

// The memory store with a Worker instead of its thread. Models are delegated to an ordinary memory store.
class StepwiseStore : public server::Store {
 public:
  explicit StepwiseStore(Worker& committer) : committer_(committer) {}

  server::StoreKind kind() const override { return server::StoreKind::kMemory; }
  absl::Status CheckHealth() override { return absl::OkStatus(); }
  std::vector<std::string> damage() const override { return {}; }
  absl::StatusOr<std::vector<server::ModelRecord>> ListModels() const override { return models_->ListModels(); }
  absl::StatusOr<server::ModelRecord> ReadModel(absl::string_view tenant, absl::string_view name) const override {
    return models_->ReadModel(tenant, name);
  }
  absl::StatusOr<bool> HasModel(absl::string_view tenant, absl::string_view name) const override {
    return models_->HasModel(tenant, name);
  }
  absl::Status PutModel(const server::ModelRecord& model) override { return models_->PutModel(model); }
  absl::Status DeleteModel(absl::string_view tenant, absl::string_view name) override {
    return models_->DeleteModel(tenant, name);
  }
  absl::StatusOr<std::unique_ptr<server::SessionLease>> CreateSession(const server::SessionRecord& record,
                                                                      const std::string& lifecycle) override {
    EVPOSE_ASSIGN_OR_RETURN(const server::FencingToken token, sessions_.Create(record, lifecycle, "holder"));
    return std::make_unique<StepwiseLease>(sessions_, committer_, record.name, token, /*next_pose_seq=*/1);
  }
  absl::StatusOr<AcquiredSession> AcquireSession(absl::string_view name) override {
    EVPOSE_ASSIGN_OR_RETURN(server::MemorySession acquired, sessions_.Acquire(name, "holder"));
    return AcquiredSession{
        .session = std::move(acquired.stored),
        .lease = std::make_unique<StepwiseLease>(sessions_, committer_, name, acquired.token, acquired.next_pose_seq)};
  }
  absl::StatusOr<server::StoredSession> ReadSession(absl::string_view name, uint64_t after_pose_seq) const override {
    return sessions_.Read(name, after_pose_seq);
  }
  absl::StatusOr<std::vector<server::StoredSession>> ReadWithoutPoses(
      const std::vector<std::string>& names) const override {
    return sessions_.ReadWithoutPoses(names);
  }
  absl::StatusOr<std::string> ReadTenant(absl::string_view name) const override { return sessions_.ReadTenant(name); }
  absl::StatusOr<server::SessionPage> ListSessions(absl::string_view tenant, absl::string_view after_name,
                                                   size_t max_sessions) const override {
    return sessions_.List(tenant, after_name, max_sessions);
  }
  absl::StatusOr<server::SessionRecord> FindRequest(absl::string_view tenant,
                                                    absl::string_view request_id) const override {
    return sessions_.FindRequest(tenant, request_id);
  }
  absl::StatusOr<std::vector<server::SessionOwner>> ListOwners() const override { return sessions_.ListOwners(); }
  absl::StatusOr<std::vector<server::StoredLifecycle>> ReadOldestLifecycles(size_t max_sessions) const override {
    return sessions_.ReadOldestLifecycles(max_sessions);
  }
  absl::Status DeleteSession(absl::string_view name) override {
    sessions_.Delete(name);
    return absl::OkStatus();
  }
  absl::Status DeleteHeldSession(absl::string_view name, const server::FencingToken& token) override {
    return sessions_.DeleteHeld(name, token);
  }
  absl::StatusOr<std::vector<std::string>> DeleteEnded(absl::Time ended_before) override {
    return sessions_.DeleteEnded(ended_before);
  }

 private:
  Worker& committer_;
  server::MemorySessions sessions_{UINT64_MAX};
  const std::unique_ptr<server::Store> models_ = server::MakeMemoryStore();
};

// The parts of a server that a TrackReactor uses, with fake trackers, small limits, and a clock that the test controls.
class StepwiseServer : private server::Drainer {
 public:
  static constexpr size_t kNumWorkers = 4;

  explicit StepwiseServer(bool writes_checkpoints)
      : sessions_(ManagerOptions(writes_checkpoints), store_, *models_, pool_) {
    const std::string_view file = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
    const auto model =
        models_->Upload(tenant(), {}, "", std::make_shared<std::vector<uint8_t>>(file.begin(), file.end()));
    config_ = server::SomeConfig({"cube"}, model.value().name);
  }

  const server::ServiceContext& context() const { return context_; }
  std::shared_ptr<server::Session> CreateSession() { return sessions_.Create(tenant(), config_, "").value(); }
  void DeleteSession(const std::string& name) {
    const absl::Status status = sessions_.Delete(tenant(), name);
    EVPOSE_FUZZ_REQUIRE(status.ok() || absl::IsNotFound(status));
  }
  void LetTimePass(absl::Duration duration) { now_ += duration; }
  // Runs the next task of one worker. Returns false if it has none.
  bool Step(size_t worker) { return workers_[worker].Step(); }
  bool StepAny() {
    for (Worker& worker : workers_) {
      if (worker.Step()) return true;
    }
    return false;
  }
  void RequireEmpty() {
    EVPOSE_FUZZ_REQUIRE(sessions_.num_sessions() == 0);
    EVPOSE_FUZZ_REQUIRE(store_.ListOwners().value().empty());
  }

 private:
  static std::string tenant() { return ""; }

  server::SessionManager::Options ManagerOptions(bool writes_checkpoints) {
    server::SessionManager::Options options;
    options.limits = {.credit_bytes = 512,
                      .max_chunk_bytes = 128,
                      .pose_log_capacity = 16,  // small, so that poses are deleted
                      .writes_checkpoints = writes_checkpoints};
    options.make_tracker = server::FakeTrackers();
    options.now = [this] { return now_; };
    // The clock advances at every reading, so that checkpoints become due.
    options.steady_now = [this] { return steady_now_ += std::chrono::milliseconds(10); };
    return options;
  }

  void Drain(absl::Duration) override { std::abort(); }

  absl::Time now_ = absl::FromUnixSeconds(1'700'000'000);
  server::SteadyTime steady_now_;
  std::array<Worker, kNumWorkers> workers_;  // workers of the pool, store, slow work, low-priority work and images
  server::WorkerPool pool_{
      server::WorkerPool::Executors{workers_[0].executor(), workers_[2].executor(), workers_[3].executor(),
                                    workers_[3].executor()},
      {.cpu_now = [] { return std::chrono::nanoseconds(0); }}};  // the order of the sessions is that of receipt
  StepwiseStore store_{workers_[1]};
  const std::unique_ptr<server::ModelRegistry> models_ =
      server::ModelRegistry::Create(server::ModelRegistry::Options(), store_).value();
  server::SessionManager sessions_;
  const std::shared_ptr<server::ServerMetrics> metrics_ = std::make_shared<server::ServerMetrics>();
  server::StreamRegistry streams_;
  const std::unique_ptr<server::Authenticator> authenticator_ = server::Authenticator::Create({}).value();
  server::LogLimiter log_limiter_;
  server::TenantQuotas quotas_{{.max_streams_of_server = 16, .now = [this] { return now_; }}};
  const server::ServiceContext context_{.store = store_,
                                        .models = *models_,
                                        .sessions = sessions_,
                                        .pool = pool_,
                                        .streams = streams_,
                                        .authenticator = *authenticator_,
                                        .quotas = quotas_,
                                        .drainer = *this,
                                        .attach_timeout = absl::Hours(1),
                                        .stream_idle_timeout = absl::ZeroDuration(),
                                        .upload_timeout = absl::Hours(1),
                                        .response_timeout = absl::Hours(1),
                                        .max_model_bytes = 0,
                                        .drain_timeout = absl::ZeroDuration(),
                                        .metrics = *metrics_,
                                        .log_limiter = log_limiter_};
  server::SessionConfig config_;
};

}  // namespace evpose
