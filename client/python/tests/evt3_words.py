# SPDX-License-Identifier: Apache-2.0
"""Decodes EVT3, for tests that need the events of a recording as an array."""

import numpy as np
from testing import evpose

from evpose.recordings import parse_header

_TIME_LOW, _TIME_HIGH, _ADDR_Y, _ADDR_X, _VECT_BASE_X, _VECT_12, _VECT_8 = 6, 8, 0, 2, 3, 4, 5


def decode_evt3(data):
    """Returns the events of a recording that `evpose simulate` has written: without wraps of the clock, lost or wrong words."""
    words = np.frombuffer(data[parse_header(data).size_bytes:], "<u2").tolist()
    events = []
    high = low = y = base = polarity = 0
    for word in words:
        kind, content = word >> 12, word & 0xFFF
        if kind == _TIME_HIGH:
            if content != high:
                low = 0
            high = content
        elif kind == _TIME_LOW:
            low = content
        elif kind == _ADDR_Y:
            y = content & 0x7FF
        elif kind == _ADDR_X:
            events.append((content & 0x7FF, y, content >> 11, high << 12 | low))
        elif kind == _VECT_BASE_X:
            base, polarity = content & 0x7FF, content >> 11
        elif kind in (_VECT_12, _VECT_8):
            num_columns = 12 if kind == _VECT_12 else 8
            events += [(base + i, y, polarity, high << 12 | low) for i in range(num_columns) if content >> i & 1]
            base += num_columns
    x, y, p, t = zip(*events)
    return evpose.make_events(x, y, p, t)
