#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The package against evpose-server: the poses are those of the command evpose to the bit, also when servers are killed and
connections are cut; access, wrong inputs, watching, the examples."""

import json
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import threading
import unittest

import numpy as np
from prometheus_client.openmetrics import parser as openmetrics
from testing import PATIENT, ROOT, Relay, evpose, run_evpose, server

import evt3_words as words

EXAMPLES = ROOT / "client/python/examples"


class ServerTest(unittest.TestCase):
    """A simulated cube, and the poses that the command evpose prints for it."""

    @classmethod
    def setUpClass(cls):
        cls.scene = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory()))
        run_evpose("simulate", "--object", "cube", "--camera", "vga", "--duration", "0.4", "--out", cls.scene)
        cls.recording, cls.model, cls.camera = (cls.scene / name for name in ("recording.raw", "model.obj", "camera.yaml"))

    def setUp(self):
        self.directory = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))

    def serve(self, *options, store="memory"):
        running = server.Server("--log-level", "error", "--shutdown-timeout", "1", *options, directory=self.directory, store=store)
        self.addCleanup(lambda: running.is_ended or running.kill())
        return running

    def connect(self, address, **settings):
        client = evpose.connect(address, **settings)
        self.addCleanup(client.close)
        return client

    def create(self, client, encoding=evpose.Encoding.EVT3, **settings):
        return client.create_session(client.upload_model(self.model), evpose.read_camera(self.camera), encoding, **settings)

    def open(self, path=None, **settings):
        recording = evpose.Recording(path or self.recording, **settings)
        self.addCleanup(recording.close)
        return recording

    def replay(self, recording=None, *options):
        """Returns the poses of the command evpose."""
        out = self.directory / "expected.jsonl"
        run_evpose("replay", recording or self.recording, "--model", self.model, "--camera", self.camera, "--out", out, *options)
        return [json.loads(line) for line in out.read_text().splitlines()]

    def assert_same(self, poses, expected):
        """Compares an array of POSE_DTYPE with lines of the command evpose, to the bit."""
        self.assertGreater(len(expected), 100)
        self.assertEqual(len(poses), len(expected))
        rows, columns = np.triu_indices(6)
        for name, values in (
                ("seq", [each["pose_seq"] for each in expected]), ("t_us", [each["t_us"] for each in expected]),
                ("translation_m", [each["translation_m"] for each in expected]),
                ("quaternion_xyzw", [each["quaternion_xyzw"] for each in expected]), ("twist", [each["twist"] for each in expected]),
                ("state", [evpose.TrackState[each["state"]] for each in expected]),
                ("num_events", [each["num_events"] for each in expected]),
                ("explained_ratio", np.float32([each["explained_ratio"] for each in expected])),
                ("residual_rms_px", np.float32([each["residual_rms_px"] for each in expected]))):
            np.testing.assert_array_equal(poses[name], np.array(values), err_msg=name)
        np.testing.assert_array_equal(poses["covariance"][:, rows, columns], [each["covariance_upper"] for each in expected])
        np.testing.assert_array_equal(poses["covariance"], poses["covariance"].transpose(0, 2, 1))

    def assert_same_poses(self, poses, expected):
        """Compares poses that were read one by one with lines of the command evpose, to the bit."""
        rows, columns = np.triu_indices(6)
        self.assertEqual(len(poses), len(expected))
        for pose, each in zip(poses, expected):
            self.assertEqual(
                (pose.seq, pose.object_id, pose.t_us, pose.translation_m.tolist(), pose.quaternion_xyzw.tolist(), pose.twist.tolist(),
                 pose.covariance[rows, columns].tolist(), pose.state.name, pose.num_events, pose.latest_loss_t_us,
                 pose.latest_loss_cause),
                (each["pose_seq"], each["object_id"], each["t_us"], each["translation_m"], each["quaternion_xyzw"], each["twist"],
                 each["covariance_upper"], each["state"], each["num_events"], each["lost_at_us"], each["loss_cause"] or ""))


class PoseTest(ServerTest):
    def test_a_recording(self):
        client = self.connect(self.serve().address)
        with self.create(client).track(self.open()) as track:
            poses = track.read_all()
        self.assert_same(poses, self.replay())
        self.assertEqual(track.summary.poses, len(poses))
        self.assertEqual(track.summary.sent_bytes, track.summary.health.processed_bytes)
        evpose.write_tum(self.directory / "poses.tum", poses)
        run_evpose("replay", self.recording, "--model", self.model, "--camera", self.camera, "--out", self.directory / "expected.tum")
        self.assertEqual((self.directory / "poses.tum").read_bytes(), (self.directory / "expected.tum").read_bytes())

    def test_one_by_one_and_of_several_objects(self):
        client = self.connect(self.serve().address)
        model = client.upload_model(self.model)
        objects = [evpose.TrackedObject(model, name) for name in ("left", "right")]
        session = client.create_session(objects, evpose.read_camera(self.camera), evpose.Encoding.EVT3)
        self.assertEqual(session.object_ids, ("left", "right"))
        poses = list(session.track(self.open()))
        self.assertGreater(len(poses), 100)
        self.assertLessEqual({pose.object_id for pose in poses}, {"left", "right"})
        stored = list(session.watch_poses())
        self.assertEqual([(pose.seq, pose.object_id, pose.t_us) for pose in stored], [(pose.seq, pose.object_id, pose.t_us) for pose in poses])
        for pose, other in zip(poses, stored):
            np.testing.assert_array_equal(pose.camera_from_object.matrix, other.camera_from_object.matrix)

    def test_arrays_of_events(self):
        events = words.decode_evt3(self.recording.read_bytes())
        self.assertGreater(len(events), 50_000)
        flat = self.directory / "flat.raw"
        flat.write_bytes(b"% format FLAT64;height=480;width=640\n% end\n" + evpose.events_to_bytes(events))
        client = self.connect(self.serve().address)
        session = self.create(client, evpose.Encoding.FLAT64)
        self.assert_same(session.track(np.array_split(events, 50)).read_all(), self.replay(flat))

    def test_a_reset_at_its_place_in_the_stream(self):
        chunks = list(self.open(chunk_bytes=65536))
        data = self.recording.read_bytes()
        header = len(data) - sum(map(len, chunks))
        # The last time of the third chunk: the command resets before the first chunk that reaches it.
        reset_us = int(words.decode_evt3(data[:header + 3 * 65536])["t"][-1])
        pose = (self.scene / "truth.tum").read_text().splitlines()[0].split()[1:]
        transform = evpose.Transform.from_quaternion([float(x) for x in pose[:3]], [float(x) for x in pose[3:]])
        client = self.connect(self.serve().address)
        source = [*chunks[:2], evpose.PoseReset(transform), *chunks[2:]]
        poses = self.create(client).track(source).read_all()
        expected = self.replay(None, "--chunk-bytes", "65536", "--reset-pose", f"{reset_us} " + " ".join(pose))
        self.assert_same(poses, expected)
        undisturbed = self.replay()
        self.assertNotEqual([each["translation_m"] for each in undisturbed], [each["translation_m"] for each in expected])


class SurvivalTest(ServerTest):
    def test_a_server_that_is_killed_and_restarted(self):
        running = self.serve(store="sqlite")
        relay = Relay(running.address)
        self.addCleanup(relay.close)
        changes = []
        client = self.connect(relay.address)
        track = self.create(client).track(self.open(chunk_bytes=8192), evpose.TrackOptions(retry=PATIENT, on_connection=changes.append))
        delivered = []
        for i, pose in enumerate(track):
            delivered.append(pose)
            if i in (60, 200):
                running.process.send_signal(signal.SIGKILL)
                running.wait()
                running.start()
                relay.target = running.address
        self.assertTrue(any(change.is_disconnected for change in changes) and not changes[-1].is_disconnected)
        self.assertGreaterEqual(track.summary.health.reattaches, 1)
        self.assert_same_poses(delivered, self.replay())

    def test_poses_across_kills_are_those_of_an_undisturbed_stream(self):
        running = self.serve(store="sqlite")
        relay = Relay(running.address)
        self.addCleanup(relay.close)
        client = self.connect(relay.address)
        kills = [3, 6]

        def source():
            for i, chunk in enumerate(self.open(chunk_bytes=65536)):
                if i in kills:
                    running.process.send_signal(signal.SIGKILL)
                    running.wait()
                    running.start()
                    relay.target = running.address
                yield chunk

        self.assert_same(self.create(client).track(source(), evpose.TrackOptions(retry=PATIENT)).read_all(), self.replay())

    def test_connections_that_are_cut(self):
        running = self.serve()
        relay = Relay(running.address)
        self.addCleanup(relay.close)
        session = self.create(self.connect(relay.address))

        def source():
            for i, chunk in enumerate(self.open(chunk_bytes=16384)):
                if i % 5 == 4:
                    relay.cut()
                yield chunk

        track = session.track(source(), evpose.TrackOptions(retry=PATIENT))
        self.assert_same(track.read_all(), self.replay())
        self.assertGreater(track.summary.health.reattaches, 0)

    def test_another_process_continues(self):
        running = self.serve(store="sqlite")
        client = self.connect(running.address)
        positions = []
        options = evpose.TrackOptions(on_position=lambda position, _: positions.append(position.to_json()))
        track = self.create(client).track(self.open(chunk_bytes=16384), options)
        first = [next(track) for _ in range(150)]
        track.close()
        with self.assertRaises(StopIteration):
            next(track)
        position = evpose.TrackPosition.from_json(track.position.to_json())
        running.process.send_signal(signal.SIGKILL)
        running.wait()
        running.start()
        other = self.connect(running.address)
        second = other.resume(position, self.open(chunk_bytes=16384)).read_all()
        expected = self.replay()
        self.assertEqual([pose.seq for pose in first] + second["seq"].tolist(), [each["pose_seq"] for each in expected])
        self.assert_same_poses(first, expected[:150])
        np.testing.assert_array_equal(second["translation_m"], [each["translation_m"] for each in expected[150:]])
        self.assertTrue(positions)

    def test_a_server_without_a_store_loses_its_sessions(self):
        running = self.serve()
        relay = Relay(running.address)
        self.addCleanup(relay.close)
        track = self.create(self.connect(relay.address)).track(self.open(chunk_bytes=8192), evpose.TrackOptions(retry=PATIENT))
        with self.assertRaises(evpose.NotFoundError) as caught:
            for i, _ in enumerate(track):
                if i == 50:
                    running.kill()
                    running.start()
                    relay.target = running.address
        self.assertEqual(caught.exception.reason, "SESSION_NOT_FOUND")
        self.assertRegex(str(caught.exception), r"after \d+ bytes sent, \d+ poses received")


class WatchTest(ServerTest):
    def test_poses_and_health_of_a_session_that_another_client_feeds(self):
        address = self.serve().address
        feeder, watcher = self.connect(address), self.connect(address)
        session = self.create(feeder)
        watched = watcher.session(session.name)
        seen = []
        thread = threading.Thread(target=lambda: seen.extend(watched.watch_poses()))
        thread.start()
        poses = session.track(self.open()).read_all()
        thread.join()
        self.assertEqual([pose.seq for pose in seen], poses["seq"].tolist())
        self.assertEqual([pose.t_us for pose in seen], poses["t_us"].tolist())
        *_, last = watched.watch_health(0.01)
        self.assertEqual((last.poses, last.objects[0].state), (len(poses), evpose.TrackState.TRACKING))
        self.assertEqual((watched.info().state, watched.health().poses), ("ENDED", len(poses)))
        self.assertEqual(len(list(watched.watch_poses(after_seq=len(poses) - 5))), 5)
        self.assertLess(len(list(watched.watch_poses(max_rate_hz=100.0))), len(poses) / 5)
        self.assertEqual([info.name for info in watcher.list_sessions()], [session.name])
        self.assertTrue(watcher.is_serving())
        self.assertEqual(watcher.server_info().store, "memory")
        with self.assertRaises(evpose.FailedPreconditionError):
            watched.track([])
        with self.assertRaises(evpose.FailedPreconditionError):
            session.track([])
        model = watcher.list_models()[0]
        self.assertEqual((watcher.get_model(model.name), model.num_lines, model.file_name), (model, 12, "model.obj"))
        with self.assertRaises(evpose.FailedPreconditionError) as caught:
            watcher.delete_model(model.name)
        self.assertEqual(caught.exception.reason, "MODEL_IN_USE")
        watched.delete()
        watched.delete()  # again: no error
        watcher.delete_model(model.name)
        for call in (session.info, lambda: list(session.watch_poses()), lambda: list(session.watch_health()),
                     lambda: watcher.session(session.name)):
            with self.assertRaises(evpose.NotFoundError) as caught:
                call()
            self.assertEqual(caught.exception.reason, "SESSION_NOT_FOUND")
        feeder.close()
        for call in (session.info, lambda: list(session.watch_poses()), lambda: self.create(feeder)):
            with self.assertRaisesRegex(evpose.FailedPreconditionError, "the client was closed"):
                call()


class TraceTest(ServerTest):
    def test_log_and_metrics_name_the_session(self):
        running = server.Server("--log-level", "info", "--log-format", "json", directory=self.directory, store="sqlite")
        self.addCleanup(lambda: running.is_ended or running.kill())
        client = self.connect(running.address)
        session = self.create(client)
        track = session.track(self.open())
        track.read_all()
        self.assertEqual(client.session(session.name).info().trace_id, session.trace_id)
        lines = [line for line in map(json.loads, running.log().splitlines()) if line.get("session") == session.name]
        self.assertEqual({line["trace_id"] for line in lines}, {session.trace_id})
        spans = {line["event"]: line.get("span_id") for line in lines}
        self.assertEqual((spans["session_attached"], spans["session_ended"]), (track.summary.trace.span_id,) * 2)

        # The parser of Prometheus's Python client is strict.
        page = running.page("/metrics", accept="application/openmetrics-text; version=1.0.0")[1]
        exemplars = {sample.name: sample.exemplar for family in openmetrics.text_string_to_metric_families(page)
                     for sample in family.samples if sample.exemplar is not None}
        for name in ("pose_latency", "turn", "decode_duration", "track_duration", "checkpoint_duration"):
            exemplar = exemplars[f"evpose_{name}_seconds_bucket"]
            self.assertEqual(exemplar.labels, {"trace_id": session.trace_id})
            self.assertGreaterEqual(exemplar.value, 0.0)
        self.assertNotIn(session.name, page)


class AccessTest(ServerTest):
    def certificate(self, name, host="IP:127.0.0.1"):
        """Makes a certificate that is its own authority. Returns the paths of certificate and key."""
        certificate, key = (str(self.directory / f"{name}.{suffix}") for suffix in ("crt", "key"))
        subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2", "-subj",
                        f"/CN={name}", "-addext", f"subjectAltName={host}", "-keyout", key, "-out", certificate],
                       check=True, capture_output=True)
        return certificate, key

    def refused(self, error, address, **settings):
        with self.assertRaises(error) as caught:
            evpose.connect(address, connect_timeout_s=1.5, **settings)
        return caught.exception

    def test_tls(self):
        certificate, key = self.certificate("server")
        other, _ = self.certificate("other")
        address = self.serve("--tls-cert", certificate, "--tls-key", key).address
        client = self.connect(address, tls=evpose.Tls(ca=certificate))
        self.assert_same(self.create(client).track(self.open()).read_all(), self.replay())
        self.assertIn("it requires TLS", str(self.refused(evpose.FailedPreconditionError, address)))
        self.assertIn("cannot be verified", str(self.refused(evpose.FailedPreconditionError, address, tls=evpose.Tls(ca=other))))
        plain = self.serve().address
        self.assertIn("does not use TLS", str(self.refused(evpose.FailedPreconditionError, plain, tls=evpose.Tls(ca=certificate))))
        for tls, error, text in ((evpose.Tls(ca="none.crt"), evpose.NotFoundError, "none.crt"),
                                 (evpose.Tls(ca=str(self.model)), evpose.FailedPreconditionError, "is not a PEM file"),
                                 (evpose.Tls(ca=certificate, key=key), evpose.InvalidArgumentError, "a key its certificate")):
            self.assertIn(text, str(self.refused(error, address, tls=tls)))

    def test_client_certificates(self):
        certificate, key = self.certificate("server")
        mine, my_key = self.certificate("lab")
        other, other_key = self.certificate("other")
        address = self.serve("--tls-cert", certificate, "--tls-key", key, "--tls-client-ca", mine).address
        client = self.connect(address, tls=evpose.Tls(certificate, mine, my_key))
        self.assertTrue(client.is_serving())
        missing = self.refused(evpose.FailedPreconditionError, address, tls=evpose.Tls(certificate))
        self.assertIn("requires a certificate", str(missing))
        wrong = self.refused(evpose.FailedPreconditionError, address, tls=evpose.Tls(certificate, other, other_key))
        self.assertIn("it rejects the certificate", str(wrong))

    def test_tokens(self):
        tokens = server.write_tokens(self.directory / "tokens", ["lab", "other"])
        address = self.serve("--token-file", str(tokens)).address
        token = server.token("lab")
        session = self.create(self.connect(address, token=token))
        self.assert_same(session.track(self.open()).read_all(), self.replay())
        for wrong, reason in ((None, "NO_TOKEN"), ("evpose_wrong", "BAD_TOKEN")):
            error = self.refused(evpose.UnauthenticatedError, address, token=wrong)
            self.assertEqual((error.reason, error.code), (reason, "UNAUTHENTICATED"))
            self.assertIn(address, str(error))
        with self.assertRaises(evpose.NotFoundError):  # of another tenant
            self.connect(address, token=server.token("other")).session(session.name)
        self.assertIn("invalid in a token", str(self.refused(evpose.InvalidArgumentError, address, token="a b")))
        self.assertIn("in clear", str(self.refused(evpose.FailedPreconditionError, "192.0.2.1:1", token=token)))
        current = ["evpose_wrong"]
        source = lambda: current[0]  # noqa: E731
        self.refused(evpose.UnauthenticatedError, address, token=source)
        current[0] = token
        client = self.connect(address, token=source)
        current[0] = ""  # a file that is being replaced: the previous token stays in use
        self.assertEqual(len(client.list_sessions()), 1)

    def test_no_server(self):
        relay = Relay(None)
        self.addCleanup(relay.close)
        self.assertIn("no server at " + relay.address, str(self.refused(evpose.UnavailableError, relay.address)))
        for address in ("localhost", "localhost:0", ":1", "localhost:99999"):
            self.assertIn("HOST:PORT is needed", str(self.refused(evpose.InvalidArgumentError, address)))
        running = self.serve()
        self.assertTrue(self.connect(f"{relay.address},{running.address}").is_serving())


class WrongInputTest(ServerTest):
    def test_errors_of_the_server_have_their_class_and_reason(self):
        client = self.connect(self.serve().address)
        camera = evpose.read_camera(self.camera)
        bad = self.directory / "bad.obj"
        bad.write_text("v 0 0 0\nf 1 2 3\n")
        empty = self.directory / "empty.obj"
        empty.write_text("")
        for call, error, reason, text in (
                (lambda: client.create_session("models/none", camera), evpose.NotFoundError, "MODEL_NOT_FOUND", "models/none"),
                (lambda: client.upload_model(bad), evpose.InvalidArgumentError, "", f"{bad}: 127.0.0.1:"),
                (lambda: client.upload_model(bad), evpose.InvalidArgumentError, "", ": line 2: "),
                (lambda: client.upload_model(empty), evpose.InvalidArgumentError, "", ": its size is 0"),
                (lambda: client.upload_model(self.model, metres_per_unit="a"), evpose.InvalidArgumentError, "",
                 "metres_per_unit: 'a' is not a number"),
                (lambda: client.upload_model(self.model, metres_per_unit=-1.0), evpose.InvalidArgumentError, "",
                 f"{self.model}: 127.0.0.1:"),
                (lambda: client.create_session("models/none", "camera.yaml"), evpose.InvalidArgumentError, "",
                 "camera: 'camera.yaml' is no Camera; read_camera(path) reads one"),
                (lambda: client.create_session("models/none", camera, "EVT3"), evpose.InvalidArgumentError, "",
                 "encoding: 'EVT3' is none of Encoding.EVT3, "),
                (lambda: client.create_session(3, camera), evpose.InvalidArgumentError, "", "objects: 3 is neither a Model"),
                (lambda: client.create_session(["models/none"], camera), evpose.InvalidArgumentError, "", "nor a list of TrackedObject"),
                (lambda: client.get_model("models/none"), evpose.NotFoundError, "MODEL_NOT_FOUND", "models/none"),
                (lambda: client.upload_model(self.directory / "none.obj"), evpose.NotFoundError, "", "none.obj"),
                (lambda: client.upload_model(self.camera), evpose.InvalidArgumentError, "", "must end in .obj, .ply or .stl"),
                (lambda: client.upload_model(self.directory), evpose.InvalidArgumentError, "", "unknown model format"),
                (lambda: list(self.create(client).watch_poses(max_rate_hz=-1.0)), evpose.InvalidArgumentError, "", "max_rate_hz")):
            with self.assertRaises(error) as caught:
                call()
            self.assertEqual(caught.exception.reason, reason)
            self.assertIn(text, str(caught.exception))
        with self.assertRaises(evpose.InvalidArgumentError) as caught:
            client.create_session([], camera)
        self.assertEqual(caught.exception.field, "config.objects")
        self.create(client, request_id="same")
        with self.assertRaises(evpose.AlreadyExistsError) as caught:
            self.create(client, evpose.Encoding.FLAT64, request_id="same")
        self.assertEqual(caught.exception.reason, "REQUEST_ID_REUSED")

    def test_recordings_and_arrays_that_do_not_fit_the_session(self):
        client = self.connect(self.serve().address)
        camera = evpose.read_camera(self.camera)
        other = self.directory / "other.raw"
        other.write_bytes(b"% evt 3.0\n% geometry 1280x720\n% end\n\x00\x80")
        events = evpose.make_events([640], [0], [0], [0])
        for encoding, source, text in (
                (evpose.Encoding.FLAT64, self.open(), "is EVT3, but the session was created for FLAT64"),
                (evpose.Encoding.EVT3, self.open(other), "the recording has 1280x720 pixels, but the session's camera has 640x480"),
                (evpose.Encoding.EVT3, b"bytes", "[events] has one chunk"), (evpose.Encoding.FLAT64, events, "[events] has one chunk"),
                (evpose.Encoding.EVT3, [events], "arrays are sent as FLAT64, but the session was created for EVT3"),
                (evpose.Encoding.FLAT64, [events], "x of event 0 is 640, but must lie in [0, 639]")):
            session = client.create_session(client.upload_model(self.model), camera, encoding)
            with self.assertRaises(evpose.InvalidArgumentError) as caught:
                session.track(source).read_all()
            self.assertIn(text, str(caught.exception))

    def test_wrong_events_are_no_error_of_the_server(self):
        session = self.create(self.connect(self.serve().address), evpose.Encoding.FLAT64)
        with self.assertRaises(evpose.InvalidArgumentError) as caught:
            session.track([evpose.make_events([640], [0], [0], [0])]).read_all()
        self.assertRegex(str(caught.exception), r"^events: x of event 0 is 640, but must lie in \[0, 639\] \(after 0 bytes sent, ")


class SessionBlockTest(ServerTest):
    def test_the_end_of_the_block_deletes_the_session(self):
        client = self.connect(self.serve().address)
        with self.create(client) as session:
            self.assertEqual([each.name for each in client.list_sessions()], [session.name])
            with client.session(session.name):
                pass
            self.assertEqual(len(client.list_sessions()), 1, "a session that another client feeds stays")
        self.assertEqual(client.list_sessions(), [])
        with self.assertRaises(ZeroDivisionError), self.create(client):
            raise ZeroDivisionError
        self.assertEqual(client.list_sessions(), [])
        with self.create(client) as session:
            session.keep()
        self.assertEqual([each.name for each in client.list_sessions()], [session.name])

    def test_an_exception_in_the_block_is_the_one_that_is_raised(self):
        running = self.serve()
        client = self.connect(running.address, call_timeout_s=1.0)
        with self.assertRaises(ZeroDivisionError), self.create(client):
            running.kill()
            raise ZeroDivisionError


class ExampleTest(ServerTest):
    def run_example(self, name, *arguments, script=None, status=0):
        environment = {**os.environ, "PYTHONPATH": str(server.BIN / "client/python"), "MPLBACKEND": "Agg"}
        command = ["bash", "-o", "pipefail", "-c", script, "bash"] if script else []
        done = subprocess.run([*command, sys.executable, EXAMPLES / name, *map(str, arguments)], capture_output=True, text=True,
                              check=False, env=environment, cwd=self.directory)
        self.assertEqual(done.returncode, status, done.stderr)
        self.assertNotIn("Traceback", done.stderr)
        return done.stdout if status == 0 else done.stderr

    def test_usage(self):
        for name in ("track_recording.py", "plot_poses.py"):
            self.assertIn("usage: ", self.run_example(name, "--help"))
            self.assertIn("the following arguments are required: server", self.run_example(name, status=2))

    def test_a_reader_that_ends_early(self):
        running = self.serve()
        output = self.run_example("track_recording.py", running.address, self.recording, self.model, self.camera, script='"$@" | head -1')
        self.assertEqual(len(output.splitlines()), 1)
        self.assertEqual(self.connect(running.address).list_sessions(), [])

    def test_track_recording(self):
        self.assertLessEqual(len((EXAMPLES / "track_recording.py").read_text().splitlines()), 26)
        output = self.run_example("track_recording.py", self.serve().address, self.recording, self.model, self.camera)
        self.assertEqual(len(output.splitlines()), len(self.replay()))

    def test_plot_poses(self):
        output = self.run_example("plot_poses.py", self.serve().address, self.recording, self.model, self.camera, "poses.png")
        self.assertIn(f"{len(self.replay())} poses", output)
        self.assertEqual((self.directory / "poses.png").read_bytes()[:4], b"\x89PNG")


if __name__ == "__main__":
    unittest.main()
