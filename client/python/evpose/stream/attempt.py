# SPDX-License-Identifier: Apache-2.0
"""One Track stream, from attach to its end."""

from __future__ import annotations

import dataclasses
import json
import math
import threading
import time
from typing import Any, Callable, Iterator, Optional, Sequence

import grpc

from evpose.channel import Endpoint
from evpose.convert import notice_from_message, seconds
from evpose.errors import (DataLossError, DeadlineExceededError, EvposeError, FailedPreconditionError, InternalError,
                           InvalidArgumentError, from_call)
from evpose.poses import WITH_POSE, defect
from evpose.stream.feed import EventFeed
from evpose.stream.outbox import Chunk, FeedPoint
from evpose.tracing import StreamTrace
from evpose.types import GoAway, Notice, PosesLost, TrackingRestarted
from evpose.v1 import track_pb2

SERVICE = "/evpose.v1.SessionService/"
TRACK = SERVICE + "Track"
# Bytes of the longest word of any encoding. The limit of a chunk that a server states must not be smaller.
_WORD_BYTES = 8
# Least period of the empty chunks that keep a stream alive, however short the idle timeout that the server states.
_SHORTEST_KEEP_ALIVE_S = 0.005
_FROM_TO_JSON = "give the text of TrackPosition.to_json()"


@dataclasses.dataclass
class TrackPosition:
    """The position of a session, from which this process or another one can continue it.

    The tokens are secrets. `previous_token` is valid until a message was sent on the stream that returned the current one.
    last_pose_seq     the last delivered pose
    lost_poses        earlier poses that were not delivered, because the server no longer stored them
    durable           data before this point is requested again only if the store has lost its last writes
    max_piece_bytes   size at which chunks of the source were divided; 0: no chunk was sent yet
    """

    session: str
    resume_token: str
    previous_token: str = ""
    last_pose_seq: int = 0
    lost_poses: int = 0
    durable: FeedPoint = FeedPoint()
    max_piece_bytes: int = 0

    def to_json(self) -> str:
        """Returns the position as JSON, for from_json(). It contains secrets."""
        return json.dumps(dataclasses.asdict(self))

    @staticmethod
    def from_json(text: str) -> TrackPosition:
        """Returns the position that to_json() has written. Raises InvalidArgumentError."""
        try:
            data: dict[str, Any] = json.loads(text)
            data["durable"] = FeedPoint(*data["durable"])
            position = TrackPosition(**data)
        except (ValueError, TypeError, LookupError, RecursionError) as error:
            raise InvalidArgumentError(f"not the position of a session: {error!r}: {_FROM_TO_JSON}") from None
        texts = {name: getattr(position, name) for name in ("session", "resume_token", "previous_token")}
        counts = {name: getattr(position, name) for name in ("last_pose_seq", "lost_poses", "max_piece_bytes")}
        for name, value in {**counts, **position.durable._asdict()}.items():
            if type(value) is not int or not 0 <= value < 1 << 64:  # a bool is no count either
                raise InvalidArgumentError(f"not the position of a session: {name} is not a count: {_FROM_TO_JSON}")
        for name, value in texts.items():
            if not isinstance(value, str):
                raise InvalidArgumentError(f"not the position of a session: {name} is not a text: {_FROM_TO_JSON}")
        return position


@dataclasses.dataclass
class Callbacks:
    """Called in the thread that reads the poses, in the order of the server's messages."""

    on_notice: Optional[Callable[[Notice], None]] = None
    # Called with each new position. When the token is new, it is called before the message that invalidates the previous token, so that
    # the caller can store it first.
    on_position: Optional[Callable[[TrackPosition, bool], None]] = None


@dataclasses.dataclass
class AttemptOptions:
    """The parts of TrackOptions and of the state of a Track that one attempt needs."""

    resume_token: str
    attach_after_pose: int  # repeated poses up to TrackPosition.last_pose_seq are dropped
    leaves_on_go_away: bool  # the session can be continued at another server or later
    credit_timeout_s: float
    attach_timeout_s: float
    object_ids: Sequence[str]
    trace: StreamTrace


class _Stopped(Exception):
    """The attempt has ended; nothing more is sent."""


