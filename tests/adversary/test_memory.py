#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Memory: what a session takes is charged before it takes it, and what cannot be had fails one call."""

import contextlib
import itertools
import pathlib
import re
import socket
import subprocess
import unittest

import grpc
import numpy

import http2
import server
from api import LARGEST, METHODS, client, failure_of, refusal
from hostile_models import CUBE, blob, padded_cube

LIMIT_BYTES = 400 << 20
# Memory of the server besides sessions: buffers of gRPC, pages that malloc keeps.
SLACK_BYTES = 100 << 20


def noise(step_px):
    """One second of events in every `step_px`th column of all rows of the largest camera, FLAT64. With 256, one event falls into each
    page of 4 KiB of any table that has 16 bytes or fewer for a pixel."""
    y, x = numpy.mgrid[0:4096, 0:4096:step_px].reshape(2, -1).astype(numpy.uint64)
    t_us = numpy.linspace(1, 1_000_000, x.size).astype(numpy.uint64)
    words = t_us << numpy.uint64(32) | x << numpy.uint64(18) | y << numpy.uint64(4) | (x ^ y) & numpy.uint64(1)
    return words.astype("<u8").tobytes()


def send_all(api, created, data):
    """Sends the data to a session until they are processed, and returns the health of the session."""
    stream, attached = api.attach(created)
    size = attached.max_chunk_bytes // 8 * 8
    starts = range(0, len(data), size)
    for seq, start in enumerate(starts, 1):
        stream.send(events={"seq": seq, "payload": data[start:start + size]})
    while stream.read("ack").ack.processed_seq < len(starts):
        continue
    health = api("GetSession", name=created.session.name).health
    stream.cancel()
    return health


def delete(running, api, created):
    """Deletes a session, and waits until its memory is released. A stream that was cancelled before has the session until the server
    has ended it, which DeleteSession does not wait for."""
    charged = running.metric("evpose_session_memory_bytes")
    api("DeleteSession", name=created.session.name)
    server.poll(lambda: running.metric("evpose_session_memory_bytes") < charged, "the release of the memory of a deleted session")


class MemoryTest(server.AdversaryTest):
    def serve(self, *options, **settings):
        # send_all() sends nothing while it waits for its last ack, for which a busy machine may take longer than the limit.
        return super().serve("--stream-idle-timeout", "0", *options, **settings)


class SessionMemoryTest(MemoryTest):
    def test_sessions_of_large_cameras_are_charged(self):
        running = self.serve("--max-session-memory", str(LIMIT_BYTES), "--max-sessions", "1000")
        api = client(self, running)
        model = api.upload(CUBE).name
        before = running.resident_bytes()
        created, failure = api.create_until_refused(model, camera=LARGEST)
        self.assertEqual((failure.code, failure.reason), ("RESOURCE_EXHAUSTED", "SESSION_MEMORY"))
        self.assertIn("QuotaFailure", failure.details)
        self.assertGreater(len(created), 1)
        for session in created:
            self.assertGreater(send_all(api, session, noise(256)).decoded_events, 0)
        self.assertLess(running.peak_bytes() - before, LIMIT_BYTES + SLACK_BYTES)
        # A small session may be refused, too; what a deleted session was charged is free again.
        delete(running, api, created.pop())
        created.append(api.create(model, camera=LARGEST))
        # A camera with fewer pixels is charged less.
        for session in created:
            api("DeleteSession", name=session.session.name)
        self.assertGreater(len(api.create_until_refused(model)[0]), len(created))

    def test_objects_are_charged(self):
        running = self.serve("--max-session-memory", str(LIMIT_BYTES), "--max-sessions", "1000")
        api = client(self, running)
        model = api.upload(CUBE).name
        counts = []
        for num_objects in (1, 16):
            before = running.resident_bytes()
            created, failure = api.create_until_refused(model, camera=LARGEST, num_objects=num_objects)
            self.assertEqual(failure.reason, "SESSION_MEMORY")
            self.assertLess(running.resident_bytes() - before, LIMIT_BYTES + SLACK_BYTES)
            counts.append(len(created))
            for session in created:
                delete(running, api, session)
        self.assertLess(counts[1], counts[0])

    def test_a_session_after_noise_in_every_page(self):
        """The peak of one session, which figures.py prints."""
        for num_objects, name in ((1, "1 object"), (16, "16 objects")):
            running = self.serve()
            api = client(self, running)
            model = api.upload(CUBE).name
            send_all(api, api.create(model), noise(256)[:8])  # what the server allocates once
            before = running.resident_bytes()
            send_all(api, api.create(model, camera=LARGEST, num_objects=num_objects), noise(256))
            rise = running.peak_bytes() - before
            server.figures[f"memory of a session with a 4096x4096 camera, {name}"] = f"{rise / 1e6:.0f} MB"
            self.assertLess(rise, 100e6 if num_objects == 1 else 300e6)
            self._end(running)

    def test_a_tenant_leaves_memory_to_others(self):
        running = self.serve("--max-session-memory", str(LIMIT_BYTES), "--max-sessions", "1000", tenants=("alice", "mallory"))
        mallory, alice = client(self, running, "mallory"), client(self, running, "alice")
        created, failure = mallory.create_until_refused(mallory.upload(CUBE).name, camera=LARGEST)
        self.assertEqual(failure.code, "RESOURCE_EXHAUSTED")
        self.assertIn(failure.reason, ("TENANT_QUOTA", "SESSION_MEMORY"))
        self.assertGreater(len(created), 0)
        alice.create(alice.upload(CUBE).name, camera=LARGEST)

    def test_an_allocation_that_fails_ends_one_call(self):
        running = self.serve("--max-session-memory", str(1 << 40), "--max-sessions", "1000",
                             prlimit=[f"--as={3 << 29}"])
        api = client(self, running)
        model = api.upload(CUBE).name
        created = []
        with self.assertRaises(grpc.RpcError) as caught:
            while len(created) < 500:
                camera = {**LARGEST, "fx_px": 3000 + len(created)}
                created.append(api.create(model, camera=camera, num_objects=16))
                send_all(api, created[-1], noise(256))
        failure = failure_of(caught.exception)
        self.assertEqual((failure.code, failure.reason), ("RESOURCE_EXHAUSTED", "OUT_OF_MEMORY"))
        for session in created:
            api("DeleteSession", name=session.session.name)
        send_all(api, api.create(model), noise(256)[:8])

    def test_a_restart_restores_no_more_than_the_limit(self):
        running = self.serve("--max-session-memory", str(LIMIT_BYTES), "--max-sessions", "1000", store="sqlite")
        api = client(self, running)
        model = api.upload(CUBE).name
        created, _ = api.create_until_refused(model, camera=LARGEST)
        self.assertGreater(len(created), 1)
        running.kill()
        running.start()
        self.assertEqual(running.defeat(), "")
        again = client(self, running)
        for session in created:
            send_all(again, session, noise(256))
        self.assertLess(running.peak_bytes(), LIMIT_BYTES + 2 * SLACK_BYTES)
        self.assertEqual(refusal(again.create, model, camera=LARGEST).reason, "SESSION_MEMORY")


