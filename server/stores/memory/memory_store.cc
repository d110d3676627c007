// SPDX-License-Identifier: Apache-2.0
#include "server/stores/memory/memory_store.h"

#include <map>
#include <mutex>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/functional/any_invocable.h"
#include "core/base/status_macros.h"
#include "server/runtime/random_name.h"
#include "server/stores/common/checked_lease.h"
#include "server/stores/common/commit_guard.h"
#include "server/stores/common/job_thread.h"
#include "server/stores/memory/memory_sessions.h"

namespace evpose::server {
namespace {

// Sorts by name, then tenant.
std::pair<std::string, std::string> ModelKey(absl::string_view name, absl::string_view tenant) {
  return {std::string(name), std::string(tenant)};
}

// A commit that waits to be written, and its completion callback.
struct CommitJob {
  absl::AnyInvocable<absl::Status()> write;
  SessionLease::Done done;
};

// The state that the leases share with their store. It lives until the last lease is destroyed.
struct Shared {
  explicit Shared(std::shared_ptr<MemorySessions> all) : sessions(std::move(all)) {}

  const std::shared_ptr<MemorySessions> sessions;
  JobThread<CommitJob> committer{[](std::vector<CommitJob> jobs) {
    for (CommitJob& job : jobs) job.done(OrUnavailable([&job] { return job.write(); }));
  }};
};

class MemoryLease : public CheckedLease {
 public:
  MemoryLease(std::shared_ptr<Shared> shared, absl::string_view name, const FencingToken& token, uint64_t next_pose_seq)
      : CheckedLease(token, next_pose_seq), shared_(std::move(shared)), name_(name) {}

 private:
  void Write(SessionCommit commit, const CommitPlace& place, Done done) override {
    shared_->committer.Push(
        {.write = [sessions = shared_->sessions, name = name_, token = token(), place,
                   commit =
                       std::move(commit)]() mutable { return sessions->Commit(name, token, place, std::move(commit)); },
         .done = std::move(done)});
  }
  void Refuse(absl::Status status, Done done) override {
    shared_->committer.Push({.write = [status = std::move(status)] { return status; }, .done = std::move(done)});
  }

  const std::shared_ptr<Shared> shared_;
  const std::string name_;
};

class MemoryStore : public Store {
 public:
  explicit MemoryStore(std::shared_ptr<MemorySessions> sessions)
      : shared_(std::make_shared<Shared>(std::move(sessions))) {}
  ~MemoryStore() override { shared_->committer.Close(); }

  StoreKind kind() const override { return StoreKind::kMemory; }
  absl::Status CheckHealth() override { return absl::OkStatus(); }
  std::vector<std::string> damage() const override { return {}; }
  std::optional<StoreUsage> Usage() override { return shared_->sessions->Usage(); }

  absl::StatusOr<std::vector<ModelRecord>> ListModels() const override {
    const std::lock_guard lock(mutex_);
    std::vector<ModelRecord> models;
    models.reserve(models_.size());
    for (const auto& [key, model] : models_) {
      models.push_back({.name = model.name,
                        .tenant = model.tenant,
                        .reading = model.reading,
                        .create_time = model.create_time,
                        .summary = model.summary,
                        .file_bytes = model.file_bytes});
    }
    return models;
  }

  absl::StatusOr<ModelRecord> ReadModel(absl::string_view tenant, absl::string_view name) const override {
    const std::lock_guard lock(mutex_);
    const auto found = models_.find(ModelKey(name, tenant));
    if (found == models_.end()) return ModelNotFoundError(name);
    return found->second;
  }

  absl::StatusOr<bool> HasModel(absl::string_view tenant, absl::string_view name) const override {
    const std::lock_guard lock(mutex_);
    return models_.contains(ModelKey(name, tenant));
  }

  absl::Status PutModel(const ModelRecord& model) override {
    ModelRecord stored = model;
    stored.file_bytes = model.bytes->size();
    const std::lock_guard lock(mutex_);
    models_.insert_or_assign(ModelKey(model.name, model.tenant), std::move(stored));
    return absl::OkStatus();
  }

  absl::Status DeleteModel(absl::string_view tenant, absl::string_view name) override {
    const std::lock_guard lock(mutex_);
    models_.erase(ModelKey(name, tenant));
    return absl::OkStatus();
  }

  absl::StatusOr<std::unique_ptr<SessionLease>> CreateSession(const SessionRecord& record,
                                                              const std::string& lifecycle) override {
    EVPOSE_ASSIGN_OR_RETURN(std::string holder, RandomHex128());
    EVPOSE_ASSIGN_OR_RETURN(const FencingToken token, shared_->sessions->Create(record, lifecycle, std::move(holder)));
    return std::make_unique<MemoryLease>(shared_, record.name, token, /*next_pose_seq=*/1);
  }

  absl::StatusOr<AcquiredSession> AcquireSession(absl::string_view name) override {
    EVPOSE_ASSIGN_OR_RETURN(std::string holder, RandomHex128());
    EVPOSE_ASSIGN_OR_RETURN(MemorySession session, shared_->sessions->Acquire(name, std::move(holder)));
    const uint64_t next_pose_seq = session.next_pose_seq;
    return AcquiredSession{.session = std::move(session.stored),
                           .lease = std::make_unique<MemoryLease>(shared_, name, session.token, next_pose_seq)};
  }

  absl::StatusOr<StoredSession> ReadSession(absl::string_view name, uint64_t after_pose_seq) const override {
    return shared_->sessions->Read(name, after_pose_seq);
  }
  absl::StatusOr<std::vector<StoredSession>> ReadWithoutPoses(const std::vector<std::string>& names) const override {
    return shared_->sessions->ReadWithoutPoses(names);
  }
  absl::StatusOr<std::string> ReadTenant(absl::string_view name) const override {
    return shared_->sessions->ReadTenant(name);
  }
  absl::StatusOr<SessionPage> ListSessions(absl::string_view tenant, absl::string_view after_name,
                                           size_t max_sessions) const override {
    return shared_->sessions->List(tenant, after_name, max_sessions);
  }
  absl::StatusOr<SessionRecord> FindRequest(absl::string_view tenant, absl::string_view request_id) const override {
    return shared_->sessions->FindRequest(tenant, request_id);
  }
  absl::StatusOr<std::vector<SessionOwner>> ListOwners() const override { return shared_->sessions->ListOwners(); }
  absl::StatusOr<std::vector<StoredLifecycle>> ReadOldestLifecycles(size_t max_sessions) const override {
    return shared_->sessions->ReadOldestLifecycles(max_sessions);
  }

  absl::Status DeleteSession(absl::string_view name) override {
    shared_->sessions->Delete(name);
    return absl::OkStatus();
  }

  absl::Status DeleteHeldSession(absl::string_view name, const FencingToken& token) override {
    return shared_->sessions->DeleteHeld(name, token);
  }

  absl::StatusOr<std::vector<std::string>> DeleteEnded(absl::Time ended_before) override {
    return shared_->sessions->DeleteEnded(ended_before);
  }

 private:
  const std::shared_ptr<Shared> shared_;
  mutable std::mutex mutex_;
  std::map<std::pair<std::string, std::string>, ModelRecord> models_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace

std::unique_ptr<Store> MakeMemoryStore(uint64_t max_bytes) {
  return MakeMemoryStore(std::make_shared<MemorySessions>(max_bytes));
}

std::unique_ptr<Store> MakeMemoryStore(std::shared_ptr<MemorySessions> sessions) {
  return std::make_unique<MemoryStore>(std::move(sessions));
}

}  // namespace evpose::server
