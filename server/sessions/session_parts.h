// SPDX-License-Identifier: Apache-2.0

// What a session is made of (SessionFactory).
#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/time/time.h"
#include "server/sessions/session_limits.h"
#include "server/sessions/session_pipeline.h"
#include "server/sessions/stream/work_queue.h"
#include "server/sessions/types/session_config.h"
#include "server/sessions/types/session_state.h"
#include "server/stores/common/store.h"
#include "server/telemetry/metrics.h"

namespace evpose::server {

struct SessionClocks {
  std::function<absl::Time()> wall;                                     // for expiry
  std::function<SteadyTime()> steady = std::chrono::steady_clock::now;  // for measured durations and for max_lag
};

struct SessionParts {
  std::string name;
  std::string tenant;
  SessionConfig config;
  SessionLimits limits;
  std::vector<std::shared_ptr<const void>> model_uses;  // released when the session closes
  std::shared_ptr<const void> memory_charge;  // for everything except the pipeline, which has a charge of its own
  std::unique_ptr<SessionPipeline> pipeline;  // in the state of the beginning's checkpoint; null when it has ended
  SessionBeginning beginning;
  std::vector<PoseSegment> stored_poses;  // the segments of a resumed session; of these only the sizes are used
  std::unique_ptr<SessionLease> lease;
  std::string resume_token;  // of a new session; empty for a resumed one: the store has only its digest
  absl::Time create_time;
  SessionClocks clocks;
  std::shared_ptr<ServerMetrics> metrics = std::make_shared<ServerMetrics>();
};

}  // namespace evpose::server
