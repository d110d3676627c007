// SPDX-License-Identifier: Apache-2.0

// What the services share. Everything in it outlives them.
#pragma once

#include "absl/time/time.h"
#include "server/auth/authenticator.h"
#include "server/models/model_registry.h"
#include "server/rpc/stream_registry.h"
#include "server/runtime/worker_pool.h"
#include "server/sessions/session_manager.h"
#include "server/sessions/tenant_quotas.h"
#include "server/stores/common/store.h"
#include "server/telemetry/metrics.h"

namespace evpose::server {

// Who makes the server leave.
class Drainer {
 public:
  virtual ~Drainer() = default;
  // Must not block. The first one counts.
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
  uint64_t max_model_bytes;
  absl::Duration drain_timeout;  // when the caller of Drain gives none
  ServerMetrics& metrics;
};

}  // namespace evpose::server
