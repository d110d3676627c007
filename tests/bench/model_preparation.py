#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measures the preparation of large models: honest dense meshes, and meshes made to be expensive.

Each case is prepared by evpose-prepare-model as a server does it, within the same budget, and prints the processor time, the peak of
the resident memory, the triangles, lines and curves of the model, and the longest steps. A case that exceeds the budget has status
"time" or "memory", one that is refused "refused". With --check, the status is 1 if a case exceeds the goal (on honest meshes:
1 s for up to 100,000 triangles, 6 s for a million, linear in between) or the budget. Needs a release build and python3-numpy.

Example: tests/bench/model_preparation.py --bin build/release --triangles 100000
"""
import argparse
import math
import multiprocessing
import os
import pathlib
import signal
import struct
import subprocess
import sys
import tempfile
import time

import numpy

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent / "models"))
from part import write_stl  # noqa: E402
from shapes import SHAPES  # noqa: E402

FORMATS = {".obj": "1", ".stl": "3"}  # ModelFormat of the API
OUT_OF_MEMORY = 3  # kPreparationOutOfMemory
MAX_FILE_BYTES = 128 << 20  # twice the default of a server, for line elements of a million lines


def write_triangles(path, corners):
    """Binary STL of an array (n, 3, 3) in metres."""
    records = numpy.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    records["corners"] = corners
    with open(path, "wb") as file:
        file.write(b"evpose bench models".ljust(80) + struct.pack("<I", len(corners)))
        file.write(records.tobytes())


def grid_triangles(points):
    """Triangles of an array (rows, columns, 3)."""
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    return numpy.concatenate([numpy.stack([a, b, c], -2).reshape(-1, 3, 3), numpy.stack([a, c, d], -2).reshape(-1, 3, 3)])


def cube_sphere(count, radius_of):
    """A closed surface about the origin, radius_of(directions) from it, of about `count` triangles of similar sizes."""
    sides = max(1, round(math.sqrt(count / 12)))
    steps = numpy.tan(numpy.linspace(-math.pi / 4, math.pi / 4, sides + 1))
    u, v = numpy.meshgrid(steps, steps, indexing="xy")
    faces = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            face = numpy.empty(u.shape + (3,))
            face[..., axis], face[..., (axis + 1) % 3], face[..., (axis + 2) % 3] = sign, sign * u, v
            direction = face / numpy.linalg.norm(face, axis=-1, keepdims=True)
            faces.append(grid_triangles(direction * radius_of(direction)[..., None]))
    return numpy.concatenate(faces)


def blob_radius(direction):
    x, y, z = numpy.moveaxis(direction, -1, 0)
    return 0.1 + 0.015 * numpy.sin(3 * x + 1) + 0.01 * numpy.sin(4 * y - 2 * z) + 0.008 * numpy.cos(5 * z + 2 * x)


def noise(direction, seed):
    """Repeatable noise of a point, because its triangles are written one by one."""
    cell = numpy.round(direction * 1e6).astype(numpy.int64)
    mixed = (cell[..., 0] * 73856093 ^ cell[..., 1] * 19349663 ^ cell[..., 2] * 83492791 ^ seed).astype(numpy.uint64)
    mixed = (mixed ^ mixed >> numpy.uint64(31)) * numpy.uint64(0x9E3779B97F4A7C15)
    return (mixed >> numpy.uint64(40)).astype(float) / 2**23 - 1.0


def sphere(count, path):
    write_triangles(path, cube_sphere(count, lambda d: numpy.full(d.shape[:-1], 0.1)))


def blob(count, path):
    write_triangles(path, cube_sphere(count, blob_radius))


def scan(count, path):
    """The blob with noise of up to 0.02 mm (1e-4 of its diameter)."""
    write_triangles(path, cube_sphere(count, lambda d: blob_radius(d) + 2e-5 * noise(d, 1)))


def shape(name):
    def write(count, path):
        """A shape of `evpose bench models`, with so many facets per circle that there are about `count` triangles."""
        low, high = (len(SHAPES[name](sides).triangles) for sides in (60, 120))
        # The number of triangles of flat ends is linear in the number of sides, that of doubly curved surfaces quadratic.
        quadratic = (high - 2 * low) / (2 * 60**2)
        linear = low / 60 - 60 * quadratic
        sides = (math.sqrt(linear**2 + 4 * quadratic * count) - linear) / (2 * quadratic)
        write_stl(path, SHAPES[name](round(sides / 4) * 4), 0.001)
    return write


def soup(count, path):
    write_triangles(path, numpy.random.default_rng(1).uniform(-0.1, 0.1, (count, 3, 3)))


def dust(count, path):
    random = numpy.random.default_rng(1)
    write_triangles(path, random.uniform(-0.1, 0.1, (count, 1, 3)) + random.uniform(-1e-3, 1e-3, (count, 3, 3)))


def flat_soup(count, path):
    corners = numpy.random.default_rng(1).uniform(-0.1, 0.1, (count, 3, 3))
    corners[..., 2] = 0.0
    write_triangles(path, corners)


def one_line(count, path):
    """Each triangle has a side on one line."""
    corners = numpy.random.default_rng(1).uniform(-0.1, 0.1, (count, 3, 3))
    corners[:, :2, 1:] = 0.0
    write_triangles(path, corners)


def plates(count, path):
    """Ten coincident square plates, whose diagonals and divisions differ."""
    plates_ = []
    for i in range(10):
        sides = max(1, round(math.sqrt(count / 20))) + i
        u, v = numpy.meshgrid(numpy.linspace(-0.1, 0.1, sides + 1), numpy.linspace(-0.1, 0.1, sides + 1))
        points = numpy.stack([u, v, 0 * u], -1)
        plates_.append(grid_triangles(points if i % 2 else points[::-1]))
    write_triangles(path, numpy.concatenate(plates_))


def fan(count, path):
    """A bumpy disc of triangles about one vertex, wide enough that its points are not welded."""
    turns = numpy.linspace(0, 2 * math.pi, count + 1)
    rim = numpy.stack([100 * numpy.cos(turns), 100 * numpy.sin(turns), numpy.sin(5 * turns)], -1)
    write_triangles(path, numpy.stack([numpy.zeros((count, 3)), rim[:-1], rim[1:]], 1))


def cone(count, path):
    """Shells of needles between two vertices."""
    turns = numpy.random.default_rng(1).uniform(0, 2 * math.pi, (count, 1))
    radius = numpy.random.default_rng(2).uniform(0.01, 0.1, (count, 1))
    rim = numpy.concatenate([radius * numpy.cos(turns), radius * numpy.sin(turns), numpy.zeros((count, 1))], 1)
    write_triangles(path, numpy.stack([numpy.tile([0, 0, -0.1], (count, 1)), numpy.tile([0, 0, 0.1], (count, 1)), rim], 1))


def write_lines(path, begin, end):
    with open(path, "w", encoding="ascii") as file:
        numpy.savetxt(file, numpy.concatenate([begin, end]), fmt="v %.5f %.5f %.5f")
        numpy.savetxt(file, numpy.stack([numpy.arange(len(begin)) + 1, numpy.arange(len(begin)) + 1 + len(begin)], -1), fmt="l %d %d")


def short_lines(count, path):
    random = numpy.random.default_rng(1)
    begin = random.uniform(-1, 1, (count, 3))
    write_lines(path, begin, begin + random.uniform(-1e-2, 1e-2, (count, 3)))


def lines_of_one(count, path):
    """Line elements that overlap on one line."""
    begin = numpy.zeros((count, 3))
    begin[:, 0] = numpy.random.default_rng(1).uniform(-1, 1, count)
    end = begin.copy()
    end[:, 0] += numpy.random.default_rng(2).uniform(-1e-2, 1e-2, count)
    end[0, 1] = 1.0
    write_lines(path, begin, end)


HONEST = {"sphere": sphere, "blob": blob, "scan": scan, "mug": shape("mug"), "flange": shape("flange"), "torus": shape("torus")}
HOSTILE = {"soup": soup, "dust": dust, "flat_soup": flat_soup, "one_line": one_line, "plates": plates, "fan": fan, "cone": cone,
           "short_lines": short_lines, "lines_of_one": lines_of_one}


def generate(name, count, path):
    """Writes the mesh of a case, in a process of its own: a child starts with the peak memory of its parent, and evpose-prepare-model would
    be charged with the mesh."""
    process = multiprocessing.get_context("fork").Process(target=(HONEST | HOSTILE)[name], args=(count, path))
    process.start()
    process.join()
    if process.exitcode != 0:
        sys.exit(f"{name} {count}: the mesh was not generated")


def varint(data, at):
    number = shift = 0
    while True:
        byte = data[at]
        at += 1
        number |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            return number, at


def parts_of(model):
    """Counts and notices of a serialized PreparedModel (proto/evpose/storage/v1/model.proto)."""
    triangles, lines, curves, notices, at = 0, 0, 0, [], 0
    while at < len(model):
        tag, at = varint(model, at)
        size = 8
        if tag & 7 == 2:
            size, at = varint(model, at)
        field, content = tag >> 3, memoryview(model)[at:at + size]
        if field == 2:
            triangles = int(numpy.count_nonzero(numpy.frombuffer(content, numpy.uint8) < 128)) // 3
        lines += field == 3
        curves += field == 7
        if field == 6:
            notices.append(bytes(content).decode())
        at += size
    return triangles, lines, curves, notices


def prepare(program, path, budget):
    """Returns status, processor seconds, megabytes, seconds of the steps, and the serialized model and views."""
    command = [program, FORMATS[path.suffix], "1", "30", "1", str(MAX_FILE_BYTES), str(budget[0]), str(budget[1] << 20)]
    with open(path, "rb") as file, subprocess.Popen(command, stdin=file, stdout=subprocess.PIPE) as process:
        steps, model, views = [], b"", b""
        for line in process.stdout:
            steps.append((time.monotonic(), line[:-1].decode(errors="replace")))
            if not line.startswith(b"step "):
                if line.startswith(b"model "):
                    model = process.stdout.read(int(line[6:]))
                    steps.append((time.monotonic(), "step finding the views"))
                    views = process.stdout.read()
                break
        steps.append((time.monotonic(), ""))
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    durations = [(after[0] - step[0], step[1].removeprefix("step ")) for step, after in zip(steps, steps[1:]) if step[1].startswith("step ")]
    outcome = "ok"
    if process.returncode == OUT_OF_MEMORY:
        outcome = "memory"
    elif process.returncode == -signal.SIGXCPU:
        outcome = "time"
    elif process.returncode < 0:
        outcome = f"signal {-process.returncode}"
    elif not model:
        outcome = "refused" if any(step == "error" for _, step in steps) else f"status {process.returncode}"
    return outcome, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024 / 1e6, durations, model, views


def goal_s(name, count):
    return 1.0 + 5.0 * max(0.0, count / 1e5 - 1.0) / 9.0 if name in HONEST else math.inf


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, default=pathlib.Path("build/release"), help="build directory (default %(default)s)")
    parser.add_argument("--triangles", default="100000,1000000", help="triangles or lines of each case (default %(default)s)")
    parser.add_argument("--cases", default=",".join([*HONEST, *HOSTILE]), help="default: %(default)s")
    parser.add_argument("--seconds", type=int, default=10, help="budget of processor time (default %(default)s)")
    parser.add_argument("--megabytes", type=int, default=1024, help="budget of address space (default %(default)s)")
    parser.add_argument("--keep", type=pathlib.Path, help="keeps the meshes and the prepared models in this directory")
    parser.add_argument("--notices", action="store_true", help="prints what was repaired")
    parser.add_argument("--check", action="store_true", help="status 1 if a case exceeds its goal or the budget")
    arguments = parser.parse_args()
    cases = arguments.cases.split(",")
    if unknown := [name for name in cases if name not in HONEST | HOSTILE]:
        parser.error(f"no case {', '.join(unknown)}; there are {', '.join(HONEST | HOSTILE)}")
    program = arguments.bin / "server" / "evpose-prepare-model"
    failed = []
    print(f"{'case':14}{'triangles':>10}  {'status':8}{'seconds':>8}{'MB':>6}{'kept':>9}{'lines':>9}{'curves':>8}{'model/KB':>10}{'views/KB':>9}  steps of 0.1 s or more")
    with tempfile.TemporaryDirectory() as temporary:
        directory = arguments.keep or pathlib.Path(temporary)
        directory.mkdir(parents=True, exist_ok=True)
        for count in (int(text) for text in arguments.triangles.split(",")):
            for name in cases:
                path = directory / f"{name}-{count}{'.obj' if 'lines' in name else '.stl'}"
                if not path.exists():
                    generate(name, count, path)
                outcome, seconds, megabytes, steps, model, views = prepare(program, path, (arguments.seconds, arguments.megabytes))
                triangles, lines, curves, notices = parts_of(model) if outcome == "ok" else (0, 0, 0, [])
                longest = ", ".join(f"{step} {duration:.1f}" for duration, step in steps if duration >= 0.1)
                print(f"{name:14}{count:10}  {outcome:8}{seconds:8.2f}{megabytes:6.0f}{triangles:9}{lines:9}{curves:8}"
                      f"{len(model) // 1000:10}{len(views) // 1000:9}  {longest}", flush=True)
                if arguments.notices:
                    print("".join(f"    {notice}\n" for notice in notices), end="")
                if arguments.keep:
                    path.with_suffix(".prepared").write_bytes(model + views)
                else:
                    path.unlink()
                if outcome not in ("ok", "refused") or seconds > goal_s(name, count):
                    failed.append(f"{name} {count}")
    if arguments.check and failed:
        sys.exit(f"over the goal or the budget: {', '.join(failed)}")


if __name__ == "__main__":
    main()
