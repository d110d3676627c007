// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/common/conversion.h"

#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "google/protobuf/generated_enum_reflection.h"
#include "google/protobuf/util/time_util.h"
#include "server/runtime/client_text.h"
#include "server/runtime/enum_number.h"
#include "server/runtime/errors.h"
#include "server/sessions/types/missing_pose.h"

namespace evpose::server {
namespace {

static_assert(EnumNumber(Encoding::kFlat64) == v1::EventEncoding_MAX);
static_assert(EnumNumber(OverloadPolicy::kLatest) == v1::OverloadPolicy_MAX);
static_assert(EnumNumber(DropReason::kReader) == v1::DropReason_MAX);
static_assert(EnumNumber(TrackState::kAmbiguous) == v1::TrackState_MAX);
static_assert(EnumNumber(kLastInitializationStatus) == v1::InitializationStatus_MAX);
static_assert(static_cast<int>(LossCause::kUnconfirmed) == v1::LossCause_MAX);
static_assert(EnumNumber(SessionState::kEnded) == v1::SessionState_MAX);
static_assert(EnumNumber(ModelFormat::kMesh) == v1::ModelFormat_MAX);
static_assert(EnumNumber(LensModel::kFisheye) == v1::LensModel_MAX);

absl::Status NotSupported(absl::string_view field, int number) {
  if (number == 0) return InvalidField(field, "is missing: give one of its values");
  return InvalidField(field, absl::StrCat("is ", number, ", which this server does not support"));
}

template <typename Value, typename Number>
absl::StatusOr<Value> EnumFromProto(absl::string_view field, Number number) {
  const bool is_known = google::protobuf::GetEnumDescriptor<Number>()->FindValueByNumber(number) != nullptr;
  if (number == 0 || !is_known) return NotSupported(field, number);
  return EnumValue<Value>(number);
}

constexpr std::pair<Estimator, v1::Estimator> kEstimators[] = {
    {Estimator::kMixture, v1::ESTIMATOR_MIXTURE},    {Estimator::kStaticLs, v1::ESTIMATOR_STATIC_LS},
    {Estimator::kStaticM, v1::ESTIMATOR_STATIC_M},   {Estimator::kStaticS, v1::ESTIMATOR_STATIC_S},
    {Estimator::kStaticMm, v1::ESTIMATOR_STATIC_MM}, {Estimator::kErrorStateFilter, v1::ESTIMATOR_ERROR_STATE_FILTER},
};

absl::StatusOr<Estimator> FieldFromProto(v1::Estimator estimator) {
  if (estimator == v1::ESTIMATOR_UNSPECIFIED) return Estimator::kMixture;
  for (const auto& [ours, theirs] : kEstimators) {
    if (theirs == estimator) return ours;
  }
  return NotSupported("config.tracker.estimator", estimator);
}

v1::Estimator ToProto(Estimator estimator) {
  for (const auto& [ours, theirs] : kEstimators) {
    if (ours == estimator) return theirs;
  }
  return v1::ESTIMATOR_UNSPECIFIED;
}

SensorProfile FieldFromProto(const v1::SensorProfile& sensor) {
  SensorProfile out;
  if (sensor.has_pixel_noise_px()) out.pixel_noise_px = sensor.pixel_noise_px();
  if (sensor.has_blur_px()) out.blur_px = sensor.blur_px();
  if (sensor.has_contrast_threshold()) out.contrast_threshold = sensor.contrast_threshold();
  if (sensor.has_refractory_us()) out.refractory_us = sensor.refractory_us();
  if (sensor.has_latency_us()) out.latency_us = sensor.latency_us();
  if (sensor.has_uncertainty()) out.uncertainty = sensor.uncertainty();
  return out;
}

v1::SensorProfile ToProto(const SensorProfile& sensor) {
  v1::SensorProfile out;
  out.set_pixel_noise_px(sensor.pixel_noise_px);
  out.set_blur_px(sensor.blur_px);
  out.set_contrast_threshold(sensor.contrast_threshold);
  out.set_refractory_us(sensor.refractory_us);
  out.set_latency_us(sensor.latency_us);
  out.set_uncertainty(sensor.uncertainty);
  return out;
}

v1::SearchCounts ToProto(const SearchCounts& searches) {
  v1::SearchCounts out;
  out.set_no_signal(searches.no_signal);
  out.set_too_small(searches.too_small);
  out.set_too_few_lines(searches.too_few_lines);
  out.set_not_enough_motion(searches.not_enough_motion);
  out.set_no_pose_fits(searches.no_pose_fits);
  out.set_poses_found(searches.poses_found);
  return out;
}

absl::StatusOr<CameraModel> FieldFromProto(const v1::CameraModel& camera) {
  // Fits int; CameraModel::Validate() has the limit of a camera.
  constexpr uint32_t kMaxSize = std::numeric_limits<uint16_t>::max();
  if (camera.width_px() > kMaxSize || camera.height_px() > kMaxSize) {
    return InvalidField("config.camera", absl::StrCat("is ", camera.width_px(), "x", camera.height_px(),
                                                      " pixels; no side may have more than ", kMaxSize));
  }
  CameraModel out;
  out.width_px = static_cast<int>(camera.width_px());
  out.height_px = static_cast<int>(camera.height_px());
  out.fx_px = camera.fx_px();
  out.fy_px = camera.fy_px();
  out.cx_px = camera.cx_px();
  out.cy_px = camera.cy_px();
  if (camera.lens_model() != v1::LENS_MODEL_UNSPECIFIED) {
    EVPOSE_ASSIGN_OR_RETURN(out.lens_model, EnumFromProto<LensModel>("config.camera.lens_model", camera.lens_model()));
  }
  const auto& distortion = camera.distortion();
  const int num_coefficients = NumCoefficients(out.lens_model);
  if (!distortion.empty() && distortion.size() != num_coefficients) {
    return InvalidField("config.camera.distortion",
                        absl::StrCat("has ", distortion.size(), " coefficients; a ", LensModelName(out.lens_model),
                                     " lens has ", num_coefficients, "; give all, or none"));
  }
  std::copy(distortion.begin(), distortion.end(), out.distortion.begin());
  return out;
}

v1::CameraModel ToProto(const CameraModel& camera) {
  v1::CameraModel out;
  out.set_width_px(static_cast<uint32_t>(camera.width_px));
  out.set_height_px(static_cast<uint32_t>(camera.height_px));
  out.set_fx_px(camera.fx_px);
  out.set_fy_px(camera.fy_px);
  out.set_cx_px(camera.cx_px);
  out.set_cy_px(camera.cy_px);
  for (const double coefficient : camera.Coefficients()) out.add_distortion(coefficient);
  out.set_lens_model(static_cast<v1::LensModel>(EnumNumber(camera.lens_model)));
  return out;
}

v1::Quaternion RotationToProto(const Eigen::Matrix3d& rotation) {
  const Eigen::Quaterniond quaternion = RigidTransform{rotation}.Quaternion();
  v1::Quaternion out;
  out.set_x(quaternion.x());
  out.set_y(quaternion.y());
  out.set_z(quaternion.z());
  out.set_w(quaternion.w());
  return out;
}

v1::Vector3 ToProto(const Eigen::Vector3d& vector) {
  v1::Vector3 out;
  out.set_x(vector.x());
  out.set_y(vector.y());
  out.set_z(vector.z());
  return out;
}

v1::RigidTransform ToProto(const RigidTransform& transform) {
  v1::RigidTransform out;
  *out.mutable_translation_m() = ToProto(transform.translation_m);
  *out.mutable_rotation() = RotationToProto(transform.rotation);
  return out;
}

v1::ContinuousSymmetry ToProto(const ContinuousSymmetry& symmetry) {
  v1::ContinuousSymmetry out;
  out.set_kind(EnumNumber<v1::ContinuousSymmetry::Kind>(symmetry.kind));
  *out.mutable_centre_m() = ToProto(symmetry.centre);
  if (symmetry.kind == ContinuousSymmetry::Kind::kAxis) *out.mutable_axis() = ToProto(symmetry.axis);
  out.set_flippable(symmetry.is_flippable);
  return out;
}

v1::SessionConfig ToProto(const SessionConfig& config) {
  v1::SessionConfig out;
  out.set_encoding(EnumNumber<v1::EventEncoding>(config.encoding));
  *out.mutable_camera() = ToProto(config.camera);
  for (const ObjectConfig& object : config.objects) {
    v1::TrackedObject& added = *out.add_objects();
    added.set_object_id(object.object_id);
    added.set_model(object.model);
    if (object.initial_camera_from_object.has_value()) {
      *added.mutable_initial_camera_from_object() = ToProto(*object.initial_camera_from_object);
    }
    *added.mutable_reference_rotation() = RotationToProto(object.reference_rotation);
  }
  out.mutable_tracker()->set_estimator(ToProto(config.estimator));
  *out.mutable_tracker()->mutable_sensor() = ToProto(config.sensor);
  out.mutable_tracker()->set_pose_rate_hz(config.pose_rate_hz);
  out.set_overload_policy(EnumNumber<v1::OverloadPolicy>(config.overload_policy));
  if (config.max_lag.has_value()) *out.mutable_max_lag() = server::ToProto(*config.max_lag);
  return out;
}

absl::StatusOr<Eigen::Matrix3d> FieldFromProto(const v1::Quaternion& rotation, const std::string& field) {
  const auto transform =
      MakeRigidTransform(Eigen::Vector3d::Zero(), {rotation.w(), rotation.x(), rotation.y(), rotation.z()});
  if (!transform.ok()) return InvalidField(field, transform.status().message());
  return transform->rotation;
}

double PerSecond(uint64_t count, int64_t duration_us) {
  return duration_us > 0 ? 1e6 * static_cast<double>(count) / static_cast<double>(duration_us) : 0.0;
}

v1::Loss LossToProto(LossCause cause, int64_t lost_at_us) {
  v1::Loss out;
  out.set_t_us(lost_at_us);
  out.set_cause(static_cast<v1::LossCause>(cause));
  return out;
}

}  // namespace

google::protobuf::Timestamp ToProto(absl::Time time) {
  return google::protobuf::util::TimeUtil::NanosecondsToTimestamp(absl::ToUnixNanos(time));
}

absl::StatusOr<RigidTransform> FromProto(const v1::RigidTransform& transform, const std::string& field) {
  const v1::Vector3& translation = transform.translation_m();
  if (!std::isfinite(translation.x()) || !std::isfinite(translation.y()) || !std::isfinite(translation.z())) {
    return InvalidField(field + ".translation_m", "must be finite");
  }
  EVPOSE_ASSIGN_OR_RETURN(const Eigen::Matrix3d rotation, FieldFromProto(transform.rotation(), field + ".rotation"));
  return RigidTransform{rotation, {translation.x(), translation.y(), translation.z()}};
}

absl::StatusOr<SessionConfig> FromProto(const v1::SessionConfig& config) {
  SessionConfig out;
  EVPOSE_ASSIGN_OR_RETURN(out.encoding, EnumFromProto<Encoding>("config.encoding", config.encoding()));
  EVPOSE_ASSIGN_OR_RETURN(out.estimator, FieldFromProto(config.tracker().estimator()));
  out.sensor = FieldFromProto(config.tracker().sensor());
  if (config.tracker().has_pose_rate_hz()) out.pose_rate_hz = config.tracker().pose_rate_hz();
  if (config.overload_policy() != v1::OVERLOAD_POLICY_UNSPECIFIED) {
    EVPOSE_ASSIGN_OR_RETURN(out.overload_policy,
                            EnumFromProto<OverloadPolicy>("config.overload_policy", config.overload_policy()));
  }
  if (config.has_max_lag()) {
    out.max_lag = FromProto(config.max_lag());
  } else if (out.overload_policy == OverloadPolicy::kLatest) {
    out.max_lag = kDefaultMaxLag;
  }
  if (!config.has_camera()) return InvalidField("config.camera", "is missing");
  EVPOSE_ASSIGN_OR_RETURN(out.camera, FieldFromProto(config.camera()));
  for (int i = 0; i < config.objects_size(); ++i) {
    const v1::TrackedObject& object = config.objects(i);
    const std::string field = absl::StrCat("config.objects[", i, "].");
    ObjectConfig added = {.object_id = object.object_id(), .model = object.model()};
    // Here, not in SessionConfig::Validate(), so that stored sessions with such names can still be read.
    if (!IsPlainText(added.object_id)) {
      return InvalidField(field + "object_id", absl::StrCat("\"", Shortened(added.object_id),
                                                            "\" has control characters, which are not allowed"));
    }
    if (object.has_initial_camera_from_object()) {
      EVPOSE_ASSIGN_OR_RETURN(
          added.initial_camera_from_object,
          FromProto(object.initial_camera_from_object(), absl::StrCat(field, "initial_camera_from_object")));
    }
    if (object.has_reference_rotation()) {
      EVPOSE_ASSIGN_OR_RETURN(added.reference_rotation,
                              FieldFromProto(object.reference_rotation(), absl::StrCat(field, "reference_rotation")));
    }
    out.objects.push_back(std::move(added));
  }
  return out;
}

absl::StatusOr<ModelReading> FromProto(const v1::UploadModelRequest::Header& header) {
  ModelReading out;
  EVPOSE_ASSIGN_OR_RETURN(out.format, EnumFromProto<ModelFormat>("header.format", header.format()));
  if (header.has_metres_per_unit()) out.metres_per_unit = header.metres_per_unit();
  if (header.has_crease_angle_deg()) out.crease_angle_deg = header.crease_angle_deg();
  if (!v1::ModelSurface_IsValid(header.surface())) return NotSupported("header.surface", header.surface());
  out.is_smooth = header.surface() != v1::MODEL_SURFACE_AS_IS;
  return out;
}

google::protobuf::Duration ToProto(absl::Duration duration) {
  google::protobuf::Duration out;
  out.set_seconds(absl::IDivDuration(duration, absl::Seconds(1), &duration));
  out.set_nanos(static_cast<int32_t>(absl::IDivDuration(duration, absl::Nanoseconds(1), &duration)));
  return out;
}

absl::Duration FromProto(const google::protobuf::Duration& duration) {
  return absl::Seconds(duration.seconds()) + absl::Nanoseconds(duration.nanos());
}

v1::Session ToProto(const SessionInfo& session) {
  const SessionSnapshot& snapshot = session.snapshot;
  v1::Session out;
  out.set_name(session.name);
  *out.mutable_config() = ToProto(session.config);
  *out.mutable_create_time() = ToProto(session.create_time);
  if (snapshot.expire_time.has_value()) *out.mutable_expire_time() = ToProto(*snapshot.expire_time);
  *out.mutable_health() = ToProto(snapshot.health, session.config);
  out.set_state(EnumNumber<v1::SessionState>(snapshot.state));
  return out;
}

v1::SessionHealth ToProto(const SessionHealth& health, const SessionConfig& config) {
  v1::SessionHealth out;
  out.set_t_us(health.t_us);
  out.set_received_bytes(health.received_bytes);
  out.set_processed_bytes(health.processed_bytes);
  out.set_decoded_events(health.counts.cd_events);
  out.set_dropped_events(health.counts.dropped_events());
  out.set_invalid_words(health.counts.invalid_words());
  out.set_time_backsteps(health.counts.time_backsteps);
  out.set_poses(health.poses);
  out.set_reattaches(health.reattaches);
  out.set_event_rate_hz(PerSecond(health.counts.cd_events, health.sensor_time_us));
  out.set_pose_rate_hz(PerSecond(health.poses, health.sensor_time_us));
  if (health.sensor_time_us > 0) {
    out.set_real_time_ratio(static_cast<double>(health.processing_us) / static_cast<double>(health.sensor_time_us));
  }
  *out.mutable_queue_age() = ToProto(absl::Microseconds(health.queue_age_us));
  v1::ProcessingHealth& processing = *out.mutable_processing();
  processing.set_cpu_s_per_s(health.processing.cpu_per_s);
  processing.set_max_cpu_s_per_s(health.processing.max_cpu_per_s);
  processing.set_falls_behind(health.processing.is_behind);
  processing.set_tenant_cpu_s_per_s(health.processing.tenant_cpu_per_s);
  processing.set_max_tenant_cpu_s_per_s(health.processing.max_tenant_cpu_per_s);
  out.set_skipped_events(health.skipped_events);
  out.set_skipped_us(health.skipped_us);
  if (health.poses > 0) {
    *out.mutable_latency_p50() = ToProto(absl::Microseconds(health.latency_p50_us));
    *out.mutable_latency_p99() = ToProto(absl::Microseconds(health.latency_p99_us));
  }
  for (size_t i = 0; i < health.objects.size(); ++i) {
    v1::ObjectHealth& object = *out.add_objects();
    object.set_object_id(config.objects[i].object_id);
    object.set_state(EnumNumber<v1::TrackState>(health.objects[i].state));
    object.set_losses(health.objects[i].losses);
    object.set_explained_ratio(health.objects[i].explained_ratio);
    const InitializationReport& initialization = health.objects[i].initialization;
    object.set_initialization(EnumNumber<v1::InitializationStatus>(initialization.status));
    object.set_initialization_attempts(initialization.attempts);
    object.set_detail(ExplainMissingPose(health.objects[i]));
    *object.mutable_searches() = ToProto(initialization.searches);
    object.set_followed_poses(initialization.num_poses);
    if (initialization.loss_cause == LossCause::kNone) continue;
    *object.mutable_latest_loss() = LossToProto(initialization.loss_cause, initialization.lost_at_us);
  }
  return out;
}

v1::TrackResponse::Notice ToProto(const SessionNotice& notice, const SessionConfig& config) {
  v1::TrackResponse::Notice out;
  if (const auto* fault = std::get_if<DecodeFault>(&notice.what)) {
    v1::TrackResponse::DecodeFault& added = *out.mutable_decode_fault();
    added.set_seq(fault->seq);
    added.set_count(fault->count);
    added.set_detail(fault->detail);
  }
  if (const auto* dropped = std::get_if<EventsDropped>(&notice.what)) {
    v1::TrackResponse::EventsDropped& added = *out.mutable_dropped();
    added.set_num_events(dropped->num_events);
    added.set_from_t_us(dropped->from_t_us);
    added.set_to_t_us(dropped->to_t_us);
    added.set_reason(EnumNumber<v1::DropReason>(dropped->reason));
  }
  if (const auto* restarted = std::get_if<TrackingRestarted>(&notice.what)) {
    v1::TrackResponse::TrackingRestarted& added = *out.mutable_tracking_restarted();
    added.set_after_seq(restarted->after_seq);
    added.set_detail(restarted->detail);
    added.set_after_pose_seq(restarted->after_pose_seq);
  }
  if (const auto* change = std::get_if<LagChange>(&notice.what)) {
    v1::TrackResponse::LagChange& added = *out.mutable_lag_change();
    added.set_falls_behind(change->is_behind);
    *added.mutable_lag() = ToProto(absl::Microseconds(change->lag_us));
  }
  if (const auto* triggers = std::get_if<ChunkTriggers>(&notice.what)) {
    v1::TrackResponse::Triggers& added = *out.mutable_triggers();
    added.set_seq(triggers->seq);
    added.set_num_skipped(triggers->num_skipped);
    for (const Trigger& trigger : triggers->triggers) {
      v1::TrackResponse::Trigger& edge = *added.add_triggers();
      edge.set_t_us(trigger.t_us);
      edge.set_input(trigger.id);
      edge.set_rising(trigger.polarity != 0);
    }
  }
  if (const auto* change = std::get_if<StateChange>(&notice.what)) {
    v1::TrackResponse::StateChange& added = *out.mutable_state_change();
    added.set_object_id(config.objects[change->object_index].object_id);
    added.set_t_us(change->t_us);
    added.set_state(EnumNumber<v1::TrackState>(change->state));
  }
  return out;
}

v1::Pose ToProto(const StoredPose& pose, const SessionConfig& config) {
  const PoseEstimate& estimate = pose.estimate;
  v1::Pose out;
  out.set_pose_seq(pose.pose_seq);
  out.set_object_id(config.objects[pose.object_index].object_id);
  out.set_t_us(estimate.t_us);
  *out.mutable_camera_from_object() = ToProto(estimate.camera_from_object);
  google::protobuf::RepeatedField<double>& upper = *out.mutable_covariance()->mutable_upper_triangle();
  upper.Reserve(21);
  for (int row = 0; row < 6; ++row) {
    for (int column = row; column < 6; ++column) upper.Add(estimate.covariance(row, column));
  }
  *out.mutable_twist()->mutable_linear_m_per_s() = ToProto(Eigen::Vector3d(estimate.twist.head<3>()));
  *out.mutable_twist()->mutable_angular_rad_per_s() = ToProto(Eigen::Vector3d(estimate.twist.tail<3>()));
  out.set_state(EnumNumber<v1::TrackState>(estimate.state));
  out.set_num_events(estimate.num_events);
  out.set_explained_ratio(estimate.explained_ratio);
  out.set_residual_rms_px(estimate.residual_rms_px);
  *out.mutable_latency() = ToProto(absl::Microseconds(pose.latency_us));
  for (const PoseAlternative& alternative : estimate.alternatives) {
    v1::PoseAlternative& added = *out.add_alternatives();
    *added.mutable_camera_from_object() = ToProto(alternative.camera_from_object);
    added.set_log_likelihood_ratio(alternative.log_likelihood_ratio);
  }
  if (estimate.loss_cause != LossCause::kNone) {
    *out.mutable_latest_loss() = LossToProto(estimate.loss_cause, estimate.lost_at_us);
  }
  return out;
}

v1::EventImage ToProto(const EventImage& image, uint64_t num_skipped, const SessionConfig& config) {
  v1::EventImage out;
  out.set_from_t_us(image.from_t_us());
  out.set_to_t_us(image.to_t_us());
  out.set_cell_px(static_cast<uint32_t>(image.bitmap().cell_px()));
  out.set_width(static_cast<uint32_t>(image.bitmap().width()));
  out.set_height(static_cast<uint32_t>(image.bitmap().height()));
  out.set_num_events(image.num_events());
  out.set_num_skipped(num_skipped);
  const EncodedCells& cells = image.cells();
  out.set_encoding(cells.is_zlib ? v1::EventImage::ENCODING_ZLIB : v1::EventImage::ENCODING_PACKED);
  if (cells.is_zlib) {
    out.set_cells(cells.zlib);
  } else {
    out.set_cells(image.bitmap().bytes().data(), image.bitmap().bytes().size());
  }
  for (const SessionOutlines::Outline& outline : image.outlines()) {
    v1::ObjectOutline& added = *out.add_outlines();
    added.set_object_id(config.objects[outline.object_index].object_id);
    added.set_state(EnumNumber<v1::TrackState>(outline.object.state));
    added.set_t_us(outline.object.t_us);
    *added.mutable_camera_from_object() = ToProto(outline.object.camera_from_object);
    added.mutable_segments_px()->Reserve(static_cast<int>(4 * outline.segments.size()));
    for (const OutlineSegment& segment : outline.segments) {
      for (const Eigen::Vector2f& end : {segment.p1_px, segment.p2_px}) {
        added.add_segments_px(end.x());
        added.add_segments_px(end.y());
      }
      added.mutable_kinds()->push_back(static_cast<char>(segment.kind));
    }
  }
  return out;
}

v1::Model ToProto(const ModelInfo& model) {
  v1::Model out;
  out.set_name(model.name);
  out.set_format(EnumNumber<v1::ModelFormat>(model.reading.format));
  out.set_size_bytes(model.size_bytes);
  out.set_num_faces(model.num_faces);
  out.set_num_lines(model.num_lines);
  out.set_num_curves(model.num_curves);
  out.set_num_regions(model.num_regions);
  out.set_file_name(model.file_name);
  out.set_num_symmetries(model.num_symmetries);
  out.set_diameter_m(model.diameter_m);
  *out.mutable_create_time() = ToProto(model.create_time);
  out.set_metres_per_unit(model.reading.metres_per_unit);
  out.set_crease_angle_deg(model.reading.crease_angle_deg);
  out.set_surface(model.reading.is_smooth ? v1::MODEL_SURFACE_SMOOTH : v1::MODEL_SURFACE_AS_IS);
  out.set_sha256(absl::HexStringToBytes(model.sha256_hex));
  for (const std::string& notice : model.notices) out.add_notices(notice);
  if (model.continuous_symmetry) *out.mutable_continuous_symmetry() = ToProto(*model.continuous_symmetry);
  return out;
}

v1::TrackResponse::Attached ToProto(const Attachment& attachment, const SessionLimits& limits) {
  v1::TrackResponse::Attached out;
  out.set_next_seq(attachment.next_seq);
  out.set_resume_token(attachment.resume_token);
  out.set_send_limit_bytes(attachment.send_limit_bytes);
  *out.mutable_resume_window() = ToProto(limits.expiry);
  out.set_max_chunk_bytes(limits.max_chunk_bytes);
  out.set_first_pose_seq(attachment.first_pose_seq);
  return out;
}

v1::TrackResponse::Ack ToProto(const SessionAck& ack) {
  v1::TrackResponse::Ack out;
  out.set_processed_seq(ack.processed_seq);
  out.set_durable_seq(ack.durable_seq);
  out.set_send_limit_bytes(ack.send_limit_bytes);
  return out;
}

}  // namespace evpose::server
