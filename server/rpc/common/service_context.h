// SPDX-License-Identifier: Apache-2.0

// The parts of the server that the services use. All of them outlive the services.
#pragma once

#include "absl/time/time.h"
#include "server/auth/authenticator.h"
#include "server/models/model_registry.h"
#include "server/rpc/common/pending_response.h"
#include "server/rpc/common/stream_registry.h"
#include "server/runtime/worker_pool.h"
#include "server/sessions/session_manager.h"
#include "server/sessions/tenant_quotas.h"
#include "server/stores/common/store.h"
#include "server/telemetry/log_limiter.h"
#include "server/telemetry/metrics.h"

namespace evpose::server {

// Starts the shutdown of the server.
class Drainer {
 public:
  virtual ~Drainer() = default;
  // Does not block. Only the first call has an effect.
  virtual void Drain(absl::Duration deadline) = 0;
};

struct ServiceContext {
  Store& store;
  ModelRegistry& models;
  SessionManager& sessions;
  WorkerPool& pool;
  StreamRegistry& streams;
  Authenticator& authenticator;
  TenantQuotas& quotas;
  Drainer& drainer;
  absl::Duration attach_timeout;
  absl::Duration stream_idle_timeout;  // zero: none
  absl::Duration upload_timeout;
  absl::Duration response_timeout;
  uint64_t max_model_bytes;
  bool shows_events;
  absl::Duration drain_timeout;  // default of DrainRequest.timeout
  ServerMetrics& metrics;
  LogLimiter& log_limiter;
};

inline ResponseLimits LimitsOf(const ServiceContext& services) { return {services.quotas, services.response_timeout}; }

}  // namespace evpose::server
