# SPDX-License-Identifier: Apache-2.0
"""The IDs by which the logs of client and servers name a session and its streams (W3C Trace Context)."""

from __future__ import annotations

import dataclasses
import hashlib
import secrets


def trace_id(session: str) -> str:
    """Returns the trace ID of a session: 32 hexadecimal digits, by which the log and the exemplars of the metrics of every server
    name it. It is a digest of the name "sessions/{id}", and does not reveal it."""
    return hashlib.sha256(session.encode()).hexdigest()[:32]


@dataclasses.dataclass(frozen=True)
class StreamTrace:
    """The IDs of one stream of a session.

    trace_id   of the session
    span_id    16 hexadecimal digits, different for each stream
    """

    trace_id: str = ""
    span_id: str = ""

    def __str__(self) -> str:
        return f"trace_id={self.trace_id} span_id={self.span_id}"

    @property
    def traceparent(self) -> str:
        """The value of the header of that name."""
        return f"00-{self.trace_id}-{self.span_id}-01"


def new_stream(session: str) -> StreamTrace:
    """Returns the IDs of a new stream."""
    # An ID of zeros is invalid.
    return StreamTrace(trace_id(session), f"{secrets.randbelow(2**64 - 1) + 1:016x}")
