# SPDX-License-Identifier: Apache-2.0
"""The servers of a client: the one that a call goes to, and the next one when it is unreachable."""

from __future__ import annotations

import dataclasses
import math
import threading
import time
from typing import Any, Callable, Generator, Iterator, Optional, Sequence, TypeVar

import grpc

from evpose.channel import Endpoint
from evpose.errors import CancelledError, EvposeError, from_call
from evpose.stream.retry import Advice, Backoff, Clock, RetryOptions, advise_on

_Result = TypeVar("_Result")

# Attempts at each server without a response, after which a call fails.
MAX_ROUNDS = 3
# Seconds to wait for a lost connection if another server can be tried next, and if there is only one server. gRPC tries to connect about
# once a second.
CONNECTION_WAIT_S = 0.1
ONLY_CONNECTION_WAIT_S = 2.0
# Codes of errors that may concern one server only: the same call may succeed at another server.
_UNREACHABLE_CODES = frozenset(("UNAVAILABLE", "CANCELLED", "UNKNOWN", "INTERNAL"))
# Reasons of RESOURCE_EXHAUSTED that are about one server. The quota of a tenant is not: the caller can delete a session.
_FULL_REASONS = frozenset(("OVERLOADED", "TOO_MANY_SESSIONS", "SESSION_MEMORY", "OUT_OF_MEMORY"))


def close_generator(generator: Generator[Any, None, None]) -> None:
    """Closes a generator whose call has been cancelled. If another thread runs it, the cancelled call ends it there."""
    try:
        generator.close()
    except ValueError:  # Python: generator already executing
        pass


