// SPDX-License-Identifier: Apache-2.0
#include "client/view/repeated_call.h"

#include <algorithm>

#include "absl/time/time.h"
#include "evpose/clock.h"

namespace evpose::client {
namespace {

// Delays between attempts, doubled from the first to the last: a short interruption is hardly seen, and a server that
// is away for long is not called often.
constexpr absl::Duration kFirstDelay = absl::Milliseconds(100);
constexpr absl::Duration kMaxDelay = absl::Seconds(2);

// Whether another attempt cannot succeed.
bool IsFinal(const absl::Status& status) {
  return status.ok() || absl::IsNotFound(status) || absl::IsPermissionDenied(status) || absl::IsUnimplemented(status) ||
         absl::IsInvalidArgument(status);
}

}  // namespace

absl::Status RepeatCall(const std::stop_token& stop, const std::function<absl::Status()>& call,
                        const std::function<void(const absl::Status&)>& on_error) {
  absl::Duration delay = kFirstDelay;
  while (true) {
    const absl::Time started = SystemClock().Now();
    absl::Status status = call();
    if (stop.stop_requested() || IsFinal(status)) return status;
    on_error(status);
    const absl::Time now = SystemClock().Now();
    if (now - started > kMaxDelay) delay = kFirstDelay;  // the call had succeeded for a while
    if (!SystemClock().SleepUntil(now + delay, stop)) return status;
    delay = std::min(2 * delay, kMaxDelay);
  }
}

}  // namespace evpose::client
