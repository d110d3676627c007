#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measures the processor time of a server while images of the events of a session are watched (SessionService.WatchEvents).

A session tracks a cube that a simulated EVK4 sees, with noise in every pixel, in real time: about 10 Mev/s. For each number of watchers it
prints the processor time of the server in seconds per second of the recording, the difference from the row before in percent of a core, and
the images, their bytes and the skipped images of the first watcher. The watchers are processes of their own. Needs a release build.
"""
import argparse
import contextlib
import multiprocessing
import pathlib
import queue
import re
import subprocess
import sys
import tempfile
import time

import grpc

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))
from processes import Server, first_pose, load_api, simulate  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]
SERVICE = "/evpose.v1.SessionService/"


def messages():
    from evpose.v1 import session_service_pb2

    return session_service_pb2


def watch(address, session, cell_px, rate_hz, results):
    api = messages()
    request = api.WatchEventsRequest(session=session, cell_px=cell_px, max_rate_hz=rate_hz)
    images = num_bytes = skipped = 0
    with grpc.insecure_channel(address) as channel:
        call = channel.unary_stream(SERVICE + "WatchEvents", api.WatchEventsRequest.SerializeToString, lambda data: data)(request)
        try:
            for data in call:
                image = api.WatchEventsResponse.FromString(data).image
                images, num_bytes, skipped = images + 1, num_bytes + len(data), image.num_skipped
        except grpc.RpcError as error:
            if error.code() != grpc.StatusCode.NOT_FOUND:  # replay deletes its session at the end
                raise
    results.put({"images": images, "bytes": num_bytes, "skipped": skipped})


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


def measure(arguments, scene, num_watchers):
    with contextlib.ExitStack() as cleanup:
        server = cleanup.enter_context(Server(arguments.bin / "server/evpose-server", "--log-level", "off", "--max-session-cpu", "0"))
        replay = subprocess.Popen([arguments.replay, "replay", scene / "recording.raw", "--model", scene / "model.obj", "--camera",
                                   scene / "camera.yaml", "--init-pose", first_pose(scene), "--server", server.address, "--rate", "1"],
                                  stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        cleanup.callback(replay.wait)
        cleanup.callback(replay.kill)
        session = wait_for_session(server.address, replay)
        results = multiprocessing.Queue()
        for _ in range(num_watchers):
            watcher = multiprocessing.Process(target=watch, args=(server.address, session, arguments.cell_px, arguments.rate, results))
            watcher.start()
            cleanup.callback(watcher.join)
            cleanup.callback(watcher.kill)
        begin, begin_cpu_s = time.monotonic(), server.cpu_s()
        if replay.wait() != 0:
            raise RuntimeError("evpose replay has failed")
        end, end_cpu_s = time.monotonic(), server.cpu_s()
        try:
            seen = [results.get(timeout=60) for _ in range(num_watchers)]
        except queue.Empty:
            raise RuntimeError("a watcher has failed") from None
        return end_cpu_s - begin_cpu_s, end - begin, seen


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build/release")
    parser.add_argument("--replay", type=pathlib.Path, help="the program evpose; default: that of --bin")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--noise", type=float, default=11.5, help="events per second of a dark pixel")
    parser.add_argument("--cell-px", type=int, default=2)
    parser.add_argument("--rate", type=float, default=30.0)
    parser.add_argument("--watchers", type=int, nargs="+", default=[0, 1, 2])
    arguments = parser.parse_args()
    arguments.bin = arguments.bin.resolve()
    arguments.replay = arguments.replay or arguments.bin / "client/cli/evpose"
    with tempfile.TemporaryDirectory() as folder:
        scene, code = pathlib.Path(folder) / "scene", pathlib.Path(folder) / "code"
        code.mkdir()
        load_api(code)
        made = simulate(arguments.replay, scene, "--object", "cube", "--camera", "evk4", "--duration", arguments.seconds,
                        "--background-activity", arguments.noise)
        print(re.search(r"\(.*Mev/s\)", made).group())
        print(f"{'watchers':>8}{'server s/s':>12}{'% more':>8}{'took s':>8}{'images':>8}{'kB each':>9}{'skipped':>9}")
        before = None
        for num_watchers in arguments.watchers:
            cpu, took_s, seen = measure(arguments, scene, num_watchers)
            share = cpu / arguments.seconds
            more = "" if before is None else f"{100 * (share - before):.1f}"
            before = share
            one = seen[0] if seen else {"images": 0, "bytes": 0, "skipped": 0}
            print(f"{num_watchers:8}{share:12.3f}{more:>8}{took_s:8.2f}{one['images']:8}"
                  f"{one['bytes'] / max(1, one['images']) / 1e3:9.1f}{one['skipped']:9}", flush=True)


if __name__ == "__main__":
    main()
