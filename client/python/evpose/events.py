# SPDX-License-Identifier: Apache-2.0
"""Events: the encodings of a session, and NumPy arrays of events as FLAT64.

FLAT64 (core/events/README.md, section 1) has a word of 64 bits for each event: time in microseconds, bits 63 to 32;
column, bits 31 to 18; row, bits 17 to 4; polarity, bit 0.
"""

from __future__ import annotations

import enum
from typing import Any

import numpy as np
import numpy.typing as npt

from evpose.errors import InvalidArgumentError

# x and y in pixels, p is 1 for brighter and 0 for darker, t in microseconds. `events_to_bytes` also takes other integer types.
EVENT_DTYPE = np.dtype([("x", np.uint16), ("y", np.uint16), ("p", np.uint8), ("t", np.int64)])

_MAX_SIDE_PX = 1 << 14
# A step of the time that is half the range of the clock or more is ambiguous.
_MAX_STEP_US = (1 << 31) - 1
_CLOCK_RANGE_US = 1 << 32
# Other names of the fields: those of Metavision and OpenEB, dv-processing, ROS messages and the datasets of DSEC.
_FIELDS = {"x": ("x",), "y": ("y",), "p": ("p", "polarity", "on"), "t": ("t", "t_us", "timestamp")}


class Encoding(enum.IntEnum):
    """How bytes encode events, with the numbers of the API."""

    EVT3 = 1
    EVT21 = 2
    EVT2 = 3
    DAT = 4
    FLAT64 = 5

    @property
    def word_bytes(self) -> int:
        """Size of a word. A chunk has whole words."""
        return {Encoding.EVT3: 2, Encoding.EVT2: 4}.get(self, 8)


def _field(events: npt.NDArray[Any], name: str) -> npt.NDArray[np.int64]:
    names = events.dtype.names or ()
    for candidate in _FIELDS[name]:
        if candidate in names:
            values = events[candidate]
            if values.dtype.kind not in "iub":
                raise InvalidArgumentError(
                    f"events: field {candidate!r} has type {values.dtype}; integers are needed (times in microseconds)")
            if values.dtype == np.uint64 and values.size and int(values.max()) > np.iinfo(np.int64).max:
                raise InvalidArgumentError(f"events: field {candidate!r} has {int(values.max())}, which is out of range")
            return values.astype(np.int64)
    raise InvalidArgumentError(f"events: there is no field {' or '.join(_FIELDS[name])}; the array has {', '.join(names) or 'no fields'}")


def _check_side(values: npt.NDArray[np.int64], name: str, limit: int) -> None:
    wrong = np.flatnonzero((values < 0) | (values >= limit))
    if wrong.size:
        i = int(wrong[0])
        raise InvalidArgumentError(f"events: {name} of event {i} is {int(values[i])}, but must lie in [0, {limit - 1}]")


def make_events(x: npt.ArrayLike, y: npt.ArrayLike, p: npt.ArrayLike, t_us: npt.ArrayLike) -> npt.NDArray[Any]:
    """Returns an array of EVENT_DTYPE, shape (n,), of four arrays of shape (n,): columns, rows, polarities (above 0 is
    brighter) and times in microseconds. Raises InvalidArgumentError."""
    columns = [np.asarray(values) for values in (x, y, p, t_us)]
    shapes = {values.shape for values in columns}
    if len(shapes) != 1 or columns[0].ndim != 1:
        raise InvalidArgumentError(f"events: x, y, p and t_us must be vectors of the same length, not of shapes {sorted(shapes)}")
    raw = np.empty(columns[0].size, dtype=[("x", np.int64), ("y", np.int64), ("p", np.int64), ("t", np.int64)])
    for name, values in zip("xypt", columns):
        if values.size and values.dtype.kind not in "iub":
            raise InvalidArgumentError(f"events: {'t_us' if name == 't' else name} has type {values.dtype}; integers are needed")
        raw[name] = values
    _check_side(raw["x"], "x", _MAX_SIDE_PX)
    _check_side(raw["y"], "y", _MAX_SIDE_PX)
    events = np.empty(raw.size, dtype=EVENT_DTYPE)
    for name in "xyt":
        events[name] = raw[name]
    events["p"] = raw["p"] > 0
    return events


class FlatEncoder:
    """Encodes arrays of events of one stream as FLAT64, and checks them.

    width_px, height_px   of the sensor; an event outside it is an error
    """

    def __init__(self, width_px: int = _MAX_SIDE_PX, height_px: int = _MAX_SIDE_PX) -> None:
        self._width_px = min(width_px, _MAX_SIDE_PX)
        self._height_px = min(height_px, _MAX_SIDE_PX)
        self._last_us: int | None = None

    def encode(self, events: npt.NDArray[Any]) -> bytes:
        """Returns the words of a structured array, shape (n,), with fields x, y, p (or polarity, on) and t (or t_us,
        timestamp; microseconds). The order is kept. Raises InvalidArgumentError with the field and the index."""
        if events.ndim != 1:
            raise InvalidArgumentError(f"events: the array has shape {events.shape}; a vector is needed")
        x, y, p, t = (_field(events, name) for name in "xypt")
        if t.size == 0:
            return b""
        _check_side(x, "x", self._width_px)
        _check_side(y, "y", self._height_px)
        self._check_times(t)
        words = (t & (_CLOCK_RANGE_US - 1)).astype(np.uint64) << np.uint64(32)
        words |= ((x << 18) | (y << 4) | (p > 0)).astype(np.uint64)
        return words.astype("<u8", copy=False).tobytes()

    def _check_times(self, t: npt.NDArray[np.int64]) -> None:
        first = int(t[0])
        if self._last_us is None and not 0 <= first < _CLOCK_RANGE_US:
            raise InvalidArgumentError(
                f"events: the first time is {first} us, but must lie in [0, {_CLOCK_RANGE_US - 1}]; subtract the time of the first event")
        steps = np.diff(t, prepend=first if self._last_us is None else self._last_us)
        wrong = np.flatnonzero((steps > _MAX_STEP_US) | (steps < -_MAX_STEP_US))
        if wrong.size:
            i = int(wrong[0])
            raise InvalidArgumentError(
                f"events: the time of event {i} is {int(steps[i])} us after the one before; a step must be below {_MAX_STEP_US + 1} us")
        if int(t.min()) < 0:
            raise InvalidArgumentError(f"events: the time of event {int(t.argmin())} is negative")
        self._last_us = int(t[-1])


def events_to_bytes(events: npt.NDArray[Any]) -> bytes:
    """Encodes one array of events as FLAT64: see FlatEncoder.encode()."""
    return FlatEncoder().encode(events)
