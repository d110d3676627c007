// SPDX-License-Identifier: Apache-2.0
#include "client/cli/console/lag_messages.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace evpose::client {

std::string LagMessages::Update(absl::Duration lag, bool is_explained) {
  if (is_late_ && lag < kInTime) {
    is_late_ = false;
    return absl::StrCat("the events keep up with ", pace_, " again");
  }
  if (is_explained) return "";
  const bool was_late = is_late_;
  is_late_ = is_late_ || lag > kLate;
  if (is_late_) longest_ = std::max(longest_, lag);
  if (was_late || !is_late_) return "";
  return absl::StrFormat(
      "slower than %s: the oldest events have waited for %.1f s; the connection, the server or this machine is too "
      "slow for them: evpose doctor --server measures the connection",
      pace_, absl::ToDoubleSeconds(lag));
}

}  // namespace evpose::client
