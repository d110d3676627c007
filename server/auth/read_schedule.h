// SPDX-License-Identifier: Apache-2.0

// The times at which files are read again.
#pragma once

#include <chrono>
#include <functional>
#include <optional>
#include <utility>

#include "absl/status/status.h"

namespace evpose::server {

// Files are read again after a change, and once per second after an error of reading, such as EMFILE or EIO, which the
// next attempt may not have. An error of the contents remains until the files change.
template <typename Stamp>
class ReadSchedule {
 public:
  using Clock = std::chrono::steady_clock;
  using Now = std::function<Clock::time_point()>;
  static constexpr std::chrono::seconds kRetryPeriod{1};

  explicit ReadSchedule(Now now = Clock::now) : now_(std::move(now)) {}

  bool IsDue(const Stamp& stamp) const { return stamp != stamp_ || (retry_at_.has_value() && now_() >= *retry_at_); }

  // `stamp` was taken before the files were read, so that a change in the meantime is detected by the next call of
  // IsDue(). Returns whether `status` is new, and not the error of the previous attempt on the same files.
  bool OnRead(const Stamp& stamp, const absl::Status& status) {
    const bool is_of_contents = absl::IsInvalidArgument(status) || absl::IsFailedPrecondition(status);
    const bool is_new = status.ok() || stamp != stamp_ || status != status_;
    retry_at_.reset();
    if (!status.ok() && !is_of_contents) retry_at_ = now_() + kRetryPeriod;
    stamp_ = stamp;
    status_ = status;
    return is_new;
  }

 private:
  const Now now_;
  Stamp stamp_ = {};  // of the last attempt
  absl::Status status_;
  std::optional<Clock::time_point> retry_at_;
};

}  // namespace evpose::server
