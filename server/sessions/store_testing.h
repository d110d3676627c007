// SPDX-License-Identifier: Apache-2.0

// Stores for tests of errors: failing, blocking and shared ones.
#pragma once

#include <condition_variable>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "core/base/status_macros.h"
#include "server/stores/common/store.h"

namespace evpose::server {

// The status that the store returns for every call while it is not OK.
struct InjectedFault {
  std::mutex mutex;
  absl::Status status;
  int num_calls = 0;

  void Set(const absl::Status& new_status) {
    const std::lock_guard lock(mutex);
    status = new_status;
    num_calls = 0;
  }
  int NumCalls() {
    const std::lock_guard lock(mutex);
    return num_calls;
  }
  absl::Status Check() {
    const std::lock_guard lock(mutex);
    ++num_calls;
    return status;
  }
};

// Commits that a store has started and not finished.
class PendingCommits {
 public:
  void Begin() {
    const std::lock_guard lock(mutex_);
    ++num_pending_;
  }
  void End() {
    const std::lock_guard lock(mutex_);
    --num_pending_;
    ended_.notify_all();
  }
  void WaitForAll() {
    std::unique_lock lock(mutex_);
    ended_.wait(lock, [this] { return num_pending_ == 0; });
  }

 private:
  std::mutex mutex_;
  std::condition_variable ended_;
  int num_pending_ = 0;
};

class FaultInjectingLease : public SessionLease {
 public:
  FaultInjectingLease(std::unique_ptr<SessionLease> lease, std::shared_ptr<InjectedFault> fault,
                      std::shared_ptr<PendingCommits> pending = std::make_shared<PendingCommits>())
      : lease_(std::move(lease)), fault_(std::move(fault)), pending_(std::move(pending)) {}
  void Commit(SessionCommit commit, Done done) override {
    if (const absl::Status fault = fault_->Check(); !fault.ok()) return done(fault);
    pending_->Begin();
    lease_->Commit(std::move(commit), [done = std::move(done), pending = pending_](absl::Status status) mutable {
      std::exchange(done, nullptr)(std::move(status));
      pending->End();  // all references of the caller have been released
    });
  }
  const FencingToken& token() const override { return lease_->token(); }

 private:
  const std::unique_ptr<SessionLease> lease_;
  const std::shared_ptr<InjectedFault> fault_;
  const std::shared_ptr<PendingCommits> pending_;
};

// Behaves as a Redis that several servers share: any number of these objects use one store.
class FaultInjectingStore : public Store {
 public:
  FaultInjectingStore(std::shared_ptr<Store> store, std::shared_ptr<InjectedFault> fault)
      : store_(std::move(store)), fault_(std::move(fault)) {}
  // All calls have ended when this store is destroyed, as with any store, although the common store continues.
  ~FaultInjectingStore() override { pending_->WaitForAll(); }

  StoreKind kind() const override { return StoreKind::kRedis; }
  absl::Status CheckHealth() override { return fault_->Check(); }
  std::vector<std::string> damage() const override { return {}; }
  absl::StatusOr<std::vector<ModelRecord>> ListModels() const override {
    EVPOSE_RETURN_IF_ERROR(fault_->Check());
    return store_->ListModels();
  }
  absl::StatusOr<ModelRecord> ReadModel(absl::string_view tenant, absl::string_view name) const override {
    EVPOSE_RETURN_IF_ERROR(fault_->Check());
    return store_->ReadModel(tenant, name);
  }
  absl::StatusOr<bool> HasModel(absl::string_view tenant, absl::string_view name) const override {
    EVPOSE_RETURN_IF_ERROR(fault_->Check());
    return store_->HasModel(tenant, name);
  }
  absl::Status PutModel(const ModelRecord& model) override {
    EVPOSE_RETURN_IF_ERROR(fault_->Check());
    return store_->PutModel(model);
  }
  absl::Status DeleteModel(absl::string_view tenant, absl::string_view name) override {
    EVPOSE_RETURN_IF_ERROR(fault_->Check());
    return store_->DeleteModel(tenant, name);
  }
  absl::StatusOr<std::string> NewSessionName(absl::string_view tenant, absl::string_view request_id) const override {
    return store_->NewSessionName(tenant, request_id);
  }
  absl::StatusOr<std::unique_ptr<SessionLease>> CreateSession(const SessionRecord& record,
                                                              const std::string& lifecycle) override {
    EVPOSE_RETURN_IF_ERROR(fault_->Check());
    EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<SessionLease> lease, store_->CreateSession(record, lifecycle));
    return std::make_unique<FaultInjectingLease>(std::move(lease), fault_, pending_);
  }
  absl::StatusOr<AcquiredSession> AcquireSession(absl::string_view name) override {
    EVPOSE_RETURN_IF_ERROR(fault_->Check());
    EVPOSE_ASSIGN_OR_RETURN(AcquiredSession acquired, store_->AcquireSession(name));
    acquired.lease = std::make_unique<FaultInjectingLease>(std::move(acquired.lease), fault_, pending_);
    return acquired;
  }
  using Store::ReadSession;
  absl::StatusOr<StoredSession> ReadSession(absl::string_view name, uint64_t after_pose_seq) const override {
    EVPOSE_RETURN_IF_ERROR(fault_->Check());
    return store_->ReadSession(name, after_pose_seq);
  }
  absl::StatusOr<std::vector<StoredSession>> ReadWithoutPoses(const std::vector<std::string>& names) const override {
    EVPOSE_RETURN_IF_ERROR(fault_->Check());
    return store_->ReadWithoutPoses(names);
  }
  absl::StatusOr<std::string> ReadTenant(absl::string_view name) const override {
    EVPOSE_RETURN_IF_ERROR(fault_->Check());
    return store_->ReadTenant(name);
  }
  absl::StatusOr<SessionPage> ListSessions(absl::string_view tenant, absl::string_view after_name,
                                           size_t max_sessions) const override {
    EVPOSE_RETURN_IF_ERROR(fault_->Check());
    return store_->ListSessions(tenant, after_name, max_sessions);
  }
  absl::StatusOr<SessionRecord> FindRequest(absl::string_view tenant, absl::string_view request_id) const override {
    EVPOSE_RETURN_IF_ERROR(fault_->Check());
    return store_->FindRequest(tenant, request_id);
  }
  absl::StatusOr<std::vector<SessionOwner>> ListOwners() const override {
    EVPOSE_RETURN_IF_ERROR(fault_->Check());
    return store_->ListOwners();
  }
  absl::StatusOr<std::vector<StoredLifecycle>> ReadOldestLifecycles(size_t max_sessions) const override {
    EVPOSE_RETURN_IF_ERROR(fault_->Check());
    return store_->ReadOldestLifecycles(max_sessions);
  }
  absl::Status DeleteSession(absl::string_view name) override {
    EVPOSE_RETURN_IF_ERROR(fault_->Check());
    return store_->DeleteSession(name);
  }
  absl::Status DeleteHeldSession(absl::string_view name, const FencingToken& token) override {
    EVPOSE_RETURN_IF_ERROR(fault_->Check());
    return store_->DeleteHeldSession(name, token);
  }
  absl::StatusOr<std::vector<std::string>> DeleteEnded(absl::Time ended_before) override {
    EVPOSE_RETURN_IF_ERROR(fault_->Check());
    return store_->DeleteEnded(ended_before);
  }

 private:
  const std::shared_ptr<Store> store_;
  const std::shared_ptr<InjectedFault> fault_;
  const std::shared_ptr<PendingCommits> pending_ = std::make_shared<PendingCommits>();
};

}  // namespace evpose::server
