#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measures the processor time of a server while images of the events of a session are watched (SessionService.WatchEvents).

A session tracks a cube that a simulated EVK4 sees, with noise in every pixel, in real time: about 10 Mev/s. For each number of watchers it
prints the processor time of the server in seconds per second of the recording, the difference from the row before in percent of a core, and
the images, their bytes and the skipped images of the first watcher. The watchers are processes of their own. Needs a release build.
"""
import argparse
import multiprocessing
import os
import pathlib
import queue
import re
import subprocess
import sys
import tempfile
import time

import grpc

ROOT = pathlib.Path(__file__).resolve().parents[2]
SERVICE = "/evpose.v1.SessionService/"


def generate(folder):
    """The Python code of the API's messages."""
    protos = [str(path.relative_to(ROOT / "proto")) for path in (ROOT / "proto/evpose/v1").glob("*.proto")]
    subprocess.run(["protoc", f"-I{ROOT / 'proto'}", f"--python_out={folder}", *protos], check=True)


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


def cpu_s(process):
    fields = pathlib.Path(f"/proc/{process.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


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
    server = subprocess.Popen([arguments.bin / "server/evpose-server", "--store", "memory", "--listen", "127.0.0.1:0", "--log-level", "off",
                               "--max-session-cpu", "0"], stdout=subprocess.PIPE, text=True)
    processes = [server]
    watchers = []
    try:
        address = re.search(r"\S+:\d+", server.stdout.readline()).group()
        pose = pathlib.Path(scene / "truth.tum").read_text(encoding="ascii").splitlines()
        first = next(line.split()[1:] for line in pose if not line.startswith("#"))
        replay = subprocess.Popen([arguments.replay, "replay", scene / "recording.raw", "--model", scene / "model.obj", "--camera",
                                   scene / "camera.yaml", "--init-pose", " ".join(first), "--server", address, "--rate", "1"],
                                  stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        processes.append(replay)
        session = wait_for_session(address, replay)
        results = multiprocessing.Queue()
        for _ in range(num_watchers):
            watcher = multiprocessing.Process(target=watch, args=(address, session, arguments.cell_px, arguments.rate, results))
            watcher.start()
            watchers.append(watcher)
        begin, begin_cpu_s = time.monotonic(), cpu_s(server)
        if replay.wait() != 0:
            raise RuntimeError("evpose replay has failed")
        end, end_cpu_s = time.monotonic(), cpu_s(server)
        seen = [results.get(timeout=60) for _ in watchers]
        return end_cpu_s - begin_cpu_s, end - begin, seen
    except queue.Empty:
        raise RuntimeError("a watcher has failed") from None
    finally:
        for watcher in watchers:
            watcher.kill()
            watcher.join()
        for process in processes:
            process.kill()
            process.wait()


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
        generate(code)
        sys.path.insert(0, str(code))
        made = subprocess.run([arguments.replay, "simulate", "--object", "cube", "--camera", "evk4", "--duration", str(arguments.seconds),
                               "--background-activity", str(arguments.noise), "--out", scene], check=True, capture_output=True, text=True)
        print(re.search(r"\(.*Mev/s\)", made.stdout).group())
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
