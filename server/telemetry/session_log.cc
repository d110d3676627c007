// SPDX-License-Identifier: Apache-2.0
#include "server/telemetry/session_log.h"

#include <optional>

#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

std::vector<LogField> Outcome(const absl::Status& status) {
  return {{"code", absl::StatusCodeToString(status.code())},
          {"reason", GetErrorDetails(status).reason},
          {"message", status.message()}};
}

std::vector<LogField> Sums(const SessionHealth& health) {
  uint64_t losses = 0;
  for (const ObjectHealth& object : health.objects) losses += object.losses;
  return {{"poses", health.poses},
          {"events", health.counts.cd_events},
          {"dropped_events", health.counts.dropped_events()},
          {"skipped_events", health.skipped_events},
          {"bytes", health.processed_bytes},
          {"sensor_time_us", health.sensor_time_us},
          {"processing_us", health.processing_us},
          {"latency_p50_us", health.latency_p50_us},
          {"latency_p99_us", health.latency_p99_us},
          {"losses", losses},
          {"reattaches", health.reattaches}};
}

}  // namespace

std::string SessionLog::peer() const {
  const std::lock_guard lock(mutex_);
  return peer_;
}

void SessionLog::Write(LogLevel level, const char* event, const std::string& peer, std::vector<LogField> more) const {
  std::vector<LogField> fields = {{"session", session_}, {"tenant", tenant_}, {"peer", peer}};
  fields.insert(fields.end(), std::make_move_iterator(more.begin()), std::make_move_iterator(more.end()));
  Log(level, event, fields);
}

void SessionLog::Created(const std::string& peer, const SessionConfig& config) {
  {
    const std::lock_guard lock(mutex_);
    peer_ = peer;
  }
  Write(LogLevel::kInfo, "session_created", peer,
        {{"encoding", EncodingName(config.encoding)},
         {"width", config.camera.width_px},
         {"height", config.camera.height_px},
         {"objects", config.objects.size()}});
}

void SessionLog::Resumed(uint64_t poses, bool has_ended) const {
  Write(LogLevel::kInfo, "session_resumed", peer(), {{"poses", poses}, {"ended", has_ended}});
}

void SessionLog::TrackerStateUnreadable(const std::string& why, uint64_t next_chunk, uint64_t poses) const {
  Write(LogLevel::kWarning, "tracker_state_unreadable", peer(),
        {{"message", why}, {"next_chunk", next_chunk}, {"poses", poses}});
}

void SessionLog::NotResumed(const absl::Status& status) const {
  Write(LogLevel::kError, "session_not_resumed", peer(), Outcome(status));
}

void SessionLog::MemoryExceeded(uint64_t charged_bytes, uint64_t max_bytes) const {
  Write(LogLevel::kWarning, "session_memory_exceeded", peer(),
        {{"charged_bytes", charged_bytes}, {"max_session_memory", max_bytes}});
}

void SessionLog::OutOfMemory() const { Write(LogLevel::kError, "session_out_of_memory", peer(), {}); }

void SessionLog::Attached(const std::string& peer, uint64_t number, uint64_t next_chunk, bool is_taken_over) {
  {
    const std::lock_guard lock(mutex_);
    peer_ = peer;
  }
  const char* event = is_taken_over ? "session_taken_over" : number > 1 ? "session_reattached" : "session_attached";
  Write(LogLevel::kInfo, event, peer, {{"stream", number}, {"next_chunk", next_chunk}});
}

void SessionLog::NotAttached(const std::string& peer, const absl::Status& status, LogLimiter& limiter) const {
  constexpr char kEvent[] = "attach_refused";
  const std::optional<uint64_t> suppressed = limiter.Admit(kEvent, peer);
  if (!suppressed.has_value()) return;
  std::vector<LogField> more = Outcome(status);
  more.emplace_back("suppressed", *suppressed);
  Write(LogLevel::kInfo, kEvent, peer, std::move(more));
}

