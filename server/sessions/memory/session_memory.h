// SPDX-License-Identifier: Apache-2.0

// The memory that a session may take, from its configuration and the server's limits.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "core/models/object_model.h"
#include "server/sessions/types/session_config.h"

namespace evpose::server {

struct SessionMemory {
  uint64_t tracking_bytes = 0;  // released when the session ends
  uint64_t other_bytes = 0;     // released when the session is deleted: its queue and its poses

  uint64_t total_bytes() const { return tracking_bytes + other_bytes; }
};

// A model with its tables, which all sessions of a tenant share.
struct ModelMemory {
  std::shared_ptr<const ObjectModel> model;
  uint64_t bytes = 0;
};

// The limits of each session that bound its memory; as in SessionLimits.
struct SessionMemoryLimits {
  uint64_t credit_bytes = 0;
  uint64_t max_chunk_bytes = 0;
  uint64_t pose_log_capacity = 0;
  bool writes_checkpoints = true;
};

// Returns an upper bound without the models, with the assumptions of EstimateTrackerMemory(). `models`: one for each of
// config.objects.
SessionMemory MaxSessionMemory(const SessionConfig& config,
                               const std::vector<std::shared_ptr<const ObjectModel>>& models,
                               const SessionMemoryLimits& limits);
// Returns an upper bound for a watcher of images of events, with its part of those that watchers share and with the
// messages that gRPC holds.
uint64_t EventWatcherMemory(const SessionConfig& config, int cell_px);
// The memory of each distinct one.
std::vector<ModelMemory> MemoryOfModels(const std::vector<std::shared_ptr<const ObjectModel>>& models);

}  // namespace evpose::server
