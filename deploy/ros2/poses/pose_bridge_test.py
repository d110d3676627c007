#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The messages, with the classes of ROS 1 that Debian has: their fields are those of ROS 2 except the stamp, and they check types when
they are serialized. The follower and the node, against evpose-server; the node with stand-ins for rclpy and tf2_ros."""

import ast
import dataclasses
import json
import pathlib
import signal
import sys
import tempfile
import threading
import unittest

HERE = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parents[2] / "client/python/tests")]
from testing import PATIENT, Relay, evpose, run_evpose, server

import genpy
import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped, TwistStamped
from pose_messages import (ERROR, OK, WARN, ClockOffset, StateChanges, diagnostics, is_published, name_in_ros, pose_message, state_message,
                           transform_message, twist_message)
from ros_testing import FakeRos, sent
from session_follower import SessionFollower, choose_session
from std_msgs.msg import String

STAMP = genpy.Time(12, 345)


def make_pose(state=evpose.TrackState.TRACKING):
    numbers = np.random.default_rng(1)
    transform = evpose.Transform.from_quaternion([0.1, -0.2, 1.5], [0.5, 0.5, -0.5, 0.5])
    half = numbers.normal(size=(6, 6))
    return evpose.Pose(
        seq=1, object_id="part", t_us=5000, translation_m=transform.translation_m, quaternion_xyzw=transform.quaternion_xyzw,
        covariance=half @ half.T, twist=numbers.normal(size=6), state=state, num_events=100, explained_ratio=0.5, residual_rms_px=0.5,
        latency_s=0.001, alternatives=())


NO_SEARCHES = evpose.SearchCounts(no_signal=0, too_small=0, too_few_lines=0, not_enough_motion=0, no_pose_fits=0, poses_found=0)


def make_health(**fields):
    health = evpose.Health(
        t_us=1, received_bytes=0, processed_bytes=0, decoded_events=0, dropped_events=0, invalid_words=0, time_backsteps=0, poses=0,
        reattaches=0, event_rate_hz=1e6, pose_rate_hz=0.0, real_time_ratio=0.5, queue_age_s=0.0, latency_p50_s=None, latency_p99_s=None,
        skipped_events=0, skipped_us=0, falls_behind=False, objects=(), cpu_s_per_s=0.0, max_cpu_s_per_s=0.0)
    return dataclasses.replace(health, **fields)


def make_object(**fields):
    lost = evpose.ObjectHealth(
        object_id="part", state=evpose.TrackState.LOST, losses=2, explained_ratio=0.25, initialization="TOO_FEW_LINES",
        initialization_attempts=7, detail="too few lines", latest_loss_t_us=5000, latest_loss_cause="CONTRADICTED",
        searches=NO_SEARCHES, followed_poses=0)
    return dataclasses.replace(lost, **fields)


class MessageTest(unittest.TestCase):
    def test_a_pose(self):
        pose = make_pose()
        message = sent(pose_message(PoseWithCovarianceStamped, pose, STAMP, "camera"))
        self.assertEqual((message.header.frame_id, message.header.stamp), ("camera", STAMP))
        position, rotation = message.pose.pose.position, message.pose.pose.orientation
        self.assertEqual([position.x, position.y, position.z], pose.translation_m.tolist())
        self.assertEqual([rotation.x, rotation.y, rotation.z, rotation.w], pose.quaternion_xyzw.tolist())
        self.assertEqual(np.reshape(message.pose.covariance, (6, 6)).tolist(), pose.covariance.tolist())

    def test_a_transform_and_a_twist(self):
        pose = make_pose()
        message = sent(transform_message(TransformStamped, pose, STAMP, "camera", "part"))
        translation, rotation = message.transform.translation, message.transform.rotation
        self.assertEqual((message.header.frame_id, message.child_frame_id), ("camera", "part"))
        self.assertEqual([translation.x, translation.y, translation.z], pose.translation_m.tolist())
        self.assertEqual([rotation.x, rotation.y, rotation.z, rotation.w], pose.quaternion_xyzw.tolist())
        twist = sent(twist_message(TwistStamped, pose, STAMP, "camera")).twist
        self.assertEqual([twist.linear.x, twist.linear.y, twist.linear.z, twist.angular.x, twist.angular.y, twist.angular.z],
                         pose.twist.tolist())

    def test_the_perturbation_is_that_of_ros(self):
        # ROS: rotations about the fixed axes X, then Y, then Z of the frame. evpose: exp(dr^) on the left. Equal to first order.
        rotation = make_pose().camera_from_object.rotation
        for axis in range(3):
            for size in (1e-4, 1e-5):
                d = np.zeros(3)
                d[axis], d[(axis + 1) % 3] = size, 0.5 * size
                turns = [evpose.Transform.from_quaternion(np.zeros(3), [*(np.sin(d[i] / 2) * np.eye(3)[i]), np.cos(d[i] / 2)]).rotation
                         for i in range(3)]
                hat = np.array([[0, -d[2], d[1]], [d[2], 0, -d[0]], [-d[1], d[0], 0]])
                np.testing.assert_allclose(turns[2] @ turns[1] @ turns[0] @ rotation, (np.eye(3) + hat) @ rotation, atol=2 * size * size)

    def test_only_confirmed_poses_are_published(self):
        published = {state for state in evpose.TrackState if is_published(make_pose(state))}
        self.assertEqual(published, {evpose.TrackState.TRACKING, evpose.TrackState.DEGRADED})

    def test_the_state_of_every_pose_is_published(self):
        fields = ["pose_seq", "object_id", "t_us", "state", "num_events", "explained_ratio", "residual_rms_px", "lost_at_us", "loss_cause"]
        for state in (evpose.TrackState.TRACKING, evpose.TrackState.DEGRADED, evpose.TrackState.UNKNOWN):
            text = json.loads(sent(state_message(String, make_pose(state))).data)
            self.assertEqual(list(text), fields)
            self.assertEqual((text["object_id"], text["t_us"], text["state"]), ("part", 5000, state.name))
            self.assertEqual((text["lost_at_us"], text["loss_cause"]), (None, None))
        lost = dataclasses.replace(make_pose(), latest_loss_t_us=4000, latest_loss_cause="CONTRADICTED")
        text = json.loads(state_message(String, lost).data)
        self.assertEqual((text["lost_at_us"], text["loss_cause"]), (4000, "CONTRADICTED"))

    def test_the_state_of_an_ambiguous_pose_has_the_pose_and_its_alternatives(self):
        other = evpose.Transform.from_quaternion([0.1, 0.2, 1.5], [0.5, 0.5, 0.5, 0.5])
        pose = dataclasses.replace(make_pose(evpose.TrackState.AMBIGUOUS), alternatives=(evpose.Alternative(other, -1.5),))
        text = json.loads(sent(state_message(String, pose)).data)
        self.assertEqual((text["state"], text["transform"]), ("AMBIGUOUS", "camera_from_object"))
        self.assertEqual((text["translation_m"], text["quaternion_xyzw"]), (pose.translation_m.tolist(), pose.quaternion_xyzw.tolist()))
        self.assertEqual(text["covariance_upper"], pose.covariance[np.triu_indices(6)].tolist())
        self.assertEqual(text["twist"], pose.twist.tolist())
        self.assertEqual(text["alternatives"], [{"translation_m": [0.1, 0.2, 1.5], "quaternion_xyzw": [0.5, 0.5, 0.5, 0.5],
                                                 "log_likelihood_ratio": -1.5}])

    def test_changes_of_state_are_published_once(self):
        changes = StateChanges()

        def changed(t_us, *states):
            objects = [make_object(object_id=name, state=state) for name, state in zip(("part", "other"), states)]
            return [(object_id, json.loads(sent(message).data))
                    for object_id, message in changes.messages(String, make_health(t_us=t_us, objects=tuple(objects)))]

        tracking, lost = evpose.TrackState.TRACKING, evpose.TrackState.LOST
        self.assertEqual([object_id for object_id, _ in changed(1, tracking, tracking)], ["part", "other"])
        self.assertEqual(changed(2, tracking, tracking), [])
        self.assertEqual(changed(3, tracking, lost), [("other", {"object_id": "other", "t_us": 3, "state": "LOST"})])

    def test_names(self):
        for text, name in (("part", "part"), ("left-hand 2", "left_hand_2"), ("7", "_7"), ("", "_"), ("Ä/b", "__b")):
            self.assertEqual(name_in_ros(text), name)

    def test_diagnostics(self):
        lost = make_object()
        objects = (lost, dataclasses.replace(lost, object_id="other", state=evpose.TrackState.TRACKING, detail=""),
                   dataclasses.replace(lost, object_id="third", state=evpose.TrackState.AMBIGUOUS))
        health = make_health(dropped_events=3, latency_p99_s=0.002, falls_behind=True, objects=objects)
        array = sent(diagnostics(DiagnosticArray, DiagnosticStatus, KeyValue, health, "sessions/1", STAMP))
        self.assertEqual([(status.name, status.level, status.message) for status in array.status],
                         [("evpose", WARN, "falls behind the camera"), ("evpose: part", ERROR, "LOST: too few lines"),
                          ("evpose: other", OK, "TRACKING"), ("evpose: third", WARN, "AMBIGUOUS: too few lines")])
        values = {each.key: each.value for each in array.status[0].values}
        self.assertEqual((values["latency, 99th percentile [ms]"], values["events dropped"]), ("2", "3"))
        self.assertNotIn("latency, median [ms]", values)

    def test_levels_are_bytes_in_ros_2(self):
        class Status(DiagnosticStatus):
            def __init__(self):
                super().__init__()
                self.level = b"\x00"

        status = diagnostics(DiagnosticArray, Status, KeyValue, make_health(falls_behind=True), "sessions/1", STAMP).status[0]
        self.assertEqual(status.level, b"\x01")


class ClockOffsetTest(unittest.TestCase):
    def test_the_earliest_arrival_determines_the_offset(self):
        offset = ClockOffset()
        epoch_ns = 1_700_000_000_000_000_000
        for t_us, delay_ns in ((1000, 5_000_000), (2000, 400_000), (3000, 9_000_000), (4000, 450_000)):
            stamp_ns = offset.stamp_ns(t_us, epoch_ns + 1000 * t_us + delay_ns)
            least_ns = 5_000_000 if t_us == 1000 else 400_000
            self.assertEqual(stamp_ns, epoch_ns + 1000 * t_us + least_ns)

    def test_the_window_follows_a_drift(self):
        offset = ClockOffset(window_ns=1_000_000_000)
        for i in range(100):  # the host's clock gains 20 us in each 0.1 s
            arrival_ns = i * 100_000_000 + i * 20_000
            error_ns = offset.stamp_ns(i * 100_000, arrival_ns) - arrival_ns
            self.assertTrue(-200_000 <= error_ns <= 0, error_ns)


class SceneTest(unittest.TestCase):
    def setUp(self):
        self.directory = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        run_evpose("simulate", "--object", "cube", "--camera", "vga", "--duration", "0.3", "--out", self.directory)

    def create(self, client):
        """Returns a new session and the recording for it."""
        recording = evpose.Recording(self.directory / "recording.raw")
        self.addCleanup(recording.close)
        camera = evpose.read_camera(self.directory / "camera.yaml")
        return client.create_session(client.upload_model(self.directory / "model.obj"), camera, recording.encoding), recording


class FollowerTest(SceneTest):
    def test_each_pose_once_across_a_kill_of_the_server(self):
        running = server.Server("--log-level", "error", directory=self.directory, store="sqlite")
        self.addCleanup(lambda: running.is_ended or running.kill())
        relay = Relay(running.address)
        self.addCleanup(relay.close)
        client = evpose.connect(relay.address)
        self.addCleanup(client.close)
        with self.assertRaisesRegex(evpose.NotFoundError, "there are 0 .none.: give its name"):
            choose_session(client, "")
        session, recording = self.create(client)
        with session.track(recording) as track:
            next(track)
            self.assertEqual(choose_session(client, "").name, session.name)
            expected = 1 + len(track.read_all())
        followed = choose_session(client, session.name)
        seen, outages = [], []

        def on_pose(pose):
            seen.append(pose.seq)
            if len(seen) == 50:
                running.process.send_signal(signal.SIGKILL)
                running.wait()
                running.start()
                relay.target = running.address

        follower = SessionFollower(followed, PATIENT)
        follower.poses(on_pose, on_outage=outages.append)
        self.assertEqual(seen, list(range(1, expected + 1)))
        self.assertEqual(follower.num_skipped, 0)
        states = []
        follower.health(states.append, 0.01)
        self.assertEqual(states[-1].poses, expected)
        later = SessionFollower(followed, PATIENT)
        self.assertEqual(later.skip_stored(), expected)
        later.poses(lambda pose: self.fail("a pose that was skipped"))
        session.delete()
        with self.assertRaises(evpose.NotFoundError):
            SessionFollower(followed, PATIENT).poses(seen.append)


class NodeTest(SceneTest):
    def run_node(self, parameters, on_log):
        """Runs the node in place of ROS with the given parameters up to its end. Returns what it has published: {topic: messages}."""
        ros = FakeRos(parameters, on_log)
        ros.run("pose_publisher")
        return ros.published

    def test_the_node_publishes_the_poses_of_a_session(self):
        running = server.Server("--log-level", "error", directory=self.directory)
        self.addCleanup(lambda: running.is_ended or running.kill())
        client = evpose.connect(running.address)
        self.addCleanup(client.close)
        session, recording = self.create(client)
        follows = threading.Event()
        poses = []

        def feed():
            follows.wait()
            poses.extend(session.track(recording))

        thread = threading.Thread(target=feed)
        thread.start()
        parameters = {"server": running.address, "session": session.name, "epoch_ns": 1_700_000_000_000_000_000, "camera_frame": "eye",
                      "object_frame_prefix": "seen_", "health_period_s": 0.01}
        published = self.run_node(parameters, lambda text: f"of {session.name} after pose 0" in text and follows.set())
        thread.join()
        confirmed = [pose for pose in poses if is_published(pose)]
        self.assertGreater(len(confirmed), 50)
        messages = published["evpose/object/pose"]
        self.assertEqual([(each.header.stamp.to_nsec(), each.header.frame_id, each.pose.pose.position.z) for each in messages],
                         [(1_700_000_000_000_000_000 + 1000 * pose.t_us, "eye", pose.translation_m[2]) for pose in confirmed])
        self.assertEqual(len(published["evpose/object/twist"]), len(confirmed))
        self.assertEqual({each.child_frame_id for each in published["/tf"]}, {"seen_object"})
        self.assertEqual(len(published["/tf"]), len(confirmed))
        states = [json.loads(each.data) for each in published["evpose/object/state"]]
        self.assertEqual([each["pose_seq"] for each in states if "pose_seq" in each], [pose.seq for pose in poses])
        self.assertEqual([each["state"] for each in states if "pose_seq" not in each][-1], "TRACKING")
        self.assertEqual(published["/diagnostics"][-1].status[0].hardware_id, session.name)
        self.assertEqual(published["/diagnostics"][-1].status[1].message, "TRACKING")

    def test_a_wrong_session_ends_the_node_with_a_reason(self):
        running = server.Server("--log-level", "error", directory=self.directory)
        self.addCleanup(lambda: running.is_ended or running.kill())
        with self.assertRaisesRegex(SystemExit, "evpose_poses: .*there is no session .sessions/none."):
            self.run_node({"server": running.address, "session": "sessions/none"}, lambda text: None)
        with self.assertRaisesRegex(SystemExit, "evpose_poses: .*no-such-file"):
            self.run_node({"server": running.address, "token_file": "/no-such-file"}, lambda text: None)
        for name, reason in (("tls_ca", "no-such-file"), ("tls_certificate", "needs its key"), ("tls_key", "a key its certificate")):
            with self.assertRaisesRegex(SystemExit, f"evpose_poses: .*{reason}"):
                self.run_node({"server": running.address, "session": "sessions/none", name: "/no-such-file"}, lambda text: None)

    def test_an_error_of_any_kind_ends_the_node(self):
        running = server.Server("--log-level", "error", directory=self.directory)
        self.addCleanup(lambda: running.is_ended or running.kill())
        client = evpose.connect(running.address)
        self.addCleanup(client.close)
        session, recording = self.create(client)
        ros = FakeRos({"server": running.address, "session": session.name}, lambda text: "after pose 0" in text and follows.set())
        follows = threading.Event()
        self.addCleanup(follows.set)

        def publish(topic, message):
            if topic == "evpose/object/pose":
                raise ZeroDivisionError("of a publisher")

        def feed():
            follows.wait()
            session.track(recording).read_all()

        ros.publish = publish
        thread = threading.Thread(target=feed, daemon=True)
        thread.start()
        with self.assertRaisesRegex(ZeroDivisionError, "of a publisher"):
            ros.run("pose_publisher")
        thread.join()

    def test_the_parameters_are_documented(self):
        tree = ast.parse((HERE / "pose_publisher.py").read_text())
        parameters = next(node.value for node in tree.body if isinstance(node, ast.Assign) and node.targets[0].id == "_PARAMETERS")
        readme = (HERE / "README.md").read_text()
        for key in ast.literal_eval(parameters):
            self.assertIn(f"`{key}`", readme)


if __name__ == "__main__":
    unittest.main()
