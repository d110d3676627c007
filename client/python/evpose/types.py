# SPDX-License-Identifier: Apache-2.0
"""Parameters and results. Each type corresponds to a message or enumeration of proto/evpose/v1, which documents its fields in
full. Times t_us are on the sensor's clock, in microseconds; durations *_s are seconds; *_time is of the server's clock, in UTC."""

from __future__ import annotations

import dataclasses
import datetime
import enum
import pathlib
from typing import Any, Optional, Union

from evpose.cameras import Camera
from evpose.errors import InvalidArgumentError
from evpose.events import Encoding
from evpose.files import read_yaml, to_duration_ns, to_number
from evpose.geometry import Matrix, Transform, rotation_to_proto
from evpose.tracing import StreamTrace, trace_id
from evpose.v1 import session_pb2


class TrackState(enum.IntEnum):
    """The state of an object's track. UNKNOWN is a state of a later server: there is no confirmed pose."""

    UNKNOWN = 0
    INITIALIZING = 1
    TRACKING = 2
    DEGRADED = 3
    LOST = 4
    AMBIGUOUS = 5

    @classmethod
    def _missing_(cls, value: object) -> TrackState:
        return cls.UNKNOWN


class Overload(enum.IntEnum):
    """Policy for events that arrive faster than they are tracked: the client waits, or old events are dropped."""

    BLOCK = 1
    LATEST = 2


class Estimator(enum.IntEnum):
    """The method that estimates a pose from a window of events. All but MIXTURE are for comparison."""

    MIXTURE = 1
    STATIC_MM = 2
    STATIC_LS = 3
    STATIC_M = 4
    STATIC_S = 5
    ERROR_STATE_FILTER = 6


class Surface(enum.IntEnum):
    """Meaning of the facets of a model's mesh: they approximate a smooth surface, or are the faces of the object."""

    SMOOTH = 1
    AS_IS = 2


@dataclasses.dataclass(frozen=True)
class Model:
    """A model on the server.

    name                    "models/{id}"
    file_name               of the first upload; for people
    size_bytes              of the file
    num_faces, num_lines, num_curves    triangles, straight edges and curved edges
    num_symmetries          rotations that map the object onto itself, with the identity; 1 with a continuous symmetry
    continuous_symmetry     "axis", "sphere", or "" for none; a rotation by it is not measured
    diameter_m              metres
    notices                 for people: what was merged or dropped when the file was loaded
    num_regions             parts of the surface that no crease crosses; 0 if all are flat, or with Surface.AS_IS
    format                  of the file: "obj", "ply", "stl" or "mesh"
    metres_per_unit, crease_angle_deg, surface    as in upload_model(); None for a surface of a later server
    sha256                  of the file, 32 bytes
    create_time             when it was uploaded; None for a model that an earlier version stored
    symmetry_centre_m       a point that the continuous symmetry does not move, in the object's frame, metres; None without one
    symmetry_axis           unit vector of the axis in the object's frame; None unless continuous_symmetry is "axis"
    symmetry_is_flippable   half turns about the axes that are perpendicular to symmetry_axis map the object onto itself, too
    """

    name: str
    file_name: str
    size_bytes: int
    num_faces: int
    num_lines: int
    num_curves: int
    num_symmetries: int
    continuous_symmetry: str
    diameter_m: float
    notices: tuple[str, ...]
    num_regions: int
    format: str
    metres_per_unit: float
    crease_angle_deg: float
    surface: Optional[Surface]
    sha256: bytes
    create_time: Optional[datetime.datetime]
    symmetry_centre_m: Optional[tuple[float, float, float]]
    symmetry_axis: Optional[tuple[float, float, float]]
    symmetry_is_flippable: bool


