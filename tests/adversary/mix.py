#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Sends requests at the limits, wrong messages, floods, cancelled calls and half-open connections to all RPCs, while another tenant tracks
a cube at its camera's pace.

  tests/adversary/mix.py --bin build/release --seconds 20 --seed 1

A run with the same seed makes the same choices in each of its threads; the order between the threads is not fixed.
"""

import argparse
import collections
import contextlib
import os
import random
import sys
import threading
import unittest

import grpc

import http2
import server
from api import EVT3, FISHEYE_LENS, FLAT64, LARGEST, MESH, METHODS, OBJ, RATIONAL_LENS, VGA, Api, failure_of
from camera import Camera, assert_same_poses, assert_undisturbed, camera_model, chunks, initial_pose, recording
from hostile_models import CUBE, MALFORMED, MALFORMED_MESHES, mesh, padded_cube, prism, tangle
from test_memory import noise
from test_names import ODD_NAMES

NUM_THREADS = 6
# gRPC processes the frames of these attacks in the threads that read from all connections, so that only the proxy bounds how long the
# events of another client wait: the latency is asserted without them.
FLOODS_OF_FRAMES = {"reset_streams", "pings"}
NICE = 10  # of the threads of the adversary, which would have machines of its own
NUM_HELD = 20  # stalled streams and connections of a thread
SESSION_MEMORY_BYTES = 512 << 20
MODEL_STORE_BYTES = 64 << 20
# Memory beside that of sessions and models: gRPC (--max-transport-bytes, 512 MiB) and the process itself. Models are prepared in other
# processes.
OTHER_BYTES = 800 << 20
OPTIONS = {
    "--max-sessions": 32, "--max-session-memory": SESSION_MEMORY_BYTES, "--max-model-store-bytes": MODEL_STORE_BYTES,
    "--max-model-bytes": 16 << 20, "--model-memory": 128 << 20, "--model-cpu-seconds": 2, "--max-uploads": 16, "--upload-timeout": 5,
    "--attach-timeout": 2, "--stream-idle-timeout": 3, "--session-expiry": 3, "--max-streams": 200,
    "--max-connections": 400, "--max-connections-per-peer": 200,
}
UNARY = ["CreateSession", "GetSession", "ListSessions", "DeleteSession", "GetModel", "GetModelGeometry", "ListModels", "DeleteModel",
         "GetServerInfo", "Drain", "SetLogLevel", "Check"]
NUMBERS = [0, -1, 1, 7, 4096, 4097, 2**31 - 1, 1e-300, 1e300, float("nan"), float("inf"), -float("inf")]


class Adversary(threading.Thread):
    """One thread of the tenant mallory, which acts until `is_ended` is set. It makes no attacks of the kinds in `without`."""

    def __init__(self, running, seed, index, is_ended, without):
        super().__init__(daemon=True)
        self._running = running
        self._without = without
        self._random = random.Random(f"{seed} {index}")
        self._is_ended = is_ended
        self._models = [prism(1365), prism(300), tangle(500, 500), CUBE, *MALFORMED.values()]
        self._meshes = [mesh(), *MALFORMED_MESHES.values()]
        self._noise = noise(256)
        self._bulk = b"".join(payload for _, payload in chunks())
        self._held = []  # functions that end a stalled stream or connection
        self.actions = collections.Counter()
        self.codes = collections.Counter()
        self.unexpected = []

    def run(self):
        try:
            self._attack()
        except Exception as error:  # an error of this script, of which the test would otherwise not know
            self.unexpected.append(repr(error))

    def _attack(self):
        with contextlib.suppress(OSError):  # this thread and those that it starts
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
        api = self._new_api()
        kinds = [name[4:] for name in sorted(vars(Adversary)) if name.startswith("act_")]
        choices = [getattr(self, "act_" + kind) for kind in kinds if kind not in self._without]
        while not self._is_ended.is_set():
            act = self._random.choice(choices)
            self.actions[act.__name__[4:]] += 1
            with contextlib.suppress(StopIteration, OSError, ValueError):
                try:
                    act(api)
                except grpc.RpcError as error:
                    self._count(error)
            if self._random.random() < 0.05:
                api.close()
                api = self._new_api()
        for end in self._held:
            end()
        api.close()

    def _new_api(self):
        return Api(self._running.address, "mallory", timeout_s=self._random.choice([0.05, 0.5, 2.0]))

    def _count(self, error):
        failure = failure_of(error)
        self.codes[f"{failure.code} {failure.reason}"] += 1
        # A server that is attacked may refuse and may end a stream, but it must not fail.
        if failure.code in ("INTERNAL", "UNKNOWN", "DATA_LOSS") and "RST_STREAM" not in failure.message:
            self.unexpected.append(failure)

    def _hold(self, end):
        """Keeps something stalled until there are too many of them."""
        self._held.append(end)
        if len(self._held) > NUM_HELD:
            self._held.pop(self._random.randrange(NUM_HELD))()

    def _number(self):
        return self._random.choice(NUMBERS)

    def _whole(self, low, high):
        """Returns an integer that a field of 32 bits can hold: `low`, `high`, one between them, 0, or the largest."""
        return self._random.choice([low, high, self._random.randint(low, high), 0, 2**31 - 1])

    def _bytes(self, limit):
        return self._random.randbytes(self._random.randrange(limit))

    def _camera(self):
        camera = dict(self._random.choice([VGA, LARGEST]))
        if self._random.random() < 0.3:
            camera[self._random.choice(["fx_px", "fy_px", "cx_px", "cy_px"])] = self._number()
        if self._random.random() < 0.2:
            camera["distortion"] = [self._number() for _ in range(self._random.randrange(7))]
        return camera

    def _create(self, api):
        """Creates a session. Its camera is now and then inadmissible."""
        model = api.upload(CUBE).name
        return api.create(model, camera=self._camera(), num_objects=self._random.choice([1, 1, 16]),
                          encoding=self._random.choice([1, FLAT64, FLAT64]))

    def act_odd_call(self, api):
        name = self._random.choice(UNARY)
        fields = {}
        for field in METHODS[name].request.DESCRIPTOR.fields_by_name:
            if field == "page_size":
                fields[field] = self._whole(-5, 2000)
            elif field in ("name", "page_token", "request_id"):
                fields[field] = self._random.choice(ODD_NAMES)
            elif field == "level":
                fields[field] = self._random.randrange(9)
        api(name, **fields)

    def act_call_that_is_cancelled(self, api):
        self._random.choice([api.start_upload, api.stream, lambda: api.watch("WatchPoses", session="sessions/x")])().cancel()

    def act_wrong_token(self, _):
        api = Api(self._running.address, token="evpose_" + self._random.randbytes(32).hex(), timeout_s=0.5)
        self._hold(api.close)
        api("GetServerInfo")

    def act_create(self, api):
        self._create(api)

    def act_delete(self, api):
        for session in api("ListSessions", page_size=5).sessions:
            api("DeleteSession", name=session.name)

    def act_stall(self, api):
        """A stream that attaches, or does not, and sends nothing more."""
        if self._random.random() < 0.3:
            stream = api.stream()
        else:
            stream, _ = api.attach(self._create(api))
        self._hold(stream.cancel)

    def act_flood(self, api):
        """Sends more than the credit, and does not read."""
        stream, _ = api.attach(self._create(api))
        for seq in range(1, self._random.randrange(2, 8)):
            stream.send(events={"seq": seq, "payload": self._random.randbytes(1 << 20)})
        self._hold(stream.cancel)

    def act_noise(self, api):
        """Events in all pages of the largest tables."""
        model = api.upload(CUBE).name
        stream, _ = api.attach(api.create(model, camera=LARGEST, num_objects=16))
        stream.send(events={"seq": 1, "payload": self._noise})
        self._hold(stream.cancel)

    def act_bulk(self, api):
        """The recording of the camera, with as many bytes at a time as the server takes, and with up to 10,000 poses per second."""
        model = api.upload(CUBE).name
        tracker = {"pose_rate_hz": self._random.choice([1000.0, 10_000.0, 10_000.0, self._number()])}
        stream, _ = api.attach(api.create(model, camera=camera_model(), num_objects=self._random.choice([1, 4]), encoding=EVT3,
                                          pose=initial_pose(), tracker=tracker))
        for seq, start in enumerate(range(0, len(self._bulk), 1 << 18), 1):
            stream.send(events={"seq": seq, "payload": self._bulk[start:start + (1 << 18)]})
        self._hold(stream.cancel)

    def act_lie(self, api):
        """A sequence of messages of which some are wrong."""
        stream, attached = api.attach(self._create(api))
        seq = attached.next_seq
        for _ in range(self._random.randrange(20)):
            kind = self._random.choice(["events"] * 6 + ["reset_pose", "attach", "end", "none"])
            if kind == "events":
                stream.send(events={"seq": self._random.choice([seq] * 8 + [0, seq + 1, 2**64 - 1]),
                                    "payload": self._bytes(5000 // 8) * 8, "discontinuity": self._random.random() < 0.1})
                seq += 1
            elif kind == "reset_pose":
                rotation = {axis: self._number() for axis in "xyzw"}
                stream.send(reset_pose={"object_id": self._random.choice(["object0", "x\0", ""]), "seq": seq,
                                        "camera_from_object": {"rotation": rotation}})
                seq += 1
            else:
                stream.send(**{kind: {}} if kind != "none" else {})
        if self._random.random() < 0.5:
            with contextlib.suppress(grpc.RpcError):  # a sequence may be right by chance, and then ends with a summary
                stream.finish()
                stream.read_all()
        else:
            self._hold(stream.cancel)

    def act_watch(self, api):
        """Watchers of which most read nothing."""
        created = self._create(api)
        for _ in range(self._random.randrange(1, 20)):
            name = self._random.choice(["WatchEvents", "WatchHealth", "WatchPoses"])
            more = {"WatchEvents": {"cell_px": self._random.choice([0, 1, 2, 3, 4, 2**32 - 1]),
                                    "max_rate_hz": self._random.choice([60.0, 1e-300, self._number()])},
                    "WatchHealth": {"period": {"nanos": self._random.choice([0, 1, 10_000_000])}},
                    "WatchPoses": {}}[name]
            self._hold(api.watch(name, session=created.session.name, **more).cancel)

    def act_upload(self, api):
        """An upload that is hostile, malformed, large, stalled or cancelled."""
        data = self._random.choice([*self._models, padded_cube(1 << 20, self._random.randrange(1000)), self._bytes(100_000)])
        stream = api.send_model(data, metres_per_unit=self._random.choice([0.1, 1.0, self._random.random(), self._number()]))
        if self._random.random() < 0.5:
            stream.call.result()
        else:
            self._hold(stream.cancel)

    def act_upload_mesh(self, api):
        """A message Mesh, most of them malformed."""
        data = bytearray(self._random.choice(self._meshes))
        if self._random.random() < 0.5:
            data[self._random.randrange(-20, -1) % max(len(data), 1):] = self._bytes(40)
        api.upload(bytes(data), format=MESH)

    def act_unread_responses(self, api):
        """Calls whose responses are not read: the connection has no window for them."""
        model = api.upload(self._random.choice([CUBE, prism(300)])).name
        method, fields = self._random.choice([("GetModelGeometry", {"name": model}), ("ListModels", {}), ("ListSessions", {})])
        request = METHODS[method].request(**fields).SerializeToString()
        calls = [http2.unary_call(stream, METHODS[method].path, request, server.token("mallory"))
                 for stream in range(1, 2 * self._random.randrange(1, 200), 2)]
        connection = http2.open_connection(self._running, http2.window(0))
        self._hold(connection.close)
        http2.send(connection, b"".join(calls))

    def act_read_model(self, api):
        """The geometry of a model that exists, several times at once, some of them cancelled; the model may be deleted meanwhile."""
        name = api.upload(self._random.choice([CUBE, prism(300), prism(1365)])).name
        api("GetModel", name=name)
        calls = [api.start("GetModelGeometry", name=name, max_faces=self._random.choice([0, 1, 500, 100_000, 100_001, 2**32 - 1]))
                 for _ in range(self._random.randrange(1, 8))]
        if self._random.random() < 0.3:
            api("DeleteModel", name=name)
        for call in calls:
            if self._random.random() < 0.5:
                call.cancel()
            else:
                self._hold(call.cancel)
        with contextlib.suppress(grpc.FutureCancelledError):
            calls[-1].result()

    def act_lens(self, api):
        """The recording of the camera, as that of another lens: a fisheye has several views, each with tables of its own."""
        lens = dict(self._random.choice([RATIONAL_LENS, FISHEYE_LENS]))
        if self._random.random() < 0.3:
            lens["distortion"] = [self._number() for _ in range(self._random.randrange(10))]
        focal_px = self._random.choice([150.0, 400.0, 1000.0])
        camera = {**camera_model(), **lens, "fx_px": focal_px, "fy_px": focal_px}
        stream, _ = api.attach(api.create(api.upload(CUBE).name, camera=camera, num_objects=self._random.choice([1, 1, 16]), encoding=EVT3))
        stream.send(events={"seq": 1, "payload": self._bulk[:1 << 18]})
        self._hold(stream.cancel)

    def act_lie_about_upload(self, api):
        stream = api.start_upload()
        size = self._random.choice([0, 10, 1 << 20, 16 << 20, 2**64 - 1])
        stream.send(header={"format": self._random.choice([OBJ, 0, 2, 3, 99]), "size_bytes": size})
        for _ in range(self._random.randrange(5)):
            stream.send(chunk=self._bytes(10_000))
        self._hold(stream.cancel)

    def act_half_open_connections(self, _):
        """From another address, so that the limit of connections of a peer is not that of the other tenant."""
        address = self._random.choice([self._running.address, self._running.metrics_address])
        for _ in range(self._random.randrange(1, 10)):
            connection = server.connect(address, "127.0.0.2")
            self._hold(connection.close)
            connection.sendall(self._random.choice([b"", b"GET /", b"\x16\x03\x01", http2.PREFACE[:10], http2.PREFACE,
                                                    http2.PREFACE + http2.EMPTY_SETTINGS, self._bytes(1000)]))

    def act_reset_streams(self, _):
        with http2.open_connection(self._running) as connection:
            http2.send(connection, http2.reset_streams(0, 500))

    def act_pings(self, _):
        with http2.open_connection(self._running) as connection:
            http2.send(connection, http2.frame(http2.PING, 0, 0, bytes(8)) * 2000)


class MixTest(server.AdversaryTest):
    def test_another_tenant_is_undisturbed(self):
        alone, runs = self._attack()
        self._report(alone, runs, "all of the mix")
        assert_same_poses(self, alone, runs)

    def test_another_tenant_has_its_latency(self):
        alone, runs = self._attack(without=FLOODS_OF_FRAMES)
        self._report(alone, runs, "the mix without floods of frames")
        assert_undisturbed(self, alone, runs, p50_ratio=25, p99_ratio=50)

    def _attack(self, without=()):
        """Returns the run of the undisturbed tenant before the attacks, and its runs beside them."""
        recording()
        options = [word for option, value in OPTIONS.items() for word in (option, str(value))]
        running = self.serve(*options, tenants=("alice", "mallory"))
        (alone,) = Camera(running, "alice").runs()
        before = running.resident_bytes()
        print(f"mix: {SECONDS:.0f} s with --seed {SEED}", flush=True)
        camera = Camera(running, "alice", seconds=SECONDS)
        is_ended = threading.Event()
        adversaries = [Adversary(running, SEED, i, is_ended, without) for i in range(NUM_THREADS)]
        for adversary in adversaries:
            adversary.start()
        try:
            runs = camera.runs()
        finally:
            is_ended.set()
            for adversary in adversaries:
                adversary.join(timeout=server.PATIENCE_S)
        for name in ("actions", "codes"):
            print(f"mix: {name}:", dict(sum((getattr(adversary, name) for adversary in adversaries), collections.Counter())))
        self.assertFalse(any(adversary.is_alive() for adversary in adversaries))
        self.assertEqual([failure for adversary in adversaries for failure in adversary.unexpected][:5], [])
        self.assertLess(running.peak_bytes(), before + SESSION_MEMORY_BYTES + 2 * MODEL_STORE_BYTES + OTHER_BYTES)
        return alone, runs

    def _report(self, alone, runs, what):
        identical = sum(run.digest == alone.digest for run in runs)
        server.figures[f"poses of an undisturbed tenant beside {what}, identical to the bit"] = f"{identical} of {len(runs)} runs"
        server.figures[f"its latency beside {what}, p50 / p99 of the worst run"] = (
            f"{max(run.p50_us for run in runs) / 1e3:.1f} / {max(run.p99_us for run in runs) / 1e3:.1f} ms")


def _arguments():
    """Removes --seconds and --seed from the command line and returns them."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=1)
    known, sys.argv[1:] = parser.parse_known_args()
    return known.seconds, known.seed


SECONDS, SEED = _arguments()

if __name__ == "__main__":
    unittest.main()
