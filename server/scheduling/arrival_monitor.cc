// SPDX-License-Identifier: Apache-2.0
#include "server/scheduling/arrival_monitor.h"

#include <algorithm>

namespace evpose::server {
namespace {

// Seconds by which the lead may exceed the reference: the variation of a network's delay. A replay fills the buffer of
// its session with the data of a longer time at once.
constexpr double kLargestLeadS = 0.05;

}  // namespace

void ArrivalMonitor::Update(Time received_at, int64_t sensor_time_us, bool is_drained) {
  const double received_s = std::chrono::duration<double>(received_at.time_since_epoch()).count();
  const double lead_s = 1e-6 * static_cast<double>(sensor_time_us) - received_s;
  if (!reference_lead_s_.has_value()) reference_lead_s_ = lead_s + static_cast<double>(kept_before_.count());
  if (lead_s - *reference_lead_s_ > kLargestLeadS) arrival_ = Arrival::kBulk;
  if (!is_drained) return;
  arrival_ = Arrival::kLive;
  reference_lead_s_ = std::max(*reference_lead_s_, lead_s);
}

}  // namespace evpose::server