class LeftMemoryTest(MemoryTest):
    """Calls of all kinds while the server may take only some megabytes more than it has."""

    def test_the_server_survives_with_little_memory_left(self):
        num_exhausted = 0
        for left in (40 << 20, 1 << 30):
            with self.subTest(left=f"{left >> 20} MiB"):
                num_exhausted += self.exhaust(left)
        self.assertGreater(num_exhausted, 0, "no call was refused for want of memory")

    def exhaust(self, left):
        """Limits the address space of a server that has answered each kind of call. Returns how many calls failed for want of memory."""
        running = self.serve("--max-session-memory", str(1 << 40))
        api = client(self, running, timeout_s=server.PATIENCE_S)
        cube = api.upload(CUBE).name
        small = noise(2048)
        send_all(api, api.create(cube), small)
        pid = running.process.pid
        size_bytes = int(re.search(r"VmSize:\s+(\d+) kB", pathlib.Path(f"/proc/{pid}/status").read_text())[1]) << 10
        self.limit(pid, size_bytes + left)
        reasons = []
        created = []

        def attempt(call):
            try:
                return call()
            except grpc.RpcError as error:
                reasons.append(failure_of(error).reason)
                self.assertIsNone(running.process.poll(), f"ended with {left} bytes left: {running.log()[-1000:]}")
                return None

        for number in range(8):
            attempt(lambda number=number: api.upload(padded_cube(8 << 20, number)))
            session = attempt(lambda number=number: api.create(cube, camera={**LARGEST, "fx_px": 3000 + number}, num_objects=16))
            if session is not None:
                created.append(session)
                attempt(lambda session=session: send_all(api, session, small))
                attempt(lambda session=session: next(api.watch("WatchHealth", session=session.session.name)))
            attempt(lambda: api("GetModelGeometry", name=cube))
        self.limit(pid, "unlimited")
        for session in created:
            api("DeleteSession", name=session.session.name, allow_missing=True)
        send_all(api, api.create(cube), small)
        self.assertEqual(running.terminate(), 0)
        return reasons.count("OUT_OF_MEMORY")

    def limit(self, pid, size):
        subprocess.run(["prlimit", f"--pid={pid}", f"--as={size}:"], check=True)