@dataclasses.dataclass(frozen=True)
class TrackedObject:
    """An object of a session. Without an initial pose, the pose is found from the events."""

    model: Union[Model, str]
    object_id: str = "object"
    initial_camera_from_object: Optional[Transform] = None
    reference_quaternion_xyzw: Optional[Matrix] = None  # selects among the poses of a symmetric object; None: the identity

    def to_proto(self) -> Any:
        """Returns a message of the API. Raises InvalidArgumentError."""
        message = session_pb2.TrackedObject(
            object_id=self.object_id, model=self.model.name if isinstance(self.model, Model) else self.model)
        if self.initial_camera_from_object is not None:
            message.initial_camera_from_object.CopyFrom(self.initial_camera_from_object.to_proto())
        if self.reference_quaternion_xyzw is not None:
            message.reference_rotation.CopyFrom(rotation_to_proto(self.reference_quaternion_xyzw, "reference_quaternion_xyzw"))
        return message


@dataclasses.dataclass(frozen=True)
class SensorProfile:
    """Constants of a sensor and its lens; the defaults are those of an EVK4. `evpose calibrate` measures them.

    uncertainty   standard deviation of the errors of the other constants, relative to the spread among sensors: 1 for a sensor
                  that was not calibrated, 0.3 after `evpose calibrate`, 0 for exact constants. It affects the covariance of
                  the poses only.
    """

    pixel_noise_px: float = 0.8
    blur_px: float = 0.47
    contrast_threshold: float = 0.35  # change of the natural logarithm of the light
    refractory_us: float = 140.0
    latency_us: float = 40.0
    uncertainty: float = 1.0


def read_sensor_profile(path: Union[str, pathlib.Path]) -> SensorProfile:
    """Reads the YAML file that `evpose calibrate` writes. Raises NotFoundError, and InvalidArgumentError with file and key."""
    data = read_yaml(path)
    if not isinstance(data, dict):
        raise InvalidArgumentError(f"{path}: not a sensor profile: it has no keys")
    names = [field.name for field in dataclasses.fields(SensorProfile)]
    # The command evpose refuses unknown fields, too. A constant of a later version that is ignored here would give other poses.
    for key in data:
        if key not in ("name", *names):
            raise InvalidArgumentError(f"{path}: {key} is not a field of a sensor profile; the fields are name, {', '.join(names)}")
    data.setdefault("uncertainty", SensorProfile.uncertainty)  # profiles of earlier versions are without it
    for name in names:
        if name not in data:
            raise InvalidArgumentError(f"{path}: the key {name!r} is missing")
    try:
        return SensorProfile(**{name: to_number(data[name], name) for name in names})
    except InvalidArgumentError as error:
        raise error.with_message(f"{path}: {error}") from None


@dataclasses.dataclass(frozen=True)
class PoseReset:
    """A pose from which the tracking of an object restarts."""

    camera_from_object: Transform
    object_id: str = "object"


class Discontinuity:
    """In a stream of events: events were lost here. The decoder waits for a full time stamp."""


@dataclasses.dataclass(frozen=True)
class EventsDropped:
    """An interval that was not tracked (Overload.LATEST)."""

    num_events: int
    from_t_us: int
    to_t_us: int
    reason: str  # "LAG", "MEMORY", "READER"


@dataclasses.dataclass(frozen=True)
class GoAway:
    """The server shuts down in this time."""

    deadline_s: float


@dataclasses.dataclass(frozen=True)
class DecodeFault:
    """The decoder skipped words."""

    chunk_seq: int
    count: int
    detail: str


@dataclasses.dataclass(frozen=True)
class StateChange:
    """The state of an object's track has changed."""

    object_id: str
    t_us: int
    state: TrackState


@dataclasses.dataclass(frozen=True)
class TrackingRestarted:
    """The state of the tracker could not be restored; every object is searched for again.

    `after_pose_seq` is the last stored pose. If later ones were delivered before, poses of the new search are delivered with the
    same numbers. None: the server has an earlier version, which does not send those.
    """

    after_seq: int
    detail: str
    after_pose_seq: Optional[int] = None


@dataclasses.dataclass(frozen=True)
class LagChange:
    """The session has begun or ceased to be processed more slowly than its camera sends."""

    falls_behind: bool
    lag_s: float


@dataclasses.dataclass(frozen=True)
class Trigger:
    """An edge on an external trigger input of the camera, at a time of the sensor's clock."""

    t_us: int
    input: int
    rising: bool


@dataclasses.dataclass(frozen=True)
class Triggers:
    """The triggers of one chunk: at most 64, and the number of those beyond. They have no influence on poses."""

    seq: int
    triggers: tuple[Trigger, ...]
    num_skipped: int


