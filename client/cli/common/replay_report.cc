// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/replay_report.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/cli/common/pace_meter.h"
#include "client/cli/common/recording_input.h"
#include "core/base/counted.h"

namespace evpose::client {
namespace {

std::string Milliseconds(const std::optional<absl::Duration>& duration) {
  return duration ? absl::StrFormat("%.2f ms", absl::ToDoubleMilliseconds(*duration)) : "-";
}

// Appends a loss that differs from the last one, if there is room for it.
void AddLoss(const std::optional<Loss>& loss, size_t max_size, std::vector<Loss>& losses) {
  if (!loss || losses.size() >= max_size || (!losses.empty() && losses.back() == *loss)) return;
  losses.push_back(*loss);
}

}  // namespace

void ReplayReport::Add(const Notice& notice) {
  if (const auto* triggers = std::get_if<Triggers>(&notice)) {
    triggers_ += triggers->triggers.size() + triggers->num_skipped;
  }
  if (const auto* fault = std::get_if<DecodeFault>(&notice)) {
    if (decode_faults_ == 0) first_decode_fault_ = absl::StrCat("chunk ", fault->chunk_seq, ": ", fault->detail);
    decode_faults_ += fault->count;
  }
  if (const auto* restart = std::get_if<TrackingRestarted>(&notice)) restarts_.push_back(*restart);
}

void ReplayReport::Add(const Pose& pose) {
  Received& received = received_[pose.object_id];
  ++received.poses;
  if (pose.state == TrackState::kTracking) ++received.tracking_poses;
  if (pose.state == TrackState::kDegraded) ++received.degraded_poses;
  if (pose.state == TrackState::kAmbiguous) ++received.ambiguous_poses;
  AddLoss(pose.latest_loss, kMaxLosses, received.losses);
}

uint64_t ReplayReport::Total(uint64_t Received::*number) const {
  uint64_t sum = 0;
  for (const auto& [object_id, received] : received_) sum += received.*number;
  return sum;
}

std::vector<std::string> ReplayReport::ObjectsWithoutPose() const {
  std::vector<std::string> object_ids;
  if (!KnowsAllPoses()) return object_ids;
  for (const ObjectHealth& object : summary.health.objects) {
    if (!received_.contains(object.object_id)) object_ids.push_back(object.object_id);
  }
  return object_ids;
}

bool ReplayReport::HasOnlyFilesWithoutPose() const {
  const auto is_without_pose = [](const PoseFile& file) { return file.num_poses == 0; };
  return !files.empty() && std::all_of(files.begin(), files.end(), is_without_pose) &&
         summary.poses > summary.lost_poses;
}

bool ReplayReport::KeepsOlderFiles() const {
  return std::any_of(files.begin(), files.end(), [](const PoseFile& file) { return file.keeps_older; });
}

std::string ReplayReport::NameOf(const std::string& object_id) const {
  return models.size() > 1 ? object_id + ": " : "";
}

std::string ReplayReport::WhyNoPose(const ObjectHealth& object) const {
  switch (object.state) {
    case TrackState::kInitializing:
      return absl::StrCat("no pose found: ", object.detail);
    case TrackState::kLost:
      return absl::StrCat("LOST: ", object.detail);
    case TrackState::kAmbiguous:
      return absl::StrCat("AMBIGUOUS: ", object.detail);
    case TrackState::kUnknown:
      return absl::StrCat("no confirmed pose, in a state of a later server: ", object.detail);
    case TrackState::kTracking:
    case TrackState::kDegraded:
      break;
  }
  return "";
}

std::vector<Loss> ReplayReport::LossesOf(const ObjectHealth& object) const {
  const auto received = received_.find(object.object_id);
  std::vector<Loss> losses = received != received_.end() ? received->second.losses : std::vector<Loss>();
  AddLoss(object.latest_loss, kMaxLosses + 1, losses);  // no pose may have followed it
  return losses;
}

std::string ReplayReport::DescribeLosses(const ObjectHealth& object) const {
  constexpr size_t kMaxPrinted = 5;
  const std::vector<Loss> losses = LossesOf(object);
  // If there is one loss and the object is still lost, the reason for the missing pose states it already.
  if (losses.empty() || (losses.size() == 1 && object.state == TrackState::kLost)) return "";
  std::vector<std::string> parts;
  for (size_t i = 0; i < std::min(losses.size(), kMaxPrinted); ++i) {
    parts.push_back(
        absl::StrFormat("at %.6f s (%s)", 1e-6 * static_cast<double>(losses[i].t_us), LossCauseName(losses[i].cause)));
  }
  std::string line = absl::StrCat("lost ", Counted(object.losses, "time"), ": ", absl::StrJoin(parts, ", "));
  if (object.losses > parts.size()) absl::StrAppend(&line, ", and ", object.losses - parts.size(), " more");
  return line;
}

uint32_t ReplayReport::Losses() const {
  uint32_t losses = 0;
  for (const ObjectHealth& object : summary.health.objects) losses += object.losses;
  return losses;
}

Json ReplayReport::ObjectsJson() const {
  Json objects = Json::array();
  for (size_t i = 0; i < summary.health.objects.size(); ++i) {
    const ObjectHealth& object = summary.health.objects[i];
    Json json = ObjectJson(object);
    json["all_losses"] = Json::array();
    for (const Loss& loss : LossesOf(object)) {
      json["all_losses"].push_back({{"t_us", loss.t_us}, {"cause", LossCauseName(loss.cause)}});
    }
    json["model_notices"] = i < models.size() ? models[i].notices : std::vector<std::string>();
    json["symmetries"] = i < models.size() ? models[i].num_symmetries : 1;
    json["continuous_symmetry"] = i < models.size() ? SymmetryJson(models[i].continuous_symmetry) : Json(nullptr);
    json["model_diameter_m"] = i < models.size() ? models[i].diameter_m : 0.0;
    objects.push_back(std::move(json));
  }
  return objects;
}

double ReplayReport::MegaEventsPerSecond() const {
  const double seconds = absl::ToDoubleSeconds(wall_time);
  return seconds > 0.0 ? static_cast<double>(summary.health.decoded_events) * 1e-6 / seconds : 0.0;
}

void ReplayReport::PrintInput(std::ostream& stream) const {
  const SessionHealth& health = summary.health;
  stream << recording << ": " << EncodingName(header.encoding) << " " << header.geometry.width_px << "x"
         << header.geometry.height_px << ", " << summary.sent_bytes << " bytes in " << summary.sent_chunks
         << " chunks\n";
  for (const Model& model : models) {
    for (const std::string& notice : model.notices) stream << NameOf(model.object_id) << "model: " << notice << "\n";
  }
  if (is_interrupted) stream << "interrupted: only the events read until then\n";
  if (outages > 0) {
    stream << absl::StrFormat("connection: lost %s, unreachable for %.1f s in all; %s\n",
                              Counted(static_cast<uint64_t>(outages), "time"), absl::ToDoubleSeconds(away_for),
                              summary.lost_poses > 0
                                  ? absl::StrCat(Counted(summary.lost_poses, "pose"), " not received")
                                  : "nothing was lost");
  }
  for (const TrackingRestarted& restart : restarts_) {
    stream << "tracking: restarted after chunk " << restart.after_seq;
    if (restart.after_pose_seq) stream << " and pose " << *restart.after_pose_seq;
    stream << ", every object was searched for again: " << restart.detail << "\n";
  }
  if (health.skipped_events > 0) {
    stream << absl::StrFormat("skipped: %d events, %.3f s, that the server could not track in time\n",
                              health.skipped_events, static_cast<double>(health.skipped_us) * 1e-6);
  }
  if (!skipped.empty()) stream << "left out of the recording: " << DescribeSkipped(skipped) << "\n";
  if (truncated_bytes > 0) {
    stream << "truncated: "
           << (truncated_bytes == 1 ? "the last byte is" : absl::StrCat("the last ", truncated_bytes, " bytes are"))
           << " no whole word; all before were used\n";
  }
  if (decode_faults_ > 0) {
    stream << "decoder: skipped " << decode_faults_ << " words or events, the first in " << first_decode_fault_ << "\n";
  }
}

void ReplayReport::PrintObjects(std::ostream& stream) const {
  for (const Model& model : models) {
    // The scale of a model cannot be observed: the translations of the poses scale with it.
    stream << NameOf(model.object_id) << "model: " << FormatLength(model.diameter_m) << " across";
    if (model.num_symmetries > 1) {
      stream << "; looks the same in " << model.num_symmetries << " orientations; a pose represents all of them";
    }
    if (model.continuous_symmetry) {
      stream << "; symmetric about an axis or a centre; the rotation about it is not measured";
    }
    stream << "\n";
  }
  for (const ObjectHealth& object : summary.health.objects) {
    if (models.size() > 1) {
      stream << object.object_id << ": " << TrackStateName(object.state) << "  losses " << object.losses << "\n";
    }
    if (const std::string losses = DescribeLosses(object); !losses.empty()) {
      stream << NameOf(object.object_id) << losses << "\n";
    }
    if (const std::string why = WhyNoPose(object); !why.empty()) stream << NameOf(object.object_id) << why << "\n";
  }
  if (!KnowsAllPoses()) return;
  for (const auto& [object_id, received] : received_) {
    if (received.degraded_poses == 0 || received.tracking_poses > 0) continue;
    stream << NameOf(object_id) << "no pose is TRACKING, " << received.degraded_poses
           << " are DEGRADED: the events have not confirmed a pose; are the "
           << "model, its scale and the camera the right ones?\n";
  }
}

void ReplayReport::PrintFiles(std::ostream& stream) const {
  if (files.empty()) return;
  for (const PoseFile& file : files) {
    stream << file.Describe();
    if (file.num_poses > 0 && transform != kCameraFromObject) stream << ", " << transform;
    stream << "\n";
  }
  const uint64_t ambiguous = Total(&Received::ambiguous_poses);
  if (ambiguous == 0) return;
  stream << Counted(ambiguous, "pose") << (ambiguous == 1 ? " is" : " are")
         << " AMBIGUOUS: a .tum file does not have them, .csv and .jsonl files have them with their alternatives\n";
}

void ReplayReport::Print(std::ostream& stream) const {
  const SessionHealth& health = summary.health;
  PrintInput(stream);
  PrintObjects(stream);
  if (!session.empty()) stream << "session: " << session << "\n";
  PrintFiles(stream);
  // In less time the first search counts as much as the tracking after it.
  if (health.real_time_ratio > 1.0 && SensorSeconds(health) >= PaceMeter::kShortestSeconds) {
    stream << absl::StrFormat(
        "slower than real time: the server needed %.2f s for a second of events; for a live camera, use a server with "
        "less load, fewer objects, or a model with fewer edges (--crease-angle)\n",
        health.real_time_ratio);
  }
  if (longest_lag > absl::ZeroDuration()) {
    stream << absl::StrFormat(
        "slower than %s: events were processed up to %.1f s late; evpose doctor --server compares the rate of the "
        "connection with that of the events\n",
        pace, absl::ToDoubleSeconds(longest_lag));
  }
  if (triggers_ > 0) stream << "triggers: " << triggers_ << " edges on the camera's trigger inputs\n";
  if (host_minus_sensor) {
    stream << absl::StrFormat(
        "clock of the host (Unix time) - clock of the sensor: at most %.6f s, from the chunk with the shortest delay\n",
        absl::ToDoubleSeconds(*host_minus_sensor));
  }
  stream << absl::StrFormat("events %d  poses %d  losses %d  %.2f Mev/s  latency p50 %s  p99 %s\n",
                            health.decoded_events, summary.poses, Losses(), MegaEventsPerSecond(),
                            Milliseconds(health.latency_p50), Milliseconds(health.latency_p99));
}

Json ReplayReport::ToJson() const {
  const SessionHealth& health = summary.health;
  std::vector<std::string> written, kept;
  for (const PoseFile& file : files) (file.keeps_older ? kept : written).push_back(file.path);
  Json json = {{"recording", recording},
               {"out", out.empty() ? Json(nullptr) : Json(out)},
               {"files", written},
               {"kept_files", kept},
               {"transform", transform},
               {"session", session.empty() ? Json(nullptr) : Json(session)},
               {"trace_id", trace_id},
               {"events", health.decoded_events},
               {"poses", summary.poses},
               {"tracking_poses", Total(&Received::tracking_poses)},
               {"degraded_poses", Total(&Received::degraded_poses)},
               {"ambiguous_poses", Total(&Received::ambiguous_poses)},
               {"losses", Losses()},
               {"objects", ObjectsJson()}};
  // For a single object, its fields are also those of the report.
  if (const Json objects = json["objects"]; objects.size() == 1) {
    for (const auto& [key, value] : objects[0].items()) json[key] = value;
  }
  json["mev_per_s"] = MegaEventsPerSecond();
  json["latency_p50_ms"] = MillisecondsJson(health.latency_p50);
  json["real_time_ratio"] = health.real_time_ratio;
  json["latency_p99_ms"] = MillisecondsJson(health.latency_p99);
  json["wall_time_s"] = absl::ToDoubleSeconds(wall_time);
  json["t_last_us"] = health.t_us;
  json["sent_bytes"] = summary.sent_bytes;
  json["sent_chunks"] = summary.sent_chunks;
  json["truncated_bytes"] = truncated_bytes;
  json["skipped"] = SkippedJson(skipped);
  json["dropped_events"] = health.dropped_events;
  json["invalid_words"] = health.invalid_words;
  json["time_backsteps"] = health.time_backsteps;
  json["skipped_events"] = health.skipped_events;
  json["tracking_restarts"] = restarts_.size();
  json["outages"] = outages;
  json["away_s"] = absl::ToDoubleSeconds(away_for);
  json["longest_lag_s"] = absl::ToDoubleSeconds(longest_lag);
  json["lost_poses"] = summary.lost_poses;
  json["triggers"] = triggers_;
  json["host_minus_sensor_s"] = host_minus_sensor ? Json(absl::ToDoubleSeconds(*host_minus_sensor)) : Json(nullptr);
  json["interrupted"] = is_interrupted;
  return json;
}

}  // namespace evpose::client
