// SPDX-License-Identifier: Apache-2.0
#include "client/lib/server_choice.h"

#include <grpcpp/grpcpp.h>

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "client/lib/messages/conversion.h"
#include "client/lib/messages/status_details.h"

namespace evpose::client {
namespace {

// Longest wait for the connection to a server in turn.
constexpr absl::Duration kTurnWait = absl::Milliseconds(100);

}  // namespace

bool IsServerAway(const absl::Status& status) {
  switch (status.code()) {
    case absl::StatusCode::kUnavailable:
      return ReasonOf(status) != v1::ROLLED_BACK;  // about the session, not the server
    case absl::StatusCode::kCancelled:             // by a server that is stopped
    case absl::StatusCode::kUnknown:
    case absl::StatusCode::kInternal:
      return AdviseOn(status) == RetryAdvice::kTryAgain;
    default:
      return false;
  }
}

bool IsServerFull(const absl::Status& status) {
  if (!absl::IsResourceExhausted(status)) return false;
  switch (ReasonOf(status)) {
    case v1::OVERLOADED:
    case v1::TOO_MANY_SESSIONS:
    case v1::SESSION_MEMORY:
    case v1::OUT_OF_MEMORY:
      return true;
    default:
      return false;
  }
}

ServerChoice::ServerChoice(std::deque<Endpoint>& endpoints, std::atomic<size_t>& current, Clock& clock,
                           const std::stop_token& stop, bool skips_full_servers)
    : endpoints_(endpoints),
      current_(current),
      clock_(clock),
      stop_(stop),
      index_(current),
      backoff_(RetryOptions()),
      skips_full_servers_(skips_full_servers) {
  Prepare();
}

void ServerChoice::Prepare() const {
  if (skips_full_servers_) endpoint().LeaveAfterRefusal(stop_);
  endpoint().ConnectAgain(endpoints_.size(), stop_);
}

void ServerChoice::Responded() {
  // Without a failure the other calls stay where they are: a model may be known to their server alone.
  if (num_failed_ > 0 || num_refusals_ > 0) current_ = index_;
  num_failed_ = 0;
  backoff_.Reset();
}

bool ServerChoice::Next(const absl::Status& status) {
  if (stop_.stop_requested()) return false;
  if (IsRefusal(status)) return NextWithRoom(status);
  if (!IsServerAway(status)) {
    Responded();
    return false;
  }
  if (endpoints_.size() == 1) return false;
  do {
    if (++num_failed_ == kMaxRounds * endpoints_.size()) return false;
    Advance();
    const bool is_next_round = num_failed_ % endpoints_.size() == 0;
    if (is_next_round && !clock_.SleepUntil(clock_.Now() + backoff_.Next(), stop_)) return false;
  } while (!Connect() && !stop_.stop_requested());
  return !stop_.stop_requested();
}

void ServerChoice::Skip() {
  Advance();
  Prepare();
}

bool ServerChoice::IsRefusal(const absl::Status& status) const {
  return skips_full_servers_ && (IsServerFull(status) || (!refusal_.ok() && absl::IsNotFound(status)));
}

bool ServerChoice::NextWithRoom(const absl::Status& refusal) {
  if (IsServerFull(refusal)) {
    refusal_ = refusal;
    endpoint().NoteRefusal();
  }
  const absl::Duration retry_in = GetDetails(refusal).retry_in;
  if (retry_in > absl::ZeroDuration()) retry_in_ = std::min(retry_in_, retry_in);
  ++num_refusals_;
  if (num_refusals_ + num_failed_ >= endpoints_.size()) return false;  // each has been tried
  Skip();
  return true;
}

bool ServerChoice::Connect() const {
  return endpoint().ConnectNow(kTurnWait, stop_) || num_failed_ >= (kMaxRounds - 1) * endpoints_.size();
}

absl::Status ServerChoice::Final(const absl::Status& status) const {
  if (stop_.stop_requested() && IsServerAway(status)) {
    return absl::CancelledError(absl::StrCat(endpoint().name, ": the call was cancelled"));
  }
  const bool is_refused = num_refusals_ > 0 && IsRefusal(status);
  if (endpoints_.size() == 1 || (!is_refused && num_failed_ < kMaxRounds * endpoints_.size())) return status;
  const std::string names = absl::StrJoin(
      endpoints_, ", ", [](std::string* text, const Endpoint& endpoint) { absl::StrAppend(text, endpoint.name); });
  if (!is_refused) {
    return WithMessage(status, absl::StrCat(status.message(), "; ", kMaxRounds, " attempts each at ", names));
  }
  const std::string other = IsServerFull(status) ? "" : absl::StrCat("; ", status.message());
  absl::Status result = WithMessage(
      refusal_, absl::StrCat(refusal_.message(), "; none of the servers ", names, " accepts the session", other));
  if (retry_in_ < absl::InfiniteDuration()) SetDetails(result, {.retry_in = retry_in_});
  return result;
}

}  // namespace evpose::client
