#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Processor time: a live camera keeps its pace beside bulk replays and beside expensive sessions."""

import concurrent.futures
import contextlib
import os
import threading
import time
import unittest

import grpc

import server
from api import EVT3, client, failure_of
from camera import Camera, assert_same_poses, assert_undisturbed, camera_model, chunks, create, initial_pose, recording
from hostile_models import blob, tangle

PIECE_BYTES = 1 << 18


class Replays:
    """Sessions that are sent the recording several times, as fast as the server takes it. No process competes with the server for the
    processor time: what the server has received and not yet processed is enough for the duration of the camera's recording."""

    SENT = 4

    def __init__(self, running, api, count):
        self._running = running
        self._api = api
        data = self.SENT * b"".join(payload for _, payload in chunks())
        self._sessions = [create(api) for _ in range(count)]
        self._streams = [api.attach(session)[0] for session in self._sessions]
        for stream in self._streams:
            for seq, start in enumerate(range(0, len(data), PIECE_BYTES), 1):
                stream.send(events={"seq": seq, "payload": data[start:start + PIECE_BYTES]})
        server.poll(lambda: self.waiting_bytes() > count * len(data) / self.SENT / 2, "events of replays that wait for the server")

    def waiting_bytes(self):
        return self._running.metric("evpose_queue_bytes")

    def end(self):
        for stream, session in zip(self._streams, self._sessions):
            stream.cancel()
            self._api("DeleteSession", name=session.session.name)


def most_expensive_model(api):
    """Returns the name of the largest tangle that the server admits."""
    for triangles in (50_000, 5000, 500):
        with contextlib.suppress(grpc.RpcError):
            return api.upload(tangle(triangles, 4096)).name
    raise AssertionError("the server admits no tangle")


def create_with_most_objects(api, model):
    """Returns a session with 16 objects of a model, or as many as are admitted."""
    for num_objects in (16, 4, 1):
        try:
            return api.create(model, encoding=EVT3, num_objects=num_objects, camera=camera_model(), pose=initial_pose())
        except grpc.RpcError as error:
            if failure_of(error).code != "RESOURCE_EXHAUSTED":
                raise
    raise AssertionError("no session was admitted")


