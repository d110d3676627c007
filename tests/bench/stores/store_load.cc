// SPDX-License-Identifier: Apache-2.0

// store_load --store STORE --sessions N...: the commits of N sessions of an EVK4 on a store, without their tracking.
// Runs one real session at the pace of its sensor and records its commits; then writes these commits at their times
// under N names. Prints a line of JSON for the recording and one for each N. store_load.py starts a Redis group for it.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "core/base/status_macros.h"
#include "server/stores/open_store.h"
#include "tests/bench/stores/commit_recording.h"
#include "tests/bench/stores/commit_replay.h"

namespace evpose::server {
namespace {

using Json = nlohmann::json;

struct Arguments {
  std::string store;
  std::vector<int> sessions = {100, 300, 1000};
  double rate_hz = 250e3;
  double seconds = 60.0;
  double spread_s = 20.0;
  double warm_up_s = 20.0;
  double idle_s = 5.0;
};

std::chrono::microseconds Microseconds(double seconds) {
  return std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::duration<double>(seconds));
}

template <typename Value>
Json OrNull(const std::optional<Value>& value) {
  return value.has_value() ? Json(*value) : Json();
}

void Print(const Json& json) { std::cout << json.dump() << std::endl; }  // a reader of the pipe gets each line at once

Json ToJson(const SessionRecording& recording) {
  const CommitBytes bytes = BytesOf(recording);
  return {{"recorded_commits", recording.commits.size()},
          {"recorded_s", 1e-6 * static_cast<double>(recording.commits.back().at.count())},
          {"recorded_poses", LastPoseSeq(recording)},
          {"checkpoint_bytes", bytes.checkpoints},
          {"pose_bytes", bytes.poses},
          {"lifecycle_bytes", bytes.lifecycles}};
}

Json ToJson(const ReplayResult& result, int sessions) {
  return {{"sessions", sessions},
          {"seconds", result.seconds},
          {"commits", result.commits},
          {"written", result.written},
          {"bytes", result.bytes},
          {"unwritten", result.unwritten},
          {"repeated", result.repeated},
          {"errors", result.errors},
          {"latency_p50_ms", 1e-3 * static_cast<double>(result.latency.Percentile(0.5))},
          {"latency_p99_ms", 1e-3 * static_cast<double>(result.latency.Percentile(0.99))},
          {"latency_max_ms", 1e-3 * static_cast<double>(result.max_latency_us)},
          {"idle_cores", OrNull(result.idle_cores)},
          {"cores", OrNull(result.cores)},
          {"store_bytes_before", OrNull(result.bytes_before)},
          {"store_bytes_after", OrNull(result.bytes_after)}};
}

absl::Status Run(const Arguments& arguments) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Store> store, OpenStore({.store = arguments.store}));
  EVPOSE_ASSIGN_OR_RETURN(const SessionRecording recording, RecordSession(arguments.rate_hz, arguments.seconds));
  Print(ToJson(recording));
  for (const int sessions : arguments.sessions) {
    EVPOSE_ASSIGN_OR_RETURN(const ReplayResult result, Replay(*store, recording,
                                                              {.sessions = sessions,
                                                               .spread = Microseconds(arguments.spread_s),
                                                               .warm_up = Microseconds(arguments.warm_up_s),
                                                               .idle = Microseconds(arguments.idle_s)}));
    Print(ToJson(result, sessions));
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace evpose::server

// NOLINTNEXTLINE(bugprone-exception-escape): an exception ends the program
int main(int argc, char** argv) {
  evpose::server::Arguments arguments;
  CLI::App app("Writes the recorded commits of a session to a store under many names.");
  app.option_defaults()->always_capture_default();
  app.add_option("--store", arguments.store, "As --store of evpose-server")->required();
  app.add_option("--sessions", arguments.sessions, "Numbers of names, one after the other")->check(CLI::PositiveNumber);
  app.add_option("--rate", arguments.rate_hz, "Events per second of the session");
  app.add_option("--seconds", arguments.seconds, "Length of the recording");
  app.add_option("--spread", arguments.spread_s, "Seconds within which the sessions begin");
  app.add_option("--warm-up", arguments.warm_up_s,
                 "Seconds after that before the measurement, which lasts for the rest");
  app.add_option("--idle", arguments.idle_s, "Seconds for the measurement of the idle processor time");
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = evpose::server::Run(arguments);
  if (status.ok()) return 0;
  std::fprintf(stderr, "store_load: %s\n", status.ToString().c_str());
  return 1;
}
