// SPDX-License-Identifier: Apache-2.0
#include "server/scheduling/pace_monitor.h"

namespace evpose::server {
namespace {

// Waiting time of the oldest chunk from which on the session is behind. Shorter delays are those of a busy server or of
// a network, and end by themselves.
constexpr std::chrono::seconds kLongestWait{2};

}  // namespace

std::optional<bool> PaceMonitor::Update(Time now, std::optional<Time> oldest_received_at, int64_t sensor_time_us) {
  const bool was_behind = is_behind_;
  const bool waits_long = oldest_received_at.has_value() && now - *oldest_received_at > kLongestWait;
  const auto duration = now - begin_;
  if (!waits_long) is_behind_ = false;
  if (waits_long && duration >= kLongestWait) {
    is_behind_ = std::chrono::microseconds(sensor_time_us - begin_us_) < duration;
  }
  if (!waits_long || duration >= kLongestWait) {
    begin_ = now;
    begin_us_ = sensor_time_us;
  }
  if (is_behind_ == was_behind) return std::nullopt;
  return is_behind_;
}

}  // namespace evpose::server
