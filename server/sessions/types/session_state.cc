// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/types/session_state.h"

#include <algorithm>

namespace evpose::server {

SessionHealth WithLatencies(SessionHealth health, const LatencyHistogram& latencies) {
  health.latency_p50_us = latencies.Percentile(0.5);
  health.latency_p99_us = latencies.Percentile(0.99);
  return health;
}

uint32_t NumReattaches(const SessionLifecycle& lifecycle) {
  return static_cast<uint32_t>(std::max<uint64_t>(lifecycle.num_attaches, 1) - 1);
}

SessionHealth StoredHealth(const SessionCheckpoint& checkpoint, const SessionLifecycle& lifecycle) {
  SessionHealth health = WithLatencies(checkpoint.health, checkpoint.latencies);
  health.reattaches = NumReattaches(lifecycle);
  return health;
}

}  // namespace evpose::server
