#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Calibrates the cameras of real recordings with `evpose calibrate`, each from the recording itself, and compares poses; fits the profile
of the sensor to each of them with the given camera.

DIR has a directory for each recording, with recording.raw, camera.yaml (the given camera), model.obj and reference.tum
(camera_from_object for the given camera). The calibration starts from a focal length that is 20 % too short and from
one that is 20 % too long, without distortion. Printed are

  given px    median, over the poses while TRACKING, of the distance in the image between the ends of the model's lines
              at the pose and at the reference, both projected with the given camera; modulo the symmetries of the model
  own px      the same, with the poses of the calibrated camera, projected with it
  ratio       own px over given px
  tracked     poses while TRACKING with the given and with the calibrated camera
  not determined  parameters that the calibration left at their defaults

and, for the guess "profile", with the given camera and the profile instead of the calibrated camera

  own px, ratio, tracked  as above, for the poses with that profile
  blur, threshold         of the profile, with their standard errors; or the reason for which it is refused

Example: tests/bench/real/calibration.py build/release/client/cli/evpose DIR
Without DIR the script prints that it is skipped and ends with status 0.
"""

import argparse
import itertools
import json
import math
import os
import pathlib
import re
import subprocess
import sys
import tempfile

import numpy as np

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))
from self_calibration import COEFFICIENTS, distort  # noqa: E402

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


def read_poses(path):
    """The rows of a file of poses, .jsonl, that have a pose."""
    with open(path, encoding="utf-8") as file:
        return [row for row in map(json.loads, file) if "translation_m" in row]


def image_errors(rows, reference, given, own, points, kind):
    """Root mean square distance in the image at each pose while TRACKING, px."""
    errors = []
    for row in rows:
        inside = reference[0][0] - 2e3 <= row["t_us"] <= reference[0][-1] + 2e3
        if row["state"] != "TRACKING" or not inside:
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
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    return done.stdout, None if done.returncode == 0 else done.stderr.strip().splitlines()[-1]


class Recording:
    """A recording with its files, and the errors of its poses."""

    def __init__(self, evpose, name, source, directory):
        self.evpose, self.name, self.directory = evpose, name, directory
        self.recording, self.model, self.camera = (f"{source}/{file}" for file in ("recording.raw", "model.obj", "camera.yaml"))
        self.given = Camera(self.camera)
        self.points, self.reference = line_ends(self.model), read_reference(f"{source}/reference.tum")

    def errors(self, camera, *options):
        poses = f"{self.directory}/poses.jsonl"
        error = run([self.evpose, "replay", self.recording, "--model", self.model, "--camera", camera, "-o", poses, *options])[1]
        if error:
            return []
        return image_errors(read_poses(poses), self.reference, self.given, Camera(camera), self.points, RECORDINGS[self.name])


def with_errors(row, given, own):
    for key, errors in (("given", given), ("own", own)):
        row[f"{key}_px"], row[f"{key}_poses"] = (float(np.median(errors)) if errors else None), len(errors)
    row["ratio"] = row["own_px"] / row["given_px"] if own and given else None
    return row


def calibrate_camera(recording, given, focal_ratio):
    row = {"recording": recording.name, "guess": focal_ratio}
    width, focal = recording.given.size[0], recording.given.focal[0]
    fov_deg = math.degrees(2 * math.atan(0.5 * width / (focal_ratio * focal)))
    estimated = f"{recording.directory}/camera.yaml"
    output, row["error"] = run([recording.evpose, "calibrate", recording.recording, "--model", recording.model, "--fov",
                                f"{fov_deg:.4f}", "--camera-out", estimated, "--json"])
    if row["error"]:
        return with_errors(row, given, [])
    report = json.loads(output)["camera"]
    row["parameters"], row["warnings"] = report["parameters"], report["warnings"]
    row["not_determined"] = [key for key, value in report["parameters"].items() if value["standard_error"] is None]
    return with_errors(row, given, recording.errors(estimated))


def fit_profile(recording, given):
    row = {"recording": recording.name, "guess": "profile"}
    profile = f"{recording.directory}/profile.yaml"
    output, row["error"] = run([recording.evpose, "calibrate", recording.recording, "--model", recording.model, "--camera",
                                recording.camera, "-o", profile, "--json"])
    if row["error"]:
        return with_errors(row, given, [])
    row["profile"] = json.loads(output)
    return with_errors(row, given, recording.errors(recording.camera, "--sensor", profile))


def rows(evpose, name, source):
    with tempfile.TemporaryDirectory() as directory:
        recording = Recording(evpose, name, source, directory)
        given = recording.errors(recording.camera)
        for focal_ratio in (0.8, 1.2):
            yield calibrate_camera(recording, given, focal_ratio)
        yield fit_profile(recording, given)


def text(value, digits):
    return "-" if value is None else f"{value:.{digits}f}"


def result(row):
    """What a row states besides its errors."""
    if row["error"]:
        return row["error"]
    if "profile" in row:
        return ", ".join(f"{name} {row['profile'][key]['value']:.2f} +- {row['profile'][key]['standard_error']:.2f}"
                         for name, key in (("blur", "blur_px"), ("threshold", "contrast_threshold")))
    focal = row["parameters"]["fx_px"]
    left = f"; not determined: {' '.join(row['not_determined'])}" if row["not_determined"] else ""
    return f"fx {focal['value']:.2f} +- {focal['standard_error'] or math.nan:.2f}{left}"


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
        print("recording              guess  given px  own px  ratio      tracked  result")
    for name in arguments.recording or RECORDINGS:
        for row in rows(os.path.abspath(arguments.evpose), name, os.path.join(arguments.directory, name)):
            if arguments.json:
                print(json.dumps(row), flush=True)
                continue
            print(f"{name:20s} {row['guess']:>7} {text(row['given_px'], 3):>9s} {text(row['own_px'], 3):>7s}"
                  f" {text(row['ratio'], 2):>6s} {row['given_poses']:>5d} / {row['own_poses']:<4d}  {result(row)}", flush=True)


if __name__ == "__main__":
    main()
