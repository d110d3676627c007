# SPDX-License-Identifier: Apache-2.0
"""A session: its events, poses and health."""

from __future__ import annotations

import threading
from typing import Any, Generator, Iterator, Optional

from google.protobuf import empty_pb2

from evpose.convert import health_from_message, session_from_message
from evpose.errors import EvposeError, FailedPreconditionError, InternalError, InvalidArgumentError
from evpose.events import Encoding
from evpose.files import to_duration_ns, to_number
from evpose.poses import WITH_POSE, Pose, defect, pose_from_message
from evpose.recordings import Recording
from evpose.stream.attempt import SERVICE, TrackPosition
from evpose.stream.feed import EventFeed, EventSource
from evpose.stream.servers import Servers, WatchCall, close_generator
from evpose.stream.track import Track, TrackOptions
from evpose.tracing import trace_id
from evpose.types import Health, SessionInfo
from evpose.v1 import session_pb2, session_service_pb2


class Session:
    """A session of a server, made by Client.create_session() or, to watch it, by Client.session(). `name` is "sessions/{id}".

    A `with` block deletes the session at its end, also after an exception, unless keep() was called or another client feeds it."""

    def __init__(self, servers: Servers, info: SessionInfo, resume_token: str, call_timeout_s: float) -> None:
        self._servers = servers
        self._info = info
        self._resume_token = resume_token
        self._call_timeout_s = call_timeout_s
        self._lock = threading.Lock()
        self._was_tracked = False  # guarded by _lock
        self._is_kept = not resume_token  # the session of another client

    def __enter__(self) -> Session:
        return self

    def __exit__(self, kind: Optional[type[BaseException]], *_: object) -> None:
        if self._is_kept:
            return
        try:
            self.delete()
        except EvposeError:  # the session expires later; the first exception has the cause
            if kind is None:
                raise

    def keep(self) -> None:
        """Lets the session live beyond a `with` block: to be watched by others, or for Client.resume() in another process."""
        self._is_kept = True

    @property
    def name(self) -> str:
        """The name of the session, "sessions/{id}"."""
        return self._info.name

    @property
    def trace_id(self) -> str:
        """The trace ID of the session, by which the logs of the servers name it."""
        return trace_id(self.name)

    @property
    def object_ids(self) -> tuple[str, ...]:
        """The IDs of the objects; `object` of POSE_DTYPE is an index in it."""
        return self._info.object_ids

    @property
    def encoding(self) -> Optional[Encoding]:
        """The encoding of the session's events; None for an encoding of a later version."""
        return self._info.encoding

    def track(self, events: EventSource, options: TrackOptions = TrackOptions()) -> Track:
        """Sends events and returns an iterator of the poses. `events` is a Recording, or yields chunks of any size: encoded
        events (bytes), arrays of events (for Encoding.FLAT64), a PoseReset at its place among them, or Discontinuity where
        events were lost. Raises InvalidArgumentError if a recording does not fit the session, and FailedPreconditionError if
        this object is not the session's writer or track() was called before (see Client.resume)."""
        if not self._resume_token:
            raise FailedPreconditionError(f"{self.name}: only the client that has created a session can feed it")
        with self._lock:
            if self._was_tracked:
                raise FailedPreconditionError(f"{self.name}: was fed already; Client.resume(track.position, events) continues a stream")
            track = self.continue_from(TrackPosition(self.name, self._resume_token), events, options)
            self._was_tracked = True
            return track

    def continue_from(self, position: TrackPosition, events: EventSource, options: TrackOptions) -> Track:
        """Implements Client.resume()."""
        if self.encoding is None:
            raise FailedPreconditionError(f"{self.name}: its events are in an encoding of a later version")
        self._check(events)
        size_px = (self._info.width_px, self._info.height_px)
        feed = EventFeed(events, self.encoding, size_px, options.memory_bytes, options.is_live, position.durable,
                         options.retain)
        if position.max_piece_bytes > 0:
            feed.start(position.max_piece_bytes)
        return Track(self._servers, self.object_ids, position, feed, options)

    def _check(self, events: Any) -> None:
        if isinstance(events, (bytes, bytearray, str)) or hasattr(events, "dtype"):
            raise InvalidArgumentError("events: give a Recording or an iterable of chunks; [events] has one chunk")
        if not isinstance(events, Recording):
            return
        if events.encoding != self.encoding:
            encoding = self.encoding.name if self.encoding is not None else ""
            raise InvalidArgumentError(f"{events.path}: is {events.encoding.name}, but the session was created for {encoding}")
        size_px = (events.width_px, events.height_px)
        if None not in size_px and size_px != (self._info.width_px, self._info.height_px):
            raise InvalidArgumentError(
                f"{events.path}: the recording has {size_px[0]}x{size_px[1]} pixels, but the session's camera has {self._info.width_px}x"
                f"{self._info.height_px}: create the session with the camera file of this sensor")

    def info(self) -> SessionInfo:
        """Returns the present state. Raises EvposeError."""
        request = session_service_pb2.GetSessionRequest(name=self.name)
        return session_from_message(self._servers.call(SERVICE + "GetSession", request, session_pb2.Session, self._call_timeout_s))

    def health(self) -> Health:
        """Returns the counters and gauges. Raises EvposeError."""
        return self.info().health

    def watch_poses(self, after_seq: int = 0, max_rate_hz: Optional[float] = None) -> PoseWatch:
        """Returns an iterator of the stored poses after `after_seq`, then live ones, until the session has ended. `max_rate_hz`
        limits the poses per second of sensor time and object. Follows the session to another server, and continues at another one
        of the client when its server is unreachable. Use it in a `with` block, or close() it. Raises InvalidArgumentError and
        EvposeError."""
        if not isinstance(after_seq, int) or not 0 <= after_seq < 1 << 64:
            raise InvalidArgumentError(f"after_seq is {after_seq!r}, but must be the number of a pose, or 0")
        request = session_service_pb2.WatchPosesRequest(session=self.name, after_pose_seq=after_seq)
        if max_rate_hz is not None:
            request.max_rate_hz = to_number(max_rate_hz, "max_rate_hz")
        return PoseWatch(self._servers, request)

    def watch_health(self, period_s: float = 1.0) -> Iterator[Health]:
        """Returns an iterator of the health: at once, after each period (at least 0.01 s), and when the session has ended. Raises
        InvalidArgumentError and EvposeError."""
        request = session_service_pb2.WatchHealthRequest(session=self.name)
        request.period.FromNanoseconds(to_duration_ns(period_s, "period_s", 0.01))
        responses = self._servers.watch(SERVICE + "WatchHealth", request, session_service_pb2.WatchHealthResponse)
        return (health_from_message(response.health) for response in responses)

    def delete(self) -> None:
        """Deletes the session; one that does not exist is no error. Raises EvposeError."""
        request = session_service_pb2.DeleteSessionRequest(name=self.name, allow_missing=True)
        self._servers.call(SERVICE + "DeleteSession", request, empty_pb2.Empty, self._call_timeout_s)