class WatchCall:
    """The present call of a watcher. close() ends it, from any thread, and no other one begins."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._call: Any = None
        self.closed = threading.Event()

    def begin(self, call: Any) -> None:
        """Takes a new call, which is cancelled at once after close()."""
        with self._lock:
            self._call = call
            if self.closed.is_set():
                call.cancel()

    def close(self) -> None:
        """Cancels the call."""
        with self._lock:
            self.closed.set()
            if self._call is not None:
                self._call.cancel()


@dataclasses.dataclass
class Servers:
    """The servers of a client. `current` is the index of the one to which calls go."""

    endpoints: Sequence[Endpoint]
    outlive_sessions: bool  # sessions are in a persistent store
    current: int = 0
    clock: Clock = dataclasses.field(default_factory=Clock)
    closed: threading.Event = dataclasses.field(default_factory=threading.Event)  # set by the client's close(), which ends all waits

    def connect_again(self, index: int, stop: Optional[threading.Event] = None) -> None:
        """Waits a moment, or until `stop`, for the connection to this server if a call found it unreachable."""
        longest_s = ONLY_CONNECTION_WAIT_S if len(self.endpoints) == 1 else CONNECTION_WAIT_S
        self.endpoints[index].connect_again(longest_s, stop or self.closed)

    def at_any(self, call: Callable[[Endpoint, float], _Result], timeout_s: float, *, skips_full: bool = False) -> _Result:
        """Returns `call(endpoint, timeout_s)` at the current server, and at the next ones while a server is unreachable or, with
        `skips_full`, has no room for a session; the attempts share the time. A call that has reached a server may be made again, so that
        it must have the same effect as one call. Raises EvposeError."""
        choice = ServerChoice(self, skips_full)
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                result = call(choice.endpoint, max(deadline - time.monotonic(), 0.001))
            except EvposeError as error:
                if choice.next(error):
                    continue
                raise choice.final(error) from None
            choice.responded()
            return result

    def where_room_is(self, call: Callable[[Endpoint, float], _Result], timeout_s: float, max_wait_s: float) -> _Result:
        """Returns the result of at_any() at a server with room for a session. If no server has room, makes the call again after the
        shortest delay of RetryInfo, as long as these delays end within `max_wait_s` seconds from the start. `timeout_s` is the limit for
        the calls between two delays. Raises EvposeError, the last refusal among others."""
        begin, backoff, num_waits = self.clock.now(), Backoff(RetryOptions()), 0
        while True:
            try:
                return self.at_any(call, timeout_s, skips_full=True)
            except EvposeError as error:
                if not _is_full(error) or error.retry_in_s == 0.0:
                    raise
                delay_s, waited_s = max(backoff.next(), error.retry_in_s), self.clock.now() - begin
                if waited_s + delay_s > max_wait_s:
                    if num_waits == 0:
                        raise
                    raise error.with_message(f"{error.message}; gave up after {num_waits} more tries in {waited_s:.1f} s") from None
            if not self.clock.wait(delay_s, self.closed):
                raise CancelledError(f"{self.endpoints[self.current].name}: the client was closed")
            num_waits += 1

    def call(self, method: str, request: Any, response: Any, timeout_s: float) -> Any:
        """Makes a call with one request and one response at any server: see at_any(). Raises EvposeError."""
        def make(endpoint: Endpoint, left_s: float) -> Any:
            return endpoint.call(method, request, response, left_s)

        return self.at_any(make, timeout_s)

    def watch(self, method: str, request: Any, response: Any, watch_call: Optional[WatchCall] = None) -> Generator[Any, None, None]:
        """Yields the responses until the session has ended, also after it has moved to another server or its server is unreachable: the
        present `request` is sent again. Raises EvposeError; CancelledError after `watch_call.close()`."""
        choice, backoff = ServerChoice(self), Backoff(RetryOptions())
        watch_call = watch_call or WatchCall()
        while True:
            call = choice.endpoint.watch(method, request, response)
            watch_call.begin(call)
            try:
                for message in _responses(call):
                    choice.responded()
                    backoff.reset()
                    yield message
            finally:
                call.cancel()
            error = from_call(call, choice.endpoint.name)
            if error is None:
                return
            if watch_call.closed.is_set():
                raise CancelledError(f"{choice.endpoint.name}: the watcher was closed")
            if choice.next(error):
                continue
            if error.reason != "FENCED" and (error.code, error.reason) != ("UNAVAILABLE", "ROLLED_BACK"):
                raise choice.final(error)
            # The session's new server may not be known yet, or the store may name this one again.
            self.clock.wait(backoff.next(), self.closed)


def _responses(call: Any) -> Iterator[Any]:
    try:
        yield from call
    except grpc.RpcError:
        return


def is_unreachable(error: EvposeError) -> bool:
    """Whether the server cannot be reached, shuts down or has lost its store, so that another one may respond."""
    return error.code in _UNREACHABLE_CODES and error.reason != "ROLLED_BACK" and advise_on(error) is Advice.TRY_AGAIN


def _is_full(error: EvposeError) -> bool:
    """Whether a server has refused a new session because it has no room for it, so that another server may create it."""
    return error.code == "RESOURCE_EXHAUSTED" and error.reason in _FULL_REASONS


class ServerChoice:
    """The servers that one call is made to, in turn, from the current one on. Used by one thread. With `skips_full`, a call goes to the
    next server also if this one has no room for a session, and a call to a server that has refused an earlier one has a new connection."""

    def __init__(self, servers: Servers, skips_full: bool = False) -> None:
        self._servers = servers
        self._skips_full = skips_full
        self._refusal: Optional[EvposeError] = None  # the last one by a full server
        self._num_refusals = 0  # by full servers, and afterwards by those without the model
        self._retry_in_s = math.inf  # the shortest delay of RetryInfo of the full servers
        self._index = servers.current
        self._num_failed = 0  # attempts since the last response
        self._backoff = Backoff(RetryOptions())
        self._prepare()

    @property
    def endpoint(self) -> Endpoint:
        """The server of the next attempt."""
        return self._servers.endpoints[self._index]

    def responded(self) -> None:
        """Informs the object of a response of the server."""
        # Without a failure the other calls stay where they are: a model may be known to their server alone.
        if self._num_failed > 0 or self._num_refusals > 0:
            self._servers.current = self._index
        self._num_failed = 0
        self._backoff.reset()

    def next(self, error: EvposeError) -> bool:
        """Chooses the next server if `error` means that this server is unreachable. Each server is tried once without delay, then
        again after growing delays. Returns False if the call is not to be repeated, also when each server has been tried and one of them
        was full. If a full server has refused the session, NOT_FOUND for the model from a later server is treated like a refusal."""
        if self._is_refusal(error):
            return self._next_with_room(error)
        if not is_unreachable(error):
            self.responded()
            return False
        self.endpoint.mark_unreachable()
        count = len(self._servers.endpoints)
        if count == 1:
            return False
        self._num_failed += 1
        if self._num_failed == MAX_ROUNDS * count:
            return False
        self._index = (self._index + 1) % count
        if self._num_failed % count == 0:
            self._servers.clock.wait(self._backoff.next(), self._servers.closed)
        self._servers.connect_again(self._index)
        return True

    def _is_refusal(self, error: EvposeError) -> bool:
        return self._skips_full and (_is_full(error) or (self._refusal is not None and error.code == "NOT_FOUND"))

    def _next_with_room(self, refusal: EvposeError) -> bool:
        if _is_full(refusal):
            self._refusal = refusal
            self.endpoint.note_refusal()
        if refusal.retry_in_s > 0.0:
            self._retry_in_s = min(self._retry_in_s, refusal.retry_in_s)
        self._num_refusals += 1
        count = len(self._servers.endpoints)
        if self._num_refusals + self._num_failed >= count:  # each has been tried
            return False
        self._index = (self._index + 1) % count
        self._prepare()
        return True

    def _prepare(self) -> None:
        if self._skips_full:
            self.endpoint.leave_after_refusal(self._servers.closed)
        self._servers.connect_again(self._index)

    def final(self, error: EvposeError) -> EvposeError:
        """Returns the error of a call that is not repeated, with the servers that were tried: the refusal of a full server if there was
        one and the last server does not know the model, because the full one may accept the session later. `retry_in_s` is the shortest
        delay of the full servers."""
        count = len(self._servers.endpoints)
        names = ", ".join(endpoint.name for endpoint in self._servers.endpoints)
        if count > 1 and self._refusal is not None and self._is_refusal(error):
            other = "" if _is_full(error) else f"; {error.message}"
            refusal = self._refusal.with_message(f"{self._refusal.message}; none of the servers {names} accepts the session{other}")
            refusal.retry_in_s = self._retry_in_s if math.isfinite(self._retry_in_s) else 0.0
            return refusal
        if count == 1 or self._num_failed < MAX_ROUNDS * count:
            return error
        return error.with_message(f"{error.message}; {MAX_ROUNDS} attempts each at {names}")
