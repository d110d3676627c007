# SPDX-License-Identifier: Apache-2.0
"""Messages of the API to the types of this package."""

from __future__ import annotations

from typing import Any, Optional

from evpose.events import Encoding
from evpose.types import (DecodeFault, EventsDropped, GoAway, Health, LagChange, Model, Notice, ObjectHealth, ServerInfo, SessionInfo,
                          StateChange, TrackingRestarted, TrackState, Trigger, Triggers)
from evpose.v1 import admin_service_pb2, geometry_pb2, session_pb2, track_pb2


def seconds(duration: Any) -> float:
    """Returns a google.protobuf.Duration in seconds."""
    return float(duration.seconds + 1e-9 * duration.nanos)


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
        return TrackingRestarted(item.after_seq, item.detail)
    if kind == "lag_change":
        return LagChange(item.falls_behind, seconds(item.lag))
    if kind == "triggers":
        return Triggers(item.seq, tuple(Trigger(each.t_us, each.input, each.rising) for each in item.triggers), item.num_skipped)
    return None


def _object_health(message: Any) -> ObjectHealth:
    has_loss = message.HasField("latest_loss")
    return ObjectHealth(
        object_id=message.object_id, state=TrackState(message.state), losses=message.losses, explained_ratio=message.explained_ratio,
        initialization=_name(session_pb2.InitializationStatus, message.initialization, "INITIALIZATION_STATUS_"),
        initialization_attempts=message.initialization_attempts, detail=message.detail,
        latest_loss_t_us=message.latest_loss.t_us if has_loss else None,
        latest_loss_cause=_name(session_pb2.LossCause, message.latest_loss.cause, "LOSS_CAUSE_") if has_loss else "")


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
        objects=tuple(_object_health(each) for each in message.objects))


def session_from_message(message: Any) -> SessionInfo:
    """Converts a Session."""
    config = message.config
    is_known = config.encoding in (int(each) for each in Encoding)
    return SessionInfo(
        name=message.name, state=_name(session_pb2.SessionState, message.state, "SESSION_STATE_"),
        encoding=Encoding(config.encoding) if is_known else None, width_px=config.camera.width_px, height_px=config.camera.height_px,
        objects=tuple((each.object_id, each.model) for each in config.objects), health=health_from_message(message.health))


def model_from_message(message: Any) -> Model:
    """Converts a Model."""
    symmetry = ""
    if message.HasField("continuous_symmetry"):
        symmetry = _name(geometry_pb2.ContinuousSymmetry.Kind, message.continuous_symmetry.kind, "KIND_").lower()
    return Model(
        name=message.name, file_name=message.file_name, size_bytes=message.size_bytes, num_faces=message.num_faces,
        num_lines=message.num_lines, num_curves=message.num_curves, num_symmetries=message.num_symmetries,
        continuous_symmetry=symmetry, diameter_m=message.diameter_m, notices=tuple(message.notices))


def server_from_message(message: Any) -> ServerInfo:
    """Converts a ServerInfo."""
    return ServerInfo(
        version=message.version, commit=message.commit, store=_name(admin_service_pb2.StoreKind, message.store, "STORE_KIND_").lower(),
        active_sessions=message.active_sessions, max_sessions=message.max_sessions, max_chunk_bytes=message.max_chunk_bytes,
        max_model_bytes=message.max_model_bytes, pose_log_capacity=message.pose_log_capacity, draining=message.draining)
