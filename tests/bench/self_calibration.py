#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Calibrates simulated cameras with `evpose calibrate` from recordings of the moving target alone, and compares the
results with the truth.

For each lens and seed: three recordings of the A4 target (--duration seconds each, 5 % noise) are simulated and
calibrated together, without a camera file and without poses. Printed are

  focal %        error of fx relative to fx
  centre px      error of the principal point
  distortion px  root mean square, over the parts of the image where the target was seen, of the difference between the
                 true and the estimated projection of the same directions, without the errors of fx, fy, cx, cy
  projection px  the same with these errors
  rotated px     the same with these errors, after the rotation of the camera for which it is smallest: what remains when
                 each pose absorbs the rest, as in mrcal's cross-validation ("Cross-validation", mrcal.secretsauce.net)
  worst sigmas   largest error of a parameter, in its standard errors. Of a lens of which a coefficient is not determined
                 and stays at its default, the other coefficients have no true value: fx, fy, cx and cy only
  chi2           mean of the squares of these; 1 if the standard errors are right
  position       error of the position of a cube in another recording, divided by that with the true camera and the
                 default profile, which is that of the simulated sensor
  cpu s          processor time of the calibration

--check compares the rows with the goals GOALS, names those that are missed, and ends with status 1 if there are any.

Example: tests/bench/self_calibration.py build/release/client/cli/evpose --lens standard --seeds 3
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile

import numpy as np

# fx, fy, cx, cy of an EVK4, the lens model and its coefficients, and the mean distances of the three recordings in metres.
LENSES = {
    "standard": (1030.0, 1030.0, 643.5, 356.5, "brown", (-0.08, 0.05, 0.0003, -0.0002, 0.0), (1.24, 0.95, 1.1)),
    "narrow": (2600.0, 2598.0, 636.0, 362.0, "brown", (-0.15, 0.2, 0.0002, 0.0003, 0.0), (3.0, 2.4, 2.7)),
    "wide": (720.0, 721.0, 645.0, 355.0, "brown", (-0.28, 0.09, 0.0004, -0.0003, -0.012), (0.9, 0.72, 0.8)),
    "rational": (720.0, 721.0, 645.0, 355.0, "rational", (0.12, 0.01, 0.0004, -0.0003, 0.001, 0.4, 0.02, 0.001),
                 (0.9, 0.72, 0.8)),
    "fisheye": (560.0, 560.5, 642.0, 358.0, "fisheye", (-0.02, 0.004, -0.001, 0.0), (0.75, 0.62, 0.7)),
}
MOTIONS = ("smooth", "smooth", "half-out")
SIZE = (1280, 720)
PINHOLE = ("fx_px", "fy_fx", "cx_px", "cy_px")
# Largest values.
GOALS = {"focal_percent": 0.05, "centre_px": 0.3, "distortion_px": 0.1, "worst_sigmas": 3.0, "position_ratio": 1.15}
MODEL_NAMES = {"brown": "plumb_bob", "rational": "rational_polynomial", "fisheye": "equidistant"}
COEFFICIENTS = {"brown": ("k1", "k2", "p1", "p2", "k3"), "fisheye": ("k1", "k2", "k3", "k4"),
                "rational": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")}


def camera_yaml(fx, fy, cx, cy, model, coefficients):
    return (f"image_width: {SIZE[0]}\nimage_height: {SIZE[1]}\ncamera_name: camera\n"
            f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: [{fx}, 0, {cx}, 0, {fy}, {cy}, 0, 0, 1]\n"
            f"distortion_model: {MODEL_NAMES[model]}\ndistortion_coefficients:\n  rows: 1\n"
            f"  cols: {len(coefficients)}\n  data: [{', '.join(map(repr, coefficients))}]\n")


def distort(model, d, points):
    """The distorted points of an n x 2 array of normalised ones."""
    x, y = points[:, 0], points[:, 1]
    r2 = x * x + y * y
    if model == "fisheye":
        r = np.sqrt(np.maximum(r2, 1e-24))
        t = np.arctan(r)
        scale = t * (1 + d[0] * t**2 + d[1] * t**4 + d[2] * t**6 + d[3] * t**8) / r
        return points * scale[:, None]
    radial = 1 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]))
    if model == "rational":
        radial = radial / (1 + r2 * (d[5] + r2 * (d[6] + r2 * d[7])))
    return np.stack([x * radial + 2 * d[2] * x * y + d[3] * (r2 + 2 * x * x),
                     y * radial + d[2] * (r2 + 2 * y * y) + 2 * d[3] * x * y], axis=1)


