# SPDX-License-Identifier: Apache-2.0
"""Chunks that the server may still request."""

from __future__ import annotations

import collections
import struct
import threading
from typing import Any, NamedTuple, Optional

import crc32c

from evpose.errors import DataLossError, FailedPreconditionError

# Approximate memory of a chunk in addition to its payload.
_OVERHEAD_BYTES = 512


class FeedPoint(NamedTuple):
    """A position between two chunks of a session. Resets are numbered together with chunks. Two positions are equal if the
    same bytes were sent up to there."""

    seq: int = 0  # number of the chunk before it; 0: the start
    bytes: int = 0  # payload up to it
    digest: int = 0  # CRC-32C over the previous digest and the chunk's own CRC-32C


class Chunk(NamedTuple):
    """A numbered piece of the stream: encoded events, or a reset of a pose (a message of the API)."""

    end: FeedPoint
    payload: bytes
    crc: int
    discontinuity: bool = False
    reset: Any = None


def make_chunk(point: FeedPoint, payload: bytes, discontinuity: bool = False, reset: Any = None) -> Chunk:
    """Returns the chunk after `point`. The payload of a reset is its message without the number."""
    crc = crc32c.crc32c(payload)
    digest = crc32c.crc32c(struct.pack("<II", point.digest, crc))
    size = 0 if reset is not None else len(payload)
    return Chunk(FeedPoint(point.seq + 1, point.bytes + size, digest), payload, crc, discontinuity, reset)


class Outbox:
    """One thread appends, one reads, and any forgets. `changed` is notified of every change, and guards all of it."""

    def __init__(self, memory_bytes: int, begin: FeedPoint) -> None:
        self.changed = threading.Condition()
        self.is_closed = False  # nobody reads any more
        self._memory_bytes = memory_bytes
        self._chunks: collections.deque[Chunk] = collections.deque()
        self._size = 0
        self._last = begin
        self._durable = begin
        self._durable_seq = begin.seq
        self._asked_bytes = begin.bytes
        self._wanted_seq = 0
        self._is_finished = False
        self._failure: Optional[Exception] = None

    def wait_for_demand(self, num_bytes: int) -> bool:
        """Waits until get() has fewer than `num_bytes` left to return or waits itself. False: the outbox was closed."""
        def is_demanded() -> bool:
            return self.is_closed or self._wanted_seq > self._last.seq or self._last.bytes - self._asked_bytes < num_bytes

        with self.changed:
            self.changed.wait_for(is_demanded)
            return not self.is_closed

    def append(self, chunk: Chunk) -> bool:
        """Waits while the outbox is full; a chunk that exceeds it is accepted when it is the only one. False: closed."""
        size = len(chunk.payload) + _OVERHEAD_BYTES
        with self.changed:
            self.changed.wait_for(lambda: self.is_closed or not self._chunks or self._size + size <= self._memory_bytes)
            if self.is_closed:
                return False
            self._chunks.append(chunk)
            self._size += size
            self._last = chunk.end
            self._drop_durable()
            self.changed.notify_all()
            return True

    def finish(self, failure: Optional[Exception]) -> None:
        """Marks the end of the feed, after an error with its cause."""
        with self.changed:
            self._is_finished, self._failure = True, failure
            self.changed.notify_all()

    def close(self) -> None:
        with self.changed:
            self.is_closed = True
            self.changed.notify_all()

    def has(self, seq: int) -> bool:
        """Whether get(seq) returns at once. Requires `changed`."""
        if self._wanted_seq != seq:
            self._wanted_seq = seq
            self.changed.notify_all()
        return seq <= self._last.seq or self._is_finished

    def get(self, seq: int) -> Optional[Chunk]:
        """Returns the chunk with this number, for which has() is true; None at the end. Raises the cause of the feed's end,
        DataLossError for a forgotten chunk, and FailedPreconditionError for a number beyond the end. Requires `changed`."""
        self._wanted_seq = 0
        if seq > self._last.seq:
            if self._failure is not None:
                raise self._failure
            if seq == self._last.seq + 1:
                return None
            raise FailedPreconditionError(f"the server has {seq - 1} chunks of this session, but there are {self._last.seq} only: "
                                          "these are not the events it was fed with")
        first = self._chunks[0].end.seq if self._chunks else self._last.seq + 1
        if seq < first:
            raise DataLossError(f"the server requests chunk {seq} again, which it had reported as durable (up to {first - 1}): "
                                "its store has lost it")
        chunk = self._chunks[seq - first]
        self._asked_bytes = max(self._asked_bytes, chunk.end.bytes)
        self.changed.notify_all()
        return chunk

    def forget(self, durable_seq: int) -> None:
        with self.changed:
            if durable_seq > self._durable_seq:
                self._durable_seq = durable_seq
                self._drop_durable()
                self.changed.notify_all()

    def _drop_durable(self) -> None:
        while self._chunks and self._chunks[0].end.seq <= self._durable_seq:
            chunk = self._chunks.popleft()
            self._durable = chunk.end
            self._size -= len(chunk.payload) + _OVERHEAD_BYTES

    @property
    def durable(self) -> FeedPoint:
        """The position after the last durable chunk."""
        with self.changed:
            return self._durable

    @property
    def last(self) -> FeedPoint:
        """The position after the last appended chunk."""
        with self.changed:
            return self._last

    @property
    def kept_bytes(self) -> int:
        with self.changed:
            return self._last.bytes - min(self._durable.bytes, self._last.bytes)


