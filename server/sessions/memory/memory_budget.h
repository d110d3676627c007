// SPDX-License-Identifier: Apache-2.0

// Bounds the memory of all sessions. Each session is charged with the most that it may take before any of it is
// allocated. A model that sessions of a tenant share is charged once.
#pragma once

#include <cstdint>
#include <limits>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "server/sessions/memory/session_memory.h"
#include "server/telemetry/metrics.h"

namespace evpose::server {

// The charges of one session. Each ends when its last copy is destroyed.
struct MemoryCharge {
  std::shared_ptr<const void> tracking;  // includes the models, each until the last charge with it ends
  std::shared_ptr<const void> other;
};

// Thread-safe. Charges keep it alive.
class MemoryBudget : public std::enable_shared_from_this<MemoryBudget> {
 public:
  struct Options {
    uint64_t max_bytes = std::numeric_limits<uint64_t>::max();
    uint64_t max_tenant_bytes = std::numeric_limits<uint64_t>::max();  // memory of the sessions of each tenant
    std::shared_ptr<ServerMetrics> metrics = std::make_shared<ServerMetrics>();
  };
  static std::shared_ptr<MemoryBudget> Create(Options options) {
    return std::shared_ptr<MemoryBudget>(new MemoryBudget(std::move(options)));
  }

  // Errors: RESOURCE_EXHAUSTED (SESSION_MEMORY) with the bytes that are needed, taken and allowed.
  absl::StatusOr<MemoryCharge> Charge(const std::string& tenant, const SessionMemory& memory,
                                      absl::Span<const ModelMemory> models = {}) {
    return Charge(tenant, memory, models, true);
  }
  // Charges a session that exists already. It is never refused.
  MemoryCharge ChargeBeyondLimit(const std::string& tenant, const SessionMemory& memory,
                                 absl::Span<const ModelMemory> models = {}) {
    return *Charge(tenant, memory, models, false);
  }

  uint64_t charged_bytes() const;
  uint64_t max_bytes() const { return options_.max_bytes; }

 private:
  explicit MemoryBudget(Options options) : options_(std::move(options)) {}

  // The bytes of a charge. Its destructor releases them if they have been added.
  struct Part;
  using ModelKey = std::pair<std::string, const ObjectModel*>;  // tenant, and the model, which its part keeps

  std::shared_ptr<Part> MakePart(const std::string& tenant);
  absl::StatusOr<MemoryCharge> Charge(const std::string& tenant, const SessionMemory& memory,
                                      absl::Span<const ModelMemory> models, bool may_refuse);
  absl::Status Check(const std::string& tenant, uint64_t bytes) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Add(Part& part, uint64_t bytes) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Release(const Part& part);

  const Options options_;
  mutable std::mutex mutex_;
  uint64_t charged_bytes_ ABSL_GUARDED_BY(mutex_) = 0;
  std::map<std::string, uint64_t> charged_by_tenant_ ABSL_GUARDED_BY(mutex_);  // no zeros
  std::map<ModelKey, std::weak_ptr<Part>> models_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
