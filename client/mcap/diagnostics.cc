// SPDX-License-Identifier: Apache-2.0
#include "client/mcap/diagnostics.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/time/time.h"

namespace evpose::client {
namespace {

RosStatus DiagnoseSession(const SessionHealth& health) {
  const bool falls_behind = health.processing.falls_behind;
  RosStatus status = {.level = falls_behind ? RosStatus::kWarn : RosStatus::kOk,
                      .name = "evpose",
                      .message = falls_behind ? "falls behind the camera" : "keeps up with the camera"};
  const auto add = [&status](const char* key, double value) {
    status.values.emplace_back(key, absl::StrFormat("%.6g", value));
  };
  const auto add_count = [&status](const char* key, uint64_t value) {
    status.values.emplace_back(key, absl::StrCat(value));
  };
  add("event rate [1/s]", health.event_rate_hz);
  add("pose rate [1/s]", health.pose_rate_hz);
  add("processing time / sensor time", health.real_time_ratio);
  if (health.latency_p50) add("latency, median [ms]", absl::ToDoubleMilliseconds(*health.latency_p50));
  if (health.latency_p99) add("latency, 99th percentile [ms]", absl::ToDoubleMilliseconds(*health.latency_p99));
  add_count("events not tracked", health.skipped_events);
  add_count("events dropped", health.dropped_events);
  add_count("invalid words", health.invalid_words);
  add_count("poses", health.poses);
  return status;
}

RosStatus::Level LevelOf(TrackState state) {
  if (state == TrackState::kTracking) return RosStatus::kOk;
  return state == TrackState::kLost ? RosStatus::kError : RosStatus::kWarn;
}

RosStatus DiagnoseObject(const ObjectHealth& object) {
  RosStatus status = {.level = LevelOf(object.state), .name = absl::StrCat("evpose: ", object.object_id)};
  status.message =
      absl::StrCat(std::string(TrackStateName(object.state)), object.detail.empty() ? "" : ": ", object.detail);
  status.values = {{"explained ratio", absl::StrFormat("%.6g", object.explained_ratio)},
                   {"losses", absl::StrCat(object.losses)},
                   {"searches", absl::StrCat(object.initialization_attempts)}};
  if (object.latest_loss) status.values.emplace_back("latest loss", LossCauseName(object.latest_loss->cause));
  return status;
}

}  // namespace

std::vector<RosStatus> Diagnose(const SessionHealth& health) {
  std::vector<RosStatus> statuses = {DiagnoseSession(health)};
  for (const ObjectHealth& object : health.objects) statuses.push_back(DiagnoseObject(object));
  return statuses;
}

}  // namespace evpose::client
