#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Measures how long a server takes to start with a full store, to serve one tenant beside another's hostile uploads, and to end.

  tests/bench/start_stop.py --bin build/release [--models-mb 512] [--sessions 10000] [--creates 200]

Prints four figures: the time from the start of the process until a call is answered, with a store of --models-mb of models and --sessions
sessions; the time of CreateSession on a stored model of --triangles triangles, with and without another session that uses the model
(goal: 100 ms); the latency of CreateSession while another tenant uploads expensive models and gives up after 1 s; and the time from
SIGTERM to the end of the process with a queue of such uploads and --shutdown-timeout 3. With --known-model-only, only the second figure is
measured. Needs python3-grpcio, python3-protobuf and python3-numpy.
"""
import argparse
import math
import os
import pathlib
import random
import struct
import subprocess
import sys
import tempfile
import threading
import time

import grpc
from google.protobuf import empty_pb2

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))
import processes  # noqa: E402
from processes import cube_obj, load_api  # noqa: E402

SHUTDOWN_TIMEOUT_S = 3
LATEST_START_S = 600
CUBE = cube_obj()


class Server(processes.Server):
    """evpose-server with a call for each method that is needed."""

    def __init__(self, program, arguments, token=None):
        super().__init__(program, "--shutdown-timeout", SHUTDOWN_TIMEOUT_S, *arguments, store=None)
        self.channel = grpc.insecure_channel(self.address, options=[("grpc.use_local_subchannel_pool", 1)])
        self.metadata = self.metadata_of(token)

    def __exit__(self, *_):
        super().__exit__()
        self.channel.close()

    @staticmethod
    def metadata_of(token):
        return [("authorization", f"Bearer {token}")] if token else []

    def unary(self, method, request, response, **options):
        call = self.channel.unary_unary(f"/evpose.v1.{method}", type(request).SerializeToString, response.FromString)
        return call(request, metadata=self.metadata, wait_for_ready=True, **options)

    def upload(self, models, file, model_format, token=None, timeout_s=None):
        header = models.UploadModelRequest(header={"format": model_format, "size_bytes": len(file)})
        piece = 1 << 20
        requests = [header] + [models.UploadModelRequest(chunk=file[i:i + piece]) for i in range(0, len(file), piece)]
        call = self.channel.stream_unary("/evpose.v1.ModelService/UploadModel", models.UploadModelRequest.SerializeToString,
                                         models.Model.FromString)
        metadata = self.metadata_of(token) if token else self.metadata
        return call(iter(requests), metadata=metadata, timeout=timeout_s)

    def end(self):
        """Sends SIGTERM and returns the seconds until the process has ended."""
        begin_s = time.monotonic()
        self.terminate()
        return time.monotonic() - begin_s


def create_request(sessions, model, side_px):
    request = sessions.CreateSessionRequest()
    request.config.encoding = 5
    camera = request.config.camera
    camera.width_px = camera.height_px = side_px
    camera.fx_px = camera.fy_px = float(side_px)
    camera.cx_px = camera.cy_px = side_px / 2
    request.config.objects.add(object_id="cube", model=model)
    return request


def grid_stl(megabytes, seed):
    """A binary STL file of about that many MB: a rough square, whose border is its lines, because no edge inside is sharp."""
    chooser = random.Random(seed)
    side = int(math.sqrt(megabytes * 1e6 / 100))
    height = [[chooser.random() * 0.05 for _ in range(side + 1)] for _ in range(side + 1)]
    facets = bytearray()
    for i in range(side):
        for j in range(side):
            corner = [(i + a, j + b, height[i + a][j + b]) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
            for triangle in ((0, 1, 2), (0, 2, 3)):
                facets += struct.pack("<12fH", 0, 0, 0, *(x for k in triangle for x in corner[k]), 0)
    return bytes(80) + struct.pack("<I", len(facets) // 50) + bytes(facets)


def expensive_prism(seed, sides=1365):
    """An OBJ file of a prism that turns into itself within the tolerance by one side, and a triangle in it that does not."""
    angle = [2 * math.pi * i / sides for i in range(sides)]
    text = [f"# {seed}"]
    for z in (0, 1):
        text += [f"v {math.cos(a):.7g} {math.sin(a):.7g} {z}" for a in angle]
    text += ["v 0.01 0 0.4", "v 0.02 0.01 0.4", "v 0.01 0.02 0.41", "f -3 -2 -1"]
    for i in range(1, sides - 1):
        text += [f"f 1 {i + 2} {i + 1}", f"f {sides + 1} {sides + i + 1} {sides + i + 2}"]
    for i in range(sides):
        j = (i + 1) % sides
        text += [f"l {i + 1} {j + 1}", f"l {sides + i + 1} {sides + j + 1}", f"l {i + 1} {sides + i + 1}",
                 f"f {i + 1} {j + 1} {sides + j + 1} {sides + i + 1}"]
    return "\n".join(text).encode() + b"\n"


def percentile(values, ratio):
    return sorted(values)[min(len(values) - 1, int(ratio * len(values)))]


def measure_start(program, api, arguments, folder):
    _, sessions, models = api
    store = ["--store", "sqlite", "--data-dir", folder + "/data", "--max-sessions", str(arguments.sessions + 1),
             "--max-session-memory", str(10**12), "--session-expiry", "86400",
             "--max-model-store-bytes", str((2 * arguments.models_mb + 64) << 20)]  # what was derived from a model counts, too
    with Server(program, store) as server:
        cube = server.upload(models, CUBE, 1).name
        for seed in range(arguments.models_mb // 8):
            file = grid_stl(8, seed)
            server.upload(models, file, 3)
        for _ in range(arguments.sessions):
            server.unary("SessionService/CreateSession", create_request(sessions, cube, 64), sessions.CreateSessionResponse)
        server.end()
    with Server(program, store) as server:
        server.unary("ModelService/GetModel", models.GetModelRequest(name=cube), models.Model, timeout=LATEST_START_S)
        start_s = time.monotonic() - server.started_s
        print(f"start with {arguments.models_mb} MB of models and {arguments.sessions} sessions: first call answered after {start_s:.2f} s")
        server.end()


def measure_known_model(program, api, arguments, folder):
    import model_preparation  # needs numpy, which other scripts that import this one do not

    _, sessions, models = api
    store = ["--store", "sqlite", "--data-dir", folder + "/known"]
    file = pathlib.Path(folder, "known.stl")
    for name in ("blob", "mug"):
        model_preparation.HONEST[name](arguments.triangles, file)
        with Server(program, store) as server:
            model = server.upload(models, file.read_bytes(), 3).name
            server.end()
        with Server(program, store) as server:
            for keeps_session in (False, True):  # without and with another session that uses the model
                if keeps_session:
                    server.unary("SessionService/CreateSession", create_request(sessions, model, 640), sessions.CreateSessionResponse)
                times_ms, processor_ms = [], []
                for _ in range(6):
                    begin_s, begin_processor_s = time.monotonic(), server.cpu_s()
                    created = server.unary("SessionService/CreateSession", create_request(sessions, model, 640), sessions.CreateSessionResponse)
                    times_ms.append(1000 * (time.monotonic() - begin_s))
                    processor_ms.append(1000 * (server.cpu_s() - begin_processor_s))
                    server.unary("SessionService/DeleteSession", sessions.DeleteSessionRequest(name=created.session.name), empty_pb2.Empty)
                print(f"CreateSession on the stored model of a {name} of {arguments.triangles} triangles, {'' if keeps_session else 'not '}used "
                      f"by another session: first {times_ms[0]:.0f} ms, then {min(times_ms[1:]):.0f} to {max(times_ms[1:]):.0f} ms; processor "
                      f"time first {processor_ms[0]:.0f} ms, then {min(processor_ms[1:]):.0f} to {max(processor_ms[1:]):.0f} ms")
            server.end()


def new_token(program, tenant, path):
    answer = subprocess.run([program, "--new-token", tenant, "--token-file", path], check=True, capture_output=True, text=True)
    return answer.stdout.strip()


def create_beside_attacks(server, api, model, count, mallory):
    """Returns the latencies of CreateSession while uploads with the token `mallory` are under way."""
    _, sessions, models = api
    has_ended = threading.Event()

    def attack(first_seed):
        seed = first_seed
        while not has_ended.is_set():
            try:
                server.upload(models, expensive_prism(seed), 1, mallory, timeout_s=1)
            except grpc.RpcError:
                pass
            seed += 100

    attackers = [threading.Thread(target=attack, args=(i,), daemon=True) for i in range(6)]
    for attacker in attackers:
        attacker.start()
    latencies_ms = []
    try:
        time.sleep(1)
        for _ in range(count):
            begin_s = time.monotonic()
            created = server.unary("SessionService/CreateSession", create_request(sessions, model, 640), sessions.CreateSessionResponse)
            latencies_ms.append(1000 * (time.monotonic() - begin_s))
            server.unary("SessionService/DeleteSession", sessions.DeleteSessionRequest(name=created.session.name), empty_pb2.Empty)
    finally:
        has_ended.set()
        for attacker in attackers:
            attacker.join()
    return latencies_ms


def measure_hostile_uploads(program, api, arguments, folder):
    models = api[2]
    tokens = folder + "/tokens"
    alice, mallory = (new_token(program, tenant, tokens) for tenant in ("alice", "mallory"))
    options = ["--store", "memory", "--token-file", tokens, "--max-sessions", "64"]
    with Server(program, options, alice) as server:
        cube = server.upload(models, CUBE, 1).name
        latencies_ms = create_beside_attacks(server, api, cube, arguments.creates, mallory)
        print(f"CreateSession of another tenant beside 6 hostile uploads: p50 {percentile(latencies_ms, 0.5):.1f} ms, "
              f"p99 {percentile(latencies_ms, 0.99):.1f} ms, longest {max(latencies_ms):.1f} ms, of {len(latencies_ms)}")
        server.end()


def measure_end(program, api):
    models = api[2]
    with Server(program, ["--store", "memory"]) as server:
        def upload(seed):
            try:
                server.upload(models, expensive_prism(seed), 1)
            except grpc.RpcError:
                pass

        uploads = [threading.Thread(target=upload, args=(seed,), daemon=True) for seed in range(40)]
        for thread in uploads:
            thread.start()
        time.sleep(1)
        end_s = server.end()
        for thread in uploads:
            thread.join()
    print(f"SIGTERM with 40 uploads under way and --shutdown-timeout {SHUTDOWN_TIMEOUT_S}: ended after {end_s:.2f} s")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", default="build/release", help="folder of the build")
    parser.add_argument("--models-mb", type=int, default=512, help="size of the models in the store, MB")
    parser.add_argument("--sessions", type=int, default=10_000, help="sessions in the store, with a camera of 64x64 pixels")
    parser.add_argument("--creates", type=int, default=200, help="calls of CreateSession beside hostile uploads")
    parser.add_argument("--triangles", type=int, default=1_000_000, help="triangles of the file of the stored model")
    parser.add_argument("--known-model-only", action="store_true", help="measures only CreateSession on that model")
    arguments = parser.parse_args()
    program = os.path.join(arguments.bin, "server", "evpose-server")
    with tempfile.TemporaryDirectory() as folder:
        api = load_api(folder)
        measure_known_model(program, api, arguments, folder)
        if arguments.known_model_only:
            return
        measure_end(program, api)
        measure_hostile_uploads(program, api, arguments, folder)
        measure_start(program, api, arguments, folder)


if __name__ == "__main__":
    main()
