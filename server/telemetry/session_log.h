// SPDX-License-Identifier: Apache-2.0

// The log events of a session's life, each with the fields session, tenant, peer and trace_id, and span_id if a stream
// has attached.
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/time/time.h"
#include "core/base/trace_context.h"
#include "core/tracking/object/track_phase.h"
#include "server/sessions/types/session_config.h"
#include "server/sessions/types/session_state.h"
#include "server/telemetry/log.h"
#include "server/telemetry/log_limiter.h"

namespace evpose::server {

// The origin of a stream.
struct StreamOrigin {
  std::string peer;     // address of the client, "" if unknown
  std::string span_id;  // of the stream (core/base/trace_context.h)
  // The trace of the client's own program, if it has stated one; else empty. The session's trace does not depend on it.
  std::string client_trace_id;
};

// What a session has done from its start to its end, through restarts of the server.
struct SessionSums {
  SessionHealth health;
  absl::Duration lifetime;    // since the session was created, by the wall clock
  bool was_reported = false;  // an earlier line has the sums: the session had ended before
};

// One function for each event. A peer is the address of the client of a call, "" if unknown. Events without a call have
// the peer and the span ID of the stream that attached last. Thread-safe.
class SessionLog {
 public:
  // Without a limiter all lines are written.
  SessionLog(std::string session, std::string tenant, std::shared_ptr<LogLimiter> limiter = nullptr)
      : session_(std::move(session)),
        tenant_(std::move(tenant)),
        trace_id_(TraceIdOf(session_)),
        limiter_(std::move(limiter)) {}

  // Makes the limiter of all sessions of a server. A tenant can cause any number of most of these lines, for example by
  // attaching again and again. For each event, the burst is enough for all sessions of a large server at once; errors
  // have no limit.
  static std::shared_ptr<LogLimiter> MakeLimiter();

  const std::string& session() const { return session_; }
  const std::string& trace_id() const { return trace_id_; }

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
  void Attached(const StreamOrigin& origin, uint64_t number, uint64_t next_chunk, bool is_taken_over);
  // Logs at most at the rate that `limiter` admits, because a client can cause any number of these lines.
  void NotAttached(const StreamOrigin& origin, const absl::Status& status, LogLimiter& limiter) const;
  void ObjectFound(const std::string& object_id, int64_t t_us, bool is_again) const;
  void ObjectLost(const std::string& object_id, int64_t t_us) const;
  // Level debug, because the phase of an object may change at every millisecond of sensor time.
  void PhaseChanged(const std::string& object_id, const PhaseTransition& transition) const;
  // The phase of a Track stream (server/rpc/README.md). At level debug.
  void StreamPhaseChanged(const StreamOrigin& origin, uint64_t number, std::string_view from,
                          std::string_view to) const;
  // The states of the session's streams and input (server/sessions/README.md). At level debug.
  void StateChanged(const std::string& change, const std::string& from, const std::string& to) const;
  void StreamEnded(const StreamOrigin& origin, uint64_t number, const absl::Status& status) const;
  // The session has begun or ceased to fall behind its camera. `lag_us`: waiting time of the oldest unprocessed chunk.
  void PaceChanged(bool is_behind, int64_t lag_us) const;
  // The line of these five that comes first has the sums of the session, with the field `cause`; the session is then
  // over for its writer.
  void Ended(const SessionSums& sums) const;
  void Expired(const SessionSums& sums) const;
  void Deleted(const std::string& peer, const char* why, const SessionSums& sums) const;
  // The store has lost items that the client can no longer send.
  void RolledBack(const StreamOrigin& origin, const absl::Status& status, const SessionSums& sums) const;
  // A session that no server has was deleted, because it has expired.
  void Orphaned(const SessionSums& sums) const;
  // Does the same as Deleted() for a session that was deleted without being read, so that its sums are unknown.
  void DeletedUnread(const std::string& peer, const char* why) const;
  // The store could not delete a session that has expired.
  void NotDeleted(const absl::Status& status) const;
  // The session has expired here and stays in the store, because another server holds it.
  void HeldByOtherServer() const;
  void Drained(uint64_t poses, bool is_durable) const;
  void StoreUnavailable(const absl::Status& status) const;
  void StoreBack() const;
  // A checkpoint of this many bytes became durable after a long time, for the first time in a series.
  void CommitSlow(absl::Duration duration, uint64_t bytes) const;
  // The session writes nothing more to the store at this server, for the reason in `status`: another server has taken
  // it, it was deleted, or the store has failed.
  void CommitFailed(const absl::Status& status) const;

 private:
  StreamOrigin last_stream() const;
  // Adds the fields of the session, and writes the line unless the limiter suppresses it. `origin.span_id` may be
  // empty.
  void Write(LogLevel level, const char* event, const StreamOrigin& origin, std::vector<LogField> more) const;
  void WriteEnd(LogLevel level, const char* event, const StreamOrigin& origin, const char* cause,
                const SessionSums& sums, std::vector<LogField> more) const;

  const std::string session_;
  const std::string tenant_;
  const std::string trace_id_;
  const std::shared_ptr<LogLimiter> limiter_;
  mutable std::mutex mutex_;
  StreamOrigin last_stream_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