@dataclasses.dataclass(frozen=True)
class PosesLost:
    """The server no longer stored these poses when the stream was resumed."""

    first_seq: int
    last_seq: int


Notice = Union[EventsDropped, GoAway, DecodeFault, StateChange, TrackingRestarted, LagChange, Triggers, PosesLost]


@dataclasses.dataclass(frozen=True)
class ConnectionChange:
    """The stream has broken (is_disconnected), or it is re-established."""

    is_disconnected: bool
    server: str  # the next one to be tried, or the one that accepted the stream
    cause: Optional[Exception]
    outage_s: float  # since the end of the last stream that made progress
    next_try_in_s: float
    kept_bytes: int  # events that wait for the server, or that it may request again
    trace: StreamTrace = StreamTrace()  # of the stream that has broken, or of the new one


@dataclasses.dataclass(frozen=True)
class SearchCounts:
    """The searches for the pose of an object, by their result.

    no_signal           no region of the image had more events than the noise
    too_small           fewer than three lines, in a region that is too small for three edges
    too_few_lines       fewer than three lines
    not_enough_motion   the lines moved by less than a pixel
    no_pose_fits        no pose of the model fitted the lines
    poses_found         poses were found, which the events may have rejected later
    """

    no_signal: int
    too_small: int
    too_few_lines: int
    not_enough_motion: int
    no_pose_fits: int
    poses_found: int


@dataclasses.dataclass(frozen=True)
class ObjectHealth:
    """The state of one object of a session.

    losses                    changes to LOST
    explained_ratio           of the latest pose: the share of the events in the gate that the model explains, 0 to 1
    initialization            why there is no confirmed pose, such as "NOT_NEEDED" or "TOO_FEW_LINES"
    initialization_attempts   searches for the pose so far
    detail                    for people: why there is no confirmed pose; "" when there is one
    latest_loss_t_us          sensor time, microseconds; None before the first loss
    latest_loss_cause         such as "OUT_OF_VIEW"; "" before the first loss
    searches                  since the start or the latest loss
    followed_poses            the first pose, which is tested or reported, and those that are compared with it
    """

    object_id: str
    state: TrackState
    losses: int
    explained_ratio: float
    initialization: str
    initialization_attempts: int
    detail: str
    latest_loss_t_us: Optional[int]
    latest_loss_cause: str
    searches: SearchCounts
    followed_poses: int


@dataclasses.dataclass(frozen=True)
class Health:
    """Counters, which start with the session, and gauges of a session.

    t_us              sensor time up to which events were processed, microseconds
    received_bytes, processed_bytes   of events, without repeated chunks
    decoded_events    changes of brightness
    dropped_events    events before the first full time stamp, or outside the sensor
    invalid_words     words of unknown type and incomplete vectors
    time_backsteps    backward steps of the time stamps
    poses             number of poses; also the number of the latest one
    reattaches        streams after the first one
    event_rate_hz, pose_rate_hz       per second of sensor time
    real_time_ratio   processing time divided by sensor time; above 1 the session falls behind
    queue_age_s       how long the oldest unprocessed chunk has waited, seconds
    latency_p50_s, latency_p99_s      median and 99th percentile of Pose.latency_s; None before the first pose
    skipped_events    with Overload.LATEST: decoded events that were not tracked
    skipped_us        with Overload.LATEST: sensor time of the intervals that were not tracked, microseconds
    falls_behind      events are processed more slowly than the camera sends them
    cpu_s_per_s       processor seconds per second that the session uses
    max_cpu_s_per_s   the server's limit of cpu_s_per_s; 0: no limit
    tenant_cpu_s_per_s, max_tenant_cpu_s_per_s   the same of all sessions of the tenant on this server
    """

    t_us: int
    received_bytes: int
    processed_bytes: int
    decoded_events: int
    dropped_events: int
    invalid_words: int
    time_backsteps: int
    poses: int
    reattaches: int
    event_rate_hz: float
    pose_rate_hz: float
    real_time_ratio: float
    queue_age_s: float
    latency_p50_s: Optional[float]
    latency_p99_s: Optional[float]
    skipped_events: int
    skipped_us: int
    falls_behind: bool
    objects: tuple[ObjectHealth, ...]
    cpu_s_per_s: float
    max_cpu_s_per_s: float
    tenant_cpu_s_per_s: float = 0.0
    max_tenant_cpu_s_per_s: float = 0.0


