// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session_pipeline.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/byte_order.h"
#include "core/base/state_io.h"
#include "core/base/status_macros.h"
#include "core/numerics/hash.h"
#include "server/runtime/errors.h"
#include "server/stores/common/record_version.h"

namespace evpose::server {
namespace {

// The stream is divided into slices of this sensor time, microseconds, counted from 0. State changes are detected at
// the ends of slices, which depend on the stream only.
constexpr int64_t kSliceUs = 1000;

void WriteModel(const ObjectModel* model, StateWriter& writer) {
  writer(model != nullptr);
  if (model == nullptr) return;
  writer(model->vertices, model->triangles, model->symmetries);
  if (const auto& symmetry = model->continuous_symmetry) {
    writer(static_cast<uint32_t>(symmetry->kind), symmetry->centre, symmetry->axis, symmetry->is_flippable);
  }
  writer.Count(model->lines.size());
  for (const ModelLine& line : model->lines) writer(line.p1, line.p2, line.face_normals);
  writer.Count(model->curves.size());
  for (const EdgeCurve& curve : model->curves) {
    const auto kind = static_cast<uint8_t>(curve.kind);
    writer(kind, curve.points, curve.face_normals, curve.turn_rad);
  }
  if (!model->facet_edges.empty()) writer(model->facet_edges);
  const SmoothSurface& surface = model->surface;
  writer(surface.region_of, surface.normals);
  writer.Count(surface.regions.size());
  for (const SurfaceRegion& region : surface.regions) {
    const auto shape = static_cast<uint8_t>(region.shape);
    writer(shape, region.point, region.axis, region.radius_m, region.half_angle_rad, region.is_convex);
  }
}

std::string ConfigurationDigest(const SessionConfig& config,
                                const std::vector<std::shared_ptr<const ObjectModel>>& models) {
  StateWriter writer;
  writer(static_cast<uint32_t>(config.encoding), static_cast<uint32_t>(config.estimator));
  const CameraModel& camera = config.camera;
  writer(camera.width_px, camera.height_px, camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px);
  for (const double coefficient : camera.Coefficients()) writer(coefficient);
  // The digest for a Brown camera is the same as in versions that had no other lens, so that their checkpoints remain
  // valid.
  if (camera.lens_model != LensModel::kBrown) writer(static_cast<uint32_t>(camera.lens_model));
  const SensorProfile& sensor = config.sensor;
  writer(sensor.pixel_noise_px, sensor.blur_px, sensor.contrast_threshold, sensor.refractory_us, sensor.latency_us,
         sensor.uncertainty);
  // For the same reason the usual rate is left out.
  if (config.pose_rate_hz != kDefaultPoseRateHz) writer(config.pose_rate_hz);
  for (const ObjectConfig& object : config.objects) {
    writer(object.initial_camera_from_object, object.reference_rotation);
  }
  for (const auto& model : models) WriteModel(model.get(), writer);
  const std::string bytes = writer.Take();
  return Sha256Hex(AsBytes(bytes));
}

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
  pipeline->configuration_ = ConfigurationDigest(config, models);
  return pipeline;
}

absl::StatusOr<std::unique_ptr<SessionPipeline>> SessionPipeline::CreateSearching(
    const SessionConfig& config, const std::vector<std::shared_ptr<const ObjectModel>>& models,
    const TrackerFactory& make_tracker) {
  SessionConfig searching = config;
  for (ObjectConfig& object : searching.objects) object.initial_camera_from_object.reset();
  EVPOSE_ASSIGN_OR_RETURN(auto pipeline, Create(searching, models, make_tracker));
  // States of this pipeline are loaded into trackers that are created from the configuration of the session itself.
  pipeline->configuration_ = ConfigurationDigest(config, models);
  return pipeline;
}

void SessionPipeline::Decode(absl::Span<const uint8_t> bytes, PipelineOutput& output) {
  decoded_.events.clear();
  decoded_.triggers.clear();
  decoded_.time_marks.clear();
  timer_.Decode([&] { decoder_->Decode(bytes, decoded_); });
  output.triggers.insert(output.triggers.end(), decoded_.triggers.begin(), decoded_.triggers.end());
}

EventGap SessionPipeline::Skip(absl::Span<const uint8_t> bytes, PipelineOutput& output) {
  Decode(bytes, output);
  if (decoded_.events.empty() && decoded_.time_marks.empty()) return EventGap();
  for (const Event& event : decoded_.events) AdvanceTime(event.t_us);
  for (const TimeMark& mark : decoded_.time_marks) AdvanceTime(mark.t_us);
  const EventGap gap = tracker_->Skip(decoded_.events, now_us_);
  CloseSlice(now_us_, output);
  return gap;
}

void SessionPipeline::Process(absl::Span<const uint8_t> bytes, PipelineOutput& output) {
  Decode(bytes, output);
  const absl::Span<const Event> events = decoded_.events;
  size_t begin = 0;
  for (const TimeMark& mark : decoded_.time_marks) {
    FeedEvents(events.subspan(begin, mark.event_index - begin), output);
    begin = mark.event_index;
    FeedTime(mark.t_us, output);
  }
  FeedEvents(events.subspan(begin), output);
  timer_.EndTracking();
}

void SessionPipeline::TrackEvents(absl::Span<const Event> events, PipelineOutput& output) {
  timer_.Track(*tracker_, [&] { tracker_->AddEvents(events, output.poses); });
}

void SessionPipeline::FeedEvents(absl::Span<const Event> events, PipelineOutput& output) {
  size_t begin = 0;
  for (size_t i = 0; i < events.size(); ++i) {
    now_us_ = std::max(now_us_, events[i].t_us);
    if (events[i].t_us < slice_end_us_) continue;
    TrackEvents(events.subspan(begin, i - begin), output);
    begin = i;
    CloseSlice(slice_end_us_, output);
    AdvanceTime(events[i].t_us);
  }
  TrackEvents(events.subspan(begin), output);
}

void SessionPipeline::FeedTime(int64_t t_us, PipelineOutput& output) {
  timer_.Track(*tracker_, [&] { tracker_->AdvanceTime(t_us, output.poses); });
  const bool slice_is_over = t_us >= slice_end_us_;
  AdvanceTime(t_us);
  if (slice_is_over) CloseSlice(t_us, output);
}

void SessionPipeline::AdvanceTime(int64_t t_us) {
  if (first_t_us_ < 0) first_t_us_ = t_us;
  now_us_ = std::max(now_us_, t_us);
  slice_end_us_ = std::max(slice_end_us_, (t_us / kSliceUs + 1) * kSliceUs);
}

void SessionPipeline::CloseSlice(int64_t t_us, PipelineOutput& output) {
  for (size_t i = 0; i < reported_states_.size(); ++i) {
    const TrackState state = tracker_->state(i);
    if (state == reported_states_[i]) continue;
    const TrackState before = std::exchange(reported_states_[i], state);
    output.state_changes.push_back({static_cast<uint32_t>(i), t_us, state, before, output.poses.size()});
  }
}

void SessionPipeline::ResetAfterLoss() { decoder_->ResetAfterLoss(); }

void SessionPipeline::ResetPose(uint32_t object_index, const RigidTransform& camera_from_object) {
  tracker_->ResetPose(object_index, camera_from_object);
}

void SessionPipeline::Finish(PipelineOutput& output) {
  timer_.Track(*tracker_, [&] { tracker_->Finish(output.poses); });
  timer_.EndTracking();
  CloseSlice(now_us_, output);
}

PipelineState SessionPipeline::SaveState() const {
  StateWriter decoder;
  decoder_->SaveState(decoder);
  StateWriter tracker;
  tracker_->SaveState(tracker);
  return {.position = {decoder.Take(), reported_states_, first_t_us_, now_us_, slice_end_us_},
          .tracker = {kTrackerStateVersion, configuration_, tracker.Take()}};
}

absl::Status SessionPipeline::LoadPosition(const StreamPosition& position) {
  const auto in_range = [](int64_t t_us) { return t_us >= -kMaxStateTimeUs && t_us <= kMaxStateTimeUs; };
  if (!in_range(position.first_t_us) || !in_range(position.now_us) || !in_range(position.slice_end_us)) {
    return absl::DataLossError("the position in the stream is damaged: a time is outside its range");
  }
  if (position.reported_states.size() != reported_states_.size()) {
    return absl::DataLossError("the position in the stream is damaged: it has another number of objects");
  }
  StateReader reader(position.decoder);
  decoder_->LoadState(reader);
  EVPOSE_RETURN_IF_ERROR(reader.Finish());
  reported_states_ = position.reported_states;
  first_t_us_ = position.first_t_us;
  now_us_ = position.now_us;
  slice_end_us_ = position.slice_end_us;
  return absl::OkStatus();
}

absl::Status SessionPipeline::LoadTracker(const SavedTracker& tracker) {
  if (tracker.version != kTrackerStateVersion) {
    return absl::DataLossError(absl::StrCat("the tracker's state has version ", tracker.version,
                                            ", this server reads version ", kTrackerStateVersion));
  }
  if (tracker.configuration != configuration_) {
    return absl::DataLossError("the tracker's state belongs to another configuration or another model");
  }
  StateReader reader(tracker.bytes);
  tracker_->LoadState(reader);
  return reader.Finish();
}

}  // namespace evpose::server
