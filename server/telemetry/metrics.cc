// SPDX-License-Identifier: Apache-2.0
#include "server/telemetry/metrics.h"

#include <algorithm>

namespace evpose::server {

DurationHistogram::Reading DurationHistogram::Read() const {
  Reading reading;
  std::transform(counts_.begin(), counts_.end(), reading.counts.begin(),
                 [](const Counter& count) { return count.value(); });
  reading.sum_s = static_cast<double>(sum_ns_.value()) * 1e-9;
  return reading;
}

}  // namespace evpose::server
