# SPDX-License-Identifier: Apache-2.0
"""When a broken stream is tried again, and which errors are final."""

from __future__ import annotations

import dataclasses
import enum
import random
import threading
import time
from typing import Callable, Optional

from evpose.errors import EvposeError, InvalidArgumentError


@dataclasses.dataclass(frozen=True)
class RetryOptions:
    """When a broken stream is tried again.

    max_outage_s    the longest outage that is tolerated, also by a server that grants no credit. 0: a broken stream is not
                    tried again, and credit is waited for without a limit; math.inf: unlimited
    first_delay_s   doubled after each failed attempt
    max_delay_s     limit of the delays
    """

    max_outage_s: float = 120.0
    first_delay_s: float = 0.1
    max_delay_s: float = 5.0

    def __post_init__(self) -> None:
        if not self.max_outage_s >= 0.0:
            raise InvalidArgumentError("max_outage_s must not be negative")
        if not self.first_delay_s > 0.0:
            raise InvalidArgumentError("first_delay_s must be positive")
        if not self.max_delay_s >= self.first_delay_s:
            raise InvalidArgumentError("max_delay_s must be at least first_delay_s")


class Clock:
    """The clock of the machine; tests have another one."""

    def now(self) -> float:
        """Returns a time in seconds that only advances."""
        return time.monotonic()

    def wait(self, seconds: float, stop: threading.Event) -> bool:
        """Returns False if `stop` was set first."""
        return not stop.wait(seconds)


class Backoff:
    """Exponential delays with jitter, so that the clients of a failed server do not reconnect simultaneously."""

    def __init__(self, options: RetryOptions, uniform: Callable[[], float] = random.random) -> None:
        self._options = options
        self._uniform = uniform
        self._delay = options.first_delay_s

    def next(self) -> float:
        """Returns a delay between half of first_delay_s * 2^n and all of it, at most max_delay_s."""
        delay = min(self._delay, self._options.max_delay_s) * (0.5 + 0.5 * self._uniform())
        self._delay = min(2.0 * self._delay, self._options.max_delay_s)
        return delay

    def reset(self) -> None:
        """Begins again with the first delay."""
        self._delay = self._options.first_delay_s


class Advice(enum.Enum):
    """The reaction to the error with which a stream ended."""

    TRY_AGAIN = enum.auto()
    TRY_OTHER_SERVER = enum.auto()  # this server does not have the session; another one may
    TRY_OTHER_TOKEN = enum.auto()  # the server may know the previous token
    TRY_OTHER_AUTH_TOKEN = enum.auto()  # the authentication token may have been replaced
    ATTACH_FROM_FIRST_POSE = enum.auto()  # the server restarted from a checkpoint and has computed fewer poses than were received
    GIVE_UP = enum.auto()


def advise_on(error: EvposeError) -> Advice:
    """Classifies the error with which a Track stream ended, from the server or from the network."""
    by_code: dict[str, Optional[bool]] = {
        "UNAVAILABLE": True,
        "DEADLINE_EXCEEDED": True,
        # Without a reason the error comes from the network or a proxy; with a reason it is final.
        "CANCELLED": not error.reason,
        "UNKNOWN": not error.reason,
        "INTERNAL": not error.reason,
        "ABORTED": error.reason != "FENCED",
        "DATA_LOSS": error.reason == "CRC_MISMATCH",
        "RESOURCE_EXHAUSTED": error.retry_in_s > 0.0,
    }
    if error.code in by_code:
        return Advice.TRY_AGAIN if by_code[error.code] else Advice.GIVE_UP
    if error.code == "NOT_FOUND" and error.reason == "SESSION_NOT_FOUND":
        return Advice.TRY_OTHER_SERVER
    if error.code == "UNAUTHENTICATED":
        # The next attempt reads the token again, which may have been renewed.
        return Advice.TRY_AGAIN if error.reason == "ACCESS_WITHDRAWN" else Advice.TRY_OTHER_AUTH_TOKEN
    if error.code == "PERMISSION_DENIED" and error.reason == "WRONG_TOKEN":
        return Advice.TRY_OTHER_TOKEN
    if error.code == "INVALID_ARGUMENT" and error.field == "attach.last_pose_seq":
        return Advice.ATTACH_FROM_FIRST_POSE
    return Advice.GIVE_UP
