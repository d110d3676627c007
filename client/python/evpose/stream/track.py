# SPDX-License-Identifier: Apache-2.0
"""A stream of events and poses that is re-established until the summary arrives."""

from __future__ import annotations

import dataclasses
import math
import threading
from typing import Any, Callable, Generator, Optional, Sequence

import numpy.typing as npt

from evpose.channel import Endpoint
from evpose.convert import health_from_message
from evpose.errors import CancelledError, EvposeError, FailedPreconditionError, InvalidArgumentError, UnavailableError
from evpose.poses import Pose, pose_from_message, poses_from_messages
from evpose.stream.attempt import AttemptOptions, Callbacks, StreamAttempt, TrackPosition
from evpose.stream.feed import EventFeed
from evpose.stream.outbox import RetainOptions
from evpose.stream.retry import Advice, Backoff, Clock, RetryOptions, advise_on
from evpose.stream.servers import Servers, close_generator, is_unreachable
from evpose.tracing import StreamTrace, new_stream
from evpose.types import ConnectionChange, Notice, PoseReset, TrackSummary

# Attempts after which a damaged chunk is regarded as damaged at its source, not by the link.
_MAX_DAMAGED_TRIES = 5
# More attaches than a store with a stale replica loses.
_MAX_OLDER_TOKENS = 8


@dataclasses.dataclass
class TrackOptions:
    """How a stream is kept.

    retry              when a broken stream is tried again
    memory_bytes       limit of the chunks that wait for the server, or that it may request again; beyond it, the source waits
    is_live            the source is read during an outage, too, up to memory_bytes
    retain             how long chunks are kept after they have become durable, beside memory_bytes
    attach_timeout_s   longest wait for the response to an attach; a server that accepts the call responds at once
    on_notice, on_connection, on_position   called in the thread that reads the poses, in the order of the server's messages.
                       on_position(position, has_new_token) comes after each ack, and with a new token before a message that
                       invalidates the previous one. An exception ends the stream.
    """

    retry: RetryOptions = RetryOptions()
    memory_bytes: int = 64 << 20
    is_live: bool = False
    retain: RetainOptions = RetainOptions()
    attach_timeout_s: float = 10.0
    on_notice: Optional[Callable[[Notice], None]] = None
    on_connection: Optional[Callable[[ConnectionChange], None]] = None
    on_position: Optional[Callable[[TrackPosition, bool], None]] = None

    def __post_init__(self) -> None:
        if not self.memory_bytes > 0:
            raise InvalidArgumentError("memory_bytes must be positive")
        if not self.attach_timeout_s > 0.0:
            raise InvalidArgumentError("attach_timeout_s must be positive")


