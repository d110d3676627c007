# SPDX-License-Identifier: Apache-2.0
"""Passes a simulated recording to a program through a pipe, in blocks of sensor time, as a camera does."""
import os
import pathlib
from typing import NamedTuple

import numpy

TIME_HIGH = 0x8  # type of the EVT3 word with bits 12 to 23 of the time
BLOCK_US = 4096


class Block(NamedTuple):
    words: bytes
    end_us: int  # sensor time


def blocks(path):
    """The header of a RAW EVT3 file with the first time word, and its blocks of BLOCK_US."""
    data = pathlib.Path(path).read_bytes()
    begin = data.index(b"% end\n") + len(b"% end\n")
    words = numpy.frombuffer(data[begin:], dtype="<u2")
    at = numpy.flatnonzero(words >> 12 == TIME_HIGH)
    high = (words[at] & 0xFFF).astype(numpy.int64)
    high += 4096 * numpy.cumsum(numpy.concatenate([[0], numpy.diff(high) < 0]))
    first = numpy.flatnonzero(numpy.concatenate([[True], numpy.diff(high) > 0]))  # time words may be repeated
    begins, ends = at[first], numpy.append(at[first][1:], len(words))
    begins[0] += 1
    header = data[: begin + 2 * begins[0]]
    return header, [Block(words[a:b].tobytes(), (int(t) + 1) * BLOCK_US) for a, b, t in zip(begins, ends, high[first])]


class BlockPipe:
    """A pipe into which a recording is written. `start` receives its other end and starts the program that reads it; its result is `reader`.
    Without the header and the first word, which are written before, the program would not begin. A context manager, which closes the pipe."""

    def __init__(self, path, start):
        header, self._blocks = blocks(path)
        self._next = 0
        self.sent_us = None  # sensor time of the end of the last block that was sent
        reading, writing = os.pipe()
        self._pipe = os.fdopen(writing, "wb")
        try:
            self._pipe.write(header)
            self._pipe.flush()
            self.reader = start(reading)
        except BaseException:
            self._pipe.close()
            raise
        finally:
            os.close(reading)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    @property
    def next_end_us(self):
        """The sensor time of the end of the next block; None after the last one."""
        return self._blocks[self._next].end_us if self._next < len(self._blocks) else None

    def send(self):
        """Sends the next block."""
        block = self._blocks[self._next]
        self._next += 1
        self._pipe.write(block.words)
        self._pipe.flush()
        self.sent_us = block.end_us

    def send_until(self, t_us):
        """Sends the blocks that end at this time or before."""
        while self.next_end_us is not None and self.next_end_us <= t_us:
            self.send()

    def send_rest(self):
        """Sends the remaining blocks and closes the pipe."""
        while self.next_end_us is not None:
            self.send()
        self.close()

    def close(self):
        self._pipe.close()
