#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Measures the latency of a live camera beside other sessions of the same server:

- alone;
- beside replays, as fast as the server takes them;
- beside two sessions with 16 objects of a model with 4096 lines and as many triangles, up to 100 000, as the server admits;
- the same with a store on the disk, to which sessions write their state in their turns;
- beside two sessions with 16 objects of a curved body of 100 000 triangles.

The number of triangles that a server admits depends on the machine: give --triangles to compare machines.

Each case is measured with the search for the first pose, which delays the poses of the first 0.1 s, one percent of the recording, and with
a given first pose. Prints the latency from the receipt of a chunk to its poses, the time that the camera's recording took, the longest turn
of a session on a worker (the upper bound of its bucket), and whether the poses of the camera are those without neighbours, to the bit. Needs
a release build, python3-numpy, and no other load on the machine.
"""
import argparse
import contextlib
import json
import math
import os
import pathlib
import random
import re
import subprocess
import sys
import tempfile
import threading
import time

import model_preparation

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))
from processes import Server, first_pose, simulate  # noqa: E402

SENSOR_SECONDS = 10
CURVED_TRIANGLES = 100_000
LARGE_CHUNK_BYTES = 262144


def write_expensive_model(path, triangles, lines=4096):
    """Random triangles in a cube of 0.15 m, and lines between random points of it."""
    numbers = random.Random(1)
    with open(path, "w", encoding="ascii") as file:
        points = 3 * triangles + 2 * lines
        for _ in range(points):
            file.write("v " + " ".join(f"{numbers.uniform(-0.075, 0.075):.5f}" for _ in range(3)) + "\n")
        for i in range(triangles):
            file.write(f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}\n")
        for i in range(3 * triangles, points, 2):
            file.write(f"l {i + 1} {i + 2}\n")


def serve(folder, *arguments, store="memory"):
    return Server(os.path.join(folder, "server/evpose-server"), "--log-level", "error", *arguments, store=store)


def num_attached(server):
    return int(server.metric("evpose_sessions", 'state="attached"'))


def longest_turn_ms(server):
    rows = re.findall(r'^evpose_turn_seconds_bucket\{le="([^"]+)"\} (\S+)', server.page("/metrics")[1], re.M)
    total = float(rows[-1][1])
    return next(1e3 * float(bound.replace("+Inf", "inf")) for bound, count in rows if float(count) == total)


class Neighbour:
    """Runs a command again and again until stop()."""

    def __init__(self, command):
        self.command = command
        self.process = None
        self.failure = None  # the reason for which it has ended by itself
        self.is_stopping = False
        self.lock = threading.Lock()
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.thread.start()

    def run(self):
        while True:
            with self.lock:
                if self.is_stopping:
                    return
                try:
                    self.process = subprocess.Popen(self.command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
                except OSError as error:
                    self.failure = str(error)
                    return
            errors = self.process.communicate()[1]
            # The expensive model is not the object in the recording.
            if self.process.returncode != 0 and "no pose was found" not in errors and not self.is_stopping:
                self.failure = f"failed: {' '.join(self.command)}: {errors}"
                return

    def stop(self):
        with self.lock:
            self.is_stopping = True
            if self.process is not None:
                self.process.kill()
        self.thread.join()

    def check(self):
        if self.failure is not None:
            sys.exit(f"neighbour.py: {self.failure}")


def measure(options, scratch, neighbours, is_on_disk, start):
    """One run of the camera; `neighbours` are lists of arguments of evpose replay, `start` further arguments of the camera. Returns its
    report and its poses."""
    evpose = os.path.join(options.bin, "client/cli/evpose")
    cube = os.path.join(scratch, "cube")
    recording = [os.path.join(cube, "recording.raw"), "--camera", os.path.join(cube, "camera.yaml")]
    out = os.path.join(scratch, "poses.tum")
    with contextlib.ExitStack() as cleanup:
        workers = [] if options.workers is None else ["--workers", options.workers]
        server = cleanup.enter_context(serve(options.bin, *workers, store="sqlite" if is_on_disk else "memory"))
        running = []
        for arguments in neighbours:
            running.append(Neighbour([evpose, "replay", *recording, "--server", server.address, "--rate", "max", *arguments]))
            cleanup.callback(running[-1].stop)
        while num_attached(server) < len(neighbours):
            for neighbour in running:
                neighbour.check()
            time.sleep(0.1)
        time.sleep(2.0 if neighbours else 0.0)
        camera = subprocess.run([evpose, "replay", *recording, "--model", os.path.join(cube, "model.obj"), "--server", server.address,
                                 "--rate", "1", "--json", "--out", out, *start], check=True, stdout=subprocess.PIPE, text=True)
        report = json.loads(camera.stdout)
        report["longest_turn_ms"] = longest_turn_ms(server)
        for neighbour in running:
            neighbour.check()
    with open(out, "rb") as file:
        return report, file.read()


def write_admitted_model(options, scratch, path):
    """Writes the most expensive model that a server prepares within its budget, or that of options.triangles; returns its number of
    triangles."""
    cube = os.path.join(scratch, "cube")
    short = os.path.join(scratch, "short.raw")
    with open(os.path.join(cube, "recording.raw"), "rb") as file, open(short, "wb") as out:
        out.write(file.read(20_000))
    with serve(options.bin) as server:
        for triangles in [options.triangles] if options.triangles else (100_000, 50_000, 20_000, 10_000, 5000, 2000):
            write_expensive_model(path, triangles)
            done = subprocess.run([os.path.join(options.bin, "client/cli/evpose"), "replay", short, "--camera",
                                   os.path.join(cube, "camera.yaml"), "--server", server.address, "--model", path],
                                  check=False, capture_output=True, text=True)
            if done.returncode == 0 or "no pose was found" in done.stderr:
                return triangles
            if "simplify it" not in done.stderr:
                sys.exit(f"neighbour.py: {done.stderr}")
    sys.exit(f"neighbour.py: the server admits no model with 4096 lines{f' and {options.triangles} triangles' if options.triangles else ''}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", default="build/release", help="build folder (default: %(default)s)")
    parser.add_argument("--workers", type=int, help="--workers of the server; default: one per core")
    parser.add_argument("--replays", type=int, default=8, help="replays beside the camera (default: %(default)s)")
    parser.add_argument("--triangles", type=int, help="triangles of the expensive model; default: as many as the server admits")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        simulate(os.path.join(options.bin, "client/cli/evpose"), os.path.join(scratch, "cube"), "--object", "cube", "--duration",
                 SENSOR_SECONDS, "--noise", "0.1", "--seed", "1")
        cube = os.path.join(scratch, "cube/model.obj")
        expensive = os.path.join(scratch, "expensive.obj")
        triangles = write_admitted_model(options, scratch, expensive)
        replay = ["--model", cube, "--chunk-bytes", str(LARGE_CHUNK_BYTES)]
        curved = os.path.join(scratch, "curved.stl")
        model_preparation.blob(CURVED_TRIANGLES, curved)

        def objects(model):
            return [argument for i in range(16) for argument in ("--object", f"o{i}={model}")]

        cases = [("alone", [], False), (f"beside {options.replays} replays", [replay] * options.replays, False),
                 (f"beside 2 sessions, 16 objects of {triangles} triangles", [objects(expensive)] * 2, False),
                 ("the same with --store sqlite", [objects(expensive)] * 2, True),
                 (f"beside 2 sessions, 16 curved objects of {CURVED_TRIANGLES}", [objects(curved)] * 2, False)]
        starts = [("search", []), ("given", ["--init-pose", first_pose(os.path.join(scratch, "cube"))])]
        print(f"{'camera':<52} {'first pose':<10} {'p50':>8} {'p99':>8} {'took':>8} {'longest turn':>13}  poses")
        references = {}
        for name, neighbours, is_on_disk in cases:
            for kind, start in starts:
                report, poses = measure(options, scratch, neighbours, is_on_disk, start)
                same = "identical" if poses == references.setdefault(kind, poses) else "DIFFERENT"
                turn = report["longest_turn_ms"]
                print(f"{name:<52} {kind:<10} {report['latency_p50_ms']:>5.2f} ms {report['latency_p99_ms']:>5.1f} ms "
                      f"{report['wall_time_s']:>6.2f} s {'> 10 s' if math.isinf(turn) else f'<= {turn:g} ms':>13}  {same}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
