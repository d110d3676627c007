// SPDX-License-Identifier: Apache-2.0

// All sessions of a server: creates, finds, resumes, expires and deletes them. Each session belongs to one tenant and
// is not visible to others.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "server/models/model_registry.h"
#include "server/runtime/keyed_mutexes.h"
#include "server/runtime/worker_pool.h"
#include "server/scheduling/load_monitor.h"
#include "server/sessions/durability/orphan_collector.h"
#include "server/sessions/durability/waiting_sessions.h"
#include "server/sessions/memory/memory_budget.h"
#include "server/sessions/session.h"
#include "server/sessions/session_factory.h"
#include "server/sessions/session_mirror.h"
#include "server/sessions/types/session_config.h"
#include "server/stores/common/store.h"

namespace evpose::server {

// Thread-safe.
class SessionManager {
 public:
  struct Options {
    uint32_t max_sessions = 64;         // ServerOptions has the reasons of both
    uint32_t max_tenant_sessions = 64;  // sessions of one tenant
    SessionLimits limits;
    TrackerFactory make_tracker;
    // True if other servers use the same store. A session is then resumed from it only when a client attaches to it
    // here.
    bool shares_store = false;
    // While it is overloaded, a tenant that has a session here gets no other. The first one of a tenant is admitted, so
    // that the replays of one tenant do not refuse the others. May be null; must outlive this object.
    const LoadMonitor* load = nullptr;
    std::function<absl::Time()> now;                                          // for expiry only, never for results
    std::function<SteadyTime()> steady_now = std::chrono::steady_clock::now;  // as SessionClocks::steady
    std::shared_ptr<ServerMetrics> metrics = std::make_shared<ServerMetrics>();
    std::shared_ptr<MemoryBudget> memory = MemoryBudget::Create({});  // unlimited
  };

  SessionManager(const Options& options, Store& store, ModelRegistry& models, WorkerPool& pool);
  ~SessionManager();

  // Creates a session. Idempotent for each tenant and `request_id`, unless it is empty. `peer` is the address for the
  // log. Slow, because it creates the trackers. Errors: INVALID_ARGUMENT with the field, NOT_FOUND (MODEL_NOT_FOUND),
  // ALREADY_EXISTS (REQUEST_ID_REUSED), RESOURCE_EXHAUSTED (TOO_MANY_SESSIONS, TENANT_QUOTA, SESSION_MEMORY,
  // OUT_OF_MEMORY, OVERLOADED), UNAVAILABLE (DRAINING), DATA_LOSS (SESSION_DAMAGED, of the session of an earlier
  // request).
  absl::StatusOr<std::shared_ptr<Session>> Create(const std::string& tenant, const SessionConfig& config,
                                                  const std::string& request_id, const std::string& peer = "");
  // Reads the names of the sessions in the store, unless the store is shared. Each of them keeps its slot, and waits
  // until the first call that needs it restores it. A session that no call needs within the expiry time is deleted.
  // Must be called before the other functions. Errors: those of the store.
  absl::Status FindStored();

