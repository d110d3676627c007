# SPDX-License-Identifier: Apache-2.0
"""Tracks objects in the events of an event camera, with evpose-server.

    with evpose.connect("127.0.0.1:50051") as client, evpose.Recording("recording.raw") as recording:
        session = client.create_session(client.upload_model("model.obj"), evpose.read_camera("camera.yaml"), recording.encoding)
        poses = session.track(recording).read_all()

README.md of the package describes shapes, units, frames and errors.
"""

from evpose.cameras import Camera, read_camera
from evpose.channel import Tls
from evpose.client import Client, connect
from evpose.errors import (AbortedError, AlreadyExistsError, CancelledError, DataLossError, DeadlineExceededError, EvposeError,
                           FailedPreconditionError, InternalError, InvalidArgumentError, NotFoundError, PermissionDeniedError,
                           ResourceExhaustedError, UnauthenticatedError, UnavailableError, UnimplementedError)
from evpose.events import EVENT_DTYPE, Encoding, FlatEncoder, events_to_bytes, make_events
from evpose.geometry import Transform
from evpose.poses import POSE_DTYPE, Alternative, Pose, in_world, of_camera, write_tum
from evpose.recordings import Recording
from evpose.session import PoseWatch, Session
from evpose.stream.attempt import TrackPosition
from evpose.stream.outbox import RetainOptions
from evpose.stream.retry import RetryOptions
from evpose.stream.track import Track, TrackOptions
from evpose.tracing import StreamTrace
from evpose.types import (ConnectionChange, DecodeFault, Discontinuity, Estimator, EventsDropped, GoAway, Health, LagChange, Model, Notice,
                          ObjectHealth, Overload, PoseReset, PosesLost, SearchCounts, SensorProfile, ServerInfo, SessionConfig, SessionInfo, StateChange,
                          Surface, TrackedObject, TrackingRestarted, TrackState, TrackSummary, Trigger, Triggers, read_sensor_profile)

__all__ = [
    "EVENT_DTYPE", "POSE_DTYPE", "AbortedError", "AlreadyExistsError", "Alternative", "Camera", "CancelledError", "Client",
    "ConnectionChange", "DataLossError", "DeadlineExceededError", "DecodeFault", "Discontinuity", "Encoding", "Estimator",
    "EventsDropped", "EvposeError", "FailedPreconditionError", "FlatEncoder", "GoAway", "Health", "InternalError", "InvalidArgumentError",
    "LagChange", "Model", "NotFoundError", "Notice", "ObjectHealth", "Overload", "PermissionDeniedError", "Pose", "PoseReset", "PoseWatch",
    "PosesLost", "Recording", "ResourceExhaustedError", "RetainOptions", "RetryOptions", "SearchCounts", "SensorProfile", "ServerInfo", "Session", "SessionConfig",
    "SessionInfo", "StateChange", "StreamTrace", "Surface", "Tls", "Track", "TrackOptions", "TrackPosition", "TrackState", "TrackSummary", "TrackedObject",
    "TrackingRestarted", "Transform", "Trigger", "Triggers", "UnauthenticatedError", "UnavailableError", "UnimplementedError", "connect", "events_to_bytes",
    "in_world", "make_events", "of_camera", "read_camera", "read_sensor_profile", "write_tum",
]