def undistort(model, d, points):
    """Inverts distort() by Newton's method with difference quotients."""
    result = points.copy()
    if model == "fisheye":  # a start near the solution, which the tangent needs
        r = np.linalg.norm(points, axis=1, keepdims=True)
        result = points * np.tan(np.minimum(r, 1.4)) / np.maximum(r, 1e-12)
    for _ in range(30):
        residual = distort(model, d, result) - points
        columns = [(distort(model, d, result + step) - distort(model, d, result - step)) / 2e-6
                   for step in (np.array([1e-6, 0.0]), np.array([0.0, 1e-6]))]
        jacobian = np.stack(columns, axis=2)
        result = result - np.linalg.solve(jacobian, residual[:, :, None])[:, :, 0]
    return result


def rotated(directions, angles):
    """The normalised points of rotated directions; `angles` is a rotation vector."""
    bearings = np.column_stack([directions, np.ones(len(directions))])
    angle = np.linalg.norm(angles)
    axis = angles / max(angle, 1e-15)
    turned = (bearings * np.cos(angle) + np.cross(axis, bearings) * np.sin(angle) +
              np.outer(bearings @ axis, axis) * (1 - np.cos(angle)))
    return turned[:, :2] / turned[:, 2:]


def rms(errors):
    return float(np.sqrt(np.mean(np.sum(errors * errors, axis=1))))


def error_after_rotation(project, directions, pixels):
    """RMS (px) of the projection's error after the best rotation, by the Gauss-Newton method with difference quotients."""
    angles, step_rad = np.zeros(3), 1e-6
    residual = lambda angles: project(rotated(directions, angles)) - pixels
    for _ in range(10):
        jacobian = np.stack([(residual(angles + step) - residual(angles - step)).ravel() / (2 * step_rad)
                             for step in step_rad * np.eye(3)], axis=1)
        angles = angles - np.linalg.lstsq(jacobian, residual(angles).ravel(), rcond=None)[0]
    return rms(residual(angles))


def projection_errors(true_lens, estimate, coverage):
    """RMS (px) of the difference of the projections where the target was seen: all of it, after the best rotation, and
    without an affine part per axis."""
    fx, fy, cx, cy, model, d, _ = true_lens
    rows, columns = np.nonzero(np.asarray(coverage) > 0)
    pixels = np.stack([(columns + 0.5) * SIZE[0] / 16 - 0.5, (rows + 0.5) * SIZE[1] / 9 - 0.5], axis=1)
    directions = undistort(model, d, (pixels - (cx, cy)) / (fx, fy))
    efx, efy, ecx, ecy, emodel, ed = estimate
    project = lambda points: distort(emodel, ed, points) * (efx, efy) + (ecx, ecy)
    difference = project(directions) - pixels
    left = difference.copy()
    for axis in range(2):
        design = np.stack([np.ones(len(pixels)), pixels[:, axis]], axis=1)
        left[:, axis] -= design @ np.linalg.lstsq(design, difference[:, axis], rcond=None)[0]
    return rms(difference), error_after_rotation(project, directions, pixels), rms(left)


