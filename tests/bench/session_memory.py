#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measures the memory of a session after one second of noise that touched every pixel.

For each case it starts evpose-server, replays a recording of noise through it, and prints in MB: the memory that the server charges for
the session, the growth of its resident memory when the session has been created, and the growth of its peak. With --check, status 1 if
a peak exceeds its charge or, with the cube, the goal of the case. Last, a session with 16 large models of which only some fit into the
memory of sessions is refused; its charge is the limit. Needs a release build and python3-numpy; about a minute.

Example: tests/bench/session_memory.py --bin build/release --check
"""
import argparse
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time
import typing

import model_preparation
import numpy

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))
from processes import Server, cube_obj  # noqa: E402

CAMERA = """image_width: {width}
image_height: {height}
camera_matrix: {{rows: 3, cols: 3, data: [{focal}, 0, {cx}, 0, {focal}, {cy}, 0, 0, 1]}}
distortion_model: {model}
distortion_coefficients: {{rows: 1, cols: {num_coefficients}, data: [{coefficients}]}}
"""


class Lens(typing.NamedTuple):
    """As in a camera file. The focal length is in widths of the image."""

    focal: float = 0.8
    model: str = "plumb_bob"
    coefficients: tuple = (0.0,) * 5


class Case(typing.NamedTuple):
    """The goal of the peak is in MB; 0: none."""

    name: str
    width: int
    height: int
    lens: Lens = Lens()
    num_objects: int = 1
    goal_mb: int = 0


RATIONAL = Lens(model="rational_polynomial", coefficients=(0.1, -0.05, 0.0005, 0.0005, 0.01, 0.05, 0.01, 0.001))
# 180 degrees: objects are sought and followed in several views of it.
FISHEYE = Lens(focal=0.32, model="equidistant", coefficients=(0.02, -0.005, 0.001, 0.0))
CASES = [
    Case("346 x 260, 1 object", 346, 260),
    Case("640 x 480, 1 object", 640, 480),
    Case("4096 x 4096, 1 object", 4096, 4096, goal_mb=60),
    Case("4096 x 4096, 16 objects", 4096, 4096, num_objects=16, goal_mb=200),
    Case("4096 x 4096 with distortion, 1 object", 4096, 4096, Lens(coefficients=(-0.01, 0.0, 0.0, 0.0, 0.0))),
    Case("1280 x 720, rational lens, 1 object", 1280, 720, RATIONAL),
    Case("1280 x 720, fisheye, 1 object", 1280, 720, FISHEYE),
]
# Its models together take several times the limit.
REFUSED = "16 models that do not fit, refused"
REFUSED_LIMIT_MB = 150
REFUSED_TRIANGLES = 50_000
MIN_EVENTS = 2_000_000  # a small sensor has several events per pixel, so that the search's memory of events is full


def write_noise(path, width, height):
    """A DAT file with one second of events at all pixels, in a random order."""
    random = numpy.random.default_rng(1)
    pixels = numpy.tile(random.permutation(width * height).astype(numpy.uint64), 1 + MIN_EVENTS // (width * height))
    times_us = numpy.arange(pixels.size, dtype=numpy.uint64) * 1_000_000 // pixels.size
    polarity = random.integers(0, 2, pixels.size).astype(numpy.uint64)
    words = times_us | (pixels % width) << 32 | (pixels // width) << 46 | polarity << 60
    with open(path, "wb") as file:
        file.write(f"% Data file containing CD events.\n% Version 2\n% Height {height}\n% Width {width}\n".encode() + bytes([12, 8]))
        words.astype("<u8").tofile(file)


def replay(evpose, server, recording, folder, case, models):
    lens = case.lens
    camera = os.path.join(folder, "camera.yaml")
    with open(camera, "w", encoding="ascii") as file:
        file.write(CAMERA.format(width=case.width, height=case.height, focal=lens.focal * case.width, cx=case.width / 2, cy=case.height / 2,
                                 model=lens.model, num_coefficients=len(lens.coefficients),
                                 coefficients=", ".join(str(number) for number in lens.coefficients)))
    command = [evpose, "replay", recording, "--camera", camera, "--server", server.address]
    for i, path in enumerate(models):
        command += ["--object", f"object{i}={path}"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def measure(binaries, store, case, model):
    """Charged, resident after the creation, and peak, in MB."""
    evpose = os.path.join(binaries, "client/cli/evpose")
    program = os.path.join(binaries, "server/evpose-server")
    options = ["--workers", "1", "--max-session-memory", "1000000000000", "--log-level", "error"]
    with tempfile.TemporaryDirectory() as folder, Server(program, *options, store=store) as server:
        recording = os.path.join(folder, "noise.dat")
        write_noise(recording, 64, 64)
        cube = os.path.join(folder, "cube.obj")
        pathlib.Path(cube).write_bytes(cube_obj(-0.1, 0.1))
        warm_up = replay(evpose, server, recording, folder, Case("", 64, 64), [cube])
        warm_up.communicate()
        write_noise(recording, case.width, case.height)
        before_mb = server.resident_bytes() / 1e6
        with open(f"/proc/{server.process.pid}/clear_refs", "w", encoding="ascii") as file:
            file.write("5")  # the peak begins anew
        charged_mb = created_mb = 0.0
        client = replay(evpose, server, recording, folder, case, case.num_objects * [model or cube])
        while client.poll() is None:
            charged_mb = max(charged_mb, server.metric("evpose_session_memory_bytes") / 1e6)
            now_mb = server.resident_bytes() / 1e6
            before_mb = min(before_mb, now_mb)  # the server gives back memory of the first session some time after its end
            if charged_mb > 0 and created_mb == 0:
                created_mb = now_mb - before_mb
            time.sleep(0.02)
        errors = client.stderr.read()
        if client.returncode != 0 and "no pose was found" not in errors:  # which is expected in noise
            sys.exit(f"{case.name}: {errors.strip()}")
        return charged_mb, created_mb, server.peak_bytes() / 1e6 - before_mb


def measure_refused(binaries):
    """Sessions with 16 large models that do not fit: the limit and the peak, in MB, of a server that has loaded none of them."""
    evpose = os.path.join(binaries, "client/cli/evpose")
    program = os.path.join(binaries, "server/evpose-server")
    options = ["--max-session-memory", str(REFUSED_LIMIT_MB * 1_000_000), "--log-level", "error"]
    with tempfile.TemporaryDirectory() as folder, Server(program, *options, store="sqlite") as server:
        recording = os.path.join(folder, "noise.dat")
        write_noise(recording, 64, 64)
        models = [os.path.join(folder, f"{i}.stl") for i in range(16)]
        for i, path in enumerate(models):
            model_preparation.blob(REFUSED_TRIANGLES + 1000 * i, path)

        def attempt():
            errors = replay(evpose, server, recording, folder, Case("", 64, 64), models).communicate()[1]
            if "the session may need" not in errors:
                sys.exit(f"a session with 16 models is not refused for its memory: {errors.strip()}")

        attempt()  # uploads the models
        server.terminate()
        server.start()
        before_mb = server.resident_bytes() / 1e6
        attempt()
        return server.peak_bytes() / 1e6 - before_mb


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", default="build/release", help="directory of the build")
    parser.add_argument("--store", default="memory", choices=["memory", "sqlite"], help="with sqlite, checkpoints count, too")
    parser.add_argument("--model", help="model of the objects, instead of a cube")
    parser.add_argument("--only", default="", metavar="REGEX", help="only the cases with such a name, as 'lens|fisheye'")
    parser.add_argument("--check", action="store_true", help="fail if a peak exceeds its charge or its goal")
    arguments = parser.parse_args()
    cases = [case for case in CASES if re.search(arguments.only, case.name)]
    failures = 0
    print("| session | charged, MB | after its creation, MB | peak, MB | goal, MB |\n| --- | --- | --- | --- | --- |")
    for case in cases:
        goal_mb = 0 if arguments.model else case.goal_mb
        charged_mb, created_mb, peak_mb = measure(arguments.bin, arguments.store, case, arguments.model)
        print(f"| {case.name} | {charged_mb:.0f} | {created_mb:.0f} | {peak_mb:.0f} | {goal_mb or '-'} |", flush=True)
        failures += peak_mb > charged_mb or (goal_mb > 0 and peak_mb > goal_mb)
    if re.search(arguments.only, REFUSED):
        peak_mb = measure_refused(arguments.bin)
        goal_mb = 2 * REFUSED_LIMIT_MB
        print(f"| {REFUSED} | {REFUSED_LIMIT_MB} | - | {peak_mb:.0f} | {goal_mb} |", flush=True)
        failures += peak_mb > goal_mb
    if arguments.check and failures:
        sys.exit(f"{failures} sessions take more than they are charged, or than their goal")


if __name__ == "__main__":
    main()
