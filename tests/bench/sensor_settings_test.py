#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The emulated event rate control and anti-flicker filter and the packets of sensor_settings.py, on words of EVT3 and DAT."""
import unittest

import numpy as np
from sensor_settings import anti_flicker, limit_rate, packets_of, times_us

HEADER = b"% format EVT3;height=480;width=640\n% end\n"


def recording(milliseconds, events_per_ms):
    """Single events and a vector of 12 in each millisecond."""
    words = [0x8000]
    for millisecond in range(milliseconds):
        t_us = 1000 * millisecond
        words += [0x8000 | t_us >> 12, 0x6000 | t_us & 0xFFF, 0x0001]
        words += [0x2000 | column for column in range(events_per_ms - 12)]
        words += [0x3000, 0x4FFF]
    return HEADER + np.array(words, dtype="<u2").tobytes()


def words_of(raw):
    return np.frombuffer(raw[len(HEADER):], dtype="<u2")


def num_events(raw):
    words = words_of(raw)
    return int((words >> 12 == 2).sum()) + sum(int(word & 0xFFF).bit_count() for word in words[words >> 12 == 4])


def dat_of(events):
    """A DAT file of events (t, x, y, p)."""
    records = np.array([(t, p << 28 | y << 14 | x) for t, x, y, p in sorted(events)], dtype=[("t", "<u4"), ("address", "<u4")])
    return b"% Data file\n% Version 2\n\x0c\x08" + records.tobytes()


def flicker(hz, x, duration_us=300_000):
    """Two ON and two OFF events of a pixel in each period."""
    period = 1_000_000 // hz
    return [(begin + step, x, 9, p) for begin in range(0, duration_us, period)
            for step, p in ((0, 1), (100, 1), (period // 2, 0), (period // 2 + 100, 0))]


def times_after_filter(events, begin_us=0):
    header = len(dat_of([]))
    return np.frombuffer(anti_flicker(dat_of(events), begin_us)[header:], dtype="<u4")[::2].tolist()


class SensorSettingsTest(unittest.TestCase):
    def test_the_filter_removes_flicker_of_its_band_from_the_seventh_burst_on(self):
        for hz, is_removed in ((40, False), (100, True), (400, True), (1000, False)):
            times = times_after_filter(flicker(hz, x=9))
            if is_removed:
                self.assertEqual(max(times), 6 * (1_000_000 // hz) - (1_000_000 // hz) // 2 + 100, hz)
            else:
                self.assertEqual(times, sorted(t for t, *_ in flicker(hz, x=9)), hz)

    def test_the_filter_acts_on_a_region_and_ends_with_the_flicker(self):
        edge = [(200_000, 200, 9, 1), (200_100, 200, 9, 1)]  # another region
        later = [(400_000, 9, 9, 1), (400_100, 9, 9, 0)]
        times = times_after_filter(flicker(100, x=9) + edge + later, begin_us=100_000)
        self.assertEqual(times, [200_000, 200_100, 400_000, 400_100])

    def test_the_limit_keeps_its_share_of_each_millisecond(self):
        raw = recording(50, 200)
        self.assertEqual(num_events(raw), 50 * 200)
        limited = limit_rate(raw, 0.05, seed=1)  # 50 events in a millisecond
        self.assertAlmostEqual(num_events(limited) / 50, 50, delta=5)
        self.assertEqual(num_events(limit_rate(raw, 1.0, seed=1)), 50 * 200)

    def test_the_limit_keeps_times_and_rows(self):
        limited = words_of(limit_rate(recording(5, 100), 0.01, seed=1))
        self.assertEqual(int((limited >> 12 == 6).sum()), 5)
        self.assertEqual(int((limited >> 12 == 3).sum()), 5)

    def test_times(self):
        words = words_of(recording(10, 20))
        self.assertEqual(int(times_us(words >> 12, words & 0xFFF)[-1]), 9000)

    def test_packets_are_all_words_by_their_period(self):
        raw = recording(10, 20)
        header, first_us, packets = packets_of(raw, 4000)
        self.assertEqual((header, first_us), (HEADER, 0))
        self.assertEqual([end_us for end_us, _ in packets], [4000, 8000, 12000])
        self.assertEqual(b"".join(data for _, data in packets), raw[len(HEADER):])


if __name__ == "__main__":
    unittest.main()
