// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/session_start.h"

#include <algorithm>
#include <optional>
#include <random>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// Duration of one attempt to connect; interrupts are checked between attempts.
constexpr absl::Duration kConnectSlice = absl::Seconds(3);

std::string RandomId() {
  std::random_device random;
  std::string id;
  for (int i = 0; i < 4; ++i) absl::StrAppendFormat(&id, "%08x", random());
  return id;
}

absl::Status Interrupted(const RunArguments& arguments, const absl::Status& cause) {
  std::string text = absl::StrCat("interrupted before a server accepted the data: ", cause.message());
  if (arguments.recording == "-") {
    absl::StrAppend(&text, arguments.resume.empty() ? "; with --resume FILE, the data would have been kept"
                                                    : "; the data is kept: the same command continues from there");
  }
  return absl::CancelledError(text);
}

class SessionStart {
 public:
  SessionStart(const SessionStartOptions& options, SessionRun& run, const RunArguments& arguments,
               const CliContext& context)
      : options_(options),
        run_(run),
        arguments_(arguments),
        context_(context),
        clock_(context.clock == nullptr ? SystemClock() : *context.clock),
        backoff_(options.retry) {}

  absl::StatusOr<std::unique_ptr<Client>> Run() {
    while (true) {
      const absl::Status status = Try();
      if (status.ok()) {
        ReportBack();
        return std::move(client_);
      }
      client_.reset();  // the next attempt may find another server
      if (!MayWait() || AdviseOn(status) != RetryAdvice::kTryAgain) return status;
      if (context_.IsInterrupted()) return Interrupted(arguments_, status);
      if (!away_since_) away_since_ = clock_.Now();
      const absl::Duration delay = backoff_.Next();
      if (away_for() + delay > options_.retry.max_outage) return status;
      Report({.is_away = true, .cause = status, .next_try_in = delay});
      if (!Sleep(delay)) return Interrupted(arguments_, status);
    }
  }

 private:
  absl::Status Try() {
    ServerArguments slice = arguments_.server;
    if (MayWait()) slice.connect_timeout_s = std::min(slice.connect_timeout_s, absl::ToDoubleSeconds(kConnectSlice));
    EVPOSE_ASSIGN_OR_RETURN(client_, slice.Connect(context_));
    was_connected_ = true;
    return run_.Begin(*client_, options_.complete, request_id_);
  }

  bool Sleep(absl::Duration delay) const {
    for (const absl::Time due = clock_.Now() + delay; clock_.Now() < due;) {
      if (context_.IsInterrupted()) return false;
      clock_.SleepUntil(std::min(due, clock_.Now() + kInterruptPeriod), {});
    }
    return true;
  }

  void ReportBack() {
    if (away_since_) Report({.is_away = false});
  }
  void Report(ConnectionChange change) {
    const OutboxState state = run_.feed().outbox().state();
    change.server = arguments_.server.address;
    change.away_for = away_for();
    change.kept_bytes = state.kept_bytes;
    change.source_waits = state.is_waiting;
    run_.Say(run_.connection().Describe(change));
  }

  // Otherwise there is one attempt, for the whole --connect-timeout.
  bool MayWait() const { return was_connected_ || options_.waits_for_first_server; }
  absl::Duration away_for() const { return clock_.Now() - *away_since_; }

  const SessionStartOptions& options_;
  SessionRun& run_;
  const RunArguments& arguments_;
  const CliContext& context_;
  Clock& clock_;
  Backoff backoff_;
  // The same in every attempt, so that a session is not created twice when the response was lost.
  const std::string request_id_ = RandomId();
  std::unique_ptr<Client> client_;
  bool was_connected_ = false;
  std::optional<absl::Time> away_since_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<Client>> StartSession(const SessionStartOptions& options, SessionRun& run,
                                                     const RunArguments& arguments, const CliContext& context) {
  return SessionStart(options, run, arguments, context).Run();
}

}  // namespace evpose::client
