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
  // Milliseconds until a response; poses are delayed by the same time. 20 ms is the longest window of tracking, 200 ms
  // the time after which the state AMBIGUOUS is reported.
  Limits round_trip_ms = {20.0, 200.0};
  // Bytes per second of the recording in its busiest tenth, relative to the measured rate of the connection. Above 1
  // the events queue up; half of the rate is left to other sessions and to retransmissions.
  Limits link_load = {0.5, 1.0};
  // Share of the sessions that the server accepts.
  Limits occupied = {0.9, 0.999};
  // Seconds between the clocks. Up to a second, log files of both machines can be compared; from a minute on,
  // certificates and the expiry of sessions may fail.
  Limits clock_s = {1.0, 60.0};
  // Number of calls. The round trip is the median of their durations, which single delays do not change.
  int num_calls = 20;
  // Bytes of the first and of the largest probe of the connection. Each probe is twice as large as the one before.
  size_t min_probe_bytes = size_t{64} << 10;
  size_t max_probe_bytes = size_t{8} << 20;
  // The last probe is the first one that takes at least this time and ten round trips: the rate is then known to a
  // tenth.
  absl::Duration probe_time = absl::Milliseconds(250);
  // Time after which a probe is ended, on a link that is too slow even for the first one.
  absl::Duration probe_timeout = absl::Seconds(5);
};

// What a server must offer for the recording and the model of the user.
struct ServerNeeds {
  std::optional<double> bytes_per_s;    // of the recording in its busiest tenth
  std::optional<uint64_t> model_bytes;  // size of the model file as it is uploaded
};

// An upload by which the rate of a connection was measured.
struct LinkProbe {
  size_t num_bytes = 0;
  absl::Duration duration;    // until the server confirmed the bytes, or the probe was ended
  absl::Duration round_trip;  // the part of the duration that was spent waiting
  bool is_complete = true;
};

// Makes the checks of a connected server. Creates no session and stores nothing: the probes of the connection are
// uploads that the server discards. Errors: those of Client::GetServerInfo().
absl::StatusOr<std::vector<Finding>> CheckServer(Client& client, const ServerNeeds& needs,
                                                 const ServerCheckOptions& options = {});

// Returns the findings about a server to which Client::Connect() failed with `status`: the cause, and the other checks
// as not made. Connects once more, without gRPC, for at most `timeout` for each address of the name.
std::vector<Finding> DescribeUnconnected(const std::string& address, const absl::Status& status,
                                         absl::Duration timeout = absl::Seconds(2));

// Checks of values that have been received from a server. They make no calls.
Finding CheckServerVersion(const ServerInfo& server);
Finding CheckSessions(const ServerInfo& server, const ServerCheckOptions& options);
Finding CheckModelBytes(const ServerInfo& server, std::optional<uint64_t> model_bytes);
Finding CheckLink(const LinkProbe& probe, std::optional<double> recording_bytes_per_s,
                  const ServerCheckOptions& options);
// `server` is the time of the server, read between `sent` and `received` by the clock of this machine.
Finding CheckServerClock(absl::Time sent, absl::Time received, std::optional<absl::Time> server,
                         const ServerCheckOptions& options);

}  // namespace evpose::client
