#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measures the processor time of a server for images of the events of a session (SessionService.WatchEvents): of the first watcher, and of
each further one.

A session tracks a cube that a simulated EVK4 sees, with noise in every pixel, in real time: about 10 Mev/s. While it runs, the number of
watchers changes from slice to slice: 0 1 1 0 0 1 ..., in another session 1 9 9 1 1 9 ... The difference of the server's processor time
between the two slices of a pair is that of the watchers, without the differences between runs. Printed are the mean of the differences in
percent of a core, with its standard error, and the size of an image. For further watchers the mean and the error are divided by their
number, 8. The watchers are threads of this process. Needs a release build.
"""
import argparse
import contextlib
import itertools
import json
import pathlib
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time

import grpc

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))
from processes import Server, first_pose, load_api, simulate  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]
SERVICE = "/evpose.v1.SessionService/"
SETTLED_S = 0.05  # after a change of the number of watchers


def messages():
    from evpose.v1 import session_service_pb2

    return session_service_pb2


class Watcher:
    """A watcher of the images of a session, in a thread."""

    def __init__(self, channel, session, arguments):
        api = messages()
        request = api.WatchEventsRequest(session=session, cell_px=arguments.cell_px, max_rate_hz=arguments.rate)
        self.call = channel.unary_stream(SERVICE + "WatchEvents", api.WatchEventsRequest.SerializeToString, lambda data: data)(request)
        self.images = self.num_bytes = 0
        self.is_watching = threading.Event()  # it has an image, or its stream has ended
        self.error = None
        self.thread = threading.Thread(target=self._read)
        self.thread.start()

    def _read(self):
        try:
            for data in self.call:
                self.images, self.num_bytes = self.images + 1, self.num_bytes + len(data)
                self.is_watching.set()
        except grpc.RpcError as error:
            # The end of the slice, or that of the session, which replay deletes.
            self.error = None if error.code() in (grpc.StatusCode.CANCELLED, grpc.StatusCode.NOT_FOUND) else error
        self.is_watching.set()

    def stop(self):
        self.call.cancel()
        self.thread.join()
        if self.error:
            raise self.error


class Watchers:
    """Watchers whose number changes. A context manager."""

    def __init__(self, address, session, arguments):
        self.channel = grpc.insecure_channel(address)
        self.session, self.arguments = session, arguments
        self.running = []
        self.images = self.num_bytes = 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.set(0)
        self.channel.close()

    def set(self, count):
        """Returns when each of this number of watchers has an image."""
        while len(self.running) > count:
            watcher = self.running.pop()
            watcher.stop()
            self.images, self.num_bytes = self.images + watcher.images, self.num_bytes + watcher.num_bytes
        while len(self.running) < count:
            self.running.append(Watcher(self.channel, self.session, self.arguments))
        for watcher in self.running:
            watcher.is_watching.wait()


def wait_for_session(address, replay):
    api = messages()
    with grpc.insecure_channel(address) as channel:
        call = channel.unary_unary(SERVICE + "ListSessions", api.ListSessionsRequest.SerializeToString, api.ListSessionsResponse.FromString)
        while replay.poll() is None:
            sessions = call(api.ListSessionsRequest()).sessions
            if sessions:
                return sessions[0].name
            time.sleep(0.01)
    raise RuntimeError("evpose replay has failed")


def process_ns(pid):
    """The processor time of all threads of a process (clock_getcpuclockid), which is exact to the nanosecond."""
    return time.clock_gettime_ns((~pid << 3) | 2)


def slices(server, replay, watchers, numbers, slice_s):
    """Yields the processor time of the server in seconds per second while the session runs, for each of `numbers` of watchers in turn."""
    for number in itertools.cycle(numbers):
        watchers.set(number)
        time.sleep(SETTLED_S)
        begin_ns, begin_cpu_ns = time.monotonic_ns(), process_ns(server.process.pid)
        time.sleep(slice_s)
        share = (process_ns(server.process.pid) - begin_cpu_ns) / (time.monotonic_ns() - begin_ns)
        if replay.poll() is not None:
            return
        yield share


def measure(arguments, scene, few, many):
    """Returns the differences between slices with many and with few watchers, the shares with few, both in cores, and the mean bytes of an
    image."""
    with contextlib.ExitStack() as cleanup:
        server = cleanup.enter_context(Server(arguments.bin / "server/evpose-server", "--log-level", "off", "--max-session-cpu", "0"))
        replay = subprocess.Popen([arguments.replay, "replay", scene / "recording.raw", "--model", scene / "model.obj", "--camera",
                                   scene / "camera.yaml", "--init-pose", first_pose(scene), "--server", server.address, "--rate", "1"],
                                  stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        cleanup.callback(replay.wait)
        cleanup.callback(replay.kill)
        watchers = cleanup.enter_context(Watchers(server.address, wait_for_session(server.address, replay), arguments))
        shares = list(slices(server, replay, watchers, (few, many, many, few), arguments.slice_s))
        if replay.wait() != 0:
            raise RuntimeError("evpose replay has failed")
    # The order within the pairs alternates, so that a drift of the load has no effect.
    pairs = [(b - a, a) if i % 2 == 0 else (a - b, b) for i, (a, b) in enumerate(zip(shares[::2], shares[1::2]))]
    return [more for more, _ in pairs], [share for _, share in pairs], watchers.num_bytes / max(1, watchers.images)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build/release")
    parser.add_argument("--replay", type=pathlib.Path, help="the program evpose; default: that of --bin")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--noise", type=float, default=11.5, help="events per second of a dark pixel")
    parser.add_argument("--cell-px", type=int, default=2)
    parser.add_argument("--rate", type=float, default=30.0)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--slice-s", type=float, default=0.5, help="duration of a slice")
    parser.add_argument("--repetitions", type=int, default=5, help="sessions of each kind")
    arguments = parser.parse_args()
    arguments.bin = arguments.bin.resolve()
    arguments.replay = arguments.replay or arguments.bin / "client/cli/evpose"
    with tempfile.TemporaryDirectory() as folder:
        scene, code = pathlib.Path(folder) / "scene", pathlib.Path(folder) / "code"
        code.mkdir()
        load_api(code)
        made = simulate(arguments.replay, scene, "--object", "cube", "--camera", "evk4", "--duration", arguments.seconds,
                        "--background-activity", arguments.noise)
        rate = float(re.search(r"([0-9.]+) Mev/s", made).group(1))
        result = {"mev_per_s": rate, "rate_hz": arguments.rate, "rows": []}
        if not arguments.json:
            print(f"{rate} Mev/s")
            print(f"{'watchers':12}{'server s/s':>12}{'% of a core more':>18}{'standard error':>16}{'pairs':>7}{'kB each':>9}")
        for title, few, many in (("the first", 0, 1), ("each further", 1, 9)):
            runs = [measure(arguments, scene, few, many) for _ in range(arguments.repetitions)]
            more = [100 * value / (many - few) for run in runs for value in run[0]]
            if len(more) < 2:
                parser.error("--seconds: is too short for two pairs of slices")
            error = statistics.stdev(more) / len(more) ** 0.5
            share = statistics.mean(value for run in runs for value in run[1])
            result["rows"].append({"watchers": title, "share": share, "more_percent": statistics.mean(more), "error_percent": error,
                                   "pairs": len(more), "image_kb": runs[0][2] / 1e3})
            if not arguments.json:
                print(f"{title:12}{share:12.3f}{statistics.mean(more):18.2f}{error:16.2f}{len(more):7}{runs[0][2] / 1e3:9.1f}", flush=True)
        if arguments.json:
            print(json.dumps(result))


if __name__ == "__main__":
    main()
