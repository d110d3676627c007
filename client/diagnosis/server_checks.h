// SPDX-License-Identifier: Apache-2.0

// Checks of a server and of the connection to it (README.md).
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "core/diagnosis/finding.h"
#include "evpose/client.h"

namespace evpose::client {

struct ServerCheckOptions {
  // Milliseconds until an answer: a pose arrives that much later. 20 ms is the longest window of tracking; 200 ms is as
  // long as the state AMBIGUOUS takes to be decided.
  Limits round_trip_ms = {20.0, 200.0};
  // Bytes per second of the recording in its busiest tenth, per measured rate of the connection: above 1 the events
  // queue up; half is left to other sessions and to retransmissions.
  Limits link_load = {0.5, 1.0};
  // Share of the sessions that the server accepts.
  Limits occupied = {0.9, 0.999};
  // Seconds between the clocks: log files of both can be compared to a second; certificates and the expiry of sessions
  // fail at a minute.
  Limits clock_s = {1.0, 60.0};
  // Number of calls whose median duration is the round trip: single delays do not change the median.
  int num_calls = 20;
  // Bytes of the first and of the largest probe of the connection; each is twice as large as the one before.
  size_t min_probe_bytes = size_t{64} << 10;
  size_t max_probe_bytes = size_t{8} << 20;
  // A probe that takes this long, and ten round trips, is the last: the rate is then known to a tenth.
  absl::Duration probe_time = absl::Milliseconds(250);
  // The end of a probe on a link that is too slow even for the first one.
  absl::Duration probe_timeout = absl::Seconds(5);
};

// What the user's recording and model need of a server.
struct ServerNeeds {
  std::optional<double> bytes_per_s;    // of the recording in its busiest tenth
  std::optional<uint64_t> model_bytes;  // size of the model file as it is uploaded
};

// An upload by which the rate of a connection was measured.
struct LinkProbe {
  size_t num_bytes = 0;
  absl::Duration duration;    // until the server had confirmed them, or until the probe was ended
  absl::Duration round_trip;  // of the duration, the part that was spent waiting
  bool is_complete = true;
};

// The checks of a server that is connected. Creates no session and stores nothing: the probes of the connection are
// uploads that the server discards. Errors: those of Client::GetServerInfo().
absl::StatusOr<std::vector<Finding>> CheckServer(Client& client, const ServerNeeds& needs,
                                                 const ServerCheckOptions& options = {});

// The checks of a server to which Client::Connect() failed with `status`: the cause, and the others as not made.
// Connects once more, without gRPC, for at most `timeout` for each address of the name.
std::vector<Finding> DescribeUnconnected(const std::string& address, const absl::Status& status,
                                         absl::Duration timeout = absl::Seconds(2));

// The parts that need no server.
Finding CheckServerVersion(const ServerInfo& server);
Finding CheckSessions(const ServerInfo& server, const ServerCheckOptions& options);
Finding CheckModelBytes(const ServerInfo& server, std::optional<uint64_t> model_bytes);
Finding CheckLink(const LinkProbe& probe, std::optional<double> recording_bytes_per_s,
                  const ServerCheckOptions& options);
// The server's time `server` was read between `sent` and `received` of this machine.
Finding CheckServerClock(absl::Time sent, absl::Time received, std::optional<absl::Time> server,
                         const ServerCheckOptions& options);

}  // namespace evpose::client