class Track:
    """The poses of a session while its events are sent: iterate over it, or call read_all(). Made by Session.track().

    The events are sent while poses are read. A broken stream is re-established: no event is lost, no pose is delivered twice,
    and the poses are those of an undisturbed stream. Raises the last error of the server, or the exception of the source.
    One thread reads; reset_pose() and close() may be called by any.
    """

    def __init__(self, servers: Servers, object_ids: Sequence[str], position: TrackPosition, feed: EventFeed, options: TrackOptions,
                 clock: Optional[Clock] = None) -> None:
        self.summary: Optional[TrackSummary] = None  # after the last pose
        self.position = dataclasses.replace(position)  # the caller keeps its own
        self._servers = servers
        self._index = servers.current  # the server of this stream; other calls change the current one, too
        self._object_ids = object_ids
        self._feed = feed
        self._options = options
        self._clock = clock or Clock()
        self._backoff = Backoff(options.retry)
        self._stop = threading.Event()
        self._attempt: Optional[StreamAttempt] = None
        self._trace = StreamTrace()  # of the last attempt
        self._fed_bytes = 0
        self._attached_at = 0.0
        self._away_since: Optional[float] = None
        self._tries = 0  # in this outage
        self._num_servers_without_session = 0  # consecutive
        self._damaged_tries = 0  # consecutive
        self._auth_token = ""  # at the start of the last attempt
        # Earlier tokens, the latest first. A store that has lost the last attaches knows one of these.
        self._older_tokens: list[str] = []
        self._tokens: list[str] = []  # those of the present attempt: the current one, the previous one, and older ones
        self._token_age = 0  # index of the token of the next attempt
        self._attaches_from_first_pose = False
        self._messages = self._run()

    def __iter__(self) -> Track:
        return self

    def __next__(self) -> Pose:
        return pose_from_message(next(self._messages))

    def read_all(self) -> npt.NDArray[Any]:
        """Returns the poses up to the end as an array of POSE_DTYPE, shape (n,)."""
        return poses_from_messages(self._messages, self._object_ids)

    def reset_pose(self, reset: PoseReset) -> None:
        """Restarts the tracking of an object from a pose, after the events that were read from the source so far. A source that
        must decide the exact place yields the PoseReset instead. Raises InvalidArgumentError and FailedPreconditionError."""
        if reset.object_id not in self._object_ids:
            raise InvalidArgumentError(f"{self.position.session}: has no object {reset.object_id!r}")
        if self._stop.is_set():
            raise FailedPreconditionError(f"{self.position.session}: the stream was closed")
        self._feed.reset_pose(reset)

    def close(self) -> None:
        """Ends the stream. Unless it had ended, the session can be continued from `position`."""
        self._stop.set()
        attempt = self._attempt
        if attempt is not None:
            attempt.stop()
        self._feed.outbox.close()
        close_generator(self._messages)

    def __enter__(self) -> Track:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> Generator[Any, None, None]:
        try:
            while True:
                self._attempt = attempt = self._make_attempt()
                if self._stop.is_set():
                    raise CancelledError("cancelled")
                yield from attempt.poses()
                self._observe(attempt)
                if attempt.summary is not None and attempt.error is None:
                    self._finish(attempt.summary)
                    return
                self._prepare_next(attempt)
        finally:
            self._feed.outbox.close()

    def _prepare_next(self, attempt: StreamAttempt) -> None:
        """Returns when the next attempt is due; raises the error if there is none."""
        error = attempt.error
        if attempt.foreign_error is not None:
            raise attempt.foreign_error
        if self._stop.is_set():
            raise self._with_progress(CancelledError("cancelled"))
        # The next attempt tells the server, and by it all readers, that the session has ended.
        must_report_loss = error is not None and error.reason == "ROLLED_BACK" and not attempt.stated_first_seq
        if attempt.is_final and must_report_loss:
            return
        if attempt.is_final or not self._plan(attempt) or not self._wait_for_next_try(error):
            if self._stop.is_set() and not attempt.is_final:
                error = CancelledError("cancelled")
            raise self._with_progress(error or UnavailableError("the server shuts down"))

    def _finish(self, health: Any) -> None:
        last = self._feed.outbox.last
        self.summary = TrackSummary(
            health=health_from_message(health), sent_bytes=last.bytes, sent_chunks=last.seq,
            poses=self.position.last_pose_seq - self.position.lost_poses, lost_poses=self.position.lost_poses, trace=self._trace)

    @property
    def _server(self) -> Endpoint:
        return self._servers.endpoints[self._index]

    def _make_attempt(self) -> StreamAttempt:
        position, retry = self.position, self._options.retry
        self._server.leave_after_refusal(self._stop)
        self._servers.connect_again(self._index, self._stop)
        self._auth_token = self._server.token.get()
        self._tokens = [token for token in (position.resume_token, position.previous_token) if token] + self._older_tokens
        self._trace = new_stream(position.session)
        options = AttemptOptions(
            resume_token=self._tokens[self._token_age],
            attach_after_pose=0 if self._attaches_from_first_pose else position.last_pose_seq,
            leaves_on_go_away=retry.max_outage_s > 0.0 and (self._servers.outlive_sessions or len(self._servers.endpoints) > 1),
            # A server without credit is an outage. Without retries, nothing limits the duration of one.
            credit_timeout_s=retry.max_outage_s if retry.max_outage_s > 0.0 else math.inf,
            attach_timeout_s=self._options.attach_timeout_s, object_ids=self._object_ids, trace=self._trace)
        return StreamAttempt(self._server, position, self._feed, Callbacks(self._options.on_notice, self._on_position), options)

    def _on_position(self, position: TrackPosition, has_new_token: bool) -> None:
        if has_new_token:
            self._servers.current = self._index
            self._attached_at = self._clock.now()
            if self._away_since is not None:
                self._report(ConnectionChange(
                    is_disconnected=False, server=self._server.name, cause=None, outage_s=self._clock.now() - self._away_since,
                    next_try_in_s=0.0, kept_bytes=0))
        if self._options.on_position is not None:
            self._options.on_position(dataclasses.replace(position), has_new_token)

    def _observe(self, attempt: StreamAttempt) -> None:
        now = self._clock.now()
        if attempt.error is not None and is_unreachable(attempt.error):
            self._server.mark_unreachable()
        if attempt.error is not None and attempt.error.code == "RESOURCE_EXHAUSTED" and not attempt.was_attached:
            self._server.note_refusal()
        self._fed_bytes = max(self._fed_bytes, attempt.fed_bytes)
        if attempt.was_attached:
            self._token_age, self._attaches_from_first_pose = 0, False
            newest = (self.position.resume_token, self.position.previous_token)
            self._older_tokens = [token for token in self._tokens if token not in newest][:_MAX_OLDER_TOKENS]
            self._num_servers_without_session = 0
        # The outage began at the end of the last stream that made progress.
        has_lasted = attempt.was_attached and now - self._attached_at >= self._options.retry.max_delay_s
        if attempt.made_progress or has_lasted:
            self._backoff.reset()
            self._damaged_tries = 0
            self._away_since = None
        if self._away_since is None:
            self._away_since = now
            self._tries = 0

    def _plan(self, attempt: StreamAttempt) -> bool:
        """Adapts the next attempt to the error; returns False if the error is final."""
        error = attempt.error
        if error is None or self._options.retry.max_outage_s == 0.0:
            return error is None
        advice = advise_on(error)
        if advice is Advice.TRY_AGAIN:
            self._num_servers_without_session = 0
            if error.code == "DATA_LOSS":
                self._damaged_tries += 1
                return self._damaged_tries < _MAX_DAMAGED_TRIES
            return True
        if advice is Advice.TRY_OTHER_SERVER:
            self._num_servers_without_session += 1
            return self._num_servers_without_session < len(self._servers.endpoints)
        if advice is Advice.TRY_OTHER_TOKEN:
            self._token_age += 1
            return self._token_age < len(self._tokens)
        if advice is Advice.TRY_OTHER_AUTH_TOKEN:
            return self._server.token.is_renewed and self._server.token.get() != self._auth_token
        if advice is Advice.ATTACH_FROM_FIRST_POSE and not self._attaches_from_first_pose:
            self._attaches_from_first_pose = True
            return True
        return False

    def _wait_for_next_try(self, cause: Optional[EvposeError]) -> bool:
        """Returns False if the outage has lasted too long, or the stream was closed."""
        now = self._clock.now()
        away_since = now if self._away_since is None else self._away_since
        is_same_server = self._token_age > 0 or self._attaches_from_first_pose
        # Each server is tried once without delay. A server that shuts down may be back soon.
        is_at_once = is_same_server or self._tries + 1 < len(self._servers.endpoints) or (cause is None and self._tries == 0)
        delay_s = 0.0 if is_at_once else max(self._backoff.next(), cause.retry_in_s if cause else 0.0)
        if now + delay_s - away_since > self._options.retry.max_outage_s:
            return False
        self._tries += 1
        if not is_same_server:
            self._index = (self._index + 1) % len(self._servers.endpoints)
        self._report(ConnectionChange(is_disconnected=True, server=self._server.name, cause=cause, outage_s=now - away_since,
                                      next_try_in_s=delay_s, kept_bytes=0))
        return self._clock.wait(delay_s, self._stop)

    def _report(self, change: ConnectionChange) -> None:
        if self._options.on_connection is not None:
            self._options.on_connection(dataclasses.replace(change, kept_bytes=self._feed.outbox.kept_bytes, trace=self._trace))

    def _with_progress(self, error: EvposeError) -> EvposeError:
        poses = self.position.last_pose_seq - self.position.lost_poses
        place = "" if error is self._feed.failure else f"{self._server.name}: "
        text = f"{place}{error.message} (after {self._fed_bytes} bytes sent, {poses} poses received)"
        if self._tries > 0 and self._away_since is not None:
            text += f"; gave up after {self._tries} more tries in {self._clock.now() - self._away_since:.1f} s"
        if self._trace.span_id:
            text += f"; {self._trace}"
        return error.with_message(text)
