# SPDX-License-Identifier: Apache-2.0
"""The servers of a client: the one that a call goes to, and the next one when it is away."""

from __future__ import annotations

import dataclasses
import threading
import time
from typing import Any, Callable, Generator, Iterator, Sequence, TypeVar

import grpc

from evpose.channel import Endpoint
from evpose.errors import EvposeError, from_call
from evpose.stream.retry import Advice, Backoff, Clock, RetryOptions, advise_on

_Result = TypeVar("_Result")

# Attempts at each server without a response, after which a call fails.
MAX_ROUNDS = 3
# Codes of errors that may say something of the server alone.
_AWAY_CODES = frozenset(("UNAVAILABLE", "CANCELLED", "UNKNOWN", "INTERNAL"))


@dataclasses.dataclass
class Servers:
    """The servers of a client. `current` is the index of the one to which calls go."""

    endpoints: Sequence[Endpoint]
    outlive_sessions: bool  # sessions are in a persistent store
    current: int = 0
    clock: Clock = dataclasses.field(default_factory=Clock)

    def at_any(self, call: Callable[[Endpoint, float], _Result], timeout_s: float) -> _Result:
        """Returns `call(endpoint, timeout_s)` at the current server, and at the next ones while a server is away; the attempts share the
        time. A call that has reached a server may be made again, so that it must have the same effect as one call. Raises EvposeError."""
        deadline = time.monotonic() + timeout_s
        choice = ServerChoice(self)
        while True:
            try:
                result = call(choice.endpoint, max(deadline - time.monotonic(), 0.001))
            except EvposeError as error:
                if choice.next(error):
                    continue
                raise choice.final(error) from None
            choice.responded()
            return result

    def call(self, method: str, request: Any, response: Any, timeout_s: float) -> Any:
        """Makes a call with one request and one response at any server: see at_any(). Raises EvposeError."""
        def make(endpoint: Endpoint, left_s: float) -> Any:
            return endpoint.call(method, request, response, left_s)

        return self.at_any(make, timeout_s)

    def watch(self, method: str, request: Any, response: Any) -> Generator[Any, None, None]:
        """Yields the responses until the session has ended, also after it has moved to another server or its server is away: the present
        `request` is sent again. Raises EvposeError."""
        choice, backoff = ServerChoice(self), Backoff(RetryOptions())
        while True:
            call = choice.endpoint.watch(method, request, response)
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
            if choice.next(error):
                continue
            if error.reason != "FENCED" and (error.code, error.reason) != ("UNAVAILABLE", "ROLLED_BACK"):
                raise choice.final(error)
            # The session's new server may not be known yet, or the store may name this one again.
            self.clock.wait(backoff.next(), threading.Event())


def _responses(call: Any) -> Iterator[Any]:
    try:
        yield from call
    except grpc.RpcError:
        return


def _is_away(error: EvposeError) -> bool:
    """Whether the server cannot be reached, shuts down or has lost its store, so that another one may respond."""
    return error.code in _AWAY_CODES and error.reason != "ROLLED_BACK" and advise_on(error) is Advice.TRY_AGAIN


class ServerChoice:
    """The servers that one call is made to, in turn, from the current one on. Used by one thread."""

    def __init__(self, servers: Servers) -> None:
        self._servers = servers
        self._index = servers.current
        self._num_failed = 0  # attempts since the last response
        self._backoff = Backoff(RetryOptions())

    @property
    def endpoint(self) -> Endpoint:
        """The server of the next attempt."""
        return self._servers.endpoints[self._index]

    def responded(self) -> None:
        """Informs the object of a response of the server."""
        # Without a failure the other calls stay where they are: a model may be known to their server alone.
        if self._num_failed > 0:
            self._servers.current = self._index
        self._num_failed = 0
        self._backoff.reset()

    def next(self, error: EvposeError) -> bool:
        """Chooses the next server if this one is away. Each server is tried once without delay, then again after growing delays. Returns
        False if the call is not to be repeated."""
        if not _is_away(error):
            self.responded()
            return False
        count = len(self._servers.endpoints)
        if count == 1:
            return False
        self._num_failed += 1
        if self._num_failed == MAX_ROUNDS * count:
            return False
        self._index = (self._index + 1) % count
        if self._num_failed % count == 0:
            self._servers.clock.wait(self._backoff.next(), threading.Event())
        return True

    def final(self, error: EvposeError) -> EvposeError:
        """Returns the error of a call that is not repeated, with the servers that were tried."""
        if self._num_failed < MAX_ROUNDS * len(self._servers.endpoints):
            return error
        names = ", ".join(endpoint.name for endpoint in self._servers.endpoints)
        return error.with_message(f"{error.message}; {MAX_ROUNDS} attempts each at {names}")
