// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/session_start.h"

#include <algorithm>
#include <optional>
#include <string>

#include "absl/strings/str_cat.h"
#include "client/lib/messages/status_details.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// Duration of one attempt to connect; interrupts are checked between attempts.
constexpr absl::Duration kConnectSlice = absl::Seconds(3);

absl::Status Interrupted(const RunArguments& arguments, const absl::Status& cause) {
  if (absl::IsCancelled(cause) && !arguments.ends_at_interrupt) return cause;  // it describes the interrupt
  std::string text = absl::StrCat("interrupted before a server accepted the data: ", cause.message());
  if (arguments.recording == "-") {
    absl::StrAppend(&text, arguments.resume.empty() ? "; with --resume FILE, the data would have been kept"
                                                    : "; the data is kept: the same command continues from there");
  }
  return absl::CancelledError(text);
}

// Makes one attempt. `timeout_s`: limit of the time for the connection, seconds.
absl::StatusOr<std::unique_ptr<Client>> TryToStart(const SessionStartOptions& options, SessionRun& run,
                                                   const RunArguments& arguments, const CliContext& context,
                                                   double timeout_s, const std::string& request_id,
                                                   bool& was_connected) {
  ServerArguments server = arguments.server;
  server.connect_timeout_s = std::min(server.connect_timeout_s, timeout_s);
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<Client> client, server.Connect(context));
  was_connected = true;
  EVPOSE_RETURN_IF_ERROR(run.Begin(*client, options.complete, request_id));
  return client;
}

bool Sleep(absl::Duration delay, Clock& clock, const CliContext& context) {
  for (const absl::Time due = clock.Now() + delay; clock.Now() < due;) {
    if (context.IsInterrupted()) return false;
    clock.SleepUntil(std::min(due, clock.Now() + kInterruptPeriod), {});
  }
  return true;
}

}  // namespace

absl::StatusOr<std::unique_ptr<Client>> StartSession(const SessionStartOptions& options, SessionRun& run,
                                                     const RunArguments& arguments, const CliContext& context) {
  Clock& clock = context.clock == nullptr ? SystemClock() : *context.clock;
  Backoff backoff(options.retry);
  // The same in every attempt, so that a session is not created twice when the response was lost.
  const std::string request_id = RandomRequestId();
  bool was_connected = false;
  std::optional<absl::Time> away_since;
  const auto report = [&](ConnectionChange change) {
    const OutboxState state = run.feed().outbox().state();
    change.server = arguments.server.address;
    change.outage = clock.Now() - *away_since;
    change.kept_bytes = state.kept_bytes;
    change.source_waits = state.is_waiting;
    run.PrintLine(run.connection().Describe(change));
  };
  // Until a server has been reachable, there is one attempt, for the whole --connect-timeout. For a session that is
  // continued, a server has been reachable in the earlier run, so that the attempts are repeated from the start.
  const auto may_wait = [&] { return was_connected || options.continues_session; };
  while (true) {
    const double timeout_s = may_wait() ? absl::ToDoubleSeconds(kConnectSlice) : arguments.server.connect_timeout_s;
    const absl::Time begin = clock.Now();
    absl::StatusOr<std::unique_ptr<Client>> client =
        TryToStart(options, run, arguments, context, timeout_s, request_id, was_connected);
    if (client.ok()) {
      if (away_since) report({.is_unreachable = false});
      return client;
    }
    const absl::Status& status = client.status();
    if (!may_wait() || AdviseOn(status) != RetryAdvice::kTryAgain) return status;
    if (context.IsInterrupted()) return Interrupted(arguments, status);
    if (!away_since) away_since = begin;
    // The error of a full server states the delay before the next attempt.
    const absl::Duration delay = std::max(backoff.Next(), GetDetails(status).retry_in);
    if (clock.Now() - *away_since + delay > options.retry.max_outage) return status;
    report({.is_unreachable = true, .cause = status, .next_try_in = delay});
    if (!Sleep(delay, clock, context)) return Interrupted(arguments, status);
  }
}

}  // namespace evpose::client
