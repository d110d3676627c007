// All sessions of a server: making, finding, expiring, deleting them.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "server/sessions/model_registry.h"
#include "server/sessions/session.h"
#include "server/sessions/session_config.h"
#include "server/sessions/worker_pool.h"
#include "server/stores/store.h"

namespace evpose::server {

// Thread-safe.
class SessionManager {
 public:
  struct Options {
    uint32_t max_sessions = 64;
    SessionLimits limits;
    TrackerFactory make_tracker;
    std::function<absl::Time()> now;  // for life spans only, never for results
  };

  SessionManager(const Options& options, Store& store, ModelRegistry& models, WorkerPool& pool);
  ~SessionManager();

  // Idempotent per `request_id` unless that is empty. Slow: makes the trackers. Errors: INVALID_ARGUMENT with the
  // field, NOT_FOUND (MODEL_NOT_FOUND), ALREADY_EXISTS (REQUEST_ID_REUSED), RESOURCE_EXHAUSTED (TOO_MANY_SESSIONS),
  // UNAVAILABLE (DRAINING).
  absl::StatusOr<std::shared_ptr<Session>> Create(const SessionConfig& config, const std::string& request_id);
  // Errors: NOT_FOUND (SESSION_NOT_FOUND).
  absl::StatusOr<std::shared_ptr<Session>> Get(absl::string_view name);
  // At most `max_sessions` whose names come after `after_name`, in their order.
  std::vector<std::shared_ptr<Session>> List(absl::string_view after_name, size_t max_sessions);
  // Deleting what is not there is OK.
  void Delete(absl::string_view name);
  // Deletes the sessions whose time is over. The other calls do so, too, before they look.
  void DeleteExpired();

  // From now on Create and CheckNotDraining fail.
  void Drain();
  absl::Status CheckNotDraining() const;
  // Ends every session.
  void CloseAll(const absl::Status& status);

  uint32_t num_sessions() const;
  const Options& options() const { return options_; }

 private:
  struct Entry {
    std::shared_ptr<Session> session;
    std::string request_id;
  };
  using Entries = std::map<std::string, Entry, std::less<>>;

  // The session of an earlier request, or null after taking a slot.
  absl::StatusOr<std::shared_ptr<Session>> FindOrTakeSlot(const SessionConfig& config, const std::string& request_id);
  absl::StatusOr<std::shared_ptr<Session>> FindRequest(const SessionConfig& config, const std::string& request_id)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::StatusOr<std::shared_ptr<Session>> Build(const SessionConfig& config);
  absl::StatusOr<std::shared_ptr<Session>> Insert(std::shared_ptr<Session> session, const std::string& request_id);
  void Remove(std::vector<Entry> entries, const char* reason);

  const Options options_;
  Store& store_;
  ModelRegistry& models_;
  WorkerPool& pool_;
  mutable std::mutex mutex_;
  Entries sessions_ ABSL_GUARDED_BY(mutex_);
  std::map<std::string, std::string> name_of_request_ ABSL_GUARDED_BY(mutex_);
  uint32_t slots_being_filled_ ABSL_GUARDED_BY(mutex_) = 0;
  bool draining_ ABSL_GUARDED_BY(mutex_) = false;
};

}  // namespace evpose::server
