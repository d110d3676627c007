// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/durability/session_codec.h"

#include <algorithm>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "evpose/storage/v1/session.pb.h"
#include "google/protobuf/arena.h"
#include "server/runtime/enum_number.h"
#include "server/sessions/durability/stored_fields.h"
#include "server/stores/common/record_version.h"

namespace evpose::server {
namespace {

namespace pb = storage::v1;

constexpr int kDigestBytes = 64;  // hexadecimal digits of SHA-256
// Version of EventDecoder::SaveState. Incremented when its format changes; earlier formats must then still be read.
constexpr uint32_t kDecoderFormat = 1;

static_assert(EnumNumber(Encoding::kFlat64) == pb::Encoding_MAX);
static_assert(EnumNumber(OverloadPolicy::kLatest) == pb::OverloadPolicy_MAX);
static_assert(EnumNumber(TrackState::kAmbiguous) == pb::TrackState_MAX);
static_assert(EnumNumber(kLastInitializationStatus) == pb::InitializationStatus_MAX);
static_assert(static_cast<int>(LossCause::kUnconfirmed) == pb::LossCause_MAX);
static_assert(EnumNumber(LensModel::kFisheye) == pb::LensModel_MAX);

void ToStored(const CameraModel& camera, pb::Camera& stored) {
  const auto& [width_px, height_px, fx_px, fy_px, cx_px, cy_px, distortion, lens_model] = camera;
  stored.set_width_px(width_px);
  stored.set_height_px(height_px);
  stored.set_fx_px(fx_px);
  stored.set_fy_px(fy_px);
  stored.set_cx_px(cx_px);
  stored.set_cy_px(cy_px);
  if (lens_model != LensModel::kBrown) stored.set_lens_model(EnumNumber<pb::LensModel>(lens_model));
  SetNumbers(camera.Coefficients(), *stored.mutable_distortion());
}

void FromStored(const pb::Camera& stored, RecordCheck& check, CameraModel& camera) {
  camera.width_px = stored.width_px();
  camera.height_px = stored.height_px();
  camera.fx_px = stored.fx_px();
  camera.fy_px = stored.fy_px();
  camera.cx_px = stored.cx_px();
  camera.cy_px = stored.cy_px();
  EnumFromStored(stored.lens_model(), check, camera.lens_model);
  auto coefficients = absl::MakeSpan(camera.distortion).first(NumCoefficients(camera.lens_model));
  GetNumbers(stored.distortion(), check, coefficients);
}

void ToStored(const SensorProfile& sensor, pb::Sensor& stored) {
  const auto& [name, pixel_noise_px, blur_px, contrast_threshold, refractory_us, latency_us, uncertainty] = sensor;
  stored.set_name(name);
  stored.set_pixel_noise_px(pixel_noise_px);
  stored.set_blur_px(blur_px);
  stored.set_contrast_threshold(contrast_threshold);
  stored.set_refractory_us(refractory_us);
  stored.set_latency_us(latency_us);
  stored.set_uncertainty(uncertainty);
}

void FromStored(const pb::Sensor& stored, SensorProfile& sensor) {
  sensor.name = stored.name();
  if (stored.has_pixel_noise_px()) sensor.pixel_noise_px = stored.pixel_noise_px();
  if (stored.has_blur_px()) sensor.blur_px = stored.blur_px();
  if (stored.has_contrast_threshold()) sensor.contrast_threshold = stored.contrast_threshold();
  if (stored.has_refractory_us()) sensor.refractory_us = stored.refractory_us();
  if (stored.has_latency_us()) sensor.latency_us = stored.latency_us();
  if (stored.has_uncertainty()) sensor.uncertainty = stored.uncertainty();
}

void ToStored(const ObjectConfig& object, pb::TrackedObject& stored) {
  const auto& [object_id, model, initial_camera_from_object, reference_rotation] = object;
  stored.set_object_id(object_id);
  stored.set_model(model);
  if (initial_camera_from_object.has_value()) {
    pb::RigidTransform& initial = *stored.mutable_initial_camera_from_object();
    SetNumbers(initial_camera_from_object->rotation, *initial.mutable_rotation());
    SetNumbers(initial_camera_from_object->translation_m, *initial.mutable_translation_m());
  }
  SetNumbers(reference_rotation, *stored.mutable_reference_rotation());
}

void FromStored(const pb::TrackedObject& stored, RecordCheck& check, ObjectConfig& object) {
  object.object_id = stored.object_id();
  object.model = stored.model();
  if (stored.has_initial_camera_from_object()) {
    const pb::RigidTransform& initial = stored.initial_camera_from_object();
    object.initial_camera_from_object.emplace();
    GetNumbers(initial.rotation(), check, object.initial_camera_from_object->rotation);
    GetNumbers(initial.translation_m(), check, object.initial_camera_from_object->translation_m);
  }
  if (!stored.reference_rotation().empty()) {
    GetNumbers(stored.reference_rotation(), check, object.reference_rotation);
  }
}

std::string NameOf(Estimator estimator) {
  for (const auto& [known, name] : kEstimatorNames) {
    if (known == estimator) return std::string(name);
  }
  return "";
}

void FromStored(const std::string& name, RecordCheck& check, Estimator& estimator) {
  const auto* const found = std::find_if(std::begin(kEstimatorNames), std::end(kEstimatorNames),
                                         [&name](const auto& known) { return known.second == name; });
  check.Require(found != std::end(kEstimatorNames), "an estimator that this version does not know");
  if (found != std::end(kEstimatorNames)) estimator = found->first;
}

void ToStored(const DecodeCounts& counts, pb::DecodeCounts& stored) {
  const auto& [cd_events, triggers, dropped_before_time, dropped_outside_sensor, kept_outside_sensor, unknown_words,
               broken_vectors, time_backsteps, clock_wraps, padding_words] = counts;
  stored.set_cd_events(cd_events);
  stored.set_triggers(triggers);
  stored.set_dropped_before_time(dropped_before_time);
  stored.set_dropped_outside_sensor(dropped_outside_sensor);
  stored.set_kept_outside_sensor(kept_outside_sensor);
  stored.set_unknown_words(unknown_words);
  stored.set_broken_vectors(broken_vectors);
  stored.set_time_backsteps(time_backsteps);
  stored.set_clock_wraps(clock_wraps);
  stored.set_padding_words(padding_words);
}

DecodeCounts FromStored(const pb::DecodeCounts& stored) {
  return {.cd_events = stored.cd_events(),
          .triggers = stored.triggers(),
          .dropped_before_time = stored.dropped_before_time(),
          .dropped_outside_sensor = stored.dropped_outside_sensor(),
          .kept_outside_sensor = stored.kept_outside_sensor(),
          .unknown_words = stored.unknown_words(),
          .broken_vectors = stored.broken_vectors(),
          .time_backsteps = stored.time_backsteps(),
          .clock_wraps = stored.clock_wraps(),
          .padding_words = stored.padding_words()};
}

void ToStored(const SearchCounts& searches, pb::SearchCounts& stored) {
  const auto& [no_signal, too_small, too_few_lines, not_enough_motion, no_pose_fits, poses_found] = searches;
  stored.set_no_signal(no_signal);
  stored.set_too_small(too_small);
  stored.set_too_few_lines(too_few_lines);
  stored.set_not_enough_motion(not_enough_motion);
  stored.set_no_pose_fits(no_pose_fits);
  stored.set_poses_found(poses_found);
}

SearchCounts FromStored(const pb::SearchCounts& stored) {
  return {.no_signal = stored.no_signal(),
          .too_small = stored.too_small(),
          .too_few_lines = stored.too_few_lines(),
          .not_enough_motion = stored.not_enough_motion(),
          .no_pose_fits = stored.no_pose_fits(),
          .poses_found = stored.poses_found()};
}

void ToStored(const ObjectHealth& object, pb::ObjectHealth& stored) {
  const auto& [state, losses, explained_ratio, initialization] = object;
  const auto& [status, attempts, num_lines, searches, extent_px, num_poses, loss_cause, lost_at_us] = initialization;
  stored.set_state(EnumNumber<pb::TrackState>(Earlier(state)));
  if (state != Earlier(state)) stored.set_later_state(EnumNumber<pb::TrackState>(state));
  stored.set_losses(losses);
  stored.set_explained_ratio(explained_ratio);
  stored.set_initialization(EnumNumber<pb::InitializationStatus>(Earlier(status)));
  if (status != Earlier(status)) stored.set_later_initialization(EnumNumber<pb::InitializationStatus>(status));
  stored.set_initialization_attempts(attempts);
  stored.set_initialization_lines(num_lines);
  ToStored(searches, *stored.mutable_searches());
  stored.set_extent_px(extent_px);
  stored.set_followed_poses(num_poses);
  stored.set_loss_cause(static_cast<pb::LossCause>(loss_cause));
  stored.set_lost_at_us(lost_at_us);
}

void FromStored(const pb::ObjectHealth& stored, RecordCheck& check, ObjectHealth& object) {
  EnumFromStored(stored.state(), check, object.state);
  EnumFromStored(stored.later_state(), check, object.state);
  object.losses = stored.losses();
  object.explained_ratio = stored.explained_ratio();
  InitializationReport& report = object.initialization;
  EnumFromStored(stored.initialization(), check, report.status);
  EnumFromStored(stored.later_initialization(), check, report.status);
  report.attempts = stored.initialization_attempts();
  report.num_lines = stored.initialization_lines();
  report.searches = FromStored(stored.searches());
  report.extent_px = stored.extent_px();
  report.num_poses = stored.followed_poses();
  check.Require(pb::LossCause_IsValid(stored.loss_cause()), "a cause of a loss that this version does not know");
  report.loss_cause = static_cast<LossCause>(stored.loss_cause());
  report.lost_at_us = stored.lost_at_us();
}

void ToStored(const SessionHealth& health, pb::SessionHealth& stored) {
  // Transient values are not stored: received but unprocessed bytes, the age of the queue, the use of processor time,
  // and the percentiles, which are computed from the histogram of latencies.
  const auto& [t_us, received_bytes, processed_bytes, counts, poses, reattaches, sensor_time_us, processing_us,
               queue_age_us, skipped_events, skipped_us, processing, latency_p50_us, latency_p99_us, objects] = health;
  stored.set_t_us(t_us);
  stored.set_processed_bytes(processed_bytes);
  ToStored(counts, *stored.mutable_counts());
  stored.set_poses(poses);
  stored.set_reattaches(reattaches);
  stored.set_sensor_time_us(sensor_time_us);
  stored.set_processing_us(processing_us);
  stored.set_skipped_events(skipped_events);
  stored.set_skipped_us(skipped_us);
  for (const ObjectHealth& object : objects) ToStored(object, *stored.add_objects());
}

void FromStored(const pb::SessionHealth& stored, RecordCheck& check, SessionHealth& health) {
  health.t_us = stored.t_us();
  health.received_bytes = health.processed_bytes = stored.processed_bytes();
  health.counts = FromStored(stored.counts());
  health.poses = stored.poses();
  health.reattaches = stored.reattaches();
  health.sensor_time_us = stored.sensor_time_us();
  health.processing_us = stored.processing_us();
  health.skipped_events = stored.skipped_events();
  health.skipped_us = stored.skipped_us();
  for (const pb::ObjectHealth& object : stored.objects()) FromStored(object, check, health.objects.emplace_back());
}

void ToStored(const StreamPosition& position, pb::StreamPosition& stored) {
  const auto& [decoder, reported_states, first_t_us, now_us, slice_end_us] = position;
  stored.set_decoder(decoder);
  stored.set_decoder_format(kDecoderFormat);
  const bool has_later = std::any_of(reported_states.begin(), reported_states.end(),
                                     [](TrackState state) { return state != Earlier(state); });
  for (const TrackState state : reported_states) {
    stored.add_reported_states(EnumNumber<pb::TrackState>(Earlier(state)));
    if (has_later) stored.add_later_reported_states(EnumNumber<pb::TrackState>(state));
  }
  if (first_t_us >= 0) stored.set_first_t_us(first_t_us);
  if (now_us >= 0) stored.set_now_us(now_us);
  stored.set_slice_end_us(slice_end_us);
}

void FromStored(const pb::StreamPosition& stored, RecordCheck& check, StreamPosition& position) {
  check.Require(stored.decoder_format() == kDecoderFormat, "the decoder's state has a format that is not known");
  position.decoder = stored.decoder();
  const auto& later = stored.later_reported_states();
  check.Require(later.empty() || later.size() == stored.reported_states_size(), "the reported states are incomplete");
  for (const int state : later.empty() ? stored.reported_states() : later) {
    EnumFromStored(static_cast<pb::TrackState>(state), check, position.reported_states.emplace_back());
  }
  if (stored.has_first_t_us()) position.first_t_us = stored.first_t_us();
  if (stored.has_now_us()) position.now_us = stored.now_us();
  position.slice_end_us = stored.slice_end_us();
}

}  // namespace

std::string EncodeConfig(const SessionConfig& config) {
  const auto& [encoding, camera, objects, estimator, sensor, pose_rate_hz, overload_policy, max_lag] = config;
  pb::SessionConfig stored;
  stored.set_encoding(EnumNumber<pb::Encoding>(encoding));
  ToStored(camera, *stored.mutable_camera());
  for (const ObjectConfig& object : objects) ToStored(object, *stored.add_objects());
  stored.set_estimator(NameOf(estimator));
  ToStored(sensor, *stored.mutable_sensor());
  stored.set_pose_rate_hz(pose_rate_hz);
  stored.set_overload_policy(EnumNumber<pb::OverloadPolicy>(overload_policy));
  if (max_lag.has_value()) stored.set_max_lag_ns(absl::ToInt64Nanoseconds(*max_lag));
  return SerializeRecord(stored);
}

absl::StatusOr<SessionConfig> DecodeConfig(absl::string_view bytes) {
  RecordCheck check("configuration");
  pb::SessionConfig stored;
  check.Parse(bytes, stored);
  SessionConfig config;
  check.Require(stored.encoding() != pb::ENCODING_UNSPECIFIED, "the encoding is missing");
  EnumFromStored(stored.encoding(), check, config.encoding);
  FromStored(stored.camera(), check, config.camera);
  for (const pb::TrackedObject& object : stored.objects()) FromStored(object, check, config.objects.emplace_back());
  FromStored(stored.estimator(), check, config.estimator);
  FromStored(stored.sensor(), config.sensor);
  if (stored.has_pose_rate_hz()) config.pose_rate_hz = stored.pose_rate_hz();
  EnumFromStored(stored.overload_policy(), check, config.overload_policy);
  if (stored.has_max_lag_ns()) config.max_lag = absl::Nanoseconds(stored.max_lag_ns());
  if (const absl::Status valid = config.Validate(); !valid.ok()) check.Require(false, valid.message());
  EVPOSE_RETURN_IF_ERROR(check.Finish());
  return config;
}

std::string EncodeLifecycle(const SessionLifecycle& lifecycle) {
  const auto& [token_digest, previous_token_digest, num_attaches, detached_at, num_renewals, lost_from_seq] = lifecycle;
  pb::SessionLifecycle stored;
  stored.set_token_digest(token_digest);
  stored.set_previous_token_digest(previous_token_digest);
  stored.set_num_attaches(num_attaches);
  if (detached_at.has_value()) stored.set_detached_at_ns(absl::ToUnixNanos(*detached_at));
  stored.set_num_renewals(num_renewals);
  stored.set_lost_from_seq(lost_from_seq);
  return SerializeRecord(stored);
}

absl::StatusOr<SessionLifecycle> DecodeLifecycle(absl::string_view bytes) {
  RecordCheck check("lifecycle");
  pb::SessionLifecycle stored;
  check.Parse(bytes, stored);
  SessionLifecycle lifecycle = {.token_digest = stored.token_digest(),
                                .previous_token_digest = stored.previous_token_digest(),
                                .num_attaches = stored.num_attaches(),
                                .num_renewals = stored.num_renewals(),
                                .lost_from_seq = stored.lost_from_seq()};
  if (stored.has_detached_at_ns()) lifecycle.detached_at = absl::FromUnixNanos(stored.detached_at_ns());
  check.Require(lifecycle.token_digest.size() == kDigestBytes, "the digest of the resume token has another length");
  check.Require(lifecycle.previous_token_digest.empty() || lifecycle.previous_token_digest.size() == kDigestBytes,
                "the digest of the previous resume token has another length");
  EVPOSE_RETURN_IF_ERROR(check.Finish());
  return lifecycle;
}

std::string EncodeCheckpoint(SessionCheckpoint checkpoint) {
  const auto& [processed_seq, ended, health, latencies, pipeline] = checkpoint;
  pb::Checkpoint stored;
  stored.set_processed_seq(processed_seq);
  stored.set_ended(ended);
  ToStored(health, *stored.mutable_health());
  stored.mutable_latency_counts()->Assign(latencies.counts().begin(), latencies.counts().end());
  if (pipeline.has_value()) {
    ToStored(pipeline->position, *stored.mutable_position());
    stored.mutable_tracker()->set_version(pipeline->tracker.version);
    stored.mutable_tracker()->set_configuration(pipeline->tracker.configuration);
    stored.mutable_tracker()->set_state(std::move(checkpoint.pipeline->tracker.bytes));
  }
  return SerializeRecord(stored);
}

absl::StatusOr<SessionCheckpoint> DecodeCheckpoint(absl::string_view bytes, size_t num_objects) {
  RecordCheck check("checkpoint");
  pb::Checkpoint stored;
  check.Parse(bytes, stored);
  SessionCheckpoint checkpoint = {.processed_seq = stored.processed_seq(), .has_ended = stored.ended()};
  FromStored(stored.health(), check, checkpoint.health);
  check.Require(checkpoint.health.objects.size() == num_objects, "it has another number of objects");
  checkpoint.latencies = LatencyHistogram({stored.latency_counts().data(), size_t(stored.latency_counts().size())});
  check.Require(stored.ended() || stored.has_position(), "it has no position in the stream");
  if (stored.has_position()) {
    PipelineState& pipeline = checkpoint.pipeline.emplace();
    FromStored(stored.position(), check, pipeline.position);
    check.Require(pipeline.position.reported_states.size() == num_objects, "it has the states of other objects");
    pipeline.tracker = {.version = stored.tracker().version(),
                        .configuration = stored.tracker().configuration(),
                        .bytes = std::move(*stored.mutable_tracker()->mutable_state())};
  }
  EVPOSE_RETURN_IF_ERROR(check.Finish());
  return checkpoint;
}

}  // namespace evpose::server
