# SPDX-License-Identifier: Apache-2.0
"""Messages of the API to the types of this package."""

from __future__ import annotations

import datetime
from typing import Any, Optional

import numpy as np

from evpose.cameras import Camera
from evpose.events import Encoding
from evpose.geometry import quaternion_from_message, transform_from_message
from evpose.types import (DecodeFault, Estimator, EventsDropped, GoAway, Health, LagChange, Model, Notice, ObjectHealth, Overload, SearchCounts,
                          SensorProfile, ServerInfo, SessionConfig, SessionInfo, StateChange, Surface, TrackedObject, TrackingRestarted, TrackState,
                          Trigger, Triggers)
from evpose.v1 import admin_service_pb2, geometry_pb2, model_service_pb2, session_pb2, track_pb2


def seconds(duration: Any) -> float:
    """Returns a google.protobuf.Duration in seconds."""
    return float(duration.seconds + 1e-9 * duration.nanos)


def _time(message: Any, field: str) -> Optional[datetime.datetime]:
    """Returns a google.protobuf.Timestamp in UTC; None if it is absent."""
    if not message.HasField(field):
        return None
    timestamp = getattr(message, field)
    epoch = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)
    return epoch + datetime.timedelta(seconds=timestamp.seconds, microseconds=timestamp.nanos // 1000)


def _point(vector: Any) -> tuple[float, float, float]:
    return (vector.x, vector.y, vector.z)


def _name(enum: Any, number: int, prefix: str) -> str:
    """Returns the name of a value without its prefix; "UNKNOWN" for one that is not given or is of a later server."""
    value = enum.DESCRIPTOR.values_by_number.get(number)
    return "UNKNOWN" if value is None or number == 0 else str(value.name).removeprefix(prefix)


def notice_from_message(message: Any) -> Optional[Notice]:
    """Returns None for a kind of a later server."""
    kind = message.WhichOneof("kind")
    item = getattr(message, kind) if kind else None
    if kind == "dropped":
        reason = _name(track_pb2.DropReason, item.reason, "DROP_REASON_")
        return EventsDropped(item.num_events, item.from_t_us, item.to_t_us, reason)
    if kind == "go_away":
        return GoAway(seconds(item.deadline))
    if kind == "decode_fault":
        return DecodeFault(item.seq, item.count, item.detail)
    if kind == "state_change":
        return StateChange(item.object_id, item.t_us, TrackState(item.state))
    if kind == "tracking_restarted":
        return TrackingRestarted(item.after_seq, item.detail, item.after_pose_seq if item.HasField("after_pose_seq") else None)
    if kind == "lag_change":
        return LagChange(item.falls_behind, seconds(item.lag))
    if kind == "triggers":
        return Triggers(item.seq, tuple(Trigger(each.t_us, each.input, each.rising) for each in item.triggers), item.num_skipped)
    return None


def latest_loss(message: Any) -> tuple[Optional[int], str]:
    """Returns sensor time (microseconds) and cause of the field latest_loss; (None, "") without it."""
    if not message.HasField("latest_loss"):
        return None, ""
    return message.latest_loss.t_us, _name(session_pb2.LossCause, message.latest_loss.cause, "LOSS_CAUSE_")


def _object_health(message: Any) -> ObjectHealth:
    loss_t_us, loss_cause = latest_loss(message)
    return ObjectHealth(
        object_id=message.object_id, state=TrackState(message.state), losses=message.losses, explained_ratio=message.explained_ratio,
        initialization=_name(session_pb2.InitializationStatus, message.initialization, "INITIALIZATION_STATUS_"),
        initialization_attempts=message.initialization_attempts, detail=message.detail,
        latest_loss_t_us=loss_t_us,
        latest_loss_cause=loss_cause,
        searches=SearchCounts(
            no_signal=message.searches.no_signal, too_small=message.searches.too_small, too_few_lines=message.searches.too_few_lines,
            not_enough_motion=message.searches.not_enough_motion, no_pose_fits=message.searches.no_pose_fits,
            poses_found=message.searches.poses_found),
        followed_poses=message.followed_poses)


def health_from_message(message: Any) -> Health:
    """Converts a SessionHealth."""
    return Health(
        t_us=message.t_us, received_bytes=message.received_bytes, processed_bytes=message.processed_bytes,
        decoded_events=message.decoded_events, dropped_events=message.dropped_events, invalid_words=message.invalid_words,
        time_backsteps=message.time_backsteps, poses=message.poses, reattaches=message.reattaches,
        event_rate_hz=message.event_rate_hz, pose_rate_hz=message.pose_rate_hz, real_time_ratio=message.real_time_ratio,
        queue_age_s=seconds(message.queue_age),
        latency_p50_s=seconds(message.latency_p50) if message.HasField("latency_p50") else None,
        latency_p99_s=seconds(message.latency_p99) if message.HasField("latency_p99") else None,
        skipped_events=message.skipped_events, skipped_us=message.skipped_us, falls_behind=message.processing.falls_behind,
        objects=tuple(_object_health(each) for each in message.objects), cpu_s_per_s=message.processing.cpu_s_per_s,
        max_cpu_s_per_s=message.processing.max_cpu_s_per_s, tenant_cpu_s_per_s=message.processing.tenant_cpu_s_per_s,
        max_tenant_cpu_s_per_s=message.processing.max_tenant_cpu_s_per_s)


def _camera_from_message(message: Any) -> Camera:
    return Camera(
        width_px=message.width_px, height_px=message.height_px, fx_px=message.fx_px, fy_px=message.fy_px, cx_px=message.cx_px,
        cy_px=message.cy_px, distortion=tuple(message.distortion),
        lens_model=_name(geometry_pb2.LensModel, message.lens_model, "LENS_MODEL_").lower())


def _object_from_message(message: Any) -> TrackedObject:
    pose = transform_from_message(message.initial_camera_from_object) if message.HasField("initial_camera_from_object") else None
    rotation = np.array(quaternion_from_message(message.reference_rotation)) if message.HasField("reference_rotation") else None
    return TrackedObject(message.model, message.object_id, pose, rotation)


def config_from_message(message: Any) -> Optional[SessionConfig]:
    """Converts a SessionConfig that a server returned; None if it has a value of a later server."""
    sensor = message.tracker.sensor
    try:
        return SessionConfig(
            encoding=Encoding(message.encoding), camera=_camera_from_message(message.camera),
            objects=tuple(_object_from_message(each) for each in message.objects), overload=Overload(message.overload_policy),
            max_lag_s=seconds(message.max_lag) if message.HasField("max_lag") else None, estimator=Estimator(message.tracker.estimator),
            sensor=SensorProfile(
                pixel_noise_px=sensor.pixel_noise_px, blur_px=sensor.blur_px, contrast_threshold=sensor.contrast_threshold,
                refractory_us=sensor.refractory_us, latency_us=sensor.latency_us, uncertainty=sensor.uncertainty),
            pose_rate_hz=message.tracker.pose_rate_hz if message.tracker.HasField("pose_rate_hz") else 1000.0)
    except ValueError:
        return None


def session_from_message(message: Any) -> SessionInfo:
    """Converts a Session."""
    config = message.config
    is_known = config.encoding in (int(each) for each in Encoding)
    return SessionInfo(
        name=message.name, state=_name(session_pb2.SessionState, message.state, "SESSION_STATE_"),
        encoding=Encoding(config.encoding) if is_known else None, width_px=config.camera.width_px, height_px=config.camera.height_px,
        objects=tuple((each.object_id, each.model) for each in config.objects), health=health_from_message(message.health),
        config=config_from_message(config), create_time=_time(message, "create_time"), expire_time=_time(message, "expire_time"))


def model_from_message(message: Any) -> Model:
    """Converts a Model."""
    has_symmetry = message.HasField("continuous_symmetry")
    of = message.continuous_symmetry
    symmetry = _name(geometry_pb2.ContinuousSymmetry.Kind, of.kind, "KIND_").lower() if has_symmetry else ""
    return Model(
        name=message.name, file_name=message.file_name, size_bytes=message.size_bytes, num_faces=message.num_faces,
        num_lines=message.num_lines, num_curves=message.num_curves, num_symmetries=message.num_symmetries,
        continuous_symmetry=symmetry, diameter_m=message.diameter_m, notices=tuple(message.notices), num_regions=message.num_regions,
        format=_name(model_service_pb2.ModelFormat, message.format, "MODEL_FORMAT_").lower(), metres_per_unit=message.metres_per_unit,
        crease_angle_deg=message.crease_angle_deg, surface=Surface(message.surface) if message.surface in tuple(Surface) else None,
        sha256=bytes(message.sha256), create_time=_time(message, "create_time"), symmetry_centre_m=_point(of.centre_m) if has_symmetry else None,
        symmetry_axis=_point(of.axis) if symmetry == "axis" else None, symmetry_is_flippable=of.flippable)


def server_from_message(message: Any) -> ServerInfo:
    """Converts a ServerInfo."""
    return ServerInfo(
        version=message.version, commit=message.commit, store=_name(admin_service_pb2.StoreKind, message.store, "STORE_KIND_").lower(),
        active_sessions=message.active_sessions, max_sessions=message.max_sessions, max_chunk_bytes=message.max_chunk_bytes,
        max_model_bytes=message.max_model_bytes, pose_log_capacity=message.pose_log_capacity, draining=message.draining,
        session_expiry_s=seconds(message.session_expiry), skipped_events=message.skipped_events, time=_time(message, "time"))