class StreamMemoryTest(MemoryTest):
    def test_random_bytes_are_counted_and_not_kept(self):
        running = self.serve()
        api = client(self, running)
        model = api.upload(CUBE).name
        random = numpy.random.default_rng(1)
        peaks = []
        for data in [random.bytes(1 << 20), bytes(1 << 20), b"\xff" * (1 << 20)]:
            for encoding in range(1, 6):
                created = api.create(model, encoding=encoding)
                health = send_all(api, created, data)
                self.assertEqual(health.processed_bytes, len(data))
                api("DeleteSession", name=created.session.name)
            peaks.append(running.peak_bytes())
        self.assertLess(peaks[-1], peaks[0] + SLACK_BYTES)

    def test_empty_chunks_are_not_kept(self):
        running = self.serve()
        api = client(self, running)
        stream, _ = api.attach(api.create(api.upload(CUBE).name))
        before = running.resident_bytes()
        for seq in range(1, 5001):
            stream.send(events={"seq": seq, "payload": b""})
        stream.send(end={})
        stream.read("summary")
        self.assertLess(running.resident_bytes(), before + SLACK_BYTES)


class UnreadResponseTest(MemoryTest):
    """Clients that call GetModelGeometry, which has the largest responses, and do not read them. The responses of a tenant may take an
    eighth of --max-transport-bytes."""

    NUM_CALLS = 800
    LIMIT_BYTES = 8 << 20

    def start(self, response_timeout_s=600):
        """Starts a server that has a model of mallory, which a session uses, so that the calls do not load it again."""
        self.running = self.serve("--max-transport-bytes", str(8 * self.LIMIT_BYTES), "--response-timeout", str(response_timeout_s),
                                  tenants=("alice", "mallory"))
        self.mallory = client(self, self.running, "mallory")
        self.model = self.mallory.upload(blob(120)).name
        self.mallory.create(self.model)

    def read_geometry(self):
        return self.mallory("GetModelGeometry", name=self.model)

    def call(self, stream):
        """Returns the frames of a call."""
        method = METHODS["GetModelGeometry"]
        request = method.request(name=self.model).SerializeToString()
        return http2.unary_call(stream, method.path, request, server.token("mallory"))

    def test_they_are_counted_until_the_call_has_ended(self):
        """The client has a window of 0 bytes, so that it receives the headers of each response and no data."""
        self.start()
        self.assertGreater(self.NUM_CALLS * self.read_geometry().ByteSize(), self.LIMIT_BYTES + SLACK_BYTES)
        before = self.running.resident_bytes()
        calls = b"".join(self.call(stream) for stream in range(1, 2 * self.NUM_CALLS, 2))
        with http2.open_connection(self.running, http2.window(0) + calls) as connection:
            begun = set()
            for kind, _, stream in http2.frames(connection):
                begun |= {stream} if kind == http2.HEADERS else set()
                if len(begun) == self.NUM_CALLS:
                    break
            self.assertEqual(len(begun), self.NUM_CALLS)
            self.assertLess(self.running.peak_bytes() - before, self.LIMIT_BYTES + SLACK_BYTES)
            failure = refusal(self.read_geometry)
            self.assertEqual((failure.code, failure.reason), ("RESOURCE_EXHAUSTED", "TENANT_QUOTA"))
            client(self, self.running, "alice")("ListModels")
        server.poll(self.is_answered, "the release of the responses of a connection that was closed")

    def is_answered(self):
        try:
            self.read_geometry()
            return True
        except grpc.RpcError as error:
            self.assertEqual(failure_of(error).reason, "TENANT_QUOTA")
            return False

    def test_they_are_counted_until_they_are_written_to_the_socket(self):
        """The clients have a large window of HTTP/2, and do not read from their sockets, whose buffers take less than half of a response."""
        self.start()
        window = http2.window(2**31 - 1) + http2.frame(http2.WINDOW_UPDATE, 0, 0, (2**30).to_bytes(4, "big"))
        host, port = self.running.address.rsplit(":", 1)
        with contextlib.ExitStack() as stack:
            for _ in range(self.NUM_CALLS // 2):
                connection = stack.enter_context(socket.socket())
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_MAXSEG, 536)
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                connection.connect((host, int(port)))
                connection.sendall(http2.PREFACE + http2.EMPTY_SETTINGS + window + self.call(1))
            server.poll(lambda: self.running.metric("evpose_quota_refusals_total", 'limit="tenant_responses"') > 0,
                        "a refusal because of the responses that are not read")

    def test_a_call_ends_whose_response_is_not_read(self):
        self.start(response_timeout_s=0.5)
        with http2.open_connection(self.running, http2.window(0) + self.call(1)) as connection:
            received = http2.frames(connection)
            kinds = {kind for kind, _, _ in itertools.takewhile(lambda frame: frame[0] != http2.RST_STREAM, received)}
            self.assertIn(http2.HEADERS, kinds)
            self.assertNotIn(http2.DATA, kinds)
            connection.sendall(http2.unary_call(3, METHODS["GetServerInfo"].path, b"", server.token("mallory")))
            self.assertIn(3, (stream for _, _, stream in received), "the connection serves other calls")


if __name__ == "__main__":
    unittest.main()