  // Returns a session of this server. Errors: NOT_FOUND (SESSION_NOT_FOUND).
  absl::StatusOr<std::shared_ptr<Session>> Get(const std::string& tenant, absl::string_view name);
  // Returns a read-only replica of a session that another server on the same store holds. All its watchers share one
  // replica. Waits for the store. Errors: NOT_FOUND (SESSION_NOT_FOUND), DATA_LOSS (SESSION_DAMAGED), UNAVAILABLE
  // (STORE_UNAVAILABLE).
  absl::StatusOr<std::shared_ptr<WatchedSession>> Mirror(const std::string& tenant, const std::string& name);
  // Returns the session if this server holds it and the token is valid; otherwise null, and the caller must use
  // ResumeForAttach().
  std::shared_ptr<Session> FindForAttach(const std::string& tenant, absl::string_view name,
                                         absl::string_view resume_token);
  // Does the same as FindForAttach(), and resumes the session from the store when this server does not hold it, or has
  // closed it (because another server fenced it, or the store was full). Waits for the store. Errors: NOT_FOUND
  // (SESSION_NOT_FOUND), PERMISSION_DENIED (WRONG_TOKEN), DATA_LOSS (SESSION_DAMAGED), RESOURCE_EXHAUSTED
  // (TOO_MANY_SESSIONS, TENANT_QUOTA), UNAVAILABLE (STORE_UNAVAILABLE, DRAINING), the status of
  // SlowExecutor::Running() if the call ends while another one resumes the session.
  absl::StatusOr<std::shared_ptr<Session>> ResumeForAttach(const std::string& tenant, const std::string& name,
                                                           absl::string_view resume_token);
  // The next three functions include the sessions of other servers, and wait for the store where they need it.
  // Errors: NOT_FOUND (SESSION_NOT_FOUND), DATA_LOSS (SESSION_DAMAGED), UNAVAILABLE (STORE_UNAVAILABLE).
  absl::StatusOr<SessionInfo> Describe(const std::string& tenant, const std::string& name);
  // Returns at most `max_sessions` sessions, in the order of their names, from the first name after `after_name` on.
  absl::StatusOr<std::vector<SessionInfo>> List(const std::string& tenant, absl::string_view after_name,
                                                size_t max_sessions);
  // Deletes a session of the tenant. If this server does not have it, it is deleted in the store.
  absl::Status Delete(const std::string& tenant, const std::string& name, const std::string& peer = "");
  // Deletes the expired sessions of this server. The other functions call it first.
  void DeleteExpired();
  // Starts the deletion of sessions in the store that ended long ago, and of ended sessions that must make room.
  void DeleteEnded();
  // Starts the deletion of expired sessions that are only in the store, because their server died or the store was
  // full. With a shared store it first renews the lifecycle records of the sessions with an attached stream.
  void MaintainStore();

  // From now on Create, ResumeForAttach and CheckNotDraining return UNAVAILABLE (DRAINING).
  void Drain();
  absl::Status CheckNotDraining() const;
  // Stops every session after the item that it is processing and waits until everything processed has been persisted.
  // Returns false if that was not reached by the deadline.
  bool FlushAll(absl::Time deadline);
  // Ends every session.
  void CloseAll(const absl::Status& status);

  // Returns the sum of SessionHealth::skipped_events over all sessions since the start of the process, including
  // deleted ones.
  uint64_t skipped_events() const { return options_.metrics->all_skipped_events(); }
  uint32_t num_sessions() const;  // with those that wait to be restored
  uint32_t num_sessions_of(const std::string& tenant) const;
  uint32_t num_attached() const;
  SessionTotals totals() const;
  const Options& options() const { return options_; }

 private:
  using Request = std::pair<std::string, std::string>;  // tenant, request_id
  using SessionLock = KeyedMutexes<std::string>::Lock;
  struct Entry {
    std::shared_ptr<Session> session;
    Request request;

    const std::string& tenant() const { return request.first; }
  };
  using Entries = std::map<std::string, Entry, std::less<>>;