class FairTimeTest(server.AdversaryTest):
    def setUp(self):
        super().setUp()
        recording()
        # A store that outlives the process, because checkpoints are made in the turns of their sessions.
        self.running = self.serve(tenants=("alice", "mallory"), store="sqlite")
        (self.alone,) = Camera(self.running, "alice").runs()

    def check(self, name, runs, p50_ratio=50, p99_ratio=30):
        server.figures[f"live camera {name}, p50 / p99"] = ", ".join(
            f"{run.p50_us / 1e3:.1f} / {run.p99_us / 1e3:.1f} ms" for run in runs)
        server.figures["live camera alone, p50 / p99"] = f"{self.alone.p50_us / 1e3:.1f} / {self.alone.p99_us / 1e3:.1f} ms"
        assert_undisturbed(self, self.alone, runs, p50_ratio, p99_ratio)

    def runs_beside(self, replays, alone, is_pose_given=True):
        """Tracks the recording beside the replays, which it ends. The poses must be those without them; skips the rest of the test if other
        processes had most of the machine."""
        before_s, start_s = self.running.cpu_s(), time.monotonic()
        runs = Camera(self.running, "alice", is_pose_given=is_pose_given).runs()
        share = (self.running.cpu_s() - before_s) / (time.monotonic() - start_s) / os.cpu_count()
        self.assertGreater(replays.waiting_bytes(), 0, "the replays ended before the camera")
        replays.end()
        self.assertEqual({run.digest for run in runs}, {alone.digest})
        if share < 0.5:
            self.skipTest(f"the machine is too busy: the server had {share:.0%} of its processor time")
        return runs

    def test_beside_bulk_replays(self):
        """As many bytes at a time as the server takes, from another tenant or from the same one."""
        for tenant in ("mallory", "alice"):
            with self.subTest(tenant):
                replays = Replays(self.running, client(self, self.running, tenant), 8)
                runs = self.runs_beside(replays, self.alone)
                self.check(f"beside 8 bulk replays of {'another' if tenant == 'mallory' else 'its own'} tenant", runs)

    def test_a_search_beside_more_replays_than_an_equal_share_allows(self):
        """The search takes more processor time than a session has with priority, and the camera then needs more than an equal share."""
        (alone,) = Camera(self.running, "alice", is_pose_given=False).runs()
        replays = Replays(self.running, client(self, self.running, "alice"), 24)
        runs = self.runs_beside(replays, alone, is_pose_given=False)
        assert_same_poses(self, alone, runs)

    def test_beside_sessions_with_an_expensive_model(self):
        mallory = client(self, self.running, "mallory")
        self.check("beside two sessions with an expensive model", self.runs_beside_two(mallory, most_expensive_model(mallory)))
        self.check_turns("an expensive model")

    def test_turns_of_a_search_and_of_a_curved_model(self):
        """The poses and the duration of every turn, also while the camera's first pose is searched for."""
        (alone,) = Camera(self.running, "alice", is_pose_given=False).runs()
        mallory = client(self, self.running, "mallory")
        runs = self.runs_beside_two(mallory, mallory.upload(blob(100)).name, is_pose_given=False)
        self.assertEqual({run.digest for run in runs}, {alone.digest})
        self.check_turns("a search and a curved model")

    def runs_beside_two(self, mallory, model, is_pose_given=True):
        """Tracks the recording beside two sessions of mallory with up to 16 objects of the model each."""
        stop = threading.Event()
        before = self.running.metric("evpose_received_bytes_total")
        with concurrent.futures.ThreadPoolExecutor() as pool:
            sending = [pool.submit(self.send_until, mallory, model, stop) for _ in range(2)]
            try:
                server.poll(lambda: self.running.metric("evpose_received_bytes_total") > before + 100_000
                            or any(future.done() for future in sending), "expensive sessions")
                runs = Camera(self.running, "alice", is_pose_given=is_pose_given).runs()
            finally:
                stop.set()
            for future in sending:
                future.result()
        return runs

    def check_turns(self, what):
        num_turns, num_short = self.running.metrics(("evpose_turn_seconds_count",), ("evpose_turn_seconds_bucket", 'le="0.005"'))
        server.figures[f"turns of at most 5 ms, with {what}"] = f"{num_short:.0f} of {num_turns:.0f}"
        self.assertGreater(self.running.metric("evpose_checkpoint_duration_seconds_count"), 0)
        self.assertGreater(num_turns, 0)
        self.assertEqual(num_short, num_turns)

    def send_until(self, api, model, stop):
        """Sends the recording to a session with 16 objects, or as many as are admitted, until `stop` is set."""
        created = create_with_most_objects(api, model)
        stream, _ = api.attach(created)
        for seq, (_, payload) in enumerate(chunks() * 5, 1):
            stream.send(events={"seq": seq, "payload": payload})
        stop.wait()
        stream.cancel()
        api("DeleteSession", name=created.session.name)


class SessionTimeTest(server.AdversaryTest):
    LIMIT = 0.02

    def send_recording(self, api):
        """Returns the name and the stream of a new session that has been sent the recording."""
        created = create(api)
        stream, _ = api.attach(created)
        for seq, (_, payload) in enumerate(chunks(), 1):
            stream.send(events={"seq": seq, "payload": payload})
        return created.session.name, stream

    def processing_when_behind(self, api, name, stream):
        """Waits until the owner of the session is told that it falls behind; returns its health then."""
        while not (notice := stream.read("notice").notice).HasField("lag_change"):
            continue
        self.assertTrue(notice.lag_change.falls_behind)
        processing = api("GetSession", name=name).health.processing
        self.assertTrue(processing.falls_behind)
        return processing

    def test_a_session_has_a_limit_and_its_owner_is_told(self):
        running = self.serve("--max-session-cpu", str(self.LIMIT))
        api = client(self, running, timeout_s=server.PATIENCE_S)
        processing = self.processing_when_behind(api, *self.send_recording(api))
        self.assertEqual(processing.max_cpu_s_per_s, self.LIMIT)
        self.assertLess(processing.cpu_s_per_s, 3 * self.LIMIT)

    def test_a_tenant_has_a_limit_and_its_owner_is_told(self):
        running = self.serve("--tenant-max-cpu", str(self.LIMIT), tenants=("mallory",))
        api = client(self, running, "mallory", timeout_s=server.PATIENCE_S)
        sessions = [self.send_recording(api) for _ in range(2)]
        for name, stream in sessions:
            processing = self.processing_when_behind(api, name, stream)
            self.assertEqual(processing.max_tenant_cpu_s_per_s, self.LIMIT)
            self.assertLess(processing.tenant_cpu_s_per_s, 3 * self.LIMIT)
            self.assertEqual(processing.max_cpu_s_per_s, 1.0, "the limit of a session is not that of its tenant")
            self.assertLessEqual(processing.cpu_s_per_s, processing.tenant_cpu_s_per_s)


if __name__ == "__main__":
    unittest.main()
