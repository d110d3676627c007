// SPDX-License-Identifier: Apache-2.0
#include "client/lib/stream/retry.h"

#include <algorithm>
#include <random>

#include "client/lib/messages/conversion.h"
#include "client/lib/messages/status_details.h"

namespace evpose::client {
namespace {

// Delays between the attempts of RepeatCall(): a short interruption is hardly seen, and a server that is unreachable
// for long is not called often.
constexpr absl::Duration kFirstCallDelay = absl::Milliseconds(100);
constexpr absl::Duration kMaxCallDelay = absl::Seconds(2);

double MachineRandom() {
  thread_local std::minstd_rand generator(std::random_device{}());
  return std::uniform_real_distribution<double>(0.0, 1.0)(generator);
}

// Whether another attempt to read a session may succeed.
bool MayPass(const absl::Status& status) {
  switch (AdviseOn(status)) {
    case RetryAdvice::kTryAgain:
    case RetryAdvice::kTryOtherAuthToken:
      return true;
    default:
      // No server tracks the events, as after the restart of one until the stream is attached again.
      return ReasonOf(status) == v1::SESSION_NOT_TRACKED_HERE;
  }
}

}  // namespace

absl::Status RetryOptions::Validate() const {
  if (max_outage < absl::ZeroDuration()) return absl::InvalidArgumentError("max_outage must not be negative");
  if (first_delay <= absl::ZeroDuration()) return absl::InvalidArgumentError("first_delay must be positive");
  if (max_delay < first_delay) return absl::InvalidArgumentError("max_delay must be at least first_delay");
  return absl::OkStatus();
}

Backoff::Backoff(const RetryOptions& options) : options_(options), delay_(options.first_delay) {}

absl::Duration Backoff::Next() {
  const double random = options_.random ? options_.random() : MachineRandom();
  const absl::Duration delay = std::min(delay_, options_.max_delay) * (0.5 + 0.5 * random);
  delay_ = std::min(2 * delay_, options_.max_delay);
  return delay;
}

RetryAdvice AdviseOn(const absl::Status& status) {
  const StatusDetails details = GetDetails(status);
  const v1::ErrorReason reason = ReasonOf(status);
  switch (status.code()) {
    case absl::StatusCode::kUnavailable:
    case absl::StatusCode::kDeadlineExceeded:
      return RetryAdvice::kTryAgain;
    case absl::StatusCode::kCancelled:
    case absl::StatusCode::kUnknown:
    case absl::StatusCode::kInternal:
      // Without a reason the error comes from the network or a proxy; with a reason it is final.
      return details.reason.empty() ? RetryAdvice::kTryAgain : RetryAdvice::kGiveUp;
    case absl::StatusCode::kAborted:
      return reason == v1::FENCED ? RetryAdvice::kGiveUp : RetryAdvice::kTryAgain;
    case absl::StatusCode::kDataLoss:
      return reason == v1::CRC_MISMATCH ? RetryAdvice::kTryAgain : RetryAdvice::kGiveUp;
    case absl::StatusCode::kResourceExhausted:
      return details.retry_in > absl::ZeroDuration() ? RetryAdvice::kTryAgain : RetryAdvice::kGiveUp;
    case absl::StatusCode::kNotFound:
      return reason == v1::SESSION_NOT_FOUND ? RetryAdvice::kTryOtherServer : RetryAdvice::kGiveUp;
    case absl::StatusCode::kUnauthenticated:
      // The next attempt reads the token again, which may have been renewed.
      return reason == v1::ACCESS_WITHDRAWN ? RetryAdvice::kTryAgain : RetryAdvice::kTryOtherAuthToken;
    case absl::StatusCode::kPermissionDenied:
      return reason == v1::WRONG_TOKEN ? RetryAdvice::kTryOtherToken : RetryAdvice::kGiveUp;
    case absl::StatusCode::kInvalidArgument:
      return details.field == "attach.last_pose_seq" ? RetryAdvice::kAttachFromFirstPose : RetryAdvice::kGiveUp;
    default:
      return RetryAdvice::kGiveUp;
  }
}

absl::Status RepeatCall(const std::stop_token& stop, const std::function<absl::Status()>& call,
                        const std::function<void(const absl::Status&)>& on_error, Clock& clock) {
  RetryOptions delays;
  delays.first_delay = kFirstCallDelay;
  delays.max_delay = kMaxCallDelay;
  Backoff backoff(delays);
  while (true) {
    const absl::Time started = clock.Now();
    absl::Status status = call();
    if (status.ok() || stop.stop_requested() || !MayPass(status)) return status;
    on_error(status);
    const absl::Time now = clock.Now();
    if (now - started > kMaxCallDelay) backoff.Reset();  // the call had succeeded for a while
    const absl::Duration delay = std::max(backoff.Next(), GetDetails(status).retry_in);
    if (!clock.SleepUntil(now + delay, stop)) return status;
  }
}

}  // namespace evpose::client
