// SPDX-License-Identifier: Apache-2.0

// All sessions of a server: making, finding, taking up, expiring, deleting them. Each belongs to a tenant; to any other
// it is as if it were not there.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "server/models/model_registry.h"
#include "server/runtime/worker_pool.h"
#include "server/sessions/durability/orphan_sweep.h"
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
    uint32_t max_sessions = 64;
    uint32_t max_tenant_sessions = 64;  // of one tenant
    SessionLimits limits;
    TrackerFactory make_tracker;
    // Other servers use the same store: a session is taken from it when a client attaches to it here, not before.
    bool shares_store = false;
    std::function<absl::Time()> now;  // for life spans only, never for results
    std::function<Session::SteadyTime()> steady_now = std::chrono::steady_clock::now;  // as Session::Parts::steady_now
    std::shared_ptr<ServerMetrics> metrics = std::make_shared<ServerMetrics>();
  };

  SessionManager(const Options& options, Store& store, ModelRegistry& models, WorkerPool& pool);
  ~SessionManager();

  // Idempotent per tenant and `request_id` unless that is empty. Peers are for the log. Slow: makes the trackers.
  // Errors: INVALID_ARGUMENT with the field, NOT_FOUND (MODEL_NOT_FOUND), ALREADY_EXISTS (REQUEST_ID_REUSED),
  // RESOURCE_EXHAUSTED (TOO_MANY_SESSIONS, TENANT_QUOTA), UNAVAILABLE (DRAINING).
  absl::StatusOr<std::shared_ptr<Session>> Create(const std::string& tenant, const SessionConfig& config,
                                                  const std::string& request_id, const std::string& peer = "");
  // Takes up all sessions that the store has, unless it is shared; names in the log those that are damaged, which stay
  // in the store. Before anything else. Errors: those of the store.
  absl::Status RestoreAll();

  // Of this server. Errors: NOT_FOUND (SESSION_NOT_FOUND).
  absl::StatusOr<std::shared_ptr<Session>> Get(const std::string& tenant, absl::string_view name);
  // What Get does not find: a session of another server on the same store, for those who look on; one mirror serves all
  // of them. Waits for the store. Errors: NOT_FOUND (SESSION_NOT_FOUND), DATA_LOSS (SESSION_DAMAGED), UNAVAILABLE
  // (STORE_AWAY).
  absl::StatusOr<std::shared_ptr<WatchedSession>> Mirror(const std::string& tenant, const std::string& name);
  // The session, when it is here and takes this token; else null, and TakeForAttach has to be asked.
  std::shared_ptr<Session> FindForAttach(const std::string& tenant, absl::string_view name,
                                         absl::string_view resume_token);
  // Waits for the store, from which it takes a session that is not here, and that closed here: fenced by another server
  // or for want of room. Errors: NOT_FOUND (SESSION_NOT_FOUND), PERMISSION_DENIED (WRONG_TOKEN), DATA_LOSS
  // (SESSION_DAMAGED), RESOURCE_EXHAUSTED (TOO_MANY_SESSIONS, TENANT_QUOTA), UNAVAILABLE (STORE_AWAY).
  absl::StatusOr<std::shared_ptr<Session>> TakeForAttach(const std::string& tenant, const std::string& name,
                                                         absl::string_view resume_token);
  // The next three know the sessions of other servers, too, and wait for the store where they have to.
  // Errors: NOT_FOUND (SESSION_NOT_FOUND), DATA_LOSS (SESSION_DAMAGED), UNAVAILABLE (STORE_AWAY).
  absl::StatusOr<SessionInfo> Describe(const std::string& tenant, const std::string& name);
  // At most `max_sessions` whose names come after `after_name`, in their order.
  absl::StatusOr<std::vector<SessionInfo>> List(const std::string& tenant, absl::string_view after_name,
                                                size_t max_sessions);
  // Deleting what is not there is OK.
  absl::Status Delete(const std::string& tenant, const std::string& name, const std::string& peer = "");
  // Deletes the sessions whose time is over. The other calls do so, too, before they look.
  void DeleteExpired();
  // Has the store delete what ended long ago, and what must make room, some time soon.
  void DeleteEnded();
  // Has the sessions deleted, some time soon, that are in the store alone and whose time is over: their server died, or
  // the store had no room for them. On a shared store it first shows that this server has those that streams are
  // attached to.
  void TendStore();

  // From now on Create and CheckNotDraining fail.
  void Drain();
  absl::Status CheckNotDraining() const;
  // Has every session stop where it is, and waits until all of that is durable, until the deadline. False: it is not.
  bool SettleAll(absl::Time deadline);
  // Ends every session.
  void CloseAll(const absl::Status& status);

  // By all sessions there ever were: the sum of SessionHealth::skipped_events, that of deleted ones included.
  uint64_t skipped_events() const { return options_.metrics->all_skipped_events(); }
  uint32_t num_sessions() const;
  uint32_t num_sessions_of(const std::string& tenant) const;
  uint32_t num_attached() const;
  SessionTotals totals() const;
  const Options& options() const { return options_; }

 private:
  using Request = std::pair<std::string, std::string>;  // tenant, request_id
  struct Entry {
    std::shared_ptr<Session> session;
    Request request;

    const std::string& tenant() const { return request.first; }
  };
  using Entries = std::map<std::string, Entry, std::less<>>;

  // The session of an earlier request, or null after taking a slot.
  absl::StatusOr<std::shared_ptr<Session>> FindOrTakeSlot(const SessionConfig& config, const Request& request);
  absl::Status CheckSlotIsFree(const std::string& tenant) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // The same that another server made, taken from it; null when there is none.
  absl::StatusOr<std::shared_ptr<Session>> TakeRequest(const SessionConfig& config, const Request& request);
  absl::StatusOr<std::shared_ptr<Session>> FindRequest(const SessionConfig& config, const Request& request)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool IsHere(const std::string& name) const;
  // Null when it is not here, or is closed.
  std::shared_ptr<Session> FindOpen(const std::string& tenant, absl::string_view name);
  std::vector<std::shared_ptr<Session>> Sessions() const;
  // Null when nobody watches it yet.
  std::shared_ptr<SessionMirror> FindMirror(const std::string& tenant, const std::string& name);
  // From the store, if it is this tenant's: to others it is not there. Errors: as Describe.
  absl::StatusOr<SessionFactory::Stored> ReadOwn(const std::string& tenant, const std::string& name) const;
  absl::Status DeleteStored(const std::string& tenant, const std::string& name, const std::string& peer);
  absl::StatusOr<std::shared_ptr<Session>> Take(const std::string& name);
  void Insert(const std::shared_ptr<Session>& session, const Request& request) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  uint32_t CountSessions(const std::string& tenant) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void GiveSlotBack(const std::string& tenant) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void DeleteEndedNow();
  static uint64_t CloseRemoved(const Entry& entry, const char* reason);  // how many poses it made

  const Options options_;
  Store& store_;
  WorkerPool& pool_;
  const SessionFactory factory_;
  OrphanSweep orphans_;    // of the pool's slow thread
  std::mutex take_mutex_;  // one at a time is taken, or made for a request; before mutex_
  mutable std::mutex mutex_;
  Entries sessions_ ABSL_GUARDED_BY(mutex_);
  std::map<Request, std::string> name_of_request_ ABSL_GUARDED_BY(mutex_);
  uint32_t slots_being_filled_ ABSL_GUARDED_BY(mutex_) = 0;
  std::map<std::string, uint32_t> slots_being_filled_by_ ABSL_GUARDED_BY(mutex_);  // tenant; no zeros
  std::map<std::pair<std::string, std::string>, std::weak_ptr<SessionMirror>> mirrors_
      ABSL_GUARDED_BY(mutex_);  // by tenant and name; those that nobody watches any more are left out, some time
  bool draining_ ABSL_GUARDED_BY(mutex_) = false;
};

}  // namespace evpose::server
