#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Calibrates the cameras of real recordings with `evpose calibrate`, each from the recording itself, and compares poses.

DIR has a directory for each recording, with recording.raw, camera.yaml (the given camera), model.obj and reference.tum
(camera_from_object for the given camera). The calibration starts from a focal length that is 20 % too short and from
one that is 20 % too long, without distortion. Printed are

  given px    median, over the poses while TRACKING, of the distance in the image between the ends of the model's lines
              at the pose and at the reference, both projected with the given camera; modulo the symmetries of the model
  own px      the same, with the poses of the calibrated camera, projected with it
  ratio       own px over given px
  tracked     poses while TRACKING with the given and with the calibrated camera
  not determined  parameters that the calibration left at their defaults

Example: tests/bench/real_calibration.py build/release/client/cli/evpose DIR
Without DIR the script prints that it is skipped and ends with status 0.
"""

import argparse
import itertools
import json
import math
import os
import re
import subprocess
import sys
import tempfile

import numpy as np

from self_calibration import COEFFICIENTS, distort

RECORDINGS = {"shapes_rotation": "none", "shapes_rotation_fast": "none", "phone_shake": "half", "cube_turntable": "cube"}
MIN_DEPTH = 1e-6


class Camera:
    """Projection with a ROS camera_info file of a Brown lens."""

    def __init__(self, path):
        with open(path, encoding="utf-8") as file:
            text = file.read()
        number = lambda key: int(re.search(rf"{key}:\s*(\d+)", text).group(1))
        listed = lambda key: [float(v) for v in
                              re.search(rf"{key}:.*?data:\s*\[(.*?)\]", text, re.S).group(1).split(",")]
        self.size = (number("image_width"), number("image_height"))
        matrix = listed("camera_matrix")
        self.focal, self.centre = np.array([matrix[0], matrix[4]]), np.array([matrix[2], matrix[5]])
        coefficients = listed("distortion_coefficients")
        self.distortion = coefficients + [0.0] * (len(COEFFICIENTS["brown"]) - len(coefficients))

    def project(self, points):
        bearings = points[:, :2] / np.maximum(points[:, 2:], MIN_DEPTH)
        return distort("brown", self.distortion, bearings) * self.focal + self.centre


def rotation(quaternion):
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def symmetries(kind):
    if kind == "half":
        return [np.eye(3), np.diag([-1.0, -1.0, 1.0])]
    if kind == "none":
        return [np.eye(3)]
    signed = (np.eye(3)[list(order)] * np.array(signs)[:, None]
              for order in itertools.permutations(range(3)) for signs in itertools.product((1, -1), repeat=3))
    return [matrix for matrix in signed if np.linalg.det(matrix) > 0]


def read_reference(path):
    rows = np.loadtxt(path, comments="#")
    return 1e6 * rows[:, 0], rows[:, 1:4], rows[:, 4:8]


def reference_at(reference, t_us):
    """The pose between the two nearest ones: linear, and the normalised mean of the quaternions."""
    times, translations, quaternions = reference
    i = int(np.clip(np.searchsorted(times, t_us), 1, len(times) - 1))
    u = float(np.clip((t_us - times[i - 1]) / (times[i] - times[i - 1]), 0.0, 1.0))
    after = quaternions[i] * np.sign(quaternions[i] @ quaternions[i - 1])
    return rotation((1 - u) * quaternions[i - 1] + u * after), (1 - u) * translations[i - 1] + u * translations[i]


def line_ends(path):
    """The vertices of the line elements of an OBJ file."""
    vertices, used = [], set()
    with open(path, encoding="utf-8") as file:
        for line in file:
            words = line.split()
            if words[:1] == ["v"]:
                vertices.append([float(v) for v in words[1:4]])
            elif words[:1] == ["l"]:
                used.update(int(v) - 1 for v in words[1:])
    return np.array(vertices)[sorted(used)]


def image_errors(poses, reference, given, own, points, kind):
    """Root mean square distance in the image at each pose while TRACKING, px."""
    errors = []
    with open(poses, encoding="utf-8") as file:
        rows = [json.loads(line) for line in file]
    for row in rows:
        inside = reference[0][0] - 2e3 <= row["t_us"] <= reference[0][-1] + 2e3
        if row["state"] != "TRACKING" or "translation_m" not in row or not inside:
            continue
        turn, shift = reference_at(reference, row["t_us"])
        expected_points = points @ turn.T + shift
        expected = given.project(expected_points)
        seen = np.all((expected >= 0) & (expected < given.size), axis=1) & (expected_points[:, 2] > MIN_DEPTH)
        pose = rotation(np.array(row["quaternion_xyzw"]))
        best = min(np.mean(np.sum((own.project(points @ (pose @ equal).T + row["translation_m"]) - expected)[seen]**2,
                                  axis=1)) for equal in symmetries(kind))
        errors.append(math.sqrt(best))
    return errors


def run(arguments):
    """Runs a command; returns its standard output, and its error output if it failed."""
    done = subprocess.run(arguments, capture_output=True, text=True)
    return done.stdout, None if done.returncode == 0 else done.stderr.strip().splitlines()[-1]


def bench(evpose, name, focal_ratio, source, directory):
    recording, model, camera = (f"{source}/{file}" for file in ("recording.raw", "model.obj", "camera.yaml"))
    given = Camera(camera)
    points, reference = line_ends(model), read_reference(f"{source}/reference.tum")

    def replay(camera_file):
        poses = f"{directory}/poses.jsonl"
        error = run([evpose, "replay", recording, "--model", model, "--camera", camera_file, "-o", poses])[1]
        own = Camera(camera_file)
        return [] if error else image_errors(poses, reference, given, own, points, RECORDINGS[name])

    row = {"recording": name, "guess": focal_ratio}
    given_errors = replay(camera)
    row["given_px"], row["given_poses"] = (float(np.median(given_errors)) if given_errors else None), len(given_errors)
    fov_deg = math.degrees(2 * math.atan(0.5 * given.size[0] / (focal_ratio * given.focal[0])))
    estimated = f"{directory}/camera.yaml"
    output, row["error"] = run([evpose, "calibrate", recording, "--model", model, "--fov", f"{fov_deg:.4f}", "--camera-out",
                                estimated, "--json"])
    if row["error"]:
        return row
    report = json.loads(output)["camera"]
    row["parameters"] = report["parameters"]
    row["warnings"] = report["warnings"]
    row["not_determined"] = [key for key, value in report["parameters"].items() if value["standard_error"] is None]
    errors = replay(estimated)
    row["own_px"], row["own_poses"] = (float(np.median(errors)) if errors else None), len(errors)
    if errors and given_errors:
        row["ratio"] = row["own_px"] / row["given_px"]
    return row


def text(value, digits):
    return "-" if value is None else f"{value:.{digits}f}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("evpose", help="the program")
    parser.add_argument("directory", nargs="?", help="the recordings")
    parser.add_argument("--recording", action="append", choices=sorted(RECORDINGS), help="default: all")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    arguments = parser.parse_args()
    if arguments.directory is None or not os.path.isdir(arguments.directory):
        print(f"skipped: no directory of recordings ({arguments.directory})")
        return
    if not arguments.json:
        print("recording             guess  given px  own px  ratio      tracked      fx_px  not determined")
    for name in arguments.recording or RECORDINGS:
        source = os.path.join(arguments.directory, name)
        for focal_ratio in (0.8, 1.2):
            with tempfile.TemporaryDirectory() as directory:
                row = bench(os.path.abspath(arguments.evpose), name, focal_ratio, source, directory)
            if arguments.json:
                print(json.dumps(row), flush=True)
                continue
            fx = row["parameters"]["fx_px"] if "parameters" in row else None
            tracked = f"{row['given_poses']} / {row.get('own_poses', '-')}"
            print(f"{name:21s} {focal_ratio:5.1f} {text(row['given_px'], 3):>9s} {text(row.get('own_px'), 3):>7s}"
                  f" {text(row.get('ratio'), 2):>6s} {tracked:>12s} {text(fx and fx['value'], 2):>10s} "
                  f" {row['error'] or ' '.join(row['not_determined'])}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
