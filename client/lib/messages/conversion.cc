// SPDX-License-Identifier: Apache-2.0
#include "client/lib/messages/conversion.h"

#include <algorithm>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "client/lib/messages/core_types.h"
#include "client/lib/messages/status_details.h"
#include "core/base/status_macros.h"
#include "google/protobuf/generated_enum_reflection.h"
#include "google/rpc/error_details.pb.h"
#include "google/rpc/status.pb.h"

namespace evpose::client {
namespace {

using client::FromProto;  // the overloads of the header, which those below would hide

// The enumerators of the public headers have the numbers of the API (tested in conversion_test.cc). Returns `otherwise`
// for an unspecified enumerator and for one of a later server.
template <typename Theirs, typename Ours>
Ours FromProto(Theirs value, Ours otherwise) {
  const bool is_known =
      value != 0 && google::protobuf::GetEnumDescriptor<Theirs>()->FindValueByNumber(value) != nullptr;
  return is_known ? static_cast<Ours>(value) : otherwise;
}

Loss FromProto(const v1::Loss& loss) { return {loss.t_us(), FromProto(loss.cause(), LossCause::kUnknown)}; }

TrackingRestarted FromProto(const v1::TrackResponse::TrackingRestarted& message) {
  TrackingRestarted restarted{message.after_seq(), message.detail(), std::nullopt};
  if (message.has_after_pose_seq()) restarted.after_pose_seq = message.after_pose_seq();
  return restarted;
}

ObjectHealth FromProto(const v1::ObjectHealth& object) {
  ObjectHealth health = {.object_id = object.object_id(),
                         .state = FromProto(object.state(), TrackState::kUnknown),
                         .losses = object.losses(),
                         .explained_ratio = object.explained_ratio(),
                         .initialization = FromProto(object.initialization(), InitializationStatus::kWaitingForEvents),
                         .initialization_attempts = object.initialization_attempts(),
                         .detail = object.detail(),
                         .searches = {.no_signal = object.searches().no_signal(),
                                      .too_small = object.searches().too_small(),
                                      .too_few_lines = object.searches().too_few_lines(),
                                      .not_enough_motion = object.searches().not_enough_motion(),
                                      .no_pose_fits = object.searches().no_pose_fits(),
                                      .poses_found = object.searches().poses_found()},
                         .followed_poses = object.followed_poses()};
  if (object.has_latest_loss()) {
    health.latest_loss = FromProto(object.latest_loss());
  }
  return health;
}

absl::Time FromProto(const google::protobuf::Timestamp& time) {
  return absl::FromUnixSeconds(time.seconds()) + absl::Nanoseconds(time.nanos());
}

Eigen::Vector3d FromProto(const v1::Vector3& v) { return {v.x(), v.y(), v.z()}; }

std::optional<ContinuousSymmetry> SymmetryFromProto(const v1::Model& message) {
  const v1::ContinuousSymmetry& symmetry = message.continuous_symmetry();
  const bool is_sphere = symmetry.kind() == v1::ContinuousSymmetry::KIND_SPHERE;
  if (!is_sphere && symmetry.kind() != v1::ContinuousSymmetry::KIND_AXIS) return std::nullopt;
  return ContinuousSymmetry{is_sphere ? ContinuousSymmetry::Kind::kSphere : ContinuousSymmetry::Kind::kAxis,
                            FromProto(symmetry.centre_m()), FromProto(symmetry.axis()), symmetry.flippable()};
}

v1::Quaternion RotationToProto(const Eigen::Matrix3d& rotation) {
  const Eigen::Quaterniond q = Transform{rotation}.Quaternion();
  v1::Quaternion message;
  message.set_x(q.x());
  message.set_y(q.y());
  message.set_z(q.z());
  message.set_w(q.w());
  return message;
}

Camera FromProto(const v1::CameraModel& message) {
  Camera camera;
  camera.width_px = static_cast<int>(message.width_px());
  camera.height_px = static_cast<int>(message.height_px());
  camera.fx_px = message.fx_px();
  camera.fy_px = message.fy_px();
  camera.cx_px = message.cx_px();
  camera.cy_px = message.cy_px();
  camera.lens_model = FromProto(message.lens_model(), LensModel::kBrown);
  const size_t count = std::min<size_t>(message.distortion_size(), camera.distortion.size());
  for (size_t i = 0; i < count; ++i) camera.distortion[i] = message.distortion(static_cast<int>(i));
  return camera;
}

v1::CameraModel ToProto(const Camera& camera) {
  v1::CameraModel message;
  message.set_width_px(static_cast<uint32_t>(camera.width_px));
  message.set_height_px(static_cast<uint32_t>(camera.height_px));
  message.set_fx_px(camera.fx_px);
  message.set_fy_px(camera.fy_px);
  message.set_cx_px(camera.cx_px);
  message.set_cy_px(camera.cy_px);
  const int num_coefficients = NumCoefficients(ToCore(camera).lens_model);
  for (int i = 0; i < num_coefficients; ++i) message.add_distortion(camera.distortion[i]);
  // Absent for Brown: a server without other lenses accepts the message.
  if (camera.lens_model != LensModel::kBrown) message.set_lens_model(static_cast<v1::LensModel>(camera.lens_model));
  return message;
}

SensorParameters FromProto(const v1::SensorProfile& message) {
  SensorParameters sensor;
  if (message.has_pixel_noise_px()) sensor.pixel_noise_px = message.pixel_noise_px();
  if (message.has_blur_px()) sensor.blur_px = message.blur_px();
  if (message.has_contrast_threshold()) sensor.contrast_threshold = message.contrast_threshold();
  if (message.has_refractory_us()) sensor.refractory_us = message.refractory_us();
  if (message.has_latency_us()) sensor.latency_us = message.latency_us();
  if (message.has_uncertainty()) sensor.uncertainty = message.uncertainty();
  return sensor;
}

v1::SensorProfile ToProto(const SensorParameters& sensor) {
  v1::SensorProfile message;
  message.set_pixel_noise_px(sensor.pixel_noise_px);
  message.set_blur_px(sensor.blur_px);
  message.set_contrast_threshold(sensor.contrast_threshold);
  message.set_refractory_us(sensor.refractory_us);
  message.set_latency_us(sensor.latency_us);
  message.set_uncertainty(sensor.uncertainty);
  return message;
}

absl::StatusOr<TrackedObject> FromProto(const v1::TrackedObject& message) {
  TrackedObject object;
  object.object_id = message.object_id();
  object.model = message.model();
  if (message.has_initial_camera_from_object()) {
    EVPOSE_ASSIGN_OR_RETURN(object.initial_camera_from_object, FromProto(message.initial_camera_from_object()));
  }
  if (message.has_reference_rotation()) {
    v1::RigidTransform reference;
    *reference.mutable_rotation() = message.reference_rotation();
    EVPOSE_ASSIGN_OR_RETURN(const Transform transform, FromProto(reference));
    object.reference_rotation = transform.rotation;
  }
  return object;
}

absl::StatusOr<SessionConfig> FromProto(const v1::SessionConfig& message) {
  SessionConfig config;
  config.encoding = FromProto(message.encoding(), EventEncoding::kEvt3);
  config.camera = FromProto(message.camera());
  config.estimator = FromProto(message.tracker().estimator(), PoseEstimator::kMixture);
  config.sensor = FromProto(message.tracker().sensor());
  if (message.tracker().has_pose_rate_hz()) config.pose_rate_hz = message.tracker().pose_rate_hz();
  config.overload_policy = FromProto(message.overload_policy(), OverloadPolicy::kBlock);
  if (message.has_max_lag()) config.max_lag = FromProto(message.max_lag());
  for (const v1::TrackedObject& object : message.objects()) {
    EVPOSE_ASSIGN_OR_RETURN(TrackedObject converted, FromProto(object));
    config.objects.push_back(std::move(converted));
  }
  return config;
}

// Expands an upper triangle, stored row by row, to the symmetric matrix.
Eigen::Matrix<double, 6, 6> SymmetricFromUpper(const google::protobuf::RepeatedField<double>& upper) {
  Eigen::Matrix<double, 6, 6> matrix;
  int index = 0;
  for (int row = 0; row < 6; ++row) {
    for (int column = row; column < 6; ++column) matrix(row, column) = matrix(column, row) = upper[index++];
  }
  return matrix;
}

Triggers ReadTriggers(const v1::TrackResponse::Triggers& message) {
  Triggers result{.chunk_seq = message.seq(), .num_skipped = message.num_skipped()};
  for (const v1::TrackResponse::Trigger& trigger : message.triggers()) {
    result.triggers.push_back({trigger.t_us(), trigger.input(), trigger.rising()});
  }
  return result;
}

}  // namespace

v1::ErrorReason ReasonOf(const absl::Status& status) {
  v1::ErrorReason reason = v1::ERROR_REASON_UNSPECIFIED;
  return v1::ErrorReason_Parse(GetDetails(status).reason, &reason) ? reason : v1::ERROR_REASON_UNSPECIFIED;
}

absl::Status FromGrpc(const grpc::Status& status, const std::string& context) {
  if (status.ok()) return absl::OkStatus();
  std::string text = absl::StrCat(context, ": ", status.error_message());
  StatusDetails details;
  google::rpc::Status message;
  if (!message.ParseFromString(status.error_details())) message.Clear();
  for (const google::protobuf::Any& any : message.details()) {
    google::rpc::BadRequest bad_request;
    google::rpc::ErrorInfo info;
    google::rpc::RetryInfo retry;
    if (any.UnpackTo(&info)) details.reason = info.reason();
    if (any.UnpackTo(&retry)) details.retry_in = FromProto(retry.retry_delay());
    if (!any.UnpackTo(&bad_request)) continue;
    for (const auto& violation : bad_request.field_violations()) {
      if (details.field.empty()) {
        details.field = violation.field();
        details.field_error = std::string(absl::StripPrefix(violation.description(), violation.field() + ": "));
      }
      if (absl::StrContains(status.error_message(), violation.field())) continue;
      absl::StrAppend(&text, " (", violation.field(), ": ", violation.description(), ")");
    }
  }
  absl::Status result(static_cast<absl::StatusCode>(status.error_code()), text);
  SetDetails(result, details);
  return result;
}

std::string_view ApiName(std::string_view name, std::string_view prefix) {
  return name.empty() || name.ends_with("_UNSPECIFIED") ? "UNKNOWN" : name.substr(prefix.size());
}

google::protobuf::Duration ToProto(absl::Duration duration) {
  google::protobuf::Duration message;
  message.set_seconds(absl::IDivDuration(duration, absl::Seconds(1), &duration));
  message.set_nanos(static_cast<int32_t>(absl::IDivDuration(duration, absl::Nanoseconds(1), &duration)));
  return message;
}

absl::Duration FromProto(const google::protobuf::Duration& duration) {
  return absl::Seconds(duration.seconds()) + absl::Nanoseconds(duration.nanos());
}

v1::ModelFormat ToProto(ModelFormat format) { return static_cast<v1::ModelFormat>(format); }
v1::ModelSurface ToProto(ModelSurface surface) { return static_cast<v1::ModelSurface>(surface); }

v1::RigidTransform ToProto(const Transform& transform) {
  v1::RigidTransform message;
  message.mutable_translation_m()->set_x(transform.translation_m.x());
  message.mutable_translation_m()->set_y(transform.translation_m.y());
  message.mutable_translation_m()->set_z(transform.translation_m.z());
  *message.mutable_rotation() = RotationToProto(transform.rotation);
  return message;
}

v1::TrackRequest::ResetPose ToProto(const PoseReset& reset) {
  v1::TrackRequest::ResetPose message;
  message.set_object_id(reset.object_id);
  *message.mutable_camera_from_object() = ToProto(reset.camera_from_object);
  return message;
}

v1::SessionConfig ToProto(const SessionConfig& config) {
  v1::SessionConfig message;
  message.set_encoding(static_cast<v1::EventEncoding>(config.encoding));
  *message.mutable_camera() = ToProto(config.camera);
  message.mutable_tracker()->set_estimator(static_cast<v1::Estimator>(config.estimator));
  *message.mutable_tracker()->mutable_sensor() = ToProto(config.sensor);
  message.mutable_tracker()->set_pose_rate_hz(config.pose_rate_hz);
  message.set_overload_policy(static_cast<v1::OverloadPolicy>(config.overload_policy));
  if (config.max_lag) *message.mutable_max_lag() = ToProto(*config.max_lag);
  for (const TrackedObject& object : config.objects) {
    v1::TrackedObject& converted = *message.add_objects();
    converted.set_object_id(object.object_id);
    converted.set_model(object.model);
    if (object.initial_camera_from_object) {
      *converted.mutable_initial_camera_from_object() = ToProto(*object.initial_camera_from_object);
    }
    if (object.reference_rotation) {
      *converted.mutable_reference_rotation() = RotationToProto(*object.reference_rotation);
    }
  }
  return message;
}

v1::LogLevel ToProto(LogLevel level) { return static_cast<v1::LogLevel>(level); }
LogLevel FromProto(v1::LogLevel level) { return FromProto(level, LogLevel::kOff); }

ServerInfo FromProto(const v1::ServerInfo& message) {
  return {.version = message.version(),
          .commit = message.commit(),
          .store = absl::AsciiStrToLower(std::string(ApiName(v1::StoreKind_Name(message.store()), "STORE_KIND_"))),
          .active_sessions = message.active_sessions(),
          .max_sessions = message.max_sessions(),
          .max_chunk_bytes = message.max_chunk_bytes(),
          .max_model_bytes = message.max_model_bytes(),
          .is_draining = message.draining(),
          .skipped_events = message.skipped_events(),
          .pose_log_capacity = message.pose_log_capacity(),
          .session_expiry = FromProto(message.session_expiry()),
          .time = message.has_time() ? std::optional(FromProto(message.time())) : std::nullopt};
}

ModelInfo FromProto(const v1::Model& message) {
  return {.name = message.name(),
          .format = FromProto(message.format(), ModelFormat::kObj),
          .size_bytes = message.size_bytes(),
          .num_faces = message.num_faces(),
          .num_lines = message.num_lines(),
          .num_curves = message.num_curves(),
          .num_regions = message.num_regions(),
          .num_symmetries = message.num_symmetries(),
          .continuous_symmetry = SymmetryFromProto(message),
          .diameter_m = message.diameter_m(),
          .metres_per_unit = message.metres_per_unit(),
          .crease_angle_deg = message.crease_angle_deg(),
          .surface = FromProto(message.surface(), ModelSurface::kSmooth),
          .sha256_hex = absl::BytesToHexString(message.sha256()),
          .create_time = FromProto(message.create_time()),
          .notices = {message.notices().begin(), message.notices().end()},
          .file_name = message.file_name()};
}

SessionHealth FromProto(const v1::SessionHealth& message) {
  SessionHealth health;
  health.t_us = message.t_us();
  health.received_bytes = message.received_bytes();
  health.processed_bytes = message.processed_bytes();
  health.decoded_events = message.decoded_events();
  health.dropped_events = message.dropped_events();
  health.invalid_words = message.invalid_words();
  health.time_backsteps = message.time_backsteps();
  health.poses = message.poses();
  health.event_rate_hz = message.event_rate_hz();
  health.pose_rate_hz = message.pose_rate_hz();
  health.real_time_ratio = message.real_time_ratio();
  if (message.has_latency_p50()) health.latency_p50 = FromProto(message.latency_p50());
  if (message.has_latency_p99()) health.latency_p99 = FromProto(message.latency_p99());
  health.skipped_events = message.skipped_events();
  health.skipped_us = message.skipped_us();
  const v1::ProcessingHealth& processing = message.processing();
  health.processing = {.cpu_s_per_s = processing.cpu_s_per_s(),
                       .max_cpu_s_per_s = processing.max_cpu_s_per_s(),
                       .falls_behind = processing.falls_behind(),
                       .tenant_cpu_s_per_s = processing.tenant_cpu_s_per_s(),
                       .max_tenant_cpu_s_per_s = processing.max_tenant_cpu_s_per_s()};
  for (const v1::ObjectHealth& object : message.objects()) health.objects.push_back(FromProto(object));
  return health;
}

absl::StatusOr<Session> FromProto(const v1::Session& message) {
  Session session;
  session.name = message.name();
  absl::StatusOr<SessionConfig> config = FromProto(message.config());
  if (!config.ok()) return absl::InternalError(absl::StrCat(message.name(), ": config: ", config.status().message()));
  session.config = *std::move(config);
  session.state = FromProto(message.state(), SessionState::kUnknown);
  session.create_time = FromProto(message.create_time());
  if (message.has_expire_time()) session.expire_time = FromProto(message.expire_time());
  session.health = FromProto(message.health());
  return session;
}

absl::StatusOr<Session> FromProto(const v1::CreateSessionResponse& message) {
  EVPOSE_ASSIGN_OR_RETURN(Session session, FromProto(message.session()));
  session.resume_token = message.resume_token();
  return session;
}

absl::StatusOr<Transform> FromProto(const v1::RigidTransform& message) {
  const v1::Quaternion& q = message.rotation();
  EVPOSE_ASSIGN_OR_RETURN(
      const RigidTransform transform,
      MakeRigidTransform(FromProto(message.translation_m()), Eigen::Quaterniond(q.w(), q.x(), q.y(), q.z())));
  return FromCore(transform);
}

absl::StatusOr<Pose> FromProto(const v1::Pose& message) {
  const auto error = [&message](absl::string_view what) {
    return absl::InternalError(absl::StrCat("pose ", message.pose_seq(), ": ", what));
  };
  if (message.covariance().upper_triangle_size() != 21) return error("covariance does not have 21 numbers");
  if (!message.has_twist()) return error("twist is missing");
  absl::StatusOr<Transform> transform = FromProto(message.camera_from_object());
  if (!transform.ok()) return error(absl::StrCat("camera_from_object: ", transform.status().message()));
  Pose pose;
  pose.seq = message.pose_seq();
  pose.object_id = message.object_id();
  pose.latency = FromProto(message.latency());
  pose.t_us = message.t_us();
  pose.camera_from_object = *transform;
  pose.covariance = SymmetricFromUpper(message.covariance().upper_triangle());
  pose.twist << FromProto(message.twist().linear_m_per_s()), FromProto(message.twist().angular_rad_per_s());
  pose.state = FromProto(message.state(), TrackState::kUnknown);
  if (pose.state == TrackState::kInitializing || pose.state == TrackState::kLost) {
    return error(absl::StrCat("the state ", std::string(TrackStateName(pose.state)), " has no pose"));
  }
  pose.num_events = message.num_events();
  pose.explained_ratio = message.explained_ratio();
  pose.residual_rms_px = message.residual_rms_px();
  for (const v1::PoseAlternative& alternative : message.alternatives()) {
    absl::StatusOr<Transform> other = FromProto(alternative.camera_from_object());
    if (!other.ok()) return error(absl::StrCat("alternatives: ", other.status().message()));
    pose.alternatives.push_back({*other, alternative.log_likelihood_ratio()});
  }
  if (message.has_latest_loss()) pose.latest_loss = FromProto(message.latest_loss());
  return pose;
}

std::optional<Notice> FromProto(const v1::TrackResponse::Notice& message) {
  switch (message.kind_case()) {
    case v1::TrackResponse::Notice::kDropped:
      return EventsDropped{message.dropped().num_events(), message.dropped().from_t_us(), message.dropped().to_t_us(),
                           FromProto(message.dropped().reason(), DropReason::kUnknown)};
    case v1::TrackResponse::Notice::kGoAway:
      return GoAway{FromProto(message.go_away().deadline())};
    case v1::TrackResponse::Notice::kDecodeFault:
      return DecodeFault{message.decode_fault().seq(), message.decode_fault().count(), message.decode_fault().detail()};
    case v1::TrackResponse::Notice::kStateChange:
      return StateChange{message.state_change().object_id(), message.state_change().t_us(),
                         FromProto(message.state_change().state(), TrackState::kUnknown)};
    case v1::TrackResponse::Notice::kTrackingRestarted:
      return FromProto(message.tracking_restarted());
    case v1::TrackResponse::Notice::kLagChange:
      return LagChange{message.lag_change().falls_behind(), FromProto(message.lag_change().lag())};
    case v1::TrackResponse::Notice::kTriggers:
      return ReadTriggers(message.triggers());
    case v1::TrackResponse::Notice::KIND_NOT_SET:
      break;
  }
  return std::nullopt;
}

}  // namespace evpose::client
