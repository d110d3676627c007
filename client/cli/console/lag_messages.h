// SPDX-License-Identifier: Apache-2.0

// What a run prints about its lag.
#pragma once

#include <string>
#include <utility>

#include "absl/time/time.h"

namespace evpose::client {

// Not thread-safe.
class LagMessages {
 public:
  // The events are processed late if the oldest have waited for longer than kLate, until they wait for less than
  // kInTime.
  static constexpr absl::Duration kLate = absl::Seconds(1);
  static constexpr absl::Duration kInTime = absl::Milliseconds(500);

  // `pace`: that of the events, "real time".
  explicit LagMessages(std::string pace) : pace_(std::move(pace)) {}

  // Returns the line to be printed when the oldest events have waited for `lag`; usually an empty text. With
  // `is_explained`, another message has stated the cause of the lag, and this lag is not reported.
  std::string Update(absl::Duration lag, bool is_explained);
  // The longest lag that was reported, or occurred while the events were late; zero if none was.
  absl::Duration longest() const { return longest_; }

 private:
  const std::string pace_;
  bool is_late_ = false;
  absl::Duration longest_;
};

}  // namespace evpose::client
