// SPDX-License-Identifier: Apache-2.0
#include "client/diagnosis/server_checks.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/time/clock.h"
#include "client/lib/client_access.h"
#include "client/lib/tcp_probe.h"
#include "core/base/counted.h"
#include "core/base/status_macros.h"
#include "core/base/version.h"
#include "core/numerics/statistics.h"

namespace evpose::client {
namespace {

constexpr const char* kChecksAfterConnection[] = {"health",     "version",      "sessions", "model-bytes",
                                                  "round-trip", "server-clock", "link"};

Finding ServerFinding(const char* check) {
  Finding finding;
  finding.check = check;
  return finding;
}

std::string Megabits(double bytes_per_s) { return absl::StrFormat("%.4g Mbit/s", 8e-6 * bytes_per_s); }

Finding CheckHealth(Client& client) {
  const absl::StatusOr<bool> is_serving = ClientAccess::IsServing(client);
  if (!is_serving.ok()) return NotChecked("health", std::string(is_serving.status().message()));
  Finding finding = ServerFinding("health");
  finding.text = *is_serving ? "the server accepts sessions" : "the server is NOT_SERVING: it accepts no sessions";
  if (*is_serving) return finding;
  finding.verdict = Verdict::kProblem;
  finding.remedy =
      "it shuts down, or its store does not respond: see its log or /readyz (--metrics-listen), and start the store or "
      "the server again";
  return finding;
}

struct Exchange {
  absl::Time sent, received;
  std::optional<absl::Time> server;
  absl::Duration duration() const { return received - sent; }
};

absl::StatusOr<std::vector<Exchange>> MakeCalls(Client& client, int num_calls) {
  std::vector<Exchange> exchanges;
  for (int i = 0; i < num_calls; ++i) {
    const absl::Time sent = absl::Now();
    EVPOSE_ASSIGN_OR_RETURN(const ServerInfo info, client.GetServerInfo());
    exchanges.push_back({sent, absl::Now(), info.time});
  }
  std::sort(exchanges.begin(), exchanges.end(),
            [](const Exchange& a, const Exchange& b) { return a.duration() < b.duration(); });
  return exchanges;
}

Finding CheckRoundTrip(const std::vector<Exchange>& exchanges, const ServerCheckOptions& options) {
  Finding finding = ServerFinding("round-trip");
  const double median_ms = absl::ToDoubleMilliseconds(exchanges[exchanges.size() / 2].duration());
  SetVerdict(median_ms, options.round_trip_ms, "ms", finding);
  finding.text =
      absl::StrFormat("the server answers within %.2f ms, within %.2f ms at most, of %d calls", median_ms,
                      absl::ToDoubleMilliseconds(exchanges.back().duration()), static_cast<int>(exchanges.size()));
  if (finding.verdict != Verdict::kOk) {
    finding.remedy = "poses are late by this time: use a server nearer to the camera, or a network with less delay";
  }
  return finding;
}

Finding MeasureLink(Client& client, const ServerInfo& info, absl::Duration round_trip, const ServerNeeds& needs,
                    const ServerCheckOptions& options) {
  const size_t max_bytes =
      std::min<uint64_t>(options.max_probe_bytes, info.max_model_bytes > 0 ? info.max_model_bytes - 1 : 0);
  if (max_bytes < options.min_probe_bytes) {
    return NotChecked("link", absl::StrCat("the server accepts uploads of ", info.max_model_bytes,
                                           " bytes only (--max-model-bytes), too few for a measurement"));
  }
  std::optional<LinkProbe> probe;
  for (size_t num_bytes = options.min_probe_bytes; num_bytes <= max_bytes; num_bytes *= 2) {
    const absl::StatusOr<absl::Duration> duration = ClientAccess::TimeUpload(client, num_bytes, options.probe_timeout);
    if (absl::IsDeadlineExceeded(duration.status())) {
      probe = {num_bytes, options.probe_timeout, absl::ZeroDuration(), /*is_complete=*/false};
      break;
    }
    if (!duration.ok()) {  // a quota may have admitted only the smaller probes
      if (!probe) return NotChecked("link", std::string(duration.status().message()));
      break;
    }
    probe = {num_bytes, *duration, round_trip};
    if (*duration >= std::max(options.probe_time, 10 * round_trip)) break;
  }
  return CheckLink(*probe, needs.bytes_per_s, options);
}

}  // namespace

Finding CheckServerVersion(const ServerInfo& server) {
  const BuildVersion own = ThisBuild();
  Finding finding = ServerFinding("version");
  finding.text = absl::StrCat("the server is evpose-server ", server.version, " (", server.commit,
                              "), this program evpose ", own.version, " (", own.commit, ")");
  if (server.version == own.version && server.commit == own.commit) return finding;
  finding.verdict = Verdict::kAdvice;
  finding.remedy =
      "install the same version on both: poses of different versions may differ, and an earlier one lacks calls and "
      "fields of the API that a later one has";
  return finding;
}

Finding CheckSessions(const ServerInfo& server, const ServerCheckOptions& options) {
  Finding finding = ServerFinding("sessions");
  SetVerdict(static_cast<double>(server.active_sessions) / std::max(1u, server.max_sessions), options.occupied,
             "share of the sessions", finding);
  finding.text = absl::StrCat(server.active_sessions, " of at most ", Counted(server.max_sessions, "session"),
                              ", store: ", server.store, "; a session without a stream is kept for ",
                              absl::FormatDuration(server.session_expiry));
  if (server.skipped_events > 0) {
    absl::StrAppend(&finding.text, "; since its start ", Counted(server.skipped_events, "event"),
                    " came faster than they were tracked and were dropped (--overload latest)");
  }
  if (server.is_draining) {
    finding.verdict = Verdict::kProblem;
    absl::StrAppend(&finding.text, "; the server shuts down and accepts no further session");
    finding.remedy = "use another server, or start it again";
  } else if (finding.verdict != Verdict::kOk) {
    finding.remedy = "evpose sessions list shows them: delete those without use, or raise --max-sessions of the server";
  }
  return finding;
}

Finding CheckModelBytes(const ServerInfo& server, std::optional<uint64_t> model_bytes) {
  if (!model_bytes) return NotChecked("model-bytes", "--model was not given");
  Finding finding = ServerFinding("model-bytes");
  const auto limit = static_cast<double>(server.max_model_bytes);
  SetMeasured(static_cast<double>(*model_bytes), limit, "bytes", finding);
  finding.text = absl::StrCat("the model has ", *model_bytes, " bytes; the server accepts ", server.max_model_bytes);
  if (*model_bytes <= server.max_model_bytes) return finding;
  finding.verdict = Verdict::kProblem;
  finding.remedy = "simplify the mesh (evpose models inspect), or raise --max-model-bytes of the server";
  return finding;
}

Finding CheckLink(const LinkProbe& probe, std::optional<double> recording_bytes_per_s,
                  const ServerCheckOptions& options) {
  Finding finding = ServerFinding("link");
  // At most nine tenths of the duration count as waiting, which limits the effect of an error of the round trip.
  const double seconds = absl::ToDoubleSeconds(std::max(probe.duration - probe.round_trip, 0.1 * probe.duration));
  const auto num_bytes = static_cast<double>(probe.num_bytes);
  const double link_bytes_per_s = num_bytes / std::max(seconds, 1e-9);
  finding.text =
      absl::StrFormat("the connection carried %s%.3g MB in %.3g s, %s", probe.is_complete ? "" : "less than ",
                      1e-6 * num_bytes, seconds, Megabits(link_bytes_per_s));
  if (!recording_bytes_per_s) {
    finding.value = 8e-6 * link_bytes_per_s;
    finding.unit = "Mbit/s";
    absl::StrAppend(&finding.text, "; with a RECORDING, this is compared with its events");
    return finding;
  }
  SetVerdict(*recording_bytes_per_s / link_bytes_per_s, options.link_load, "share of the connection", finding);
  absl::StrAppend(&finding.text, "; the recording has ", Megabits(*recording_bytes_per_s),
                  " in the busiest tenth of its time");
  if (finding.verdict != Verdict::kOk) {
    finding.remedy =
        "a faster network, or fewer events: higher thresholds, a region of interest, event rate control "
        "(deploy/sensors/README.md); --overload latest drops old events instead of waiting";
  }
  return finding;
}

Finding CheckServerClock(absl::Time sent, absl::Time received, std::optional<absl::Time> server,
                         const ServerCheckOptions& options) {
  if (!server) return NotChecked("server-clock", "the server is of a version that does not state its time");
  Finding finding = ServerFinding("server-clock");
  // The smallest difference of the clocks that agrees with the times of sending and receipt.
  const absl::Duration ahead = *server > received ? *server - received
                               : *server < sent   ? *server - sent
                                                  : absl::ZeroDuration();
  SetVerdict(std::abs(absl::ToDoubleSeconds(ahead)), options.clock_s, "s", finding);
  finding.text =
      absl::StrFormat("the server's clock is %.3f s %s this machine's, exact to %.3f s", *finding.value,
                      ahead < absl::ZeroDuration() ? "behind" : "ahead of", absl::ToDoubleSeconds(received - sent));
  if (finding.verdict != Verdict::kOk) {
    finding.remedy =
        "synchronise both clocks (chrony, systemd-timesyncd): certificates, expiry times and logs use them";
  }
  return finding;
}

absl::StatusOr<std::vector<Finding>> CheckServer(Client& client, const ServerNeeds& needs,
                                                 const ServerCheckOptions& options) {
  EVPOSE_ASSIGN_OR_RETURN(const ServerInfo info, client.GetServerInfo());
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<Exchange> exchanges, MakeCalls(client, std::max(1, options.num_calls)));
  Finding connection = ServerFinding("connection");
  connection.text = "the server is reachable and accepts the credentials";
  std::vector<Finding> findings = {std::move(connection), CheckHealth(client), CheckServerVersion(info),
                                   CheckSessions(info, options), CheckModelBytes(info, needs.model_bytes)};
  findings.push_back(CheckRoundTrip(exchanges, options));
  const Exchange& fastest = exchanges.front();
  findings.push_back(CheckServerClock(fastest.sent, fastest.received, fastest.server, options));
  findings.push_back(MeasureLink(client, info, fastest.duration(), needs, options));
  return findings;
}

std::vector<Finding> DescribeUnconnected(const std::string& address, const absl::Status& status,
                                         absl::Duration timeout) {
  Finding finding = ServerFinding("connection");
  finding.verdict = Verdict::kProblem;
  finding.text = std::string(status.message());
  const auto unreachable =
      absl::IsUnavailable(status) ? ExplainUnreachable(address, timeout) : std::optional<TcpFailure>();
  if (unreachable) {
    finding.text = unreachable->cause;
    finding.remedy = unreachable->remedy;
  } else if (absl::IsUnavailable(status) || absl::IsUnimplemented(status)) {
    finding.remedy =
        "a program listens there: give the port of evpose-server's --listen, and --tls or --tls-ca if it uses TLS";
  } else if (absl::IsUnauthenticated(status)) {
    finding.remedy =
        "give the token of this server, --token-file or the variable EVPOSE_TOKEN; evpose-server --new-token makes one";
  }
  std::vector<Finding> findings = {std::move(finding)};
  for (const char* check : kChecksAfterConnection) findings.push_back(NotChecked(check, "there is no connection"));
  return findings;
}

}  // namespace evpose::client
