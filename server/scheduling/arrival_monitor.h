// SPDX-License-Identifier: Apache-2.0

// Whether the data of a session arrive as a camera records them.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>

#include "server/scheduling/fair_queue.h"

namespace evpose::server {

// Not thread-safe, without a clock. Until there are two items, the data count as live.
class ArrivalMonitor {
 public:
  using Time = std::chrono::steady_clock::time_point;

  // An item that was received at `received_at` is processed, and with it the data up to this sensor time.
  // `is_drained`: no other data wait.
  void Update(Time received_at, int64_t sensor_time_us, bool is_drained);

  // kBulk: since the last time at which no data waited, more sensor time was received than time has passed. A camera
  // cannot send so, a replay at full speed does. A camera that is processed too slowly stays kLive.
  Arrival arrival() const { return arrival_; }

 private:
  Arrival arrival_ = Arrival::kLive;
  std::optional<double> first_lead_s_;  // sensor time minus time of receipt of the first item that is compared
};

}  // namespace evpose::server