def run(arguments):
    """Runs a command; returns its standard output."""
    done = subprocess.run(arguments, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{' '.join(arguments)}: exit status {done.returncode}\n{done.stderr}")
    return done.stdout


def child_cpu_s():
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def position_rmse(evpose, scene, camera, sensor, directory):
    poses = os.path.join(directory, "poses.tum")
    command = [evpose, "replay", f"{scene}/recording.raw", "--model", f"{scene}/model.obj", "--camera", camera, "-o", poses]
    run(command + (["--sensor", sensor] if sensor else []))
    table = json.loads(run([evpose, "evaluate", "--truth", f"{scene}/truth.tum", "--estimate", poses, "--json"]))
    return table["estimates"][0]["position_rmse_m"]


def simulate_recordings(evpose, seed, duration, distances, true_camera, directory):
    run([evpose, "target", "-o", f"{directory}/target.pdf"])
    recordings = []
    for i, (distance, motion) in enumerate(zip(distances, MOTIONS)):
        out = f"{directory}/r{i}"
        run([evpose, "simulate", "--model", f"{directory}/target.obj", "--front", "--camera", true_camera, "--distance",
             str(distance), "--motion", motion, "--duration", str(duration), "--noise", "0.05", "--seed",
             str(100 * seed + i), "-o", out])
        recordings.append(f"{out}/recording.raw")
    return recordings


def errors_in_sigmas(values, truth):
    """Of the parameters with a standard error: of all of them, or of PINHOLE if another one stays at its default."""
    is_complete = all(values[key][1] is not None for key in truth)
    return [(values[key][0] - truth[key]) / values[key][1] for key in (truth if is_complete else PINHOLE)
            if values[key][1] is not None]


def bench(evpose, name, seed, duration, directory):
    lens = LENSES[name]
    fx, fy, cx, cy, model, coefficients, distances = lens
    true_camera = os.path.join(directory, "true.yaml")
    with open(true_camera, "w", encoding="utf-8") as file:
        file.write(camera_yaml(fx, fy, cx, cy, model, coefficients))
    recordings = simulate_recordings(evpose, seed, duration, distances, true_camera, directory)
    camera, profile = f"{directory}/camera.yaml", f"{directory}/profile.yaml"
    start = child_cpu_s()
    report = json.loads(run([evpose, "calibrate", *recordings, "--model", f"{directory}/target.obj", "--lens", model, "-o",
                             profile, "--camera-out", camera, "--json"]))["camera"]
    cpu_s = child_cpu_s() - start
    values = {key: (p["value"], p["standard_error"]) for key, p in report["parameters"].items()}
    sigmas = errors_in_sigmas(values, dict(zip(PINHOLE + COEFFICIENTS[model], (fx, fy / fx, cx, cy, *coefficients))))
    efx = values["fx_px"][0]
    estimate = (efx, efx * values["fy_fx"][0], values["cx_px"][0], values["cy_px"][0], model,
                [values[key][0] for key in COEFFICIENTS[model]])
    projection, rotated_px, distortion = projection_errors(lens, estimate, report["coverage"])
    run([evpose, "simulate", "--object", "cube", "--camera", true_camera, "--duration", "3", "--noise", "0.05", "--seed",
         str(100 * seed + 50), "-o", f"{directory}/cube"])
    position = (position_rmse(evpose, f"{directory}/cube", camera, profile, directory) /
                position_rmse(evpose, f"{directory}/cube", true_camera, None, directory))
    return {"lens": name, "seed": seed, "focal_percent": 100 * abs(efx - fx) / fx,
            "centre_px": float(np.hypot(values["cx_px"][0] - cx, values["cy_px"][0] - cy)),
            "centre_error_px": [values["cx_px"][1], values["cy_px"][1]], "distortion_px": distortion,
            "projection_px": projection, "rotated_px": rotated_px, "worst_sigmas": max(map(abs, sigmas)),
            "chi2": float(np.mean(np.square(sigmas))), "position_ratio": position, "cpu_s": cpu_s,
            "rms_px": report["rms_px"], "rounds": report["rounds"], "parameters": report["parameters"],
            "warnings": report["warnings"]}


def missed_goals(row):
    return [f"{row['lens']}, seed {row['seed']}: {key} is {row[key]:.3f}, the goal {goal:g}"
            for key, goal in GOALS.items() if row[key] > goal]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("evpose", help="the program")
    parser.add_argument("--lens", action="append", choices=sorted(LENSES), help="default: all")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--duration", type=float, default=10.0, help="seconds of each recording")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    parser.add_argument("--check", action="store_true", help="status 1 if a goal is missed")
    arguments = parser.parse_args()
    missed = []
    if not arguments.json:
        print("lens      seed  focal %  centre px  distortion px  projection px  rotated px  worst sigmas   chi2"
              "  position  cpu s")
    for name in arguments.lens or LENSES:
        for seed in range(1, arguments.seeds + 1):
            with tempfile.TemporaryDirectory() as directory:
                row = bench(os.path.abspath(arguments.evpose), name, seed, arguments.duration, directory)
            missed += missed_goals(row)
            if arguments.json:
                print(json.dumps(row), flush=True)
                continue
            print(f"{name:9s} {seed:4d} {row['focal_percent']:8.3f} {row['centre_px']:10.2f} {row['distortion_px']:14.3f}"
                  f" {row['projection_px']:14.3f} {row['rotated_px']:11.3f} {row['worst_sigmas']:13.1f}"
                  f" {row['chi2']:6.1f} {row['position_ratio']:9.2f} {row['cpu_s']:6.0f}", flush=True)
    if arguments.check and missed:
        sys.exit("\n".join(missed))


if __name__ == "__main__":
    main()
