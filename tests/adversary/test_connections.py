#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Connections: many, idle, half open or malicious ones do not disturb calls, probes and other sessions."""

import contextlib
import ctypes
import math
import os
import socket
import time
import unittest

import grpc

import http2
import server
from api import client, failure_of, refusal
from hostile_models import CUBE

SLACK_BYTES = 200 << 20
PIDFD_GETFD = 438  # the system call of Linux 5.6, which Python does not have


def open_many(address, count, stack, source=None):
    """Opens TCP connections without a byte until one fails. Returns those that were opened."""
    connections = []
    with contextlib.suppress(OSError):
        for _ in range(count):
            connections.append(stack.enter_context(server.connect(address, source)))
    return connections


def slowest_s(call, count):
    times = []
    for _ in range(count):
        start = time.monotonic()
        call()
        times.append(time.monotonic() - start)
    return max(times)


def shut_listener(running):
    """Shuts the listening socket of the server down, without its knowledge. Returns false if this process is not permitted to do so."""
    process = os.pidfd_open(running.process.pid)
    port = int(running.address.rsplit(":", 1)[1])
    is_shut = False
    for number in map(int, os.listdir(f"/proc/{running.process.pid}/fd")):
        descriptor = ctypes.CDLL(None).syscall(PIDFD_GETFD, process, number, 0)
        if descriptor < 0:
            continue
        with os.fdopen(descriptor, "rb", buffering=0), contextlib.suppress(OSError):  # not a socket
            with socket.socket(fileno=os.dup(descriptor)) as listener:
                if listener.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN) and listener.getsockname()[1] == port:
                    listener.shutdown(socket.SHUT_RD)
                    is_shut = True
    os.close(process)
    return is_shut


class ConnectionTest(server.AdversaryTest):
    def test_a_server_that_no_longer_accepts_is_not_ready_and_ends(self):
        """The server ends, so that its supervisor starts it again."""
        running = self.serve("--listener-timeout", "2")
        if not shut_listener(running):
            self.skipTest("the descriptors of another process cannot be used here")

        def is_unready():
            try:
                return running.page("/readyz")[0] == 503
            except OSError:
                return running.process.poll() is not None

        server.poll(is_unready, "a page that says that no connection is accepted")
        self.assertEqual(running.wait(), 1)
        self.assertIn("listener_stalled", running.log())

    def test_the_server_accepts_again_after_it_had_no_descriptors(self):
        # The limits of connections are high, because they would be reached before.
        running = self.serve("--max-connections", "1000", "--max-connections-per-peer", "1000", prlimit=["--nofile=128:128"])
        with contextlib.ExitStack() as stack:
            opened = open_many(running.address, 300, stack)
            self.assertGreater(len(opened), 60)
            server.poll(lambda: running.page("/readyz")[0] == 503, "a page that says that descriptors are missing")
        server.poll(lambda: running.answers(timeout=1.0), "a connection after the others were closed")
        client(self, running)("GetServerInfo")

    def test_connections_are_counted(self):
        """Two peers reach the limit of all connections. Each has fewer than a peer may have."""
        running = self.serve("--max-connections", "20", "--max-connections-per-peer", "18")
        before = client(self, running)
        before("GetServerInfo")
        with contextlib.ExitStack() as stack:
            for source in ("127.0.0.2", "127.0.0.3"):
                self.assertEqual(len(open_many(running.address, 15, stack, source)), 15)
            self.wait_for_refusals(running, 11)
            before("GetServerInfo")
        server.poll(lambda: running.answers(timeout=1.0), "a connection after the others were closed")

    def test_one_peer_leaves_connections_to_others(self):
        running = self.serve("--max-connections", "40", "--max-connections-per-peer", "20")
        with contextlib.ExitStack() as stack:
            self.assertEqual(len(open_many(running.address, 60, stack, source="127.0.0.2")), 60)
            self.wait_for_refusals(running, 40)
            client(self, running)("GetServerInfo")

    def wait_for_refusals(self, running, count):
        """Reads the metric instead of waiting for closed connections, because the server closes all silent ones after 20 s."""
        server.poll(lambda: running.metric("evpose_connections_refused_total") == count, f"{count} refused connections")

    def test_half_requests_do_not_delay_probes(self):
        running = self.serve()
        alone = slowest_s(lambda: running.page("/healthz"), 20)
        with contextlib.ExitStack() as stack:
            for connection in open_many(running.metrics_address, 100, stack):
                with contextlib.suppress(OSError):  # the server may have closed it in favour of later ones
                    connection.sendall(b"GET /metrics HTTP/1.1\r\nHost: a\r\nX: ")
            for path in ("/healthz", "/readyz"):
                beside = slowest_s(lambda path=path: self.assertEqual(running.page(path)[0], 200), 3)
                self.assertLess(beside, 100 * max(alone, 0.01))

    def test_requests_for_files_are_refused(self):
        running = self.serve()
        for request in (b"GET /../../etc/passwd HTTP/1.1\r\n\r\n", b"GET /%2e%2e/%2e%2e/etc/passwd HTTP/1.1\r\n\r\n",
                        b"GET /\0 HTTP/1.1\r\n\r\n", b"GET /" + b"a" * 100_000 + b" HTTP/1.1\r\n\r\n",
                        b"POST /metrics HTTP/1.1\r\nContent-Length: 99999999999\r\n\r\n", bytes(1000)):
            with server.connect(running.metrics_address) as connection:
                with contextlib.suppress(ConnectionError):
                    connection.sendall(request)
                    self.assertRegex(connection.recv(4096) or b"HTTP/1.1 400", rb"^HTTP/1\.1 4")
        self.assertEqual(running.page("/healthz")[0], 200)


