// SPDX-License-Identifier: Apache-2.0

// Whether the data of a session arrive as a camera records them.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>

#include "server/scheduling/fair_queue.h"

namespace evpose::server {

// Not thread-safe, without a clock.
class ArrivalMonitor {
 public:
  using Time = std::chrono::steady_clock::time_point;

  // `kept_before`: the client may have kept the data of this time, because it had no server. It sends them at once.
  explicit ArrivalMonitor(std::chrono::seconds kept_before = std::chrono::seconds(0)) : kept_before_(kept_before) {}

  // An item that was received at `received_at` is processed, and with it the data up to this sensor time.
  // `is_drained`: no other data wait.
  void Update(Time received_at, int64_t sensor_time_us, bool is_drained);

  // kBulk: the sensor time is ahead of the time of receipt by more than it was for any item after which no data waited,
  // and data have waited ever since. A replay at full speed arrives so. A camera cannot send faster than it records: it
  // stays kLive although it is processed too slowly. kLive at first.
  Arrival arrival() const { return arrival_; }

 private:
  const std::chrono::seconds kept_before_;
  Arrival arrival_ = Arrival::kLive;
  // Sensor time minus time of receipt: the largest one of the items after which no data waited, or that of the first
  // item and the time before it.
  std::optional<double> reference_lead_s_;
};

}  // namespace evpose::server
