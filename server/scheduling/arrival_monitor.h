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

  // `kept_before`: duration of the data that the client may have kept while it had no server, and now sends at once.
  explicit ArrivalMonitor(std::chrono::seconds kept_before = std::chrono::seconds(0)) : kept_before_(kept_before) {}

  // An item that was received at `received_at` is processed, and with it the data up to this sensor time.
  // `is_drained`: no other data wait.
  void Update(Time received_at, int64_t sensor_time_us, bool is_drained);

  // kBulk as in a replay at full speed: the lead (sensor time minus time of receipt) of an item has exceeded, by more
  // than 50 ms, the largest lead of the items after which the queue was empty, and the queue has not been empty since.
  // Otherwise kLive, also before the first item: a camera cannot send faster than it records, even if it is processed
  // too slowly.
  Arrival arrival() const { return arrival_; }

 private:
  const std::chrono::seconds kept_before_;
  Arrival arrival_ = Arrival::kLive;
  // The largest of the leads of the items after which the queue was empty, and of the lead of the first item plus
  // kept_before_.
  std::optional<double> reference_lead_s_;
};

}  // namespace evpose::server
