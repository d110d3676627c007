# SPDX-License-Identifier: Apache-2.0
"""event_camera_msgs/EventPacket as chunks for evpose.Session.track(). Without ROS: the messages need only the fields of that type."""

import collections
import threading

import evpose

# A packet whose `seq` is behind the last one by less than this is repeated or overtaken. By more, the publisher has started again.
_MAX_OVERTAKEN = 16


class PacketReader:
    """Checks the packets of one camera, and marks what was lost between them."""

    def __init__(self, width_px, height_px):
        self.num_packets = 0  # accepted
        self.num_lost = 0  # packets, by the gaps of `seq`
        self.num_repeated = 0  # or overtaken: not sent
        self.num_refused = 0  # packets that are no whole words
        self._size_px = (width_px, height_px)
        self._seq = None
        self._is_after_gap = False

    def mark_lost(self):
        """The next packet follows a gap that its `seq` does not show."""
        self._is_after_gap = True

    def note_seq(self, seq):
        """Takes the number of a packet that is dropped instead of passed to chunks(), so that the next packet follows a gap. Returns
        False if the packet is repeated or overtaken, which is no loss."""
        is_new = self._is_new(seq)
        if is_new:
            self.mark_lost()
        return is_new

    def chunks(self, packet):
        """Returns the chunks of a packet: its bytes, after evpose.Discontinuity where events were lost. Raises
        evpose.InvalidArgumentError for a packet that no stream of this camera has."""
        if packet.encoding != "evt3":
            raise evpose.InvalidArgumentError(
                f"encoding {packet.encoding!r}: EventPackets with evt3 are forwarded, as metavision_driver publishes them")
        if (packet.width, packet.height) != self._size_px:
            raise evpose.InvalidArgumentError(
                f"a packet is of {packet.width}x{packet.height} pixels, but the camera file of {self._size_px[0]}x{self._size_px[1]}")
        if not self._is_new(packet.seq):
            return []
        events = bytes(packet.events)
        if len(events) % 2 != 0:
            self.num_refused += 1
            self.mark_lost()
            return []
        if packet.is_bigendian:
            swapped = bytearray(events)
            swapped[0::2], swapped[1::2] = events[1::2], events[0::2]
            events = bytes(swapped)
        self.num_packets += 1
        if not events:
            return []
        marks = [evpose.Discontinuity()] if self._is_after_gap else []
        self._is_after_gap = False
        return [*marks, events]

    def _is_new(self, seq):
        """`seq` counts the packets. A publisher that has restarted begins again, at 0 or near it."""
        last, self._seq = self._seq, seq
        if last is None or seq == last + 1:
            return True
        if seq > last:
            self.num_lost += seq - last - 1
            self.mark_lost()
            return True
        if last - seq < _MAX_OVERTAKEN and seq > 0:
            self._seq = last
            self.num_repeated += 1
            return False
        self.mark_lost()
        return True


class PacketQueue:
    """Takes packets from the thread of ROS, which must not wait, and gives their chunks to the thread that sends. A packet that
    has no room is dropped and counted, and a discontinuity follows."""

    def __init__(self, reader, max_bytes):
        self.reader = reader
        self.num_dropped = 0
        self._max_bytes = max_bytes
        self._bytes = 0
        self._chunks = collections.deque()
        self._changed = threading.Condition()
        self._has_ended = False

    def put(self, packet):
        """Does nothing after end(). Raises evpose.InvalidArgumentError as PacketReader.chunks()."""
        with self._changed:
            if self._has_ended:
                return
            if self._bytes + len(packet.events) > self._max_bytes:
                if self.reader.note_seq(packet.seq):
                    self.num_dropped += 1
                return
            for chunk in self.reader.chunks(packet):
                self._chunks.append(chunk)
                self._bytes += _size(chunk)
            self._changed.notify()

    def end(self):
        """Ends the iteration after the chunks so far."""
        with self._changed:
            self._has_ended = True
            self._changed.notify()

    def __iter__(self):
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._chunks or self._has_ended)
                if not self._chunks:
                    return
                chunk = self._chunks.popleft()
                self._bytes -= _size(chunk)
            yield chunk


def _size(chunk):
    return len(chunk) if isinstance(chunk, bytes) else 0
