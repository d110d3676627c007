#include "server/sessions/session_pipeline.h"

#include <algorithm>
#include <utility>

#include "core/base/status_macros.h"
#include "server/sessions/errors.h"

namespace evpose::server {
namespace {

// Sensor time is fed in slices of this length, counted from 0. At their ends, which depend on the stream alone, the
// states are compared.
constexpr int64_t kSliceUs = 1000;

}  // namespace

absl::StatusOr<std::unique_ptr<SessionPipeline>> SessionPipeline::Create(
    const SessionConfig& config, const std::vector<std::shared_ptr<const ObjectModel>>& models,
    const TrackerFactory& make_tracker) {
  std::unique_ptr<SessionPipeline> pipeline(new SessionPipeline());
  auto decoder = MakeEventDecoder(config.encoding, {config.camera.width_px, config.camera.height_px});
  if (!decoder.ok()) return InvalidField("config.camera", decoder.status().message());
  pipeline->decoder_ = *std::move(decoder);
  EVPOSE_ASSIGN_OR_RETURN(pipeline->tracker_, make_tracker(config, models));
  for (size_t i = 0; i < pipeline->tracker_->num_objects(); ++i) {
    pipeline->reported_states_.push_back(pipeline->tracker_->state(i));
  }
  return pipeline;
}

void SessionPipeline::Process(absl::Span<const uint8_t> bytes, PipelineOutput& output) {
  decoded_.events.clear();
  decoded_.triggers.clear();
  decoded_.time_marks.clear();
  decoder_->Decode(bytes, decoded_);
  const absl::Span<const Event> events = decoded_.events;
  size_t begin = 0;
  for (const TimeMark& mark : decoded_.time_marks) {
    FeedEvents(events.subspan(begin, mark.event_index - begin), output);
    begin = mark.event_index;
    FeedTime(mark.t_us, output);
  }
  FeedEvents(events.subspan(begin), output);
}

void SessionPipeline::FeedEvents(absl::Span<const Event> events, PipelineOutput& output) {
  size_t begin = 0;
  for (size_t i = 0; i < events.size(); ++i) {
    now_us_ = std::max(now_us_, events[i].t_us);
    if (events[i].t_us < slice_end_us_) continue;
    tracker_->AddEvents(events.subspan(begin, i - begin), output.poses);
    begin = i;
    CloseSlice(slice_end_us_, output);
    SeeTime(events[i].t_us);
  }
  tracker_->AddEvents(events.subspan(begin), output.poses);
}

void SessionPipeline::FeedTime(int64_t t_us, PipelineOutput& output) {
  tracker_->AdvanceTime(t_us, output.poses);
  const bool slice_is_over = t_us >= slice_end_us_;
  SeeTime(t_us);
  if (slice_is_over) CloseSlice(t_us, output);
}

void SessionPipeline::SeeTime(int64_t t_us) {
  if (first_t_us_ < 0) first_t_us_ = t_us;
  now_us_ = std::max(now_us_, t_us);
  slice_end_us_ = std::max(slice_end_us_, (t_us / kSliceUs + 1) * kSliceUs);
}

void SessionPipeline::CloseSlice(int64_t t_us, PipelineOutput& output) {
  for (size_t i = 0; i < reported_states_.size(); ++i) {
    const TrackState state = tracker_->state(i);
    if (state == reported_states_[i]) continue;
    reported_states_[i] = state;
    output.state_changes.push_back({static_cast<uint32_t>(i), t_us, state, output.poses.size()});
  }
}

void SessionPipeline::ResetAfterLoss() { decoder_->ResetAfterLoss(); }

void SessionPipeline::ResetPose(uint32_t object_index, const RigidTransform& camera_from_object) {
  tracker_->ResetPose(object_index, camera_from_object);
}

void SessionPipeline::Finish(PipelineOutput& output) {
  tracker_->Finish(output.poses);
  CloseSlice(now_us_, output);
}

}  // namespace evpose::server
