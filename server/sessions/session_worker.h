// SPDX-License-Identifier: Apache-2.0

// Processes the items of a session, slice by slice.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "absl/types/span.h"
#include "core/base/yield_point.h"
#include "core/windows/event_window.h"
#include "server/sessions/session_pipeline.h"
#include "server/sessions/stream/work_queue.h"
#include "server/sessions/types/overload.h"
#include "server/sessions/types/pose_log.h"
#include "server/sessions/types/session_config.h"
#include "server/sessions/types/session_state.h"
#include "server/sessions/watching/event_images.h"
#include "server/telemetry/metrics.h"
#include "server/telemetry/session_log.h"

namespace evpose::server {

// Result of one slice.
struct WorkResult {
  uint64_t poses_before = 0;      // number of the last pose before the slice
  std::vector<StoredPose> poses;  // consecutive, from poses_before + 1
  std::vector<ObjectStateChange> state_changes;
  EventGap dropped_now;              // events dropped from this slice
  std::optional<EventsDropped> gap;  // a gap that has ended before this slice
  // Totals after the slice.
  DecodeCounts counts;
  int64_t t_us = 0;
  int64_t sensor_time_us = 0;
  int64_t processing_us = 0;
  std::vector<ObjectHealth> objects;
  // Set only with the last slice of an item.
  struct Item {
    uint64_t stream = 0;
    uint64_t seq = 0;
    uint64_t bytes = 0;
    bool is_end = false;
    std::optional<DecodeFault> fault;
    std::optional<ChunkTriggers> triggers;
  };
  std::optional<Item> finished;

  uint64_t last_pose_seq() const { return poses_before + poses.size(); }
};

// Not thread-safe: belongs to the turns of its session. Results do not depend on the clock, except with kLatest, where
// the caller decides from the backlog which slices are dropped.
class SessionWorker {
 public:
  struct Options {
    std::function<SteadyTime()> now;
    std::shared_ptr<ServerMetrics> metrics;
    std::shared_ptr<const SessionLog> log;
    std::shared_ptr<EventImages> images = nullptr;  // null: none are made
  };
  // `pipeline` is in the state of `checkpoint`; null when the session has ended. `config` must outlive the worker.
  // `health` is that of the checkpoint, or empty for a new session, with one element for each object.
  SessionWorker(const SessionConfig& config, Options options, std::unique_ptr<SessionPipeline> pipeline,
                const SessionHealth& health);

  // Precondition: no unfinished item.
  void Start(WorkItem item);
  // The item has events, which may be dropped.
  bool is_events() const { return std::holds_alternative<EventChunk>(item_->what); }
  // Processes the next slice of the item. `backlog` decides whether its events are dropped (OverloadGate).
  WorkResult Work(const Backlog& backlog);

  // Returns the state of the objects; empty without a pipeline.
  std::vector<ObjectHealth> Objects() const;
  bool has_pipeline() const { return pipeline_ != nullptr; }
  PipelineState SaveState() const { return pipeline_->SaveState(); }
  // To be called after the end, when the tracker is no longer needed. Postcondition: there is no pipeline.
  std::unique_ptr<SessionPipeline> ReleasePipeline() { return std::move(pipeline_); }

 private:
  // Returns the time without the pauses of the work, for durations of processing.
  SteadyTime WorkTime() const { return options_.now() - PausedTime(); }
  void AdaptSlice(std::chrono::steady_clock::duration duration);
  bool WorkOnItem();
  bool WorkOnEvents(const EventChunk& chunk);
  void DropOrTrack(absl::Span<const uint8_t> slice);
  bool HasImageWatchers() const { return options_.images != nullptr && options_.images->is_watched(); }
  // Shows these events, which have been tracked since the sensor time `from_t_us`, to the watchers of images.
  void ShowEvents(absl::Span<const Event> events, int64_t from_t_us);
  std::vector<StoredPose> NumberPoses();
  std::optional<DecodeFault> FindDecodeFault() const;
  void CollectTriggers();
  WorkResult MakeResult(bool item_is_finished);
  void OnPhaseTransition(const PhaseTransition& transition) const;
  void ReportStateChanges() const;  // to log and metrics

  const SessionConfig& config_;
  const Options options_;
  std::unique_ptr<SessionPipeline> pipeline_;
  PipelineOutput output_;  // output of the slice
  std::optional<WorkItem> item_;
  size_t item_offset_ = 0;
  size_t slice_bytes_;  // size of the next slice, at most
  DecodeCounts counts_before_item_;
  ChunkTriggers triggers_;  // triggers of the item so far
  uint64_t next_pose_seq_ = 1;
  OverloadGate overload_;
  bool must_drop_ = false;            // the events of the slice
  EventGap dropped_now_;              // gap of the slice
  std::optional<EventsDropped> gap_;  // the gap that ended before the slice
  std::chrono::steady_clock::duration processing_time_{0};
  std::vector<float> explained_ratios_;   // explained ratio of each object's latest pose
  std::vector<uint32_t> earlier_losses_;  // losses of each object before the present tracker was created
};

}  // namespace evpose::server
