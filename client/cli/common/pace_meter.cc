// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/pace_meter.h"

#include "absl/strings/str_format.h"

namespace evpose::client {
namespace {

// Pace below which a session is called too slow; it prints as less than 1.0.
constexpr double kSlowPace = 0.95;

}  // namespace

// A server reports the rate of the events instead of this time.
double SensorSeconds(const SessionHealth& health) {
  return health.event_rate_hz > 0.0 ? static_cast<double>(health.decoded_events) / health.event_rate_hz : 0.0;
}

std::string PaceMeter::Update(const SessionHealth& health) {
  const double sensor_s = SensorSeconds(health);
  // The server continues from an earlier state, or the clock of the sensor has stepped back.
  if (!reports_.empty() && sensor_s < reports_.back().sensor_s) reports_.clear();
  const bool has_advanced = !reports_.empty() && sensor_s > reports_.back().sensor_s;
  if (!reports_.empty() && !has_advanced) return "";
  reports_.push_back({sensor_s, health.real_time_ratio * sensor_s});
  while (reports_.size() > 2 && sensor_s - reports_[1].sensor_s >= kShortestSeconds) reports_.pop_front();
  const double passed_s = sensor_s - reports_.front().sensor_s;
  const double processing_s = reports_.back().processing_s - reports_.front().processing_s;
  if (passed_s < kShortestSeconds || processing_s <= 0.0) return "";
  const double pace = passed_s / processing_s;
  return absl::StrFormat("can track %.*f x real time%s", pace < 0.1 ? 2 : 1, pace,
                         pace < kSlowPace ? ": too slow" : "");
}

}  // namespace evpose::client
