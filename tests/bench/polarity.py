#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Measures what different thresholds of ON and OFF events cost, which the sensor profile describes by one threshold and one latency.

With different thresholds, ON and OFF edges lie at different distances from their events, by an amount that grows with the speed. For each
ratio of the thresholds, whose geometric mean is that of the default sensor, and each speed, a cube and a book are simulated and tracked
without a first pose. Printed are the means over objects and seeds: position error (% of the depth), median of the NEES and share of the
truths inside the 95 % ellipsoid, with the default profile and with the one that `evpose calibrate` fits to a cuboid on the same sensor. What
a profile with a constant for each polarity could gain is at most the difference from the row with equal thresholds.

Example: tests/bench/polarity.py --bin build/release --seeds 2
"""
import argparse
import math
import pathlib
import statistics
import tempfile

from consistency import calibrate, cells, evaluate, simulate

OBJECTS = ("cube", "book")
THRESHOLD = 0.28  # the simulator's default
RATIOS = (1.0, 1.25, 1.5, 2.0)
SPEEDS = (1.0, 4.0)


def options(ratio, speed):
    """Options of `evpose simulate`."""
    return {"--camera": "vga", "--speed": speed, "--threshold": round(THRESHOLD * math.sqrt(ratio), 4),
            "--threshold-off": round(THRESHOLD / math.sqrt(ratio), 4)}


def mean(rows):
    """None if one of the recordings has no pose."""
    if None in rows:
        return None
    return {key: statistics.mean(row[key] for row in rows) for key in ("position_rmse_of_depth", "nees_median", "nees_inside_95_ratio")}


def measure(evpose, ratio, speed, seeds, duration):
    """The means with the default profile and with the calibrated one, and how often the calibration was refused."""
    sensor, plain, calibrated, refused = options(ratio, speed), [], [], 0
    for seed in range(1, seeds + 1):
        with tempfile.TemporaryDirectory() as folder:
            other = pathlib.Path(folder) / "calibration"
            simulate(evpose, other, "cuboid", {**sensor, "--motion": "bursts"}, 100 * seed, 2.0)
            profile = calibrate(evpose, other)
            refused += profile is None
            for index, name in enumerate(OBJECTS):
                directory = pathlib.Path(folder) / name
                simulate(evpose, directory, name, sensor, 100 * seed + 1 + index, duration)
                plain.append(evaluate(evpose, directory, None))
                calibrated.append(evaluate(evpose, directory, profile))
    return mean(plain), mean(calibrated), refused


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, default=pathlib.Path("build/release"), help="build folder")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--duration", type=float, default=0.5, help="seconds of each recording")
    arguments = parser.parse_args()
    print(f"{'':15}{'default profile':>25}{'calibrated':>26}")
    print(f"{'ON / OFF':>8}{'speed':>7}{'% depth':>9}{'NEES':>8}{'in 95 %':>8} {'% depth':>9}{'NEES':>8}{'in 95 %':>8}")
    for speed in SPEEDS:
        for ratio in RATIOS:
            plain, calibrated, refused = measure(arguments.bin / "client/cli/evpose", ratio, speed, arguments.seeds, arguments.duration)
            note = f"  default profile in {refused} of {arguments.seeds}: calibration refused" if refused else ""
            print(f"{ratio:8.2f}{speed:7.1f}{cells(plain)} {cells(calibrated)}{note}", flush=True)


if __name__ == "__main__":
    main()
