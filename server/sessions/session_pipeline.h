// SPDX-License-Identifier: Apache-2.0

// Turns the bytes of a session into poses and state changes, without threads. The output is a function of the
// configuration and of the sequence of bytes, resets and losses. It does not depend on the division of the bytes into
// calls.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/types/span.h"
#include "core/events/decoder.h"
#include "core/events/event.h"
#include "core/tracking/tracker.h"
#include "server/sessions/types/session_config.h"
#include "server/sessions/types/session_state.h"
#include "server/telemetry/stage_timer.h"

namespace evpose::server {

struct ObjectStateChange {
  uint32_t object_index = 0;
  int64_t t_us = 0;
  TrackState state = TrackState::kInitializing;
  TrackState state_before = TrackState::kInitializing;
  size_t num_poses_before = 0;  // its place in PipelineOutput::poses
};

struct PipelineOutput {
  std::vector<PoseEstimate> poses;
  std::vector<ObjectStateChange> state_changes;
  std::vector<Trigger> triggers;  // in the order of the bytes

  void clear() {
    poses.clear();
    state_changes.clear();
    triggers.clear();
  }
};

// Not thread-safe.
class SessionPipeline {
 public:
  // `models` has one model for each of config.objects, in the same order. Errors: INVALID_ARGUMENT with the field of
  // `config`.
  static absl::StatusOr<std::unique_ptr<SessionPipeline>> Create(
      const SessionConfig& config, const std::vector<std::shared_ptr<const ObjectModel>>& models,
      const TrackerFactory& make_tracker);
  // Does the same as Create() without the initial poses of the configuration: the tracker searches for every object.
  static absl::StatusOr<std::unique_ptr<SessionPipeline>> CreateSearching(
      const SessionConfig& config, const std::vector<std::shared_ptr<const ObjectModel>>& models,
      const TrackerFactory& make_tracker);

  // Keeps a charge of its memory until it is destroyed.
  void HoldCharge(std::shared_ptr<const void> charge) { memory_charge_ = std::move(charge); }
  // Reports the phase transitions of the tracker from now on.
  void SetPhaseListener(const PhaseListener& listener) { tracker_->SetPhaseListener(listener); }
  // Measures the durations of the stages from now on.
  void Measure(StageTimer timer) { timer_ = std::move(timer); }

  // Each appends to `output`.
  void Process(absl::Span<const uint8_t> bytes, PipelineOutput& output);
  // Does the same as Process(), but drops the events after decoding (Tracker::Skip).
  EventGap Skip(absl::Span<const uint8_t> bytes, PipelineOutput& output);
  void ResetAfterLoss();
  void ResetPose(uint32_t object_index, const RigidTransform& camera_from_object);
  void Finish(PipelineOutput& output);

  // Returns the whole state on which later output depends, to the bit. For a sensor of 1280x720 pixels it has about 0.2
  // MB while tracking, and up to 1.2 MB for each object that is searched for.
  PipelineState SaveState() const;
  // LoadPosition() and LoadTracker() load a state into a pipeline with the same configuration and models that has
  // processed nothing; it then continues from that state. Error: DATA_LOSS with the reason if the state is damaged; the
  // pipeline must then not be used.
  absl::Status LoadPosition(const StreamPosition& position);
  // Error: DATA_LOSS also for a state of another version or configuration; use CreateSearching() then.
  absl::Status LoadTracker(const SavedTracker& tracker);

  // The events of the latest Process(); valid until the next one.
  absl::Span<const Event> events() const { return decoded_.events; }
  const DecodeCounts& counts() const { return decoder_->counts(); }
  int64_t first_t_us() const { return first_t_us_; }  // -1: no time seen yet
  int64_t now_us() const { return now_us_; }          // -1: no time seen yet
  int64_t sensor_time_us() const { return now_us_ - first_t_us_; }
  const Tracker& tracker() const { return *tracker_; }

 private:
  SessionPipeline() = default;
  void Decode(absl::Span<const uint8_t> bytes, PipelineOutput& output);
  void FeedEvents(absl::Span<const Event> events, PipelineOutput& output);
  void FeedTime(int64_t t_us, PipelineOutput& output);
  void AdvanceTime(int64_t t_us);
  void CloseSlice(int64_t t_us, PipelineOutput& output);
  void TrackEvents(absl::Span<const Event> events, PipelineOutput& output);

  std::shared_ptr<const void> memory_charge_;
  std::string configuration_;  // digest of the configuration and models to which a state belongs
  std::unique_ptr<EventDecoder> decoder_;
  std::unique_ptr<Tracker> tracker_;
  std::vector<TrackState> reported_states_;  // reported state of each object
  DecodedEvents decoded_;                    // a member so that its memory is reused
  int64_t first_t_us_ = -1;
  int64_t now_us_ = -1;
  int64_t slice_end_us_ = 0;
  StageTimer timer_;
};

}  // namespace evpose::server