class Http2Test(server.AdversaryTest):
    def setUp(self):
        super().setUp()
        self.running = self.serve("--max-transport-bytes", str(128 << 20), tenants=("alice",))
        self.alice = client(self, self.running, "alice")
        self.call = lambda: self.alice("GetServerInfo")
        self.alone_s = slowest_s(self.call, 100)
        self.before = self.running.resident_bytes()

    def attack(self, pieces, peak_bytes, start=b"", max_delay=100):
        """Floods the server on two connections, with a call of alice between the pieces, which may take `max_delay` times as long as
        without a flood. A connection that the server cuts is opened again. Returns how many were cut."""
        num_cut = 0
        times = []
        connections = [http2.open_connection(self.running, start) for _ in range(2)]
        for piece in pieces:
            for i, connection in enumerate(connections):
                if not http2.send(connection, piece):
                    num_cut += 1
                    connection.close()
                    connections[i] = http2.open_connection(self.running, start)
            times.append(slowest_s(self.call, 1))
        for connection in connections:
            connection.close()
        server.poll(lambda: self.running.resident_bytes() < self.before + SLACK_BYTES, "memory that is given back")
        self.assertLess(self.running.peak_bytes(), self.before + peak_bytes)
        self.assertLess(max(times), max_delay * max(self.alone_s, 0.01))
        return num_cut

    def test_calls_that_are_reset_at_once(self):
        # gRPC 1.51 keeps 10 to 20 kB for each of them until it has processed the reset, and other calls wait meanwhile: only the proxy
        # prevents that. How many it keeps at once depends on the machine; 32 kB for each of all calls is more than it ever keeps.
        pieces = (http2.reset_streams(5000 * i, 5000) for i in range(10))
        self.attack(pieces, 32_000 * 100_000, max_delay=math.inf)

    def test_pings_whose_answers_are_not_read(self):
        pings = http2.frame(http2.PING, 0, 0, bytes(8)) * 10_000
        self.assertGreater(self.attack([pings] * 20, 2 * SLACK_BYTES), 0)

    def test_a_header_without_end(self):
        """gRPC 1.51 keeps as much of it as is sent: only the proxy prevents that."""
        piece = http2.frame(http2.CONTINUATION, 0, 1, http2.LONG_FIELD) * 100
        start = http2.frame(http2.HEADERS, 0, 1, http2.CALL)
        self.attack([piece] * 100, 2 * 2 * 100 * len(piece), start)

    def test_settings_whose_answers_are_not_read(self):
        self.attack([http2.frame(http2.SETTINGS, 0, 0, b"\x00\x04\x00\x00\xff\xff") * 5000] * 10, 2 * SLACK_BYTES)


