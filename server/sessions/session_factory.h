// SPDX-License-Identifier: Apache-2.0

// Creates new sessions, and resumes stored ones.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "server/models/model_registry.h"
#include "server/runtime/worker_pool.h"
#include "server/sessions/memory/memory_budget.h"
#include "server/sessions/session.h"
#include "server/sessions/types/session_config.h"
#include "server/stores/common/store.h"

namespace evpose::server {

// Thread-safe. All functions except the constructor wait for the store.
class SessionFactory {
 public:
  struct Options {
    SessionLimits limits;
    TrackerFactory make_tracker;
    SessionClocks clocks;
    std::shared_ptr<ServerMetrics> metrics;
    std::shared_ptr<MemoryBudget> memory;
  };
  SessionFactory(Options options, Store& store, ModelRegistry& models, WorkerPool& pool)
      : options_(std::move(options)), store_(store), models_(models), pool_(pool) {}

  // Creates a session, which is persisted when this function returns. Errors: INVALID_ARGUMENT with the field,
  // NOT_FOUND (MODEL_NOT_FOUND), RESOURCE_EXHAUSTED (SESSION_MEMORY), ALREADY_EXISTS when the tenant has a session of
  // the same `request_id`, those of the store.
  absl::StatusOr<std::shared_ptr<Session>> MakeNew(const std::string& tenant, const SessionConfig& config,
                                                   const std::string& request_id) const;

  struct Resumed {
    std::shared_ptr<Session> session;
    SessionRecord record;
  };
  // Fences the server that has the session, and resumes the session from its last checkpoint. Errors: as Read.
  absl::StatusOr<Resumed> Resume(absl::string_view name) const;

  // The stored state of a session, with its poses after `after_pose_seq`; fences no server. Errors: NOT_FOUND
  // (SESSION_NOT_FOUND), DATA_LOSS (SESSION_DAMAGED), UNAVAILABLE (STORE_UNAVAILABLE).
  struct Stored {
    SessionRecord record;
    SessionLifecycle lifecycle;
    SessionInfo info;
    std::vector<StoredPose> poses;

    SessionSums Sums(absl::Time now) const {  // for the log
      const bool has_ended = info.snapshot.state == SessionState::kEnded || lifecycle.lost_from_seq > 0;
      return {.health = info.snapshot.health, .lifetime = now - record.create_time, .was_reported = has_ended};
    }
  };
  absl::StatusOr<Stored> Read(absl::string_view name, uint64_t after_pose_seq = 0) const;
  // Reads several sessions without poses by one call of the store. Those that do not exist or are damaged are omitted.
  // Errors: those of the store.
  absl::StatusOr<std::vector<Stored>> ReadWithoutPoses(const std::vector<std::string>& names) const;

 private:
  // The models of the objects of a session, and the handles that protect them from deletion.
  struct Models {
    std::vector<std::shared_ptr<const ObjectModel>> models;
    std::vector<std::shared_ptr<const void>> uses;
    std::vector<MemoryCharge> charges;  // of each model
  };
  // If the models are charged, each one is before the next one is loaded.
  absl::StatusOr<Models> UseModels(const std::string& tenant, const SessionConfig& config, bool are_charged) const;
  // `stored` has only the poses after `after_pose_seq`. Errors: DATA_LOSS.
  absl::StatusOr<Stored> Decode(StoredSession stored, uint64_t after_pose_seq) const;
  absl::Status CheckModelsStored(const std::string& tenant, const SessionConfig& config) const;
  SessionParts MakeParts(const std::string& name, const std::string& tenant) const;
  SessionMemory MemoryOf(const SessionConfig& config,
                         const std::vector<std::shared_ptr<const ObjectModel>>& models) const;
  // Returns a pipeline in the state of the checkpoint of `beginning`. If the state of the tracker is unreadable, the
  // pipeline searches for every object, and `beginning.restarted` is set.
  absl::StatusOr<std::unique_ptr<SessionPipeline>> RestorePipeline(
      const SessionConfig& config, const std::vector<std::shared_ptr<const ObjectModel>>& models,
      SessionBeginning& beginning) const;
  absl::StatusOr<std::shared_ptr<Session>> Restore(StoredSession stored, std::unique_ptr<SessionLease> lease) const;

  const Options options_;
  Store& store_;
  ModelRegistry& models_;
  WorkerPool& pool_;
};

// Returns the error NOT_FOUND (SESSION_NOT_FOUND).
absl::Status SessionNotFound(absl::string_view name);

}  // namespace evpose::server
