// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/memory/session_memory.h"

#include <algorithm>

#include "core/events/event_bitmap.h"
#include "core/tracking/object/object_outline.h"
#include "core/tracking/object/tracker_options.h"
#include "core/tracking/tracker_memory.h"
#include "server/sessions/types/pose_log.h"

namespace evpose::server {
namespace {

// The events of a slice of 16 KiB: 6 MB with the densest encoding, EVT3, and the growth of their vector.
constexpr uint64_t kSliceEventBytes = 9u << 20;
// Streams with their messages, watchers, the log, and what the allocator does not return.
constexpr uint64_t kFixedBytes = 2u << 20;

}  // namespace

SessionMemory MaxSessionMemory(const SessionConfig& config,
                               const std::vector<std::shared_ptr<const ObjectModel>>& models,
                               const SessionMemoryLimits& limits) {
  const TrackerMemory tracker = EstimateTrackerMemory(config.camera, models, TrackerOptions());
  // The queue of an overloaded session with kLatest takes twice its credit. The last chunk may exceed it, and the
  // stream has read the next one.
  const uint64_t queue_bytes =
      (config.overload_policy == OverloadPolicy::kLatest ? 2 : 1) * limits.credit_bytes + 2 * limits.max_chunk_bytes;
  const uint64_t pose_bytes = limits.pose_log_capacity * sizeof(StoredPose);
  SessionMemory memory;
  memory.tracking_bytes = tracker.max_bytes + kSliceEventBytes;
  // A checkpoint: the state and the new poses, encoded, and the copy that the store writes.
  if (limits.writes_checkpoints) memory.tracking_bytes += 2 * (tracker.max_state_bytes + pose_bytes / 2);
  memory.other_bytes = queue_bytes + pose_bytes + kFixedBytes;
  return memory;
}

uint64_t EventWatcherMemory(const SessionConfig& config, int cell_px) {
  // The canvas, the waiting image, the image that is sent, its message in the API, and the copy of gRPC.
  constexpr uint64_t kImages = 5;
  // The new outline, the waiting outline, and the messages.
  constexpr uint64_t kBytesPerSegment = 4 * sizeof(OutlineSegment);
  constexpr uint64_t kWatcherBytes = 64u << 10;
  const SensorGeometry sensor = {config.camera.width_px, config.camera.height_px};
  return kImages * EventBitmap::NumBytes(sensor, cell_px) +
         config.objects.size() * kMaxOutlineSegments * kBytesPerSegment + kWatcherBytes;
}

std::vector<ModelMemory> MemoryOfModels(const std::vector<std::shared_ptr<const ObjectModel>>& models) {
  std::vector<ModelMemory> distinct;
  for (const auto& model : models) {
    const auto is_same = [&](const ModelMemory& memory) { return memory.model == model; };
    if (std::any_of(distinct.begin(), distinct.end(), is_same)) continue;
    distinct.push_back({model, EstimateModelMemory(*model)});
  }
  return distinct;
}

}  // namespace evpose::server
