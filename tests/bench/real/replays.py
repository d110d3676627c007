#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Replays real recordings through a server, without a prior, and compares the poses with references.

DIR has a directory for each recording, with recording.raw (or NAME.raw), camera.yaml, model.obj and reference.tum (or NAME.tum). Each
recording is sent to an evpose-server, by `evpose replay --server`, as fast as the server takes it. Printed are

  sensor        camera_name of camera.yaml
  s, events     duration and events of the recording
  first pose s  time from the first event of the recording to the first pose while TRACKING
  losses        how often the server lost the object
  tracking %    share of the poses while TRACKING
  residual px   reprojection error of the events: median of residual_rms_px of the poses while TRACKING, the distance of the events from the
                projected lines
  error px      agreement with the reference: median and 95 % quantile, over the poses while TRACKING, of the distance in the image between
                the ends of the model's lines at the pose and at the reference; modulo the symmetries of the model

A recording without any pose has only the numbers of its events; that is the right result for a board that flashes before a camera at rest.

Example: tests/bench/real/replays.py --bin build/release DIR
Without DIR the script prints that it is skipped and ends with status 0.
"""
import argparse
import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile

import numpy as np

from calibration import RECORDINGS, Camera, image_errors, line_ends, read_poses, read_reference, text

sys.path.append(str(pathlib.Path(__file__).resolve().parents[2]))
from processes import Server, run_evpose  # noqa: E402

# The symmetries of the model, by recording.
REPLAYED = {**RECORDINGS, "checkerboard_flash/09": "half", "checkerboard_flash/20": "half"}


def files(source):
    """The recording and its reference, and the directory with the camera and the model."""
    if os.path.isdir(source):
        return f"{source}/recording.raw", f"{source}/reference.tum", source
    return f"{source}.raw", f"{source}.tum", os.path.dirname(source)


def sensor(camera):
    with open(camera, encoding="utf-8") as file:
        found = re.search(r"^camera_name:\s*(\S+)", file.read(), re.M)
    return found.group(1) if found else "-"


def replay(evpose, address, name, source, directory):
    """The row of one recording."""
    recording, reference, folder = files(source)
    camera, model, poses = f"{folder}/camera.yaml", f"{folder}/model.obj", f"{directory}/poses.jsonl"
    info = json.loads(run_evpose(evpose, "info", recording, "--json"))
    done = subprocess.run([evpose, "replay", recording, "--model", model, "--camera", camera, "--server", address, "--rate", "max", "-o",
                           poses, "--json"], check=False, capture_output=True, text=True)
    # Without any pose, the report is printed all the same, and the status is 1.
    if done.returncode not in (0, 1) or not done.stdout:
        raise RuntimeError(f"evpose replay {recording}: {done.stderr.strip()}")
    report = json.loads(done.stdout)
    rows = read_poses(poses) if os.path.exists(poses) else []
    tracking = [row for row in rows if row["state"] == "TRACKING"]
    given = Camera(camera)
    errors = image_errors(rows, read_reference(reference), given, given, line_ends(model), REPLAYED[name])
    row = {"recording": name, "sensor": sensor(camera), "seconds": 1e-6 * (info["t_last_us"] - info["t_first_us"]),
           "events": info["cd_events"], "sent_events": report["events"], "poses": len(rows), "losses": report["losses"],
           "first_pose_s": None, "tracking_ratio": None, "residual_px": None, "median_px": None, "p95_px": None}
    if tracking:
        row["first_pose_s"] = 1e-6 * (tracking[0]["t_us"] - info["t_first_us"])
        row["tracking_ratio"] = len(tracking) / len(rows)
        row["residual_px"] = float(np.median([pose["residual_rms_px"] for pose in tracking]))
    if errors:
        row["median_px"], row["p95_px"] = map(float, np.quantile(errors, [0.5, 0.95]))
    return row


def measure(binaries, directory, names):
    """Yields a row for each recording, all replayed through one server."""
    evpose = os.path.join(binaries, "client/cli/evpose")
    with Server(os.path.join(binaries, "server/evpose-server"), "--log-level", "error") as server:
        for name in names:
            with tempfile.TemporaryDirectory() as scratch:
                yield replay(evpose, server.address, name, os.path.join(directory, name), scratch)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", required=True, help="directory of the build")
    parser.add_argument("directory", nargs="?", help="the recordings")
    parser.add_argument("--recording", action="append", choices=sorted(REPLAYED), help="default: all")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    arguments = parser.parse_args()
    if arguments.directory is None or not os.path.isdir(arguments.directory):
        print(f"skipped: no directory of recordings ({arguments.directory})")
        return
    if not arguments.json:
        print("recording              sensor       s   events  first pose s  losses  tracking %  residual px  error px: median    p95")
    for row in measure(os.path.abspath(arguments.bin), arguments.directory, arguments.recording or REPLAYED):
        if arguments.json:
            print(json.dumps(row), flush=True)
            continue
        tracking = row["tracking_ratio"] and 100 * row["tracking_ratio"]
        print(f"{row['recording']:21s} {row['sensor']:>8s} {row['seconds']:7.2f} {row['events']:8d} {text(row['first_pose_s'], 3):>13s}"
              f" {row['losses']:7d} {text(tracking, 1):>11s} {text(row['residual_px'], 2):>12s} {text(row['median_px'], 2):>17s}"
              f" {text(row['p95_px'], 2):>6s}", flush=True)


if __name__ == "__main__":
    main()
