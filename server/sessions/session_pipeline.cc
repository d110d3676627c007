#include "server/sessions/session_pipeline.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/sessions/errors.h"

namespace evpose::server {
namespace {

// Sensor time is fed in slices of this length, counted from 0. At their ends, which depend on the stream alone, the
// states are compared and the poses of several objects are put in order.
constexpr int64_t kSliceUs = 1000;

}  // namespace

absl::StatusOr<std::unique_ptr<SessionPipeline>> SessionPipeline::Create(
    const SessionConfig& config, const std::vector<std::shared_ptr<const ObjectModel>>& models,
    const TrackerFactory& make_tracker) {
  std::unique_ptr<SessionPipeline> pipeline(new SessionPipeline());
  auto decoder = MakeEventDecoder(config.encoding, {config.camera.width_px, config.camera.height_px});
  if (!decoder.ok()) return InvalidField("config.camera", decoder.status().message());
  pipeline->decoder_ = *std::move(decoder);
  for (size_t i = 0; i < config.objects.size(); ++i) {
    auto tracker = make_tracker(models[i], config, config.objects[i]);
    if (!tracker.ok()) return InvalidField(absl::StrCat("config.objects[", i, "]"), tracker.status().message());
    const TrackState state = (*tracker)->state();
    pipeline->objects_.push_back({*std::move(tracker), state, {}});
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
    FeedSlice(events.subspan(begin, i - begin), output);
    begin = i;
    CloseSlice(slice_end_us_, output);
    SeeTime(events[i].t_us);
  }
  FeedSlice(events.subspan(begin), output);
}

void SessionPipeline::FeedSlice(absl::Span<const Event> events, PipelineOutput& output) {
  if (events.empty()) return;
  for (Object& object : objects_) object.tracker->AddEvents(events, object.estimates);
  // With one object there is nothing to put in order: its poses need not wait.
  if (objects_.size() == 1) GiveOutEstimates(output);
}

void SessionPipeline::FeedTime(int64_t t_us, PipelineOutput& output) {
  for (Object& object : objects_) object.tracker->AdvanceTime(t_us, object.estimates);
  if (objects_.size() == 1) GiveOutEstimates(output);
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
  GiveOutEstimates(output);
  for (size_t i = 0; i < objects_.size(); ++i) {
    const TrackState state = objects_[i].tracker->state();
    if (state == objects_[i].reported_state) continue;
    objects_[i].reported_state = state;
    output.state_changes.push_back({static_cast<uint32_t>(i), t_us, state, output.poses.size()});
  }
}

void SessionPipeline::GiveOutEstimates(PipelineOutput& output) {
  for (size_t i = 0; i < objects_.size(); ++i) {
    for (const PoseEstimate& estimate : objects_[i].estimates) {
      output.poses.push_back({static_cast<uint32_t>(i), estimate});
    }
    objects_[i].estimates.clear();
  }
}

void SessionPipeline::ResetAfterLoss() { decoder_->ResetAfterLoss(); }

void SessionPipeline::ResetPose(uint32_t object_index, const RigidTransform& camera_from_object) {
  objects_[object_index].tracker->ResetPose(camera_from_object);
}

void SessionPipeline::Finish(PipelineOutput& output) {
  for (Object& object : objects_) object.tracker->Finish(object.estimates);
  CloseSlice(now_us_, output);
}

}  // namespace evpose::server
