// SPDX-License-Identifier: Apache-2.0
#include "server/telemetry/session_log.h"

#include <iterator>
#include <optional>

#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

constexpr char kNoServerHasIt[] = "no server has it, and it has expired";

std::vector<LogField> Outcome(const absl::Status& status) {
  return {{"code", absl::StatusCodeToString(status.code())},
          {"reason", GetErrorDetails(status).reason},
          {"message", status.message()}};
}

std::vector<LogField> FieldsOf(const SessionSums& sums) {
  const SessionHealth& health = sums.health;
  uint64_t losses = 0;
  for (const ObjectHealth& object : health.objects) losses += object.losses;
  return {{"lifetime_us", absl::ToInt64Microseconds(sums.lifetime)},
          {"objects", health.objects.size()},
          {"poses", health.poses},
          {"events", health.counts.cd_events},
          {"dropped_events", health.counts.dropped_events()},
          {"invalid_words", health.counts.invalid_words()},
          {"skipped_events", health.skipped_events},
          {"skipped_us", health.skipped_us},
          {"received_bytes", health.received_bytes},
          {"bytes", health.processed_bytes},
          {"sensor_time_us", health.sensor_time_us},
          {"processing_us", health.processing_us},
          {"latency_p50_us", health.latency_p50_us},
          {"latency_p99_us", health.latency_p99_us},
          {"losses", losses},
          {"reattaches", health.reattaches}};
}

void Append(std::vector<LogField> more, std::vector<LogField>& fields) {
  fields.insert(fields.end(), std::make_move_iterator(more.begin()), std::make_move_iterator(more.end()));
}

}  // namespace

StreamOrigin SessionLog::last_stream() const {
  const std::lock_guard lock(mutex_);
  return last_stream_;
}

std::shared_ptr<LogLimiter> SessionLog::MakeLimiter() {
  // Beyond the burst, 20 events with 400 bytes each fill less than 60 MB in an hour.
  return std::make_shared<LogLimiter>(
      LogLimiter::Options{.lines_per_s = 2.0, .burst_lines = 1000.0, .max_buckets = 4096});
}

void SessionLog::Write(LogLevel level, const char* event, const StreamOrigin& origin,
                       std::vector<LogField> more) const {
  if (limiter_ != nullptr && (level == LogLevel::kInfo || level == LogLevel::kWarning)) {
    const std::optional<uint64_t> suppressed = limiter_->Admit(event, tenant_);
    if (!suppressed.has_value()) return;
    if (*suppressed > 0) more.emplace_back("suppressed", *suppressed);
  }
  std::vector<LogField> fields = {
      {"session", session_}, {"tenant", tenant_}, {"peer", origin.peer}, {"trace_id", trace_id_}};
  if (!origin.span_id.empty()) fields.emplace_back("span_id", origin.span_id);
  Append(std::move(more), fields);
  Log(level, event, fields);
}

void SessionLog::WriteEnd(LogLevel level, const char* event, const StreamOrigin& origin, const char* cause,
                          const SessionSums& sums, std::vector<LogField> more) const {
  if (!sums.was_reported) {
    more.emplace_back("cause", cause);
    Append(FieldsOf(sums), more);
  }
  Write(level, event, origin, std::move(more));
}

void SessionLog::Created(const std::string& peer, const SessionConfig& config) {
  {
    const std::lock_guard lock(mutex_);
    last_stream_ = {.peer = peer};
  }
  Write(LogLevel::kInfo, "session_created", {.peer = peer},
        {{"encoding", EncodingName(config.encoding)},
         {"width", config.camera.width_px},
         {"height", config.camera.height_px},
         {"objects", config.objects.size()}});
}

void SessionLog::Resumed(uint64_t poses, bool has_ended) const {
  Write(LogLevel::kInfo, "session_resumed", last_stream(), {{"poses", poses}, {"ended", has_ended}});
}

void SessionLog::TrackerStateUnreadable(const std::string& why, uint64_t next_chunk, uint64_t poses) const {
  Write(LogLevel::kWarning, "tracker_state_unreadable", last_stream(),
        {{"message", why}, {"next_chunk", next_chunk}, {"poses", poses}});
}

void SessionLog::NotResumed(const absl::Status& status) const {
  Write(LogLevel::kError, "session_not_resumed", last_stream(), Outcome(status));
}

void SessionLog::MemoryExceeded(uint64_t charged_bytes, uint64_t max_bytes) const {
  Write(LogLevel::kWarning, "session_memory_exceeded", last_stream(),
        {{"charged_bytes", charged_bytes}, {"max_session_memory", max_bytes}});
}

void SessionLog::OutOfMemory() const { Write(LogLevel::kError, "session_out_of_memory", last_stream(), {}); }

void SessionLog::Attached(const StreamOrigin& origin, uint64_t number, uint64_t next_chunk, bool is_taken_over) {
  {
    const std::lock_guard lock(mutex_);
    last_stream_ = origin;
  }
  const char* event = is_taken_over ? "session_taken_over" : number > 1 ? "session_reattached" : "session_attached";
  std::vector<LogField> more = {{"stream", number}, {"next_chunk", next_chunk}};
  if (!origin.client_trace_id.empty()) more.emplace_back("client_trace_id", origin.client_trace_id);
  Write(LogLevel::kInfo, event, origin, std::move(more));
}

void SessionLog::NotAttached(const StreamOrigin& origin, const absl::Status& status, LogLimiter& limiter) const {
  constexpr char kEvent[] = "attach_refused";
  const std::optional<uint64_t> suppressed = limiter.Admit(kEvent, origin.peer);
  if (!suppressed.has_value()) return;
  std::vector<LogField> more = Outcome(status);
  more.emplace_back("suppressed", *suppressed);
  Write(LogLevel::kInfo, kEvent, origin, std::move(more));
}

