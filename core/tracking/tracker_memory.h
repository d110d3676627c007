// SPDX-License-Identifier: Apache-2.0

// The memory of a tracker, from its configuration.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "core/geometry/camera.h"
#include "core/models/object_model.h"

namespace evpose {

struct TrackerOptions;

struct TrackerMemory {
  uint64_t max_bytes = 0;  // memory of the tracker and its camera's tables, without its models, whatever its events are
  uint64_t max_state_bytes = 0;  // size of what Tracker::SaveState() writes
};

// Returns an estimate that the tracker does not exceed, also after noise in every pixel and with as many hypotheses of
// each object as there may be. It assumes that the hypotheses of an object together have lines in at most twice the
// area of the image. Tables that trackers with the same camera share count in full. `models`: one for each object.
// tests/bench/session_memory.py compares the estimate with the memory of a server.
TrackerMemory EstimateTrackerMemory(const CameraModel& camera,
                                    const std::vector<std::shared_ptr<const ObjectModel>>& models,
                                    const TrackerOptions& options);

// The bytes of a model and of the tables that all trackers with this model share (ObjectToTrack).
uint64_t EstimateModelMemory(const ObjectModel& model);

}  // namespace evpose
