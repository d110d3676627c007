#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measures the processor time of the Python client, compared with that of the command evpose, for the same recording and server.

Prints the events per second of processor time of the Python client (a RAW file, and arrays of events), and the ratio of its processor time
to that of `evpose replay --server`, both for the whole process and without the start of the interpreter. The recording is that of a
simulated EVK4 with noise in every pixel. Of the repetitions, that with the least processor time counts. Needs a release build. The target is 10 Mev/s on one core.
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
        begin = time.process_time()
        track = session.track(source)
        poses = track.read_all()
        cpu_s = time.process_time() - begin
        session.delete()
    print(json.dumps({"cpu_s": cpu_s, "events": track.summary.health.decoded_events, "poses": len(poses), "bytes": track.summary.sent_bytes}))


def child_cpu_s(command, **settings):
    """Returns the processor time of a process and what it prints."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    output = subprocess.run(command, check=True, capture_output=True, text=True, **settings).stdout
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, output


def compare(arguments, address, scene):
    evpose = arguments.bin / "client/cli/evpose"
    environment = {**os.environ, "PYTHONPATH": str(arguments.bin / "client/python")}

    def least(command, **settings):
        return min((child_cpu_s(command, **settings) for _ in range(arguments.repetitions)), key=lambda run: run[0])

    inputs = ["--model", f"{scene}/model.obj", "--camera", f"{scene}/camera.yaml"]
    cli_cpu_s, _ = least([evpose, "replay", f"{scene}/recording.raw", *inputs, "--server", address])
    import_cpu_s, _ = least([PYTHON, "-c", "import evpose"], env=environment, cwd=scene)
    print(f"{'':24}{'events':>12}{'poses':>8}{'client s':>10}{'Mev/s of client':>17}{'ratio to CLI':>14}")
    for kind in ("raw", "arrays"):
        runs = [child_cpu_s([PYTHON, __file__, "--measure", address, scene, kind], env=environment) for _ in range(arguments.repetitions)]
        process_cpu_s = min(cpu_s for cpu_s, _ in runs)
        figures = min((json.loads(output) for _, output in runs), key=lambda each: each["cpu_s"])
        rate = figures["events"] / figures["cpu_s"] * 1e-6
        ratio = f"{figures['cpu_s'] / cli_cpu_s:14.2f}" if kind == "raw" else ""
        print(f"{'Python, ' + kind:24}{figures['events']:12}{figures['poses']:8}{figures['cpu_s']:10.3f}{rate:17.1f}{ratio}")
        if kind == "raw":
            print(f"{'  whole process':24}{'':12}{'':8}{process_cpu_s:10.3f}{'':17}{process_cpu_s / cli_cpu_s:14.2f}")
            print(f"{'  import of the package':24}{'':12}{'':8}{import_cpu_s:10.3f}")
            print(f"{'evpose replay':24}{figures['events']:12}{figures['poses']:8}{cli_cpu_s:10.3f}"
                  f"{figures['events'] / cli_cpu_s * 1e-6:17.1f}{1.0:14.2f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build/release")
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--noise", type=float, default=25.0, help="events per second of a dark pixel")
    parser.add_argument("--repetitions", type=int, default=3)
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
        with Server(arguments.bin / "server/evpose-server", "--log-level", "off", "--max-session-cpu", "0") as server:
            compare(arguments, server.address, scene)


if __name__ == "__main__":
    main()
