// SPDX-License-Identifier: Apache-2.0

// The log events of a session's life, each with the fields session, tenant and peer.
#pragma once

#include <cstdint>
#include <mutex>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "core/tracking/track_phase.h"
#include "server/sessions/types/session_config.h"
#include "server/sessions/types/session_state.h"
#include "server/telemetry/log.h"
#include "server/telemetry/log_limiter.h"

namespace evpose::server {

// One function for each event. A peer is the address of the client of a call, "" if unknown. Events without a call have
// the peer that attached last. Thread-safe.
class SessionLog {
 public:
  SessionLog(std::string session, std::string tenant) : session_(std::move(session)), tenant_(std::move(tenant)) {}

  const std::string& session() const { return session_; }

  void Created(const std::string& peer, const SessionConfig& config);
  void Resumed(uint64_t poses, bool has_ended) const;  // the session was loaded from the store
  // The objects are searched for again from `next_chunk` on; the poses up to number `poses` are stored.
  void TrackerStateUnreadable(const std::string& why, uint64_t next_chunk, uint64_t poses) const;
  void NotResumed(const absl::Status& status) const;
  // A resumed session has been charged beyond the limit of the memory of sessions.
  void MemoryExceeded(uint64_t charged_bytes, uint64_t max_bytes) const;
  // An allocation for this session failed, and it was closed.
  void OutOfMemory() const;
  // `number` counts the streams of the session. `is_taken_over`: the previous stream was still open and is ended.
  void Attached(const std::string& peer, uint64_t number, uint64_t next_chunk, bool is_taken_over);
  // At the rate that `limiter` admits, because a client can cause any number of these lines.
  void NotAttached(const std::string& peer, const absl::Status& status, LogLimiter& limiter) const;
  void ObjectFound(const std::string& object_id, int64_t t_us, bool is_again) const;
  void ObjectLost(const std::string& object_id, int64_t t_us) const;
  // Level debug, because the phase of an object may change at every millisecond of sensor time.
  void PhaseChanged(const std::string& object_id, const PhaseTransition& transition) const;
  // The phase of a Track stream (server/rpc/README.md). At level debug.
  void StreamPhaseChanged(const std::string& peer, uint64_t number, std::string_view from, std::string_view to) const;
  // The states of the session's streams and input (server/sessions/README.md). At level debug.
  void StateChanged(const std::string& change, const std::string& from, const std::string& to) const;
  void StreamEnded(const std::string& peer, uint64_t number, const absl::Status& status) const;
  // The session has begun or ceased to fall behind its camera. `lag_us`: waiting time of the oldest unprocessed chunk.
  void PaceChanged(bool is_behind, int64_t lag_us) const;
  // The sums of the session, from its start and through restarts of the server, are a part of these three lines.
  void Ended(const SessionHealth& health) const;
  void Expired(const SessionHealth& health) const;
  void Deleted(const std::string& peer, const char* why, const SessionHealth& health) const;
  // The same for a session whose sums are not known, because it was not read.
  void DeletedUnread(const std::string& peer, const char* why) const;
  void NotDeleted(const absl::Status& status) const;
  void LivesElsewhere() const;
  void Drained(uint64_t poses, bool is_durable) const;
  void StoreAway(const absl::Status& status) const;
  void StoreBack() const;

 private:
  std::string peer() const;
  void Write(LogLevel level, const char* event, const std::string& peer, std::vector<LogField> more) const;

  const std::string session_;
  const std::string tenant_;
  mutable std::mutex mutex_;
  std::string peer_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