class StreamAttempt:
    """Used once. poses() yields the messages of new poses; afterwards the outcome is in the attributes."""

    def __init__(self, endpoint: Endpoint, position: TrackPosition, feed: EventFeed, callbacks: Callbacks,
                 options: AttemptOptions) -> None:
        self.error: Optional[EvposeError] = None  # None: the summary was received, or the stream was left because of go_away
        self.foreign_error: Optional[Exception] = None  # of the source
        self.is_final = False  # the error is on this side, or the server violates the protocol
        self.was_attached = False
        self.made_progress = False
        self.stated_first_seq = False  # the server was told which chunks can still be sent
        self.summary: Any = None
        self.fed_bytes = 0
        self._endpoint = endpoint
        self._position = position
        self._feed = feed
        self._callbacks = callbacks
        self._options = options
        # The uplink: guarded by the condition of the outbox.
        self._changed = feed.outbox.changed
        self._is_stopped = False
        self._is_leaving = False
        self._attached: Any = None
        self._send_limit_bytes = 0
        self._sent_bytes = 0
        self._sent_seq = 0  # number of the last chunk or reset that the server has, or that was sent
        self._uplink_error: Optional[Exception] = None
        self._keep_alive_s = math.inf
        self._reading_since = math.inf  # monotonic time since which _read() waits; inf while it does not wait
        # The downlink.
        self._call: Any = None
        self._timed_out = False
        self._next_pose_seq = 1
        self._first_processed_seq = 0
        self._last_t_us: dict[str, int] = {}

    # Uplink: gRPC consumes this in a thread of its own.

    def _requests(self) -> Iterator[Any]:
        first_seq = self._feed.outbox.first_seq
        self.stated_first_seq = first_seq is not None
        yield track_pb2.TrackRequest(attach={
            "session": self._position.session, "resume_token": self._options.resume_token,
            "last_pose_seq": self._options.attach_after_pose, "first_seq": first_seq or 0})
        try:
            yield from self._chunks()
        except _Stopped:
            return
        except Exception as error:  # of the source, or of the credit
            self._uplink_error = error
            self._call.cancel()
            return
        yield track_pb2.TrackRequest(end={})

    def _chunks(self) -> Iterator[Any]:
        yield from self._wait(lambda: self._attached is not None, math.inf)
        seq = self._attached.next_seq
        while True:
            yield from self._wait(lambda seq=seq: self._feed.outbox.has(seq), math.inf)  # type: ignore[misc]
            with self._changed:
                chunk = self._feed.outbox.get(seq)
            if chunk is None:
                return
            if chunk.reset is None:
                size = len(chunk.payload)
                yield from self._wait(lambda size=size: self._sent_bytes + size <= self._send_limit_bytes,  # type: ignore[misc]
                                      self._options.credit_timeout_s)
            with self._changed:
                self._sent_seq = seq
            yield self._request_of(chunk)
            seq += 1

    def _request_of(self, chunk: Chunk) -> Any:
        if chunk.reset is not None:  # uses no credit
            request = track_pb2.TrackRequest(reset_pose=chunk.reset)
            request.reset_pose.seq = chunk.end.seq
            return request
        self._sent_bytes += len(chunk.payload)
        self.fed_bytes = chunk.end.bytes
        return track_pb2.TrackRequest(events={
            "seq": chunk.end.seq, "discontinuity": chunk.discontinuity, "payload": chunk.payload, "crc32c": chunk.crc})

    def _wait(self, is_ready: Callable[[], bool], timeout_s: float) -> Iterator[Any]:
        """Waits for a condition. Meanwhile yields an empty chunk after each period without a message."""
        limit_bytes, begin = self._send_limit_bytes, time.monotonic()
        while True:
            # A caller that does not read poses, but does something else with them, does not receive credit.
            since = max(begin, self._reading_since)
            left_s = timeout_s if since == math.inf else since + timeout_s - time.monotonic()
            wait_s = max(min(self._keep_alive_s, left_s), 0.0)
            with self._changed:
                self._changed.wait_for(lambda: self._is_stopped or is_ready(), None if wait_s > threading.TIMEOUT_MAX else wait_s)
                if self._is_stopped:
                    raise _Stopped
                if is_ready():
                    return
                if self._send_limit_bytes > limit_bytes:  # credit was raised, though not by enough
                    limit_bytes, begin = self._send_limit_bytes, time.monotonic()
                elif left_s <= 0.0:
                    raise DeadlineExceededError(f"the server has granted no credit for {timeout_s:g} s")
            yield track_pb2.TrackRequest(events={})

    def stop(self) -> None:
        """Ends the stream. Thread-safe."""
        self._stop_uplink()
        if self._call is not None:
            self._call.cancel()

    def _stop_uplink(self) -> None:
        with self._changed:
            self._is_stopped = True
            self._changed.notify_all()

    # Downlink.

    def poses(self) -> Iterator[Any]:
        """Yields the messages of the poses that were not delivered before."""
        self._call = self._endpoint.stream(TRACK, self._requests(), track_pb2.TrackResponse,
                                           [("traceparent", self._options.trace.traceparent)])
        if self._is_stopped:  # before there was a call to cancel
            self._call.cancel()
        timer = threading.Timer(self._options.attach_timeout_s, self._time_out)
        timer.daemon = True
        timer.start()
        try:
            response = self._read()
            timer.cancel()
            if response is not None and self._handle_first(response):
                while (response := self._read()) is not None:
                    kind = response.WhichOneof("message")
                    if kind == "pose":
                        if not self._check_pose(response.pose):
                            break
                        if response.pose.pose_seq > self._position.last_pose_seq:
                            self._position.last_pose_seq = response.pose.pose_seq
                            if response.pose.state in WITH_POSE:
                                yield response.pose
                    elif not self._handle(kind, response):
                        break
            if self.error is not None:
                self._call.cancel()
        except BaseException:
            self._call.cancel()
            raise
        finally:
            timer.cancel()
            self._stop_uplink()
        self._conclude()

    def _time_out(self) -> None:
        if not self.was_attached:
            self._timed_out = True
            self._call.cancel()

    def _read(self) -> Any:
        self._reading_since = time.monotonic()
        try:
            return next(self._call)
        except (StopIteration, grpc.RpcError):
            return None
        finally:
            self._reading_since = math.inf

    def _handle_first(self, response: Any) -> bool:
        if response.WhichOneof("message") != "attached":
            return self._malformed("its first message is not `attached`")
        attached = response.attached
        if attached.next_seq == 0:
            return self._malformed("it expects chunk 0")
        if attached.first_pose_seq == 0:
            return self._malformed("it begins with pose 0")
        if attached.max_chunk_bytes < _WORD_BYTES:
            return self._malformed("its chunks have no room for a single word")
        self._feed.start(attached.max_chunk_bytes)
        if self._feed.max_piece_bytes > attached.max_chunk_bytes:
            return self._fail(FailedPreconditionError(
                f"the server takes chunks of at most {attached.max_chunk_bytes} bytes, but those of this session have up to "
                f"{self._feed.max_piece_bytes}: begin with smaller ones, or let the server take more"))
        self.was_attached = True
        self._first_processed_seq = attached.next_seq - 1
        self._take_position(attached)
        with self._changed:
            idle_s = seconds(attached.idle_timeout)
            # The time without a message is less than two periods, which are a third of the server's limit.
            self._keep_alive_s = max(idle_s / 6.0, _SHORTEST_KEEP_ALIVE_S) if idle_s > 0.0 else math.inf
            self._send_limit_bytes = attached.send_limit_bytes
            self._sent_seq = attached.next_seq - 1
            self._attached = attached
            self._changed.notify_all()
        return True

    def _take_position(self, attached: Any) -> None:
        position = self._position
        self._next_pose_seq = attached.first_pose_seq
        if attached.resume_token:
            position.previous_token, position.resume_token = self._options.resume_token, attached.resume_token
        if self._next_pose_seq > position.last_pose_seq + 1:
            lost = PosesLost(position.last_pose_seq + 1, self._next_pose_seq - 1)
            position.lost_poses += lost.last_seq - position.last_pose_seq
            position.last_pose_seq = lost.last_seq
            self._notify(lost)
        self._report_position(True)

    def _check_pose(self, message: Any) -> bool:
        why = defect(message)
        if why:
            return self._malformed(f"pose {message.pose_seq}: {why}")
        if message.pose_seq != self._next_pose_seq:
            return self._malformed(f"pose {message.pose_seq} arrived instead of pose {self._next_pose_seq}")
        if message.object_id not in self._options.object_ids:
            return self._malformed(f"pose {message.pose_seq}: the session has no object {message.object_id[:100]!r}")
        last_us = self._last_t_us.get(message.object_id, -1)
        if message.t_us <= last_us:
            return self._malformed(f"pose {message.pose_seq}: its time, {message.t_us} us, is not after {last_us} us, "
                                   "that of the object's last")
        self._last_t_us[message.object_id] = message.t_us
        self._next_pose_seq += 1
        return True

    def _handle(self, kind: Optional[str], response: Any) -> bool:
        """Returns False, with the cause in `error`, if the server violates the protocol."""
        if self.summary is not None:
            return self._malformed("a message follows the summary")
        if kind == "ack":
            return self._handle_ack(response.ack)
        if kind == "notice":
            return self._handle_notice(response.notice)
        if kind == "attached":
            return self._malformed("it sends `attached` twice")
        if kind == "summary":
            self.summary = response.summary.health
        return True  # a message of a later server is ignored

    def _handle_ack(self, ack: Any) -> bool:
        with self._changed:
            sent_seq = self._sent_seq
            if ack.send_limit_bytes > self._send_limit_bytes:
                self._send_limit_bytes = ack.send_limit_bytes
                self._changed.notify_all()
        if ack.processed_seq > sent_seq:
            return self._malformed(f"it acknowledges chunk {ack.processed_seq}, but the last one sent is {sent_seq}")
        if ack.durable_seq > ack.processed_seq:
            return self._malformed(f"it has stored chunk {ack.durable_seq}, but processed only those up to {ack.processed_seq}")
        self._feed.outbox.release(ack.durable_seq)
        self.made_progress = self.made_progress or ack.processed_seq > self._first_processed_seq
        self._report_position(False)
        return True

    def _handle_notice(self, message: Any) -> bool:
        notice = notice_from_message(message)
        if isinstance(notice, GoAway) and self._options.leaves_on_go_away:
            self._is_leaving = True
            self._stop_uplink()
        if isinstance(notice, TrackingRestarted):
            # The poses after the restart are not ordered with those before, and have the numbers of those that were not stored.
            self._last_t_us.clear()
            if notice.after_pose_seq is not None:
                self._position.last_pose_seq = min(self._position.last_pose_seq, notice.after_pose_seq)
        if notice is not None:
            self._notify(notice)
        return True

    def _notify(self, notice: Notice) -> None:
        if self._callbacks.on_notice is not None:
            self._callbacks.on_notice(notice)

    def _report_position(self, has_new_token: bool) -> None:
        self._position.durable = self._feed.outbox.durable
        self._position.max_piece_bytes = self._feed.max_piece_bytes
        if self._callbacks.on_position is not None:
            self._callbacks.on_position(self._position, has_new_token)

    def _fail(self, error: EvposeError) -> bool:
        self.error, self.is_final = error, True
        return False

    def _malformed(self, what: str) -> bool:
        return self._fail(InternalError(f"the server violates the protocol: {what}"))

    def _conclude(self) -> None:
        if self.error is not None:
            return
        failure = self._uplink_error
        if failure is not None:
            self._fail(failure if isinstance(failure, EvposeError) else DataLossError(f"the source of events fails: {failure}"))
            self.foreign_error = None if isinstance(failure, EvposeError) else failure
        elif self.summary is not None:
            # The summary is the last message: nothing was lost, even if the connection then ended with an error.
            if self.summary.poses + 1 != self._next_pose_seq:
                self._malformed(f"the summary counts {self.summary.poses} poses")
        elif self._timed_out:
            self.error = DeadlineExceededError(f"no response to `attach` within {self._options.attach_timeout_s:g} s")
        else:
            self.error = from_call(self._call, "the stream broke")
            if self.error is None and not self._is_leaving:
                self._malformed("the stream ended without a summary")