void SessionLog::ObjectFound(const std::string& object_id, int64_t t_us, bool is_again) const {
  Write(LogLevel::kInfo, is_again ? "object_found_again" : "object_initialized", peer(),
        {{"object", object_id}, {"sensor_time_us", t_us}});
}

void SessionLog::ObjectLost(const std::string& object_id, int64_t t_us) const {
  Write(LogLevel::kInfo, "object_lost", peer(), {{"object", object_id}, {"sensor_time_us", t_us}});
}

void SessionLog::PhaseChanged(const std::string& object_id, const PhaseTransition& transition) const {
  if (CurrentLogLevel() > LogLevel::kDebug) return;
  const auto write = [&](const char* event, std::string_view from, std::string_view to) {
    Write(LogLevel::kDebug, event, peer(),
          {{"object", object_id}, {"from", from}, {"to", to}, {"sensor_time_us", transition.t_us}});
  };
  if (const auto* track = std::get_if<TrackTransition>(&transition.change)) {
    write("track_phase", TrackPhaseName(track->from), TrackPhaseName(track->to));
  } else {
    const auto& object = std::get<ObjectTransition>(transition.change);
    write("object_phase", ObjectPhaseName(object.from), ObjectPhaseName(object.to));
  }
}

void SessionLog::StreamPhaseChanged(const std::string& peer, uint64_t number, std::string_view from,
                                    std::string_view to) const {
  if (CurrentLogLevel() > LogLevel::kDebug) return;
  Write(LogLevel::kDebug, "stream_phase", peer, {{"stream", number}, {"from", from}, {"to", to}});
}

void SessionLog::StateChanged(const std::string& change, const std::string& from, const std::string& to) const {
  if (CurrentLogLevel() > LogLevel::kDebug) return;
  Write(LogLevel::kDebug, "session_state", peer(), {{"change", change}, {"from", from}, {"to", to}});
}

void SessionLog::StreamEnded(const std::string& peer, uint64_t number, const absl::Status& status) const {
  std::vector<LogField> more = {{"stream", number}};
  for (LogField& field : Outcome(status)) more.push_back(std::move(field));
  Write(LogLevel::kInfo, "stream_ended", peer, std::move(more));
}

void SessionLog::PaceChanged(bool is_behind, int64_t lag_us) const {
  Write(is_behind ? LogLevel::kWarning : LogLevel::kInfo, is_behind ? "session_falls_behind" : "session_keeps_up",
        peer(), {{"lag_us", lag_us}});
}

void SessionLog::Ended(const SessionHealth& health) const {
  Write(LogLevel::kInfo, "session_ended", peer(), Sums(health));
}

void SessionLog::Expired(const SessionHealth& health) const {
  Write(LogLevel::kInfo, "session_expired", peer(), Sums(health));
}

void SessionLog::Deleted(const std::string& peer, const char* why, const SessionHealth& health) const {
  std::vector<LogField> more = {{"why", why}};
  for (LogField& field : Sums(health)) more.push_back(std::move(field));
  Write(LogLevel::kInfo, "session_deleted", peer, std::move(more));
}

void SessionLog::DeletedUnread(const std::string& peer, const char* why) const {
  Write(LogLevel::kInfo, "session_deleted", peer, {{"why", why}});
}

void SessionLog::NotDeleted(const absl::Status& status) const {
  Write(LogLevel::kWarning, "session_not_deleted", peer(), Outcome(status));
}

void SessionLog::LivesElsewhere() const { Write(LogLevel::kInfo, "session_held_by_other_server", peer(), {}); }

void SessionLog::Drained(uint64_t poses, bool is_durable) const {
  Write(is_durable ? LogLevel::kInfo : LogLevel::kWarning, "session_drained", peer(),
        {{"poses", poses}, {"durable", is_durable}});
}

void SessionLog::StoreAway(const absl::Status& status) const {
  Write(LogLevel::kWarning, "session_waits_for_store", peer(), Outcome(status));
}

void SessionLog::StoreBack() const { Write(LogLevel::kInfo, "session_store_back", peer(), {}); }

}  // namespace evpose::server
