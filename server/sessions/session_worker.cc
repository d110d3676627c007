// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session_worker.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/byte_order.h"
#include "core/events/decoder.h"
#include "server/runtime/out_of_memory.h"
#include "server/scheduling/endable_work.h"
#include "server/sessions/session_limits.h"

namespace evpose::server {
namespace {

// The slice after which the readers are notified and the session may stop: at most about 6 MB of decoded events,
// whatever the encoding. An expensive session would take seconds for so many bytes, so its slices are shorter. A slice
// that took longer than kLongSlice is halved, and one that took less than kShortSlice doubled: between them, by more
// than a factor of two, the size does not alternate.
constexpr size_t kMaxSliceBytes = size_t{16} * 1024;
constexpr size_t kMinSliceBytes = 256;
constexpr std::chrono::milliseconds kLongSlice{5};
constexpr std::chrono::milliseconds kShortSlice{2};

bool HasPose(TrackState state) { return state != TrackState::kInitializing && state != TrackState::kLost; }

}  // namespace

SessionWorker::SessionWorker(const SessionConfig& config, Options options, std::unique_ptr<SessionPipeline> pipeline,
                             const SessionHealth& health)
    : config_(config),
      options_(std::move(options)),
      pipeline_(std::move(pipeline)),
      slice_bytes_(kMaxSliceBytes),
      next_pose_seq_(health.poses + 1),
      overload_(config),
      processing_time_(std::chrono::microseconds(health.processing_us)),
      explained_ratios_(config.objects.size(), 0.0f),
      earlier_losses_(config.objects.size(), 0) {
  for (size_t i = 0; i < health.objects.size(); ++i) {
    explained_ratios_[i] = health.objects[i].explained_ratio;
    if (pipeline_ != nullptr) earlier_losses_[i] = health.objects[i].losses - pipeline_->tracker().losses(i);
  }
  if (pipeline_ == nullptr) return;
  pipeline_->Measure({options_.metrics, [this] { return WorkTime(); }, options_.log->trace_id()});
  pipeline_->SetPhaseListener([this](const PhaseTransition& transition) { OnPhaseTransition(transition); });
}

void SessionWorker::Start(WorkItem item) {
  item_ = std::move(item);
  item_offset_ = 0;
  triggers_ = {.seq = item_->seq()};
}

WorkResult SessionWorker::Work(const Backlog& backlog) {
  must_drop_ = is_events() && overload_.MustSkip(backlog);
  const SteadyTime begin = WorkTime();
  output_.clear();
  const bool item_is_finished = WorkOnItem();
  CollectTriggers();
  const auto duration = WorkTime() - begin;
  AdaptSlice(duration);
  processing_time_ += duration;
  options_.metrics->processing_ns.Add(static_cast<uint64_t>(std::chrono::nanoseconds(duration).count()));
  WorkResult result = MakeResult(item_is_finished);
  ReportStateChanges();
  return result;
}

// No pose depends on the division of the bytes into slices.
void SessionWorker::AdaptSlice(std::chrono::steady_clock::duration duration) {
  if (duration > kLongSlice) slice_bytes_ = std::max(kMinSliceBytes, slice_bytes_ / 2);
  if (duration < kShortSlice) slice_bytes_ = std::min(kMaxSliceBytes, 2 * slice_bytes_);
}

bool SessionWorker::WorkOnItem() {
  if (const auto* chunk = std::get_if<EventChunk>(&item_->what)) return WorkOnEvents(*chunk);
  if (const auto* reset = std::get_if<PoseReset>(&item_->what)) {
    pipeline_->ResetPose(reset->object_index, reset->camera_from_object);
  } else {
    gap_ = overload_.EndGap();
    pipeline_->Finish(output_);
    if (HasImageWatchers()) {
      ShowEvents({}, pipeline_->now_us());
      RunUnlessOutOfMemory([this] { options_.images->Finish(); });
    }
  }
  return true;
}

bool SessionWorker::WorkOnEvents(const EventChunk& chunk) {
  if (item_offset_ == 0) {
    counts_before_item_ = pipeline_->counts();
    if (chunk.discontinuity) pipeline_->ResetAfterLoss();
  }
  const absl::Span<const uint8_t> slice = AsBytes(chunk.payload).subspan(item_offset_, slice_bytes_);
  DropOrTrack(slice);
  item_offset_ += slice.size();
  return item_offset_ == chunk.payload.size();
}

void SessionWorker::DropOrTrack(absl::Span<const uint8_t> slice) {
  if (!must_drop_) {
    gap_ = overload_.EndGap();
    const int64_t from_t_us = pipeline_->now_us();
    {
      const ScopedEndableWork scope;  // when the scheduler ends, the session is closed: nothing uses the pipeline again
      pipeline_->Process(slice, output_);
    }
    if (HasImageWatchers()) ShowEvents(pipeline_->events(), from_t_us);
    return;
  }
  dropped_now_ = pipeline_->Skip(slice, output_);
  overload_.AddDropped(dropped_now_);
  options_.metrics->skipped_events[overload_.reason()].Add(dropped_now_.num_events);
}

// If there is no memory for an image, the session continues without it.
void SessionWorker::ShowEvents(absl::Span<const Event> events, int64_t from_t_us) {
  if (pipeline_->first_t_us() < 0) return;  // the sensor's clock is not known yet
  const int64_t begin_t_us = from_t_us < 0 ? pipeline_->first_t_us() : from_t_us;
  RunUnlessOutOfMemory([&] { options_.images->Add(events, begin_t_us, pipeline_->now_us(), pipeline_->tracker()); });
}

std::vector<StoredPose> SessionWorker::NumberPoses() {
  const int64_t latency_us =
      std::chrono::duration_cast<std::chrono::microseconds>(options_.now() - item_->received_at).count();
  std::vector<StoredPose> poses;
  poses.reserve(output_.poses.size());
  for (const PoseEstimate& estimate : output_.poses) {
    explained_ratios_[estimate.object_index] = estimate.explained_ratio;
    poses.push_back({next_pose_seq_++, estimate.object_index, estimate, latency_us});
  }
  return poses;
}

std::optional<DecodeFault> SessionWorker::FindDecodeFault() const {
  const auto* chunk = std::get_if<EventChunk>(&item_->what);
  if (chunk == nullptr) return std::nullopt;
  const DecodeCounts& now = pipeline_->counts();
  const uint64_t unknown = now.unknown_words - counts_before_item_.unknown_words;
  const uint64_t broken = now.broken_vectors - counts_before_item_.broken_vectors;
  const uint64_t outside = now.dropped_outside_sensor - counts_before_item_.dropped_outside_sensor;
  if (unknown + broken + outside == 0) return std::nullopt;
  return DecodeFault{chunk->seq, unknown + broken + outside,
                     absl::StrCat("skipped ", unknown, " unknown words, ", broken, " broken vectors, ", outside,
                                  " events outside the sensor")};
}

// Triggers are collected by item and not by slice, because the size of a slice depends on the clock.
void SessionWorker::CollectTriggers() {
  const size_t room = kMaxTriggersOfChunk - triggers_.triggers.size();
  const size_t kept = std::min(room, output_.triggers.size());
  triggers_.triggers.insert(triggers_.triggers.end(), output_.triggers.begin(),
                            output_.triggers.begin() + static_cast<std::ptrdiff_t>(kept));
  triggers_.num_skipped += output_.triggers.size() - kept;
}

std::vector<ObjectHealth> SessionWorker::Objects() const {
  std::vector<ObjectHealth> objects;
  if (pipeline_ == nullptr) return objects;
  const Tracker& tracker = pipeline_->tracker();
  for (size_t i = 0; i < config_.objects.size(); ++i) {
    objects.push_back(
        {tracker.state(i), earlier_losses_[i] + tracker.losses(i), explained_ratios_[i], tracker.initialization(i)});
  }
  return objects;
}

WorkResult SessionWorker::MakeResult(bool item_is_finished) {
  WorkResult result;
  result.poses_before = next_pose_seq_ - 1;
  result.poses = NumberPoses();
  result.state_changes = output_.state_changes;
  result.dropped_now = std::exchange(dropped_now_, EventGap());
  result.gap = std::exchange(gap_, std::nullopt);
  result.counts = pipeline_->counts();
  result.t_us = std::max<int64_t>(pipeline_->now_us(), 0);
  result.sensor_time_us = pipeline_->sensor_time_us();
  result.processing_us = std::chrono::duration_cast<std::chrono::microseconds>(processing_time_).count();
  result.objects = Objects();
  if (item_is_finished) {
    result.finished = WorkResult::Item{.stream = item_->stream,
                                       .seq = item_->seq(),
                                       .bytes = item_->bytes(),
                                       .is_end = item_->is_end(),
                                       .fault = FindDecodeFault()};
    if (!triggers_.triggers.empty()) result.finished->triggers = std::move(triggers_);
  }
  return result;
}

void SessionWorker::OnPhaseTransition(const PhaseTransition& transition) const {
  ServerMetrics& metrics = *options_.metrics;
  if (const auto* track = std::get_if<TrackTransition>(&transition.change)) {
    metrics.track_transitions[track->from][track->to].Add();
  } else {
    const auto& object = std::get<ObjectTransition>(transition.change);
    metrics.object_transitions[object.from][object.to].Add();
  }
  options_.log->PhaseChanged(config_.objects[transition.object_index].object_id, transition);
}

void SessionWorker::ReportStateChanges() const {
  for (const ObjectStateChange& change : output_.state_changes) {
    const std::string& object_id = config_.objects[change.object_index].object_id;
    const bool was_lost = pipeline_->tracker().losses(change.object_index) > 0;
    if (change.state == TrackState::kLost) {
      options_.log->ObjectLost(object_id, change.t_us);
    } else if (HasPose(change.state) && !HasPose(change.state_before)) {
      options_.log->ObjectFound(object_id, change.t_us, was_lost);
      if (was_lost) options_.metrics->reinitializations.Add();
    }
  }
}

}  // namespace evpose::server
