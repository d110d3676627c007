// SPDX-License-Identifier: Apache-2.0

// The time for which the client of a Track stream has been silent (ServerOptions::stream_idle_timeout).
#pragma once

#include <algorithm>
#include <chrono>
#include <optional>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "server/runtime/errors.h"

namespace evpose::server {

// Counts only the time in which the next step is the client's: it may send and has the acks of all that it has sent, or
// it must read a response. A client that waits for the server is not silent. Not thread-safe, without clock.
class StreamSilence {
 public:
  using Time = std::chrono::steady_clock::time_point;

  struct Situation {
    // The server waits for a message; false while the queue is full or the tenant has exceeded its rate.
    bool is_reading = false;
    bool is_processed = false;  // everything received has been processed, and its results may be sent
    bool is_writing = false;    // a response is in flight
  };
  // To be called after each change of the situation. Returns the duration of the silence so far.
  absl::Duration Update(const Situation& situation, Time now) {
    Set(may_send_since_, situation.is_reading && situation.is_processed, now);
    Set(must_read_since_, situation.is_reading && situation.is_writing, now);
    return absl::FromChrono(now - std::min(may_send_since_.value_or(now), must_read_since_.value_or(now)));
  }
  // The client has sent a message.
  void OnMessage() {
    may_send_since_.reset();
    must_read_since_.reset();
  }
  // The client has read a response.
  void OnWritten() { must_read_since_.reset(); }

 private:
  static void Set(std::optional<Time>& since, bool is_so, Time now) {
    if (!is_so) {
      since.reset();
    } else if (!since) {
      since = now;
    }
  }

  std::optional<Time> may_send_since_;
  std::optional<Time> must_read_since_;
};

// DEADLINE_EXCEEDED (STREAM_IDLE) for a stream that has been silent for this time.
inline absl::Status StreamIdleError(absl::Duration timeout) {
  return WithReason(absl::DeadlineExceededError(
                        absl::StrCat("the stream has sent no message for ", absl::FormatDuration(timeout),
                                     ": attach again to continue, and send empty chunks while there are no events")),
                    v1::STREAM_IDLE);
}

// DEADLINE_EXCEEDED (ATTACH_TIMEOUT) for a stream that has not attached to a session for this time.
inline absl::Status AttachTimeoutError(absl::Duration timeout) {
  return WithReason(
      absl::DeadlineExceededError(absl::StrCat("the stream has not attached within ", absl::FormatDuration(timeout),
                                               ": send `attach` as the first message")),
      v1::ATTACH_TIMEOUT);
}

}  // namespace evpose::server
