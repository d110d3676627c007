#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The effect of a camera's settings on tracking, in simulation; deploy/sensors/README.md quotes the table.

Each row is the mean over the objects: event rate, error of the position as a share of the distance, error of the rotation, share of the
time with a good pose. From the true first pose, a VGA camera, 0.3 s each. The event rate control is emulated: the events of each millisecond
beyond the limit are dropped at random. The anti-flicker filter is emulated from its public description (anti_flicker()). --delay instead
measures how long after the motion a pose arrives, by the period of the camera's packets, with a server in real time. Needs a release build;
a few minutes, the delay 20 s.
"""
import argparse
import csv
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import numpy as np

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))
from processes import Server, first_pose, run_evpose, simulate  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]
OBJECTS = ("cube", "book")
SPEED = ("--speed", "2")
TEXTURE = ("--textured-background",)
DURATION_S, SETTLING_S = 0.3, 0.1

# Setting, value, options of the simulation, and what is emulated: the limit of the event rate control in Mev/s, or AFK, the anti-flicker
# filter.
AFK = "anti-flicker"
SETTINGS = [
    ("default", "", (), None),
    ("threshold (bias_diff_on, bias_diff_off)", "0.1", ("--threshold", "0.1"), None),
    ("", "0.5", ("--threshold", "0.5"), None),
    ("", "0.8", ("--threshold", "0.8"), None),
    ("bandwidth (bias_fo)", "300 Hz", ("--bandwidth", "300"), None),
    ("", "1 kHz", ("--bandwidth", "1000"), None),
    ("", "10 kHz", ("--bandwidth", "10000"), None),
    ("refractory time (bias_refr)", "20 us", ("--refractory", "20"), None),
    ("", "1 ms", ("--refractory", "1000"), None),
    ("", "5 ms", ("--refractory", "5000"), None),
    ("noise (low light, bias_hpf)", "1 Hz", ("--background-activity", "1"), None),
    ("", "10 Hz", ("--background-activity", "10"), None),
    ("focus: blur, standard deviation", "0.3 px", ("--lens-blur", "0.3"), None),
    ("", "1 px", ("--lens-blur", "1"), None),
    ("", "2 px", ("--lens-blur", "2"), None),
    ("flicker, no anti-flicker filter: depth", "10 %", ("--flicker", "0.1"), None),
    ("", "30 %", ("--flicker", "0.3"), None),
    ("", "60 %", ("--flicker", "0.6"), None),
    ("anti-flicker filter: depth of the flicker", "0 %", (), AFK),
    ("", "10 %", ("--flicker", "0.1"), AFK),
    ("", "30 %", ("--flicker", "0.3"), AFK),
    ("", "60 %", ("--flicker", "0.6"), AFK),
    ("textured background, event rate control", "off", TEXTURE, None),
    ("", "1 Mev/s", TEXTURE, 1.0),
    ("", "0.3 Mev/s", TEXTURE, 0.3),
    ("", "0.1 Mev/s", TEXTURE, 0.1),
]
HEADER_END = b"% end\n"


def limit_rate(raw, mev_per_s, seed):
    """Returns a RAW file (EVT3) of at most so many events in each millisecond; the others are dropped at random."""
    begin = raw.index(HEADER_END) + len(HEADER_END)
    words = np.frombuffer(raw[begin:], dtype="<u2").copy()
    kind, content = words >> 12, words & 0xFFF
    bits = np.zeros(words.size, dtype=np.int64)  # events of each word
    bits[kind == 2] = 1
    for vector, mask in ((4, 0xFFF), (5, 0xFF)):
        chosen = kind == vector
        bits[chosen] = sum((content[chosen] & mask) >> i & 1 for i in range(12))
    milliseconds = times_us(kind, content) // 1000
    _, slot = np.unique(milliseconds, return_inverse=True)
    counts = np.bincount(slot, weights=bits)
    keep = np.minimum(1.0, 1000 * mev_per_s / np.maximum(counts, 1))[slot]
    random = np.random.default_rng(seed)
    mask = np.zeros(words.size, dtype=np.uint16)
    for i in range(12):
        mask |= (random.random(words.size) < keep).astype(np.uint16) << i
    vectors = (kind == 4) | (kind == 5)
    words[vectors] &= np.uint16(0xF000) | mask[vectors]
    is_dropped = (kind == 2) & ((mask & 1) == 0)
    return raw[:begin] + words[~is_dropped].tobytes()


# The anti-flicker filter of Prophesee's sensors, as far as OpenEB (i_antiflicker_module.h) and the manual of the sensors describe it: the
# regions, the band (Hz), and the numbers of successive periodic bursts that start and stop it, with OpenEB's defaults.
REGION_PX, BAND_HZ, START_BURSTS, STOP_BURSTS = 4, (50, 520), 6, 4


def burst_times_us(t, p):
    """The begins of the bursts in the events of a region. How the sensor tells bursts apart is not published: here a burst begins with an ON
    event after an OFF event, at least half of the shortest period after the burst before."""
    bursts = []
    for begin in t[np.diff(p.astype(np.int64), prepend=0) == 1]:
        if not bursts or begin - bursts[-1] >= 0.5e6 / BAND_HZ[1]:
            bursts.append(begin)
    return bursts


def filtered_spans_us(bursts):
    """When the filter is active: a burst after a period in the band counts up, another one down, and a pause longer than any period clears."""
    spans, count, begin = [], 0, None
    for before, burst in zip(bursts, bursts[1:]):
        period = burst - before
        if period > 1e6 / BAND_HZ[0]:
            count = 0
            if begin is not None:
                spans.append((begin, before + 1e6 / BAND_HZ[0]))
                begin = None
            continue
        count = min(START_BURSTS, count + 1) if period >= 1e6 / BAND_HZ[1] else max(0, count - 1)
        if begin is None and count >= START_BURSTS:
            begin = burst
        if begin is not None and count < STOP_BURSTS:
            spans.append((begin, burst))
            begin = None
    return spans if begin is None else [*spans, (begin, bursts[-1] + 1e6 / BAND_HZ[0])]


def anti_flicker(dat, begin_us):
    """Returns a DAT file without the events of regions that flicker, and without those before a time."""
    begin = 0
    while dat[begin:begin + 1] == b"%":
        begin = dat.index(b"\n", begin) + 1
    begin += 2  # type and size of the events
    events = np.frombuffer(dat[begin:], dtype=[("t", "<u4"), ("address", "<u4")])
    x, y, p = events["address"] & 0x3FFF, events["address"] >> 14 & 0x3FFF, events["address"] >> 28 & 1
    region = (y // REGION_PX).astype(np.int64) << 16 | x // REGION_PX
    order = np.argsort(region, kind="stable")
    keep = events["t"] >= begin_us
    for part in np.split(order, np.flatnonzero(np.diff(region[order])) + 1):
        t = events["t"][part].astype(np.int64)
        for from_us, to_us in filtered_spans_us(burst_times_us(t, p[part])):
            keep[part[(t >= from_us) & (t < to_us)]] = False
    return dat[:begin] + events[keep].tobytes()


def times_us(kind, content):
    """The time of each word: the high part wraps at 2^24, which a recording does not reach twice. The low part counts from its first
    word after a change of the high part."""
    def last(chosen):
        return np.maximum.accumulate(np.where(chosen, np.arange(kind.size), -1))

    def value(index):
        return np.where(index >= 0, content[np.maximum(index, 0)].astype(np.int64), 0)

    high = value(last(kind == 8))
    change = last(np.diff(high, prepend=high[:1]) != 0)
    low = last(kind == 6)
    return high * 4096 + np.where(low >= change, value(low), 0)


def scene_of(evpose, directory, name, options, duration_s=DURATION_S):
    simulate(evpose, directory, "--object", name, "--camera", "vga", "--duration", duration_s, "--seed", "3", *SPEED, *options)
    return directory


def write_filtered(evpose, scene):
    """Returns the recording behind the anti-flicker filter, as a DAT file. The filter has been active for SETTLING_S: recording and truth
    of the scene begin so much later."""
    run_evpose(evpose, "convert", scene / "recording.raw", scene / "all.dat")
    lines = (scene / "truth.tum").read_text(encoding="ascii").splitlines(keepends=True)
    begin_s = next(float(line.split()[0]) for line in lines if not line.startswith("#")) + SETTLING_S
    (scene / "truth.tum").write_text("".join(line for line in lines if line.startswith("#") or float(line.split()[0]) >= begin_s),
                                     encoding="ascii")
    recording = scene / "filtered.dat"
    recording.write_bytes(anti_flicker((scene / "all.dat").read_bytes(), 1e6 * begin_s))
    return recording


def measure(evpose, name, options, emulated):
    with tempfile.TemporaryDirectory() as folder:
        has_filter = emulated == AFK
        scene = scene_of(evpose, pathlib.Path(folder, "scene"), name, options, DURATION_S + (SETTLING_S if has_filter else 0.0))
        recording = write_filtered(evpose, scene) if has_filter else scene / "recording.raw"
        if emulated is not None and not has_filter:
            recording.write_bytes(limit_rate(recording.read_bytes(), emulated, seed=1))
        info = json.loads(run_evpose(evpose, "info", recording, "--json"))
        inputs = ("--model", scene / "model.obj", "--camera", scene / "camera.yaml")
        poses = scene / "poses.tum"
        subprocess.run([evpose, "replay", recording, *inputs, "--out", poses, "--init-pose", first_pose(scene)], check=False, capture_output=True)
        table = json.loads(run_evpose(evpose, "evaluate", "--truth", scene / "truth.tum", *inputs, "--symmetric", "--estimate", poses, "--json"))
        row = table["estimates"][0]
        return (info["cd_events"] / (1e6 * DURATION_S), 100 * row["position_rmse_of_depth"], row["rotation_mean_deg"], 100 * row["coverage_ratio"])


def print_settings(evpose):
    print("| setting | value | Mev/s | position, % of the distance | rotation, deg | good poses, % of the time |\n" + "| --- " * 6 + "|")
    for setting, value, options, emulated in SETTINGS:
        rows = [measure(evpose, name, options, emulated) for name in OBJECTS]
        rate, position, rotation, cover = (statistics.mean(column) for column in zip(*rows))
        print(f"| {setting} | {value} | {rate:.2f} | {position:.3f} | {rotation:.2f} | {cover:.1f} |", flush=True)


def packets_of(raw, period_us):
    """Returns the header of a RAW file, the time of its first word (us), and its packets: pairs of the end of the period after which the
    packet leaves the camera (us since the first word) and the words of the packet, as bytes."""
    begin = raw.index(HEADER_END) + len(HEADER_END)
    words = np.frombuffer(raw[begin:], dtype="<u2")
    t_us = np.maximum.accumulate(times_us(words >> 12, words & 0xFFF))
    period = (t_us - t_us[0]) // period_us
    cuts = np.flatnonzero(np.diff(period)) + 1
    ends = [int(period[max(cut - 1, 0)] + 1) * period_us for cut in [*cuts, words.size]]
    return raw[:begin], int(t_us[0]), list(zip(ends, [part.tobytes() for part in np.split(words, cuts)]))


def pose_delays_ms(evpose, server, scene, period_us, folder):
    """The delays of poses behind their sensor times, while the camera sends a packet each period."""
    header, first_us, packets = packets_of((scene / "recording.raw").read_bytes(), period_us)
    log = pathlib.Path(folder, f"clock{period_us}.csv")
    stream = subprocess.Popen([evpose, "stream", "-", "--model", scene / "model.obj", "--camera", scene / "camera.yaml", "--server", server,
                               "--init-pose", first_pose(scene), "--clock-log", log], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    stream.stdin.write(header)
    stream.stdin.flush()
    time.sleep(1.0)  # the session is created meanwhile
    begin_s = time.time()
    for end_us, data in packets:
        time.sleep(max(0.0, begin_s + 1e-6 * end_us - time.time()))
        stream.stdin.write(data)
        stream.stdin.flush()
    stream.stdin.close()
    if stream.wait() != 0:
        raise RuntimeError(stream.stderr.read().decode())
    epoch_us = 1e6 * begin_s - first_us % (1 << 24)
    with open(log, encoding="utf-8", newline="") as file:
        return [(int(row["host_unix_us"]) - epoch_us - int(row["t_us"]) % (1 << 24)) / 1000
                for row in csv.DictReader(file) if row["kind"] == "pose"]


def print_delays(evpose, server_program):
    with tempfile.TemporaryDirectory() as folder:
        scene = scene_of(evpose, pathlib.Path(folder, "scene"), "cube", ())
        with Server(server_program, "--log-level", "off") as server:
            print("| packet period, ms | delay of a pose, median, ms | 99 % |\n| --- | --- | --- |")
            for period_us in (1000, 4000, 10_000, 33_000):
                delays = sorted(pose_delays_ms(evpose, server.address, scene, period_us, folder))
                print(f"| {period_us // 1000} | {statistics.median(delays):.1f} | {delays[int(0.99 * len(delays))]:.1f} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build/release", help="directory of the build")
    parser.add_argument("--delay", action="store_true", help="measure the delay by the period of the packets")
    arguments = parser.parse_args()
    evpose = arguments.bin / "client/cli/evpose"
    if not os.access(evpose, os.X_OK):
        sys.exit(f"{evpose}: build first: cmake --preset release && cmake --build --preset release")
    if arguments.delay:
        print_delays(evpose, arguments.bin / "server/evpose-server")
    else:
        print_settings(evpose)


if __name__ == "__main__":
    main()
