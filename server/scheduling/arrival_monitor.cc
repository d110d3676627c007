// SPDX-License-Identifier: Apache-2.0
#include "server/scheduling/arrival_monitor.h"

namespace evpose::server {
namespace {

// Time by which the items of a camera may be closer together at their receipt than at the sensor. A network delays
// some by more than others; a replay fills the buffer of its session with the data of a longer time at once.
constexpr double kLargestLeadS = 0.05;

}  // namespace

void ArrivalMonitor::Update(Time received_at, int64_t sensor_time_us, bool is_drained) {
  const double received_s = std::chrono::duration<double>(received_at.time_since_epoch()).count();
  const double lead_s = 1e-6 * static_cast<double>(sensor_time_us) - received_s;
  if (!first_lead_s_.has_value()) first_lead_s_ = lead_s;
  if (lead_s - *first_lead_s_ > kLargestLeadS) arrival_ = Arrival::kBulk;
  if (!is_drained || arrival_ == Arrival::kLive) return;
  arrival_ = Arrival::kLive;
  first_lead_s_.reset();
}

}  // namespace evpose::server
