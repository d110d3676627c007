#include "client/cli/replay_report.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace evpose::client {
namespace {

std::string Milliseconds(const std::optional<absl::Duration>& duration) {
  return duration ? absl::StrFormat("%.2f ms", absl::ToDoubleMilliseconds(*duration)) : "-";
}

Json MillisecondsJson(const std::optional<absl::Duration>& duration) {
  return duration ? Json(absl::ToDoubleMilliseconds(*duration)) : Json(nullptr);
}

}  // namespace

void ReplayReport::Add(const Notice& notice) {
  if (const auto* change = std::get_if<StateChange>(&notice)) last_change_us_ = change->t_us;
  if (const auto* fault = std::get_if<DecodeFault>(&notice)) {
    if (decode_faults_ == 0) first_decode_fault_ = absl::StrCat("chunk ", fault->chunk_seq, ": ", fault->detail);
    decode_faults_ += fault->count;
  }
}

std::string ReplayReport::WhyNoPose() const {
  if (Object() == nullptr) return "";
  if (Object()->state == TrackState::kInitializing) return absl::StrCat("never found: ", Object()->detail);
  if (Object()->state != TrackState::kLost) return "";
  return absl::StrFormat("LOST: the object is lost since %.6f s; no pose is claimed from then on: %s",
                         last_change_us_ * 1e-6, Object()->detail);
}

double ReplayReport::MegaEventsPerSecond() const {
  const double seconds = absl::ToDoubleSeconds(wall_time);
  return seconds > 0.0 ? static_cast<double>(summary.health.decoded_events) * 1e-6 / seconds : 0.0;
}

void ReplayReport::Print(std::ostream& stream) const {
  const SessionHealth& health = summary.health;
  stream << recording << ": " << EncodingName(header.encoding) << " " << header.geometry.width_px << "x"
         << header.geometry.height_px << ", " << summary.sent_bytes << " bytes in " << summary.sent_chunks
         << " chunks\n";
  for (const std::string& notice : model_notices) stream << "model: " << notice << "\n";
  if (is_interrupted) stream << "interrupted: only what was read until then\n";
  if (truncated_bytes > 0) {
    stream << "truncated: the last " << truncated_bytes << " bytes are no whole word; all before them were used\n";
  }
  if (decode_faults_ > 0) {
    stream << "decoder: skipped " << decode_faults_ << " words or events, the first in " << first_decode_fault_ << "\n";
  }
  if (num_symmetries > 1) {
    stream << "model: looks the same in " << num_symmetries << " orientations; a pose stands for all of them\n";
  }
  if (const std::string why = WhyNoPose(); !why.empty()) stream << why << "\n";
  if (!session.empty()) stream << "session: " << session << "\n";
  if (!out.empty()) stream << out << ": " << summary.poses << " poses\n";
  stream << absl::StrFormat("events %d  poses %d  losses %d  %.2f Mev/s  latency p50 %s  p99 %s\n",
                            health.decoded_events, summary.poses, Object() == nullptr ? 0 : Object()->losses,
                            MegaEventsPerSecond(), Milliseconds(health.latency_p50), Milliseconds(health.latency_p99));
}

Json ReplayReport::ToJson() const {
  const SessionHealth& health = summary.health;
  Json json;
  json["recording"] = recording;
  json["out"] = out.empty() ? Json(nullptr) : Json(out);
  json["session"] = session.empty() ? Json(nullptr) : Json(session);
  json["events"] = health.decoded_events;
  json["poses"] = summary.poses;
  json["losses"] = Object() == nullptr ? 0 : Object()->losses;
  json["state"] = Object() == nullptr ? Json(nullptr) : Json(std::string(TrackStateName(Object()->state)));
  json["initialization"] =
      Object() == nullptr ? Json(nullptr) : Json(std::string(InitializationStatusName(Object()->initialization)));
  json["initialization_attempts"] = Object() == nullptr ? 0 : Object()->initialization_attempts;
  json["detail"] = Object() == nullptr ? "" : Object()->detail;
  json["model_notices"] = model_notices;
  json["symmetries"] = num_symmetries;
  json["mev_per_s"] = MegaEventsPerSecond();
  json["latency_p50_ms"] = MillisecondsJson(health.latency_p50);
  json["latency_p99_ms"] = MillisecondsJson(health.latency_p99);
  json["wall_time_s"] = absl::ToDoubleSeconds(wall_time);
  json["t_last_us"] = health.t_us;
  json["sent_bytes"] = summary.sent_bytes;
  json["sent_chunks"] = summary.sent_chunks;
  json["truncated_bytes"] = truncated_bytes;
  json["dropped_events"] = health.dropped_events;
  json["invalid_words"] = health.invalid_words;
  json["time_backsteps"] = health.time_backsteps;
  json["interrupted"] = is_interrupted;
  return json;
}

}  // namespace evpose::client
