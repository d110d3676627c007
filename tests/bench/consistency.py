#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measures whether the covariance is consistent with the errors on sensors that differ from the default profile.

Draws sensors at random (threshold, bandwidth, refractory time, blur of the lens; the draw is printed), simulates each object on one of them,
and prints for each recording the position error, the median of the NEES and the share of the poses whose truth lies inside the 95 %
ellipsoid: without a profile, and with the profile that `evpose calibrate` fits to another recording of the same sensor. Consistent are a
median of 5.3 and a share of 95 %. With --check, the status is 1 if a median without a profile lies outside 3 to 8 or a share outside 90
to 99 %. Needs a release build.

Example: tests/bench/consistency.py --bin build/release --sensors 2
"""
import argparse
import json
import pathlib
import random
import subprocess
import sys
import tempfile

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))
import processes  # noqa: E402

OBJECTS = ["cube", "cuboid", "planar", "book", "spacecraft"]
LOW, HIGH = 3.0, 8.0


def draw_sensor(generator):
    """Options of `evpose simulate`; the ranges are stated in core/estimation/systematic_error.h."""
    return {
        "--threshold": round(generator.uniform(0.15, 0.45), 3),
        "--bandwidth": generator.choice([600, 1000, 2000, 5000, 10000]),
        "--refractory": round(generator.uniform(50, 400)),
        "--lens-blur": round(generator.uniform(0.3, 1.2), 2),
    }


def simulate(evpose, directory, name, sensor, seed, duration):
    options = [item for pair in sensor.items() for item in pair]
    processes.simulate(evpose, directory, "--object", name, "--noise", "0.05", "--seed", seed, "--duration", duration, *options)


def files(directory):
    return ["--model", directory / "model.obj", "--camera", directory / "camera.yaml"]


def evaluate(evpose, directory, profile):
    """The row of `evpose evaluate` for a replay without a first pose; None if no pose was found."""
    poses = directory / "poses.csv"
    sensor = ["--sensor", profile] if profile else []
    command = [evpose, "replay", directory / "recording.raw", *files(directory), *sensor, "--out", poses]
    replay = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False)
    if replay.returncode == 1 and "no pose was found" in replay.stderr:
        return None
    if replay.returncode != 0:
        sys.exit(f"consistency.py: {replay.stderr}")
    command = [evpose, "evaluate", "--truth", directory / "truth.tum", "--estimate", poses, *files(directory), "--symmetric", "--json"]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)["estimates"][0]


def calibrate(evpose, directory):
    profile = directory / "profile.yaml"
    command = [evpose, "calibrate", directory / "recording.raw", "--truth", directory / "truth.tum", *files(directory), "-o", profile]
    return profile if subprocess.run(command, capture_output=True, check=False).returncode == 0 else None


def cells(row):
    if row is None:
        return f"{'no pose':>25}"
    return f"{100 * row['position_rmse_of_depth']:9.3f} {row['nees_median']:7.1f} {100 * row['nees_inside_95_ratio']:7.1f}"


def is_consistent(row):
    return row is not None and LOW <= row["nees_median"] <= HIGH and 0.90 <= row["nees_inside_95_ratio"] <= 0.99


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, default=pathlib.Path("build/release"), help="build folder")
    parser.add_argument("--sensors", type=int, default=2, help="number of sensors for each object")
    parser.add_argument("--seed", type=int, default=1, help="of the draw and of the simulations")
    parser.add_argument("--duration", type=float, default=1.0, help="seconds of each recording")
    parser.add_argument("--objects", nargs="+", default=OBJECTS, choices=OBJECTS)
    parser.add_argument("--without-profile-only", action="store_true", help="do not calibrate")
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    evpose = arguments.bin / "client/cli/evpose"
    generator = random.Random(arguments.seed)
    print(f"{'':55}{'without a profile':>25}{'calibrated':>26}")
    print(f"{'object':11}{'threshold':>10}{'bandwidth':>10}{'refractory':>11}{'blur':>6}{'':7}"
          f"{'% depth':>9}{'NEES':>8}{'in 95 %':>8} {'% depth':>9}{'NEES':>8}{'in 95 %':>8}")
    wrong = 0
    for index in range(arguments.sensors):
        for name in arguments.objects:
            sensor = draw_sensor(generator)
            seed = arguments.seed * 1000 + index * 10
            with tempfile.TemporaryDirectory() as folder:
                directory, other = pathlib.Path(folder) / "tracked", pathlib.Path(folder) / "calibration"
                simulate(evpose, directory, name, sensor, seed + 1, arguments.duration)
                without = evaluate(evpose, directory, None)
                line = f"{name:11}" + "".join(f"{value:>{width}}" for value, width in zip(sensor.values(), (10, 10, 11, 6)))
                line += f"{'':7}{cells(without)}"
                if not arguments.without_profile_only:
                    simulate(evpose, other, "cuboid", sensor, seed + 2, 2.0)
                    profile = calibrate(evpose, other)
                    line += f" {cells(evaluate(evpose, directory, profile)) if profile else 'calibration refused':>25}"
                print(line, flush=True)
                wrong += not is_consistent(without)
    print(f"{wrong} of {arguments.sensors * len(arguments.objects)} recordings without a profile are outside NEES {LOW:g} to {HIGH:g} "
          "or 90 to 99 %")
    return 1 if arguments.check and wrong else 0


if __name__ == "__main__":
    sys.exit(main())