class PoseWatch:
    """The poses of a session that another client, or another thread, feeds."""

    def __init__(self, servers: Servers, request: Any) -> None:
        self.num_skipped = 0  # poses that were not sent, because this reader was too slow or they are no longer stored
        # Set when the session had fewer poses than were read, because it was resumed from a checkpoint or its store has lost the last
        # writes: the number of its last pose at that time. The session computes the same poses again; they are not returned again.
        self.continues_after_seq: Optional[int] = None
        self._request = request
        self._call = WatchCall()
        self._responses = servers.watch(SERVICE + "WatchPoses", request, session_service_pb2.WatchPosesResponse, self._call)
        self._poses = self._run()

    def _run(self) -> Generator[Pose, None, None]:
        for response in self._responses:
            self.num_skipped += response.num_skipped
            if response.HasField("continues_after_pose_seq"):
                self.continues_after_seq = response.continues_after_pose_seq
            for message in response.poses:
                why = defect(message)
                if why:
                    raise InternalError(f"{self._request.session}: pose {message.pose_seq}: {why}")
                self._request.after_pose_seq = message.pose_seq
                if message.state in WITH_POSE:
                    yield pose_from_message(message)

    def __iter__(self) -> PoseWatch:
        return self

    def __next__(self) -> Pose:
        return next(self._poses)

    def close(self) -> None:
        """Ends the call. Thread-safe: another thread that reads the poses gets CancelledError."""
        self._call.close()
        close_generator(self._poses)
        close_generator(self._responses)

    def __enter__(self) -> PoseWatch:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
