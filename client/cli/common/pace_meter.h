// SPDX-License-Identifier: Apache-2.0

// Whether a server processes a session as fast as its camera sends, from successive health reports.
#pragma once

#include <deque>
#include <string>

#include "evpose/types.h"

namespace evpose::client {

// The processed time of the sensor since the first event, seconds; 0 before it.
double SensorSeconds(const SessionHealth& health);

// Not thread-safe.
class PaceMeter {
 public:
  // The shortest sensor time over which a pace is computed, seconds. In less time one search for a pose counts as much
  // as the tracking after it.
  static constexpr double kShortestSeconds = 1.0;

  // Returns the pace over the latest second of sensor time that the server could keep, "can track 2.5 x real time" or
  // "can track 0.6 x real time: too slow". The text is empty before the first second, and if nothing was processed
  // since the previous report, because a server that waits for events is not slow.
  std::string Update(const SessionHealth& health);

 private:
  struct Report {
    double sensor_s = 0.0;
    double processing_s = 0.0;
  };

  // The latest reports. The second of them is less than kShortestSeconds before the last one.
  std::deque<Report> reports_;
};

}  // namespace evpose::client
