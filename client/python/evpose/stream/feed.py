# SPDX-License-Identifier: Apache-2.0
"""Reads a source of events in a thread, numbers its chunks, and keeps them until the server has made them durable."""

from __future__ import annotations

import threading
import time
from typing import Any, Callable, Iterable, Optional, Union

import numpy as np
import numpy.typing as npt

from evpose.errors import FailedPreconditionError, InvalidArgumentError
from evpose.events import Encoding, FlatEncoder
from evpose.stream.outbox import Chunk, FeedPoint, Outbox, RetainOptions, make_chunk
from evpose.types import Discontinuity, PoseReset
from evpose.v1 import track_pb2

# The items of a source of events: encoded events, arrays of events (FLAT64), and marks between them.
EventItem = Union[bytes, bytearray, memoryview, "npt.NDArray[Any]", PoseReset, Discontinuity]
EventSource = Iterable[EventItem]

# A multiple of the word sizes of all encodings.
_WORD_BYTES = 8
# Bytes that are read ahead of what is sent, unless the source is live.
_READ_AHEAD_BYTES = 1 << 20
# Limit of the resets of the caller that wait for the source to return; bounds memory.
_MAX_PENDING_RESETS = 1000


def _message_of(reset: PoseReset) -> Any:
    return track_pb2.TrackRequest.ResetPose(object_id=reset.object_id, camera_from_object=reset.camera_from_object.to_proto())


class EventFeed:
    """Feeds of the same source with the same size of pieces assign the same numbers to the same bytes."""

    def __init__(self, source: EventSource, encoding: Encoding, size_px: tuple[int, int], memory_bytes: int, is_live: bool,
                 skip: FeedPoint, retain: RetainOptions = RetainOptions(), now: Callable[[], float] = time.monotonic) -> None:
        """`skip`: position up to which the source's chunks are durable: they are read from the start, and only the last ones are
        retained. `is_live`: the source is read during an outage, too."""
        self.outbox = Outbox(memory_bytes, skip, retain, now)
        self.max_piece_bytes = 0  # before start()
        self._source = source
        self._encoding = encoding
        self._encoder = FlatEncoder(*size_px)
        self._read_ahead_bytes = memory_bytes if is_live else _READ_AHEAD_BYTES
        self._skip = skip
        self.failure: Optional[Exception] = None  # of the source, or of its data
        self._point = FeedPoint()
        self._is_after_gap = False
        self._lock = threading.Lock()
        self._pending_resets: list[Any] = []  # messages
        self._has_ended = False

    def start(self, max_piece_bytes: int) -> None:
        """Starts to read. Chunks of the source are divided into pieces of at most `max_piece_bytes`, in whole words. Calls
        after the first have no effect."""
        if self.max_piece_bytes == 0:
            self.max_piece_bytes = max(max_piece_bytes // _WORD_BYTES * _WORD_BYTES, _WORD_BYTES)
            # A source that waits for data cannot be interrupted; its thread must not keep the process.
            threading.Thread(target=self._run, name="evpose-feed", daemon=True).start()

    def reset_pose(self, reset: PoseReset) -> None:
        """Inserts a reset after the chunks that were read so far, as soon as the source returns. Thread-safe. Raises
        InvalidArgumentError for a pose that is none, and FailedPreconditionError if the events have ended, or too many resets wait."""
        message = _message_of(reset)
        with self._lock:
            if self._has_ended:
                raise FailedPreconditionError("the events of the session have ended")
            if len(self._pending_resets) >= _MAX_PENDING_RESETS:
                raise FailedPreconditionError(
                    f"{_MAX_PENDING_RESETS} resets wait for the source of events: call reset_pose() less often")
            self._pending_resets.append(message)

    def _run(self) -> None:
        failure: Optional[Exception] = None
        try:
            is_complete = self._read_all()
        except Exception as error:  # of the source, or of its data: the reader of the outbox raises it
            self.failure = failure = error
            is_complete = True
        if is_complete:
            self.outbox.finish(failure)

    def _read_all(self) -> bool:
        """Returns False if the outbox was closed."""
        items = iter(self._source)
        while self.outbox.wait_for_demand(self._read_ahead_bytes):
            item = next(items, None)
            is_skipping = self._point.seq < self._skip.seq
            if item is None and is_skipping:
                raise FailedPreconditionError(
                    f"the events end after {self._point.bytes} bytes, but the session was fed with at least {self._skip.bytes}: "
                    "these are not the events it was fed with")
            # While chunks are skipped, a reset of the caller has no place in their numbering.
            if not is_skipping and not self._add_pending_resets(item is None):
                return False
            if item is None:
                return True
            if not self._add(item):
                return False
        return False

    def _add_pending_resets(self, is_end: bool) -> bool:
        with self._lock:
            resets, self._pending_resets = self._pending_resets, []
            self._has_ended = is_end
        return all(self._add_reset(message) for message in resets)

    def _add(self, item: EventItem) -> bool:
        if isinstance(item, PoseReset):
            return self._add_reset(_message_of(item))
        if isinstance(item, Discontinuity) or item is Discontinuity:
            self._is_after_gap = True
            return True
        payload = self._encode(item)
        for begin in range(0, len(payload), self.max_piece_bytes):
            chunk = make_chunk(self._point, payload[begin:begin + self.max_piece_bytes], self._is_after_gap)
            self._is_after_gap = False
            if not self._add_chunk(chunk):
                return False
        return True

    def _encode(self, item: Any) -> bytes:
        if isinstance(item, np.ndarray):
            if self._encoding != Encoding.FLAT64:
                raise InvalidArgumentError(
                    f"events: arrays are sent as FLAT64, but the session was created for {self._encoding.name}")
            return self._encoder.encode(item)
        if not isinstance(item, (bytes, bytearray, memoryview)):
            raise InvalidArgumentError(f"events: a source yields bytes, arrays, PoseReset or Discontinuity, not {type(item).__name__}")
        payload = bytes(item)
        if len(payload) % self._encoding.word_bytes:
            raise InvalidArgumentError(f"events: {len(payload)} bytes are not whole words of {self._encoding.name} "
                                       f"({self._encoding.word_bytes} bytes)")
        return payload

    def _add_reset(self, message: Any) -> bool:
        return self._add_chunk(make_chunk(self._point, message.SerializeToString(), reset=message))

    def _add_chunk(self, chunk: Chunk) -> bool:
        self._point = chunk.end
        if chunk.end.seq == self._skip.seq and chunk.end != self._skip:
            raise FailedPreconditionError(
                f"the first {chunk.end.bytes} bytes differ from those that the session was fed with: these are not its events")
        if chunk.end.seq > self._skip.seq:
            return self.outbox.append(chunk)
        self.outbox.add_durable(chunk)
        return True
