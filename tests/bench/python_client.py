#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measures the processor time of the Python client, compared with that of the command evpose, for the same recording and server.

Prints the events per second of processor time of the Python client (a RAW file, and arrays of events), and the ratio of its processor time
to that of `evpose replay --server`, both for the whole process and without the start of the interpreter; and the events per second of wall
time, from the first event to the last pose, which the server limits, too. With --core the client runs on this core alone, and the server on
all others. The recording is that of a simulated EVK4 with noise in every pixel. Each figure is the least of the repetitions, of processor
time or of wall time. Needs a release build. The target is 10 Mev/s on one core.
"""
import argparse
import json
import os
import pathlib
import resource
import subprocess
import sys
import tempfile
import time

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))
from processes import Server, simulate  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]
PYTHON = "/usr/bin/python3"  # Debian's, which has the packages


def measure(address, scene, kind):
    """Runs in a process of its own: streams a recording once and prints what it took."""
    import numpy as np

    import evpose

    with evpose.connect(address) as client, evpose.Recording(scene / "recording.raw") as recording:
        camera = evpose.read_camera(scene / "camera.yaml")
        model = client.upload_model(scene / "model.obj")
        source, encoding = recording, recording.encoding
        if kind == "arrays":
            # Random events in the order of time, as many per second as in the recording: only the cost of the client matters.
            numbers = np.random.default_rng(1)
            count = 5_000_000
            events = evpose.make_events(numbers.integers(camera.width_px, size=count), numbers.integers(camera.height_px, size=count),
                                        numbers.integers(2, size=count), np.arange(count) // 10)
            source, encoding = np.array_split(events, count // 16384), evpose.Encoding.FLAT64
        session = client.create_session(model, camera, encoding)
        begin, begin_s = time.process_time(), time.perf_counter()
        track = session.track(source)
        poses = track.read_all()
        cpu_s, wall_s = time.process_time() - begin, time.perf_counter() - begin_s
        session.delete()
    print(json.dumps({"cpu_s": cpu_s, "wall_s": wall_s, "events": track.summary.health.decoded_events, "poses": len(poses), "bytes": track.summary.sent_bytes}))


def on_cores(cores):
    """The settings of a process that runs on these cores only; on all if there are none."""
    return {"preexec_fn": lambda: os.sched_setaffinity(0, cores)} if cores else {}


def child_cpu_s(command, **settings):
    """Returns the processor time of a process and what it prints."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    output = subprocess.run(command, check=True, capture_output=True, text=True, **settings).stdout
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, output


def compare(arguments, address, scene):
    evpose = arguments.bin / "client/cli/evpose"
    environment = {**os.environ, "PYTHONPATH": str(arguments.bin / "client/python")}
    cores = on_cores({arguments.core} if arguments.core is not None else set())

    def least(command, **settings):
        return min((child_cpu_s(command, **settings, **cores) for _ in range(arguments.repetitions)), key=lambda run: run[0])

    inputs = ["--model", f"{scene}/model.obj", "--camera", f"{scene}/camera.yaml"]
    cli_cpu_s, _ = least([evpose, "replay", f"{scene}/recording.raw", *inputs, "--server", address])
    import_cpu_s, _ = least([PYTHON, "-c", "import evpose"], env=environment, cwd=scene)
    rows = []
    for kind in ("raw", "arrays"):
        runs = [child_cpu_s([PYTHON, __file__, "--measure", address, scene, kind], env=environment, **cores) for _ in range(arguments.repetitions)]
        process_cpu_s = min(cpu_s for cpu_s, _ in runs)
        runs = [json.loads(output) for _, output in runs]
        figures = min(runs, key=lambda each: each["cpu_s"])
        wall_s = min(each["wall_s"] for each in runs)
        rows.append({**figures, "kind": kind, "wall_s": wall_s, "process_cpu_s": process_cpu_s,
                     "mev_per_cpu_s": figures["events"] / figures["cpu_s"] * 1e-6, "mev_per_wall_s": figures["events"] / wall_s * 1e-6})
    return {"rows": rows, "cli_cpu_s": cli_cpu_s, "import_cpu_s": import_cpu_s, "ratio_to_replay": rows[0]["cpu_s"] / cli_cpu_s,
            "whole_process_ratio": rows[0]["process_cpu_s"] / cli_cpu_s}


def print_table(result):
    print(f"{'':24}{'events':>12}{'poses':>8}{'client s':>10}{'Mev/s of client':>17}{'Mev/s of wall time':>20}{'ratio to CLI':>14}")
    for row in result["rows"]:
        ratio = f"{result['ratio_to_replay']:14.2f}" if row["kind"] == "raw" else ""
        print(f"{'Python, ' + row['kind']:24}{row['events']:12}{row['poses']:8}{row['cpu_s']:10.3f}{row['mev_per_cpu_s']:17.1f}"
              f"{row['mev_per_wall_s']:20.1f}{ratio}")
        if row["kind"] == "raw":
            print(f"{'  whole process':24}{'':20}{row['process_cpu_s']:10.3f}{'':37}{result['whole_process_ratio']:14.2f}")
            print(f"{'  import of the package':24}{'':20}{result['import_cpu_s']:10.3f}")
            print(f"{'evpose replay':24}{row['events']:12}{row['poses']:8}{result['cli_cpu_s']:10.3f}"
                  f"{row['events'] / result['cli_cpu_s'] * 1e-6:17.1f}{'':20}{1.0:14.2f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build/release")
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--noise", type=float, default=25.0, help="events per second of a dark pixel")
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--core", type=int, help="core of the client; the server runs on the others")
    parser.add_argument("--measure", nargs=3, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        address, scene, kind = arguments.measure
        measure(address, pathlib.Path(scene), kind)
        return
    arguments.bin = arguments.bin.resolve()
    with tempfile.TemporaryDirectory() as scene:
        simulate(arguments.bin / "client/cli/evpose", scene, "--object", "cube", "--camera", "evk4", "--duration", arguments.seconds,
                 "--background-activity", arguments.noise)
        others = sorted(os.sched_getaffinity(0) - {arguments.core})
        if arguments.core is not None and (not others or arguments.core not in os.sched_getaffinity(0)):
            parser.error("--core: must be one of the cores of this process, which needs a second one for the server")
        prefix = ("taskset", "-c", ",".join(map(str, others))) if arguments.core is not None else ()
        with Server(arguments.bin / "server/evpose-server", "--log-level", "off", "--max-session-cpu", "0", prefix=prefix) as server:
            result = compare(arguments, server.address, scene)
    if arguments.json:
        print(json.dumps(result))
    else:
        print_table(result)


if __name__ == "__main__":
    main()