@dataclasses.dataclass(frozen=True)
class SessionInfo:
    """A session on the server, as GetSession and ListSessions return it.

    name          "sessions/{id}"
    state         "DETACHED", "ATTACHED" or "ENDED"
    encoding      None: one of a later server
    width_px, height_px   size of the sensor
    objects       object_id and name of the model of each object
    config        with the defaults filled in; None if it has a value of a later server
    create_time   when the session was created
    expire_time   when it is deleted; None while a stream is attached
    """

    name: str
    state: str
    encoding: Optional[Encoding]
    width_px: int
    height_px: int
    objects: tuple[tuple[str, str], ...]
    health: Health
    config: Optional[SessionConfig]
    create_time: Optional[datetime.datetime]
    expire_time: Optional[datetime.datetime]

    @property
    def trace_id(self) -> str:
        """The trace ID of the session, by which the logs of the servers name it."""
        return trace_id(self.name)

    @property
    def object_ids(self) -> tuple[str, ...]:
        """The IDs of the objects, in the order of the configuration."""
        return tuple(object_id for object_id, _ in self.objects)


@dataclasses.dataclass(frozen=True)
class ServerInfo:
    """Version, limits and load of a server.

    version             of the program
    commit              that it was built from; "unknown" if the build had none
    store               "memory", "sqlite", "redis" or "postgresql"
    active_sessions     in any state: of all tenants for an operator, else of the caller's tenant
    max_sessions        limit of all sessions
    max_chunk_bytes     limit of a chunk of a new session, and of a piece of a model's file
    max_model_bytes     limit of a model's file
    pose_log_capacity   poses that are kept for each session
    draining            the server shuts down: it accepts no new sessions and streams
    session_expiry_s    a session without a stream is deleted after this time, seconds
    skipped_events      with Overload.LATEST: decoded events that were not tracked, of all sessions since the server started; 0
                        unless the caller is an operator
    time                the server's clock when it responded; None if the server is of an earlier version
    """

    version: str
    commit: str
    store: str
    active_sessions: int
    max_sessions: int
    max_chunk_bytes: int
    max_model_bytes: int
    pose_log_capacity: int
    draining: bool
    session_expiry_s: float
    skipped_events: int
    time: Optional[datetime.datetime]


@dataclasses.dataclass(frozen=True)
class TrackSummary:
    """The end of a stream."""

    health: Health
    sent_bytes: int
    sent_chunks: int
    poses: int
    lost_poses: int
    trace: StreamTrace = StreamTrace()  # of the last stream


@dataclasses.dataclass(frozen=True)
class SessionConfig:
    """Configuration of a new session.

    pose_rate_hz   1000 to 10,000: poses per second of each object, while there are 150 events for each
    """

    encoding: Encoding
    camera: Camera
    objects: tuple[TrackedObject, ...]
    overload: Overload = Overload.BLOCK
    max_lag_s: Optional[float] = None
    estimator: Estimator = Estimator.MIXTURE
    sensor: SensorProfile = SensorProfile()
    pose_rate_hz: float = 1000.0

    def to_proto(self) -> Any:
        """Returns a message of the API. Raises InvalidArgumentError."""
        message: Any = session_pb2.SessionConfig()
        message.encoding = int(self.encoding)
        message.camera.CopyFrom(self.camera.to_proto())
        message.objects.extend(each.to_proto() for each in self.objects)
        message.overload_policy = int(self.overload)
        message.tracker.estimator = int(self.estimator)
        message.tracker.pose_rate_hz = to_number(self.pose_rate_hz, "pose_rate_hz")
        message.tracker.sensor.CopyFrom(session_pb2.SensorProfile(**dataclasses.asdict(self.sensor)))
        if self.max_lag_s is not None:
            message.max_lag.FromNanoseconds(to_duration_ns(self.max_lag_s, "max_lag_s", 0.0))
        return message