  // Returns the session of an earlier request with the same id, or null after reserving a slot for a new session.
  absl::StatusOr<std::shared_ptr<Session>> FindOrReserveSlot(const SessionConfig& config, const Request& request);
  absl::Status CheckSlotIsFree(const std::string& tenant) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Reserves a slot, until ReleaseSlot(), if one is free.
  absl::Status ReserveSlot(const std::string& tenant) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Resumes the session that another server created for the same request, and locks it; null when there is none.
  absl::StatusOr<std::shared_ptr<Session>> ResumeRequest(const SessionConfig& config, const Request& request,
                                                         SessionLock& lock);
  absl::StatusOr<std::shared_ptr<Session>> ResumeOrMake(const SessionConfig& config, const Request& request,
                                                        SessionLock& lock);
  // Refuses a further session of the tenant while the workers have too little time for it.
  absl::Status CheckLoad(const std::string& tenant) const;
  // Restores the session of the request if it waits to be restored.
  absl::Status RestoreRequest(const Request& request);
  absl::StatusOr<std::shared_ptr<Session>> FindRequest(const SessionConfig& config, const Request& request)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool IsHere(const std::string& name) const;
  // Returns null when this server does not have the session, or it is closed.
  std::shared_ptr<Session> FindOpen(const std::string& tenant, absl::string_view name);
  std::vector<std::shared_ptr<Session>> Sessions() const;
  // Returns null when there is no replica yet.
  std::shared_ptr<SessionMirror> FindMirror(const std::string& tenant, const std::string& name);
  // Reads a session of this tenant from the store, with its poses after `after_pose_seq`. Errors: as Describe.
  absl::StatusOr<SessionFactory::Stored> ReadOwn(const std::string& tenant, const std::string& name,
                                                 uint64_t after_pose_seq = kAfterAllPoses) const;
  // Deletes a session that this server does not have. It must be locked, so that it is not resumed at the same time.
  absl::Status DeleteStored(const std::string& tenant, const std::string& name, const std::string& peer);
  // If `slot_of` is not null, a slot of this tenant is reserved for the session; it is released in any case.
  absl::StatusOr<std::shared_ptr<Session>> Resume(const std::string& name, const std::string* slot_of = nullptr);
  // Restores the session if it waits to be restored and belongs to the tenant. A damaged session is reported in the log
  // and stays in the store.
  void RestoreIfWaiting(const std::string& tenant, const std::string& name);
  bool IsWaiting(const std::string& tenant, const std::string& name) const;
  void StopWaiting(const std::string& name);
  // Changes the description of a session in the store if it waits to be restored.
  void NoteWaiting(const std::string& tenant, SessionInfo& info) const;
  // Does the same as Describe() for several sessions, and does not restore waiting ones. Those that do not exist or are
  // damaged are omitted.
  absl::StatusOr<std::map<std::string, SessionInfo>> DescribeAsStored(const std::string& tenant,
                                                                      const std::vector<std::string>& names);
  // The names of the tenant's sessions of this server after `after_name` and up to `last_name`; to the end if that is
  // empty.
  std::set<std::string> NamesHere(const std::string& tenant, absl::string_view after_name,
                                  absl::string_view last_name) const;
  Entry Remove(Entries::iterator entry) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Insert(const std::shared_ptr<Session>& session, const Request& request) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  uint32_t CountSessions(const std::string& tenant) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void ReleaseSlot(const std::string& tenant) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  static SessionSums CloseRemoved(const Entry& entry, const char* reason);

  const Options options_;
  Store& store_;
  WorkerPool& pool_;
  const SessionFactory factory_;
  OrphanCollector orphans_;  // used by the server's own slow work only, which runs one item at a time
  // These are locked before mutex_, in this order: by request while a session is created for it, and by name while a
  // session is resumed or deleted: until it is in sessions_, or is not in the store any more.
  KeyedMutexes<Request> request_mutexes_;
  KeyedMutexes<std::string> session_mutexes_;
  mutable std::mutex mutex_;
  Entries sessions_ ABSL_GUARDED_BY(mutex_);
  WaitingSessions waiting_ ABSL_GUARDED_BY(mutex_);
  absl::Time found_at_ ABSL_GUARDED_BY(mutex_);  // of FindStored()
  std::map<Request, std::string> name_of_request_ ABSL_GUARDED_BY(mutex_);
  uint32_t reserved_slots_ ABSL_GUARDED_BY(mutex_) = 0;
  std::map<std::string, uint32_t> reserved_slots_by_ ABSL_GUARDED_BY(mutex_);  // tenant; no zeros
  std::map<std::pair<std::string, std::string>, std::weak_ptr<SessionMirror>> mirrors_
      ABSL_GUARDED_BY(mutex_);  // by tenant and name; replicas without watchers are removed by the next search
  bool is_draining_ ABSL_GUARDED_BY(mutex_) = false;
};

}  // namespace evpose::server
