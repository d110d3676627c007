// SPDX-License-Identifier: Apache-2.0

// Decides when a broken stream is tried again, and which errors are final.
#pragma once

#include "absl/status/status.h"
#include "absl/time/time.h"
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

}  // namespace evpose::client
