#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Tests a client with two servers. When one of them stops or refuses, calls and watchers continue at the other one, with the effect of one
call."""

import dataclasses
import pathlib
import subprocess
import tempfile
import threading
import unittest
from concurrent import futures
from unittest import mock

import grpc
from scripted_server import Fail, FakeClock, pose
from testing import Balancer, evpose

from evpose.channel import Endpoint, TokenSource, explain_tls
from evpose.client import Client
from evpose.stream.servers import Servers
from evpose.v1 import admin_service_pb2, model_service_pb2, session_pb2, session_service_pb2

CAMERA = evpose.Camera(640, 480, 600.0, 600.0, 319.5, 239.5)
REFUSED = Fail(grpc.StatusCode.UNAVAILABLE, "DRAINING")


def full(reason, retry_in_s=5):
    return Fail(grpc.StatusCode.RESOURCE_EXHAUSTED, reason, retry_in_s=retry_in_s)


class OneOfTwo(grpc.GenericRpcHandler):
    """A server that records its calls in `calls`, and ends them with `failure`, unless it is None."""

    def __init__(self, first_pose_seq, address="127.0.0.1:0"):
        self.calls = []
        self.requests = []
        self.failure = None
        self.fails_after_pose = False
        self.on_watched = lambda: None  # called after the first response to a watcher
        self.max_model_bytes = 0
        self.on_call = lambda: None
        self._first_pose_seq = first_pose_seq
        self._server = grpc.server(futures.ThreadPoolExecutor(8))
        self._server.add_generic_rpc_handlers([self])
        self.address = f"127.0.0.1:{self._server.add_insecure_port(address)}"
        self._server.start()

    def stop(self):
        self._server.stop(None).wait()

    def take_calls(self):
        calls, self.calls = self.calls, []
        return calls

    def service(self, details):
        name = details.method.rsplit("/", 1)[1]
        modules = (session_service_pb2, model_service_pb2, admin_service_pb2)
        (request,) = [getattr(module, name + "Request") for module in modules if hasattr(module, name + "Request")]
        response = {"GetSession": session_pb2.Session(), "CreateSession": session_service_pb2.CreateSessionResponse(session={"name": "sessions/1"}),
                    "ListSessions": session_service_pb2.ListSessionsResponse(),
                    "GetServerInfo": admin_service_pb2.ServerInfo(max_model_bytes=self.max_model_bytes)}.get(
                        name, model_service_pb2.Model())

        def record(message, context):
            self.calls.append(name)
            self.requests.append(message)
            self.on_call()
            if self.failure is not None:
                self.failure.apply(context)
            return response

        def upload(messages, context):
            return record(sum(len(each.chunk) for each in messages), context)

        def watch(message, context):
            record(message, context)
            if name == "WatchPoses":
                yield session_service_pb2.WatchPosesResponse(poses=[pose(self._first_pose_seq).pose])
            else:
                yield session_service_pb2.WatchHealthResponse()
            self.on_watched()
            if self.fails_after_pose:
                REFUSED.apply(context)

        if name == "UploadModel":
            return grpc.stream_unary_rpc_method_handler(upload, request.FromString, lambda each: each.SerializeToString())
        if name.startswith("Watch"):
            return grpc.unary_stream_rpc_method_handler(watch, request.FromString, lambda each: each.SerializeToString())
        return grpc.unary_unary_rpc_method_handler(record, request.FromString, lambda each: each.SerializeToString())


class ServersTest(unittest.TestCase):
    def setUp(self):
        self.first, self.second = OneOfTwo(1), OneOfTwo(2)
        self.addCleanup(self.first.stop)
        self.addCleanup(self.second.stop)
        self.model = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()), "model.obj")
        self.model.write_text("v 0 0 0\n")

    def client(self, *servers):
        self.clock = FakeClock()
        endpoints = [Endpoint.open(server.address, None, TokenSource(None)) for server in servers or (self.first, self.second)]
        client = Client(Servers(endpoints, True, 0, self.clock), 60.0)
        self.addCleanup(client.close)
        return client

    def test_calls_go_to_the_server_that_is_alive(self):
        client = self.client()
        client.server_info()
        self.assertEqual(self.first.take_calls(), ["GetServerInfo"])
        self.first.stop()
        client.server_info()
        client.upload_model(self.model)
        client.get_model("models/1")
        client.create_session("models/1", CAMERA)
        client.list_sessions()
        client.session("sessions/1").delete()
        self.assertEqual(self.second.take_calls(), ["GetServerInfo", "UploadModel", "GetModel", "CreateSession", "ListSessions", "GetSession",
                                                    "DeleteSession"])
        self.assertEqual(self.clock.waits, [])

    def test_a_repeated_call_has_the_effect_of_one(self):
        self.first.failure = REFUSED
        for call in (lambda client: client.create_session("models/1", CAMERA), lambda client: client.upload_model(self.model),
                     lambda client: client.get_session("sessions/1")):
            call(self.client())
        self.assertEqual(self.first.calls, self.second.calls)
        self.assertEqual(self.first.requests, self.second.requests)  # with the same request_id
        self.assertTrue(self.first.requests[0].request_id)
        self.client().delete_model("models/1")
        # The first server may have deleted the model before it became unreachable.
        self.assertEqual([each.requests[-1].allow_missing for each in (self.first, self.second)], [False, True])

    def test_the_only_server_is_found_by_the_first_call_after_its_start(self):
        client = self.client(self.first)
        client.list_sessions()
        self.first.stop()
        for _ in range(2):
            with self.assertRaises(evpose.UnavailableError):
                client.list_sessions()
        again = OneOfTwo(1, self.first.address)
        self.addCleanup(again.stop)
        client.list_sessions()
        self.assertEqual(again.take_calls(), ["ListSessions"])

    def test_the_attempts_are_bounded(self):
        self.first.failure = self.second.failure = REFUSED
        client = self.client()
        with self.assertRaises(evpose.UnavailableError) as caught:
            client.get_session("sessions/1")
        self.assertIn(f"3 attempts each at {self.first.address}, {self.second.address}", str(caught.exception))
        self.assertEqual([len(self.first.take_calls()), len(self.second.take_calls())], [3, 3])
        # The delays are 0.1 and 0.2 s, which the jitter reduces by at most a half.
        self.assertEqual(len(self.clock.waits), 2)
        self.assertTrue(0.15 <= sum(self.clock.waits) <= 0.3, self.clock.waits)

    def test_a_response_that_is_an_error_is_final(self):
        for failure in (Fail(grpc.StatusCode.NOT_FOUND, "SESSION_NOT_FOUND"), Fail(grpc.StatusCode.INTERNAL, "STORE_FAILED")):
            self.first.failure = failure
            with self.assertRaises(evpose.EvposeError):
                self.client().get_session("sessions/1")
            self.assertEqual(self.first.take_calls(), ["GetSession"])
            self.assertEqual(self.second.calls, [])

    def refusal(self, client, **settings):
        with self.assertRaises(evpose.ResourceExhaustedError) as caught:
            client.create_session("models/1", CAMERA, **settings)
        return caught.exception

    def test_a_session_is_created_at_the_server_with_room(self):
        for reason in ("OVERLOADED", "TOO_MANY_SESSIONS", "SESSION_MEMORY", "OUT_OF_MEMORY"):
            self.first.failure = full(reason)
            # The session may be known to the second server alone.
            self.client().create_session("models/1", CAMERA).info()
            self.assertEqual(self.first.take_calls(), ["CreateSession"], reason)
            self.assertEqual(self.second.take_calls(), ["CreateSession", "GetSession"])
            self.assertEqual(self.clock.waits, [])
            self.assertEqual(self.first.requests[-1], self.second.requests[-2])  # with the same request_id

    def test_full_servers_are_waited_for_as_they_request(self):
        # The failures of the calls. The second server does not say for how long to wait.
        failures = [full("OVERLOADED", 7), full("TOO_MANY_SESSIONS", 5), None]
        self.second.failure = full("OUT_OF_MEMORY", 0)

        def on_call():
            self.first.failure = failures.pop(0)

        self.first.on_call = on_call
        client = self.client()
        client.create_session("models/1", CAMERA)
        self.assertEqual(self.clock.waits, [7.0, 5.0])
        self.assertEqual([len(each.take_calls()) for each in (self.first, self.second)], [3, 2])
        self.assertEqual(len({each.request_id for each in self.first.requests + self.second.requests}), 1)

    def test_the_wait_for_room_is_bounded(self):
        self.first.failure, self.second.failure = full("OVERLOADED", 60), full("TOO_MANY_SESSIONS", 5)
        names = f"{self.first.address}, {self.second.address}"
        error = self.refusal(self.client())
        self.assertEqual(str(error), f"{self.second.address}: from the script; none of the servers {names} accepts the session; "
                                     "gave up after 6 more tries in 30.0 s")
        self.assertEqual((error.reason, error.retry_in_s), ("TOO_MANY_SESSIONS", 5.0))
        self.assertEqual(self.clock.waits, 6 * [5.0])
        self.assertEqual([len(each.take_calls()) for each in (self.first, self.second)], [7, 7])
        self.first.failure, self.second.failure = self.second.failure, self.first.failure
        error = self.refusal(self.client(), max_wait_s=4.0)
        self.assertEqual(str(error), f"{self.second.address}: from the script; none of the servers {names} accepts the session")
        self.assertEqual((error.reason, error.retry_in_s), ("OVERLOADED", 5.0))
        self.assertEqual([len(each.take_calls()) for each in (self.first, self.second)], [1, 1])
        self.assertEqual(self.clock.waits, [])
        with self.assertRaisesRegex(evpose.InvalidArgumentError, "max_wait_s"):
            self.client().create_session("models/1", CAMERA, max_wait_s=-1.0)

    def test_a_refusal_that_neither_a_server_nor_a_delay_changes_is_final(self):
        self.first.failure = self.second.failure = full("TENANT_QUOTA")
        self.assertEqual(self.refusal(self.client()).retry_in_s, 5.0)
        self.assertEqual([each.take_calls() for each in (self.first, self.second)], [["CreateSession"], []])
        self.first.failure = self.second.failure = full("SESSION_MEMORY", 0)
        self.assertEqual(self.refusal(self.client()).retry_in_s, 0.0)
        self.assertEqual([each.take_calls() for each in (self.first, self.second)], [["CreateSession"], ["CreateSession"]])
        self.assertEqual(self.clock.waits, [])

    def test_a_full_server_is_waited_for_while_the_other_one_is_unreachable(self):
        for at_limit, unreachable in ((self.first, self.second), (self.second, self.first)):
            at_limit.failure, unreachable.failure = full("OVERLOADED"), REFUSED
            client = self.client()
            self.assertIn(f"{at_limit.address}: from the script; none of the servers", str(self.refusal(client, max_wait_s=0.0)))
            self.assertEqual(unreachable.take_calls(), ["CreateSession"])

            def on_call(server=at_limit):
                if self.clock.waits:
                    server.failure = None

            at_limit.on_call = on_call
            client.create_session("models/1", CAMERA)
            self.assertEqual(self.clock.waits, [5.0])
            at_limit.on_call = lambda: None
            at_limit.take_calls(), unreachable.take_calls()

    def test_a_full_server_is_waited_for_if_the_other_one_does_not_know_the_model(self):
        self.first.failure, self.second.failure = full("OVERLOADED"), Fail(grpc.StatusCode.NOT_FOUND, "MODEL_NOT_FOUND")
        client = self.client()
        error = self.refusal(client, max_wait_s=0.0)
        self.assertEqual(str(error), f"{self.first.address}: from the script; none of the servers {self.first.address}, "
                         f"{self.second.address} accepts the session; {self.second.address}: from the script")
        self.assertEqual((error.reason, error.retry_in_s), ("OVERLOADED", 5.0))
        self.assertEqual([each.take_calls() for each in (self.first, self.second)], [["CreateSession"], ["CreateSession"]])

        def on_call():
            if self.clock.waits:
                self.first.failure = None

        self.first.on_call = on_call  # the other calls stay at the server that knows the model
        client.create_session("models/1", CAMERA)
        self.assertEqual(self.clock.waits, [5.0])
        self.assertEqual(self.first.take_calls(), ["CreateSession", "CreateSession"])
        self.assertEqual(self.second.take_calls(), ["CreateSession"])

    def test_a_server_without_the_model_is_the_last_one_if_none_was_full(self):
        self.first.failure, self.second.failure = Fail(grpc.StatusCode.NOT_FOUND, "MODEL_NOT_FOUND"), full("OVERLOADED")
        with self.assertRaises(evpose.NotFoundError):
            self.client().create_session("models/1", CAMERA)
        self.assertEqual(self.second.take_calls(), [])

    def test_the_only_server_is_waited_for(self):
        self.first.failure = full("OVERLOADED")
        error = self.refusal(self.client(self.first), max_wait_s=9.0)
        self.assertEqual(str(error), f"{self.first.address}: from the script; gave up after 1 more tries in 5.0 s")
        self.assertEqual(len(self.first.take_calls()), 2)

    def test_close_ends_the_wait_for_room(self):
        self.first.failure = self.second.failure = full("OVERLOADED")
        client = self.client()

        class ClosingClock(FakeClock):
            def wait(self, seconds, stop):
                client.close()
                return super().wait(seconds, stop)

        client._servers.clock = ClosingClock()
        with self.assertRaisesRegex(evpose.CancelledError, "the client was closed"):
            client.create_session("models/1", CAMERA)
        self.assertEqual(len(self.second.take_calls()), 1)

    def test_watchers_continue_at_the_other_server(self):
        self.first.fails_after_pose = True
        session = self.client().session("sessions/1")
        self.assertEqual([each.seq for each in session.watch_poses()], [1, 2])
        self.assertEqual(self.first.take_calls(), ["GetSession", "WatchPoses"])
        self.assertEqual(self.second.requests[0].after_pose_seq, 1)
        self.assertEqual(len(list(self.client().session("sessions/1").watch_health())), 2)
        self.assertEqual(self.second.take_calls(), ["WatchPoses", "WatchHealth"])

    def test_close_of_a_watcher_that_another_thread_reads(self):
        ends, is_watched = threading.Event(), threading.Event()
        self.addCleanup(ends.set)
        self.first.on_watched = lambda: (is_watched.set(), ends.wait())
        with self.client().session("sessions/1").watch_poses() as watch:
            self.assertEqual(next(watch).seq, 1)
            errors, is_reading = [], threading.Event()

            def read():
                is_reading.set()
                try:
                    next(watch)
                except evpose.EvposeError as error:
                    errors.append(error)
                except StopIteration:  # close() came before the read
                    errors.append(evpose.CancelledError("closed"))

            reader = threading.Thread(target=read)
            reader.start()
            is_reading.wait()
            is_watched.wait()
            watch.close()
            reader.join()
            self.assertEqual([type(error) for error in errors], [evpose.CancelledError])
        self.assertEqual(self.second.take_calls(), [])
        self.assertEqual(list(watch), [])

    def test_parameters_of_watchers_are_checked_at_the_call(self):
        session = self.client().session("sessions/1")
        for watch in (lambda: session.watch_health(float("nan")), lambda: session.watch_health(0.001),
                      lambda: session.watch_poses(-1), lambda: session.watch_poses(max_rate_hz="fast")):
            with self.assertRaises(evpose.InvalidArgumentError):
                watch()

    def test_a_session_can_be_fed_after_a_recording_that_does_not_fit(self):
        session = self.client().create_session("models/1", CAMERA)
        session._resume_token = "token"
        session._info = dataclasses.replace(session._info, encoding=evpose.Encoding.FLAT64)
        with self.assertRaises(evpose.InvalidArgumentError):
            session.track(b"bytes")
        session.track([]).close()
        with self.assertRaisesRegex(evpose.FailedPreconditionError, "was fed already"):
            session.track([])

    def test_connect_tries_the_next_server_if_one_does_not_respond(self):
        timeouts = []

        def server_info(endpoint, timeout_s):
            timeouts.append(timeout_s)
            if endpoint.name == self.first.address:
                raise evpose.DeadlineExceededError("no response")
            return evpose.client.server_from_message(admin_service_pb2.ServerInfo())

        addresses = f"{self.first.address},{self.second.address}"
        with mock.patch("evpose.client._server_info", server_info):
            with evpose.connect(addresses, connect_timeout_s=8.0) as client:
                self.assertEqual(client._servers.current, 1)
        self.assertEqual(len(timeouts), 2)
        self.assertLessEqual(timeouts[0], 4.0)

    def test_connect_closes_the_channels_after_an_error(self):
        with mock.patch.object(Endpoint, "close", autospec=True) as close:
            with self.assertRaises(evpose.FailedPreconditionError):
                evpose.connect(f"{self.first.address},192.0.2.1:1", token="secret")
        self.assertEqual([call.args[0].name for call in close.call_args_list], [self.first.address])

    def test_the_limit_of_models_is_that_of_the_server(self):
        self.first.max_model_bytes = 4
        with evpose.connect(self.first.address) as client:
            with self.assertRaisesRegex(evpose.InvalidArgumentError, "larger than 4 bytes, the limit of the server for a model"):
                client.upload_model(self.model)
        self.first.max_model_bytes = 8
        with evpose.connect(self.first.address) as client:
            client.upload_model(self.model)

    def test_tls_files_that_cannot_be_used(self):
        directory = self.model.parent
        certificate, key, locked = (str(directory / name) for name in ("c.pem", "k.pem", "locked.pem"))
        subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-subj", "/CN=a",
                        "-keyout", key, "-out", certificate], check=True, capture_output=True)
        subprocess.run(["openssl", "ec", "-in", key, "-aes256", "-passout", "pass:secret", "-out", locked], check=True, capture_output=True)
        defective = directory / "defective.pem"
        defective.write_text("-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n")
        for tls in (evpose.Tls(ca=str(defective)), evpose.Tls(certificate, str(defective), key), evpose.Tls(certificate, certificate, locked)):
            self.assertIn("the TLS files of this client cannot be used", explain_tls(self.first.address, tls, 1.0))
            with self.assertRaisesRegex(evpose.FailedPreconditionError, "check Tls.ca, Tls.certificate and Tls.key"):
                evpose.connect(self.first.address, tls=tls, connect_timeout_s=0.1)


class BalancedServersTest(unittest.TestCase):
    """One address, behind which the connections go to two servers in turn. The first one has no room for a session."""

    def setUp(self):
        self.full, self.free = OneOfTwo(1), OneOfTwo(1)
        self.balancer = Balancer(self.full.address, self.free.address)
        for each in (self.full.stop, self.free.stop, self.balancer.close):
            self.addCleanup(each)
        self.clock = FakeClock()
        self.endpoint = Endpoint.open(self.balancer.address, None, TokenSource(None))
        self.client = Client(Servers([self.endpoint], True, 0, self.clock), 60.0)
        self.addCleanup(self.client.close)
        self.client.server_info()
        self.assertEqual(self.full.take_calls(), ["GetServerInfo"])
        self.full.failure = full("OVERLOADED")

    def test_a_refused_session_is_created_at_the_server_of_a_new_connection(self):
        self.client.create_session("models/1", CAMERA)
        self.client.get_session("sessions/1")
        self.assertEqual(self.clock.waits, [5.0])
        self.assertEqual(self.full.take_calls(), ["CreateSession"])
        self.assertEqual(self.free.take_calls(), ["CreateSession", "GetSession"])
        self.assertEqual(self.endpoint._left, [], "the former connection is still open")

    def test_the_call_after_a_refusal_has_a_new_connection(self):
        with self.assertRaises(evpose.ResourceExhaustedError):
            self.client.create_session("models/1", CAMERA, max_wait_s=0.0)
        self.assertEqual(self.free.take_calls(), [])
        self.client.create_session("models/1", CAMERA, max_wait_s=0.0)
        self.assertEqual(self.free.take_calls(), ["CreateSession"])

    def test_a_watcher_keeps_its_connection_while_a_session_is_refused(self):
        ends = threading.Event()
        self.addCleanup(ends.set)
        self.full.failure = None
        self.full.on_watched = ends.wait
        with self.client.session("sessions/1").watch_poses() as watch:
            self.assertEqual(next(watch).seq, 1)
            self.full.failure = full("OVERLOADED")
            self.client.create_session("models/1", CAMERA)
            self.assertEqual(len(self.endpoint._left), 1)
            ends.set()
            self.assertEqual(list(watch), [])
        self.assertEqual(self.full.take_calls(), ["GetSession", "WatchPoses", "CreateSession"])
        self.client.server_info()
        self.assertEqual(self.endpoint._left, [], "the former connection is still open")

    def test_the_connection_remains_if_there_is_no_new_one(self):
        self.balancer.refuse()
        with self.assertRaisesRegex(evpose.ResourceExhaustedError, "gave up after 1 more tries in 5.0 s"):
            self.client.create_session("models/1", CAMERA, max_wait_s=9.0)
        self.assertEqual(self.full.take_calls(), ["CreateSession", "CreateSession"])


if __name__ == "__main__":
    unittest.main()
