#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Counts wrong poses that are reported as TRACKING under a lamp that flickers strongly.

The objects are those that are nearly symmetric under half a turn. Each recording has 0.5 s, at 1.5 times the usual speed, with a
modulation of the light of 50 %, or of 40 % in front of a textured background. No first pose is given. A pose is wrong if it is off by
more than 10 deg or 5 % of the depth, the bounds of `evpose evaluate`. Needs a release build; about 20 s of processor time for each
recording, of which there are 144.
"""
import argparse
import concurrent.futures
import csv
import json
import math
import os
import subprocess
import sys
import tempfile

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
EVPOSE = os.path.join(ROOT, "build/release/client/cli/evpose")
LIGHTS = {"50 %": ["--flicker", "0.5"], "40 %, textured background": ["--flicker", "0.4", "--textured-background"]}
MAX_ROTATION_DEG = 10
MAX_POSITION_OF_DEPTH = 0.05


def run(*arguments, statuses=(0,)):
    status = subprocess.run([EVPOSE, *arguments], check=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode
    if status not in statuses:
        raise RuntimeError(f"evpose {arguments[0]} ended with the status {status}")


def read_truth(path):
    """Rows of (time in s, x, y, z in m, quaternion x, y, z, w) in the order of time."""
    with open(path, encoding="utf-8") as file:
        return [[float(value) for value in line.split()] for line in file if not line.startswith("#")]


def is_wrong(pose, true):
    position_error = math.dist(pose[:3], true[:3])
    cosine = min(1.0, abs(sum(a * b for a, b in zip(pose[3:], true[3:]))))
    return math.degrees(2 * math.acos(cosine)) > MAX_ROTATION_DEG or position_error > MAX_POSITION_OF_DEPTH * true[2]


def wrong_times_ms(poses_path, truth_path):
    """The durations of the periods in which successive poses with the state TRACKING are wrong."""
    truth = read_truth(truth_path)
    periods = []
    begin_us = nearest = 0
    is_in_period = False
    with open(poses_path, encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            if row["state"] != "TRACKING":
                continue
            t_us = int(row["t_us"])
            while nearest + 1 < len(truth) and abs(truth[nearest + 1][0] - t_us / 1e6) <= abs(truth[nearest][0] - t_us / 1e6):
                nearest += 1
            wrong = is_wrong([float(row[key]) for key in ("tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw")], truth[nearest][1:8])
            if wrong and not is_in_period:
                begin_us = t_us
                periods.append(0.0)
            if wrong:
                periods[-1] = (t_us - begin_us) / 1000
            is_in_period = wrong
    return periods


def measure(task):
    name, light, seed = task
    with tempfile.TemporaryDirectory() as folder:
        scene = os.path.join(folder, "scene")
        poses = os.path.join(folder, "poses.csv")
        truth = os.path.join(scene, "truth.tum")
        run("simulate", "--object", name, "--speed", "1.5", "--duration", "0.5", "--seed", str(seed), "--out", scene, *LIGHTS[light])
        run("replay", os.path.join(scene, "recording.raw"), "--model", os.path.join(scene, "model.obj"),
            "--camera", os.path.join(scene, "camera.yaml"), "--out", poses, statuses=(0, 1))  # 1: no pose was found
        if not os.path.exists(poses):
            raise RuntimeError(f"no poses of {name}, seed {seed}")
        return {"object": name, "light": light, "seed": seed, "wrong_ms": wrong_times_ms(poses, truth)}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", nargs="+", default=["planar", "book", "spacecraft"])
    parser.add_argument("--seeds", type=int, default=24, help="number of seeds for each object and light (%(default)s)")
    parser.add_argument("--json", action="store_true", help="one JSON object with a row for each recording")
    arguments = parser.parse_args()
    if not os.access(EVPOSE, os.X_OK):
        sys.exit("flicker.py: build first: cmake --preset release && cmake --build --preset release")
    tasks = [(name, light, seed) for name in arguments.objects for light in LIGHTS for seed in range(1, arguments.seeds + 1)]
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        rows = list(pool.map(measure, tasks))
    if arguments.json:
        print(json.dumps({"rows": rows}))
        return
    for row in rows:
        if row["wrong_ms"]:
            print(f"{row['object']}, {row['light']}, seed {row['seed']}: wrong for {', '.join(f'{t:.0f}' for t in row['wrong_ms'])} ms")
    print(f"{sum(bool(row['wrong_ms']) for row in rows)} of {len(rows)} recordings report a wrong pose as TRACKING")


if __name__ == "__main__":
    main()