void SessionLog::ObjectFound(const std::string& object_id, int64_t t_us, bool is_again) const {
  Write(LogLevel::kInfo, is_again ? "object_found_again" : "object_initialized", last_stream(),
        {{"object", object_id}, {"sensor_time_us", t_us}});
}

void SessionLog::ObjectLost(const std::string& object_id, int64_t t_us) const {
  Write(LogLevel::kInfo, "object_lost", last_stream(), {{"object", object_id}, {"sensor_time_us", t_us}});
}

void SessionLog::PhaseChanged(const std::string& object_id, const PhaseTransition& transition) const {
  if (CurrentLogLevel() > LogLevel::kDebug) return;
  const auto write = [&](const char* event, std::string_view from, std::string_view to) {
    Write(LogLevel::kDebug, event, last_stream(),
          {{"object", object_id}, {"from", from}, {"to", to}, {"sensor_time_us", transition.t_us}});
  };
  if (const auto* track = std::get_if<TrackTransition>(&transition.change)) {
    write("track_phase", TrackPhaseName(track->from), TrackPhaseName(track->to));
  } else {
    const auto& object = std::get<ObjectTransition>(transition.change);
    write("object_phase", ObjectPhaseName(object.from), ObjectPhaseName(object.to));
  }
}

void SessionLog::StreamPhaseChanged(const StreamOrigin& origin, uint64_t number, std::string_view from,
                                    std::string_view to) const {
  if (CurrentLogLevel() > LogLevel::kDebug) return;
  Write(LogLevel::kDebug, "stream_phase", origin, {{"stream", number}, {"from", from}, {"to", to}});
}

void SessionLog::StateChanged(const std::string& change, const std::string& from, const std::string& to) const {
  if (CurrentLogLevel() > LogLevel::kDebug) return;
  Write(LogLevel::kDebug, "session_state", last_stream(), {{"change", change}, {"from", from}, {"to", to}});
}

void SessionLog::StreamEnded(const StreamOrigin& origin, uint64_t number, const absl::Status& status) const {
  std::vector<LogField> more = {{"stream", number}};
  Append(Outcome(status), more);
  Write(LogLevel::kInfo, "stream_ended", origin, std::move(more));
}

void SessionLog::PaceChanged(bool is_behind, int64_t lag_us) const {
  Write(is_behind ? LogLevel::kWarning : LogLevel::kInfo, is_behind ? "session_falls_behind" : "session_keeps_up",
        last_stream(), {{"lag_us", lag_us}});
}

void SessionLog::Ended(const SessionSums& sums) const {
  WriteEnd(LogLevel::kInfo, "session_ended", last_stream(), "end_of_input", {sums.health, sums.lifetime}, {});
}

void SessionLog::Expired(const SessionSums& sums) const {
  WriteEnd(LogLevel::kInfo, "session_expired", last_stream(), "expired", sums, {});
}

void SessionLog::Deleted(const std::string& peer, const char* why, const SessionSums& sums) const {
  WriteEnd(LogLevel::kInfo, "session_deleted", {peer, last_stream().span_id, ""}, "deleted", sums, {{"why", why}});
}

void SessionLog::RolledBack(const StreamOrigin& origin, const absl::Status& status, const SessionSums& sums) const {
  WriteEnd(LogLevel::kError, "session_rolled_back", origin, "rolled_back", sums, Outcome(status));
}

void SessionLog::Orphaned(const SessionSums& sums) const {
  WriteEnd(LogLevel::kInfo, "session_deleted", {}, "expired", sums, {{"why", kNoServerHasIt}});
}

void SessionLog::DeletedUnread(const std::string& peer, const char* why) const {
  Write(LogLevel::kInfo, "session_deleted", {.peer = peer}, {{"why", why}});
}

void SessionLog::NotDeleted(const absl::Status& status) const {
  Write(LogLevel::kWarning, "session_not_deleted", last_stream(), Outcome(status));
}

void SessionLog::HeldByOtherServer() const {
  Write(LogLevel::kInfo, "session_held_by_other_server", last_stream(), {});
}

void SessionLog::Drained(uint64_t poses, bool is_durable) const {
  Write(is_durable ? LogLevel::kInfo : LogLevel::kWarning, "session_drained", last_stream(),
        {{"poses", poses}, {"durable", is_durable}});
}

void SessionLog::StoreUnavailable(const absl::Status& status) const {
  Write(LogLevel::kWarning, "session_waits_for_store", last_stream(), Outcome(status));
}

void SessionLog::StoreBack() const { Write(LogLevel::kInfo, "session_store_back", last_stream(), {}); }

void SessionLog::CommitSlow(absl::Duration duration, uint64_t bytes) const {
  Write(LogLevel::kWarning, "session_commit_slow", last_stream(),
        {{"duration_us", absl::ToInt64Microseconds(duration)}, {"bytes", bytes}});
}

void SessionLog::CommitFailed(const absl::Status& status) const {
  // Expected when a session moves, is deleted, or its server leaves.
  const std::string reason = GetErrorDetails(status).reason;
  const auto is = [&reason](v1::ErrorReason expected) { return reason == v1::ErrorReason_Name(expected); };
  const bool is_expected = is(v1::FENCED) || is(v1::SESSION_DELETED) || is(v1::DRAINING);
  Write(is_expected ? LogLevel::kInfo : LogLevel::kError, "session_commit_failed", last_stream(), Outcome(status));
}

}  // namespace evpose::server
