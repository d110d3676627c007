# SPDX-License-Identifier: Apache-2.0
"""Chunks that the server may still request."""

from __future__ import annotations

import collections
import dataclasses
import struct
import threading
import time
from typing import Any, Callable, NamedTuple, Optional

import crc32c

from evpose.errors import DataLossError, FailedPreconditionError, InvalidArgumentError

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


def _size_between(seq: int, num_bytes: int, point: FeedPoint) -> int:
    """Returns the size of the chunks after chunk `seq`, up to which there are `num_bytes` of payload, up to `point`."""
    return point.bytes - num_bytes + (point.seq - seq) * _OVERHEAD_BYTES


@dataclasses.dataclass(frozen=True)
class RetainOptions:
    """How long chunks are kept after the server has reported them as durable.

    A server that takes over after its store has lost the last writes, because a replica without them was made the master,
    requests them again. When an earlier one is requested, the stream ends with DataLossError and the reason ROLLED_BACK.

    duration_s   from the report; 0: none is kept
    max_bytes    payload, and 512 bytes for each chunk; the earliest chunks are dropped beyond it
    """

    duration_s: float = 5.0
    max_bytes: int = 64 << 20

    def __post_init__(self) -> None:
        if not self.duration_s >= 0.0:
            raise InvalidArgumentError("retain.duration_s must not be negative")
        if not self.max_bytes >= 0:
            raise InvalidArgumentError("retain.max_bytes must not be negative")


class _Mark(NamedTuple):
    """A position up to which the chunks became durable at one time."""

    seq: int
    bytes: int
    durable_at: float


class Outbox:
    """One thread may append, one may read, and any may call release(). `changed` is notified of every change, and guards all of it.

    Durable chunks are retained for a while (RetainOptions), beside `memory_bytes`. Those up to `begin` are durable from the
    beginning, and are added with add_durable().
    """

    def __init__(self, memory_bytes: int, begin: FeedPoint, retain: RetainOptions = RetainOptions(),
                 now: Callable[[], float] = time.monotonic) -> None:
        self.changed = threading.Condition()
        self.is_closed = False  # nobody reads any more
        self._memory_bytes = memory_bytes
        self._retain = retain
        self._now = now
        self._begin = begin
        self._has_reached_begin = begin.seq == 0
        self._retained: collections.deque[Chunk] = collections.deque()  # durable; the numbers of _chunks follow
        self._marks: collections.deque[_Mark] = collections.deque()  # of the retained chunks
        self._released = 0, 0  # number and bytes up to the first retained chunk
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

    def add_durable(self, chunk: Chunk) -> None:
        """Adds a chunk up to `begin`, in the order of the numbers. It is retained if it is close to `begin`."""
        with self.changed:
            start_bytes = chunk.end.bytes - (0 if chunk.reset is not None else len(chunk.payload))
            size = _size_between(chunk.end.seq - 1, start_bytes, self._begin)
            if self._retain.duration_s > 0.0 and size <= self._retain.max_bytes:
                self._retained.append(chunk)
            else:
                self._released = chunk.end.seq, chunk.end.bytes
            self._has_reached_begin = chunk.end.seq >= self._begin.seq
            if self._has_reached_begin:
                self._marks.append(_Mark(chunk.end.seq, chunk.end.bytes, self._now()))
                self._drop_retained()
            self.changed.notify_all()

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
        is_added = self._has_reached_begin or seq > self._begin.seq
        return (seq <= self._last.seq and is_added) or self._is_finished

    def get(self, seq: int) -> Optional[Chunk]:
        """Returns the chunk with this number, for which has() is true; None at the end. Raises the cause of the feed's end,
        DataLossError for a released chunk, and FailedPreconditionError for a number beyond the end. Requires `changed`."""
        self._wanted_seq = 0
        if seq <= self._begin.seq and not self._has_reached_begin and self._failure is not None:
            raise self._failure
        if seq > self._last.seq:
            if self._failure is not None:
                raise self._failure
            if seq == self._last.seq + 1:
                return None
            raise FailedPreconditionError(f"the server has {seq - 1} chunks of this session, but there are {self._last.seq} only: "
                                          "these are not the events it was fed with")
        first = self._first_seq()
        if seq < first:
            raise DataLossError(f"the server requests chunk {seq} again, which it had reported as durable (up to {first - 1}) and "
                                "which is no longer kept: its store has lost it, and the session cannot go on", reason="ROLLED_BACK")
        index = seq - first
        is_retained = index < len(self._retained)
        chunk = self._retained[index] if is_retained else self._chunks[index - len(self._retained)]
        self._asked_bytes = max(self._asked_bytes, chunk.end.bytes)
        self.changed.notify_all()
        return chunk

    def release(self, durable_seq: int) -> None:
        with self.changed:
            if durable_seq > self._durable_seq:
                self._durable_seq = durable_seq
                self._drop_durable()
                self.changed.notify_all()

    def _drop_durable(self) -> None:
        durable_seq = self._durable.seq
        while self._chunks and self._chunks[0].end.seq <= self._durable_seq:
            chunk = self._chunks.popleft()
            self._durable = chunk.end
            self._size -= len(chunk.payload) + _OVERHEAD_BYTES
            self._retained.append(chunk)
        if self._durable.seq > durable_seq:
            self._marks.append(_Mark(self._durable.seq, self._durable.bytes, self._now()))
        self._drop_retained()

    def _drop_retained(self) -> None:
        oldest = self._now() - self._retain.duration_s
        while self._marks and (self._marks[0].durable_at <= oldest
                               or _size_between(*self._released, self._durable) > self._retain.max_bytes):
            mark = self._marks.popleft()
            self._released = mark.seq, mark.bytes
        while self._retained and self._retained[0].end.seq <= self._released[0]:
            self._retained.popleft()

    def _first_seq(self) -> int:
        for chunks in (self._retained, self._chunks):
            if chunks:
                return chunks[0].end.seq
        return self._last.seq + 1

    @property
    def first_seq(self) -> Optional[int]:
        """The first chunk that get() can return; None while chunks up to `begin` are still being added."""
        with self.changed:
            return self._first_seq() if self._has_reached_begin else None

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