class StreamTest(server.AdversaryTest):
    def test_silent_streams_end(self):
        """A session whose stream is silent is given up; one whose client sends empty chunks is not."""
        running = self.serve("--max-sessions", "4", "--stream-idle-timeout", "1", "--session-expiry", "1")
        api = client(self, running)
        model = api.upload(CUBE).name
        sessions = [api.attach(api.create(model)) for _ in range(4)]
        live, attached = sessions.pop()
        self.assertEqual(attached.idle_timeout.seconds, 1)
        self.assertEqual(refusal(api.create, model).reason, "TOO_MANY_SESSIONS")

        def has_room():
            live.send(events={})
            try:
                return api.create(model)
            except grpc.RpcError as error:
                self.assertEqual(failure_of(error).reason, "TOO_MANY_SESSIONS")
                return None

        server.poll(has_room, "room for a session")
        for silent, _ in sessions:
            self.assertEqual(silent.failure().reason, "STREAM_IDLE")
        live.send(end={})
        live.read("summary")

    def test_streams_that_never_attach_end(self):
        running = self.serve("--attach-timeout", "0.5")
        stream = client(self, running).stream()
        self.assertEqual(stream.failure().reason, "ATTACH_TIMEOUT")

    def test_watchers_of_health_have_a_rate(self):
        running = self.serve("--tenant-max-health-per-s", "100")
        api = client(self, running)
        name = api.create(api.upload(CUBE).name).session.name
        start = time.monotonic()
        watchers = [api.watch("WatchHealth", session=name, period={"nanos": 10_000_000}) for _ in range(20)]
        received = sum(1 for watcher in watchers for _ in zip(range(15), watcher))
        self.assertEqual(received, 300)
        # Each watcher has one message at once; the others come at the tenant's rate.
        self.assertLess(received - len(watchers), 2 * 100 * (time.monotonic() - start))

    def test_violations_of_the_protocol_end_their_stream_only(self):
        running = self.serve()
        api = client(self, running)
        model = api.upload(CUBE).name
        nan = float("nan")
        pose = {"rotation": {"x": nan, "y": 0, "z": 0, "w": 1}}
        violations = {
            "INVALID_ARGUMENT": [
                [{"attach": {"session": "sessions/x"}}], [{}], [{"events": {"seq": 0, "payload": bytes(8)}}],
                [{"events": {"seq": 1, "payload": bytes(7)}}], [{"events": {"seq": 1, "payload": bytes((1 << 20) + 8)}}],
                [{"reset_pose": {"object_id": "object0", "seq": 1, "camera_from_object": pose}}],
                [{"reset_pose": {"object_id": "another", "seq": 1}}],
            ],
            "FAILED_PRECONDITION": [[{"events": {"seq": 2}}], [{"events": {"seq": 2**64 - 1}}]],
            "DATA_LOSS": [[{"events": {"seq": 1, "payload": bytes(8), "crc32c": 1}}]],
        }
        for code, cases in violations.items():
            for messages in cases:
                with self.subTest(code=code, messages=str(messages)[:200]):
                    created = api.create(model)
                    stream, _ = api.attach(created)
                    for message in messages:
                        stream.send(**message)
                    self.assertEqual(stream.failure().code, code)
                    api("DeleteSession", name=created.session.name)


if __name__ == "__main__":
    unittest.main()
