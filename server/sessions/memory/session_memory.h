// SPDX-License-Identifier: Apache-2.0

// Computes the memory that a session may take from its configuration and the limits of the server.
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

// Returns an upper bound of the memory without the models, with the assumptions of EstimateTrackerMemory(). `models`
// has one element for each of config.objects.
SessionMemory MaxSessionMemory(const SessionConfig& config,
                               const std::vector<std::shared_ptr<const ObjectModel>>& models,
                               const SessionMemoryLimits& limits);
// Returns an upper bound of the memory for a watcher of images of events. It includes a part of the images that
// watchers share, and the messages that gRPC holds.
uint64_t EventWatcherMemory(const SessionConfig& config, int cell_px);
// Returns the memory of each distinct model.
std::vector<ModelMemory> MemoryOfModels(const std::vector<std::shared_ptr<const ObjectModel>>& models);

}  // namespace evpose::server
