// SPDX-License-Identifier: Apache-2.0

// When a stream that broke is tried again, and when that has no use.
#pragma once

#include <functional>

#include "absl/status/status.h"
#include "absl/time/time.h"

namespace evpose::client {

struct RetryOptions {
  // The longest time without a server that takes the stream. Zero: what breaks is not tried again; infinite: for ever.
  absl::Duration max_outage = absl::Minutes(2);
  absl::Duration first_delay = absl::Milliseconds(100);  // doubled with each try that fails
  absl::Duration max_delay = absl::Seconds(5);
  std::function<double()> random;  // in [0, 1), for the jitter; empty: the machine's

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// Exponential delays with jitter: many clients of a server that went away do not come back all at once.
class Backoff {
 public:
  explicit Backoff(const RetryOptions& options);
  // Between half and the whole of first_delay * 2^n, at most max_delay.
  absl::Duration Next();
  void Reset() { delay_ = options_.first_delay; }

 private:
  const RetryOptions options_;
  absl::Duration delay_;
};

enum class RetryAdvice {
  kTryAgain,
  kTryOtherServer,   // this one does not have the session; another one may
  kTryOtherToken,    // the one before it may be the server's
  kTryWithoutCount,  // the server has made fewer poses than were received: it starts from a checkpoint
  kGiveUp,
};
// Of the status that a Track stream ended with, as the server or the network gave it.
RetryAdvice AdviseOn(const absl::Status& status);

}  // namespace evpose::client
