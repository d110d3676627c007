// SPDX-License-Identifier: Apache-2.0

// Decides when a broken stream is tried again, and which errors are final.
#pragma once

#include <cstddef>
#include <functional>
#include <stop_token>

#include "absl/status/status.h"
#include "absl/time/time.h"
#include "evpose/clock.h"
#include "evpose/track.h"

namespace evpose::client {

// Exponential delays with jitter, so that the clients of a failed server do not reconnect simultaneously.
class Backoff {
 public:
  explicit Backoff(const RetryOptions& options);
  // Returns a delay between half of first_delay * 2^n and all of it, at most max_delay.
  absl::Duration Next();
  void Reset() { delay_ = options_.first_delay; }

 private:
  const RetryOptions options_;
  absl::Duration delay_;
};

// Number of tokens of a session that are tried, the newest first: more than the attaches that a store with a stale
// replica loses.
inline constexpr size_t kMaxTriedTokens = 10;

enum class RetryAdvice {
  kTryAgain,
  kTryOtherServer,       // this server does not have the session; another one may
  kTryOtherToken,        // the server may know the previous token
  kTryOtherAuthToken,    // the authentication token may have been replaced
  kAttachFromFirstPose,  // the server restarted from a checkpoint and has computed fewer poses than were received
  kGiveUp,
};
// Classifies the status with which a Track stream ended, from the server or from the network.
RetryAdvice AdviseOn(const absl::Status& status);

// Repeats `call`, which reads a session, until it returns OK or an error that another attempt cannot change, and
// returns the last status. The delays between two attempts grow. `on_error` receives the status before each delay.
// Returns early after a request of `stop`, which must also cancel the call.
absl::Status RepeatCall(const std::stop_token& stop, const std::function<absl::Status()>& call,
                        const std::function<void(const absl::Status&)>& on_error, Clock& clock = SystemClock());

}  // namespace evpose::client
