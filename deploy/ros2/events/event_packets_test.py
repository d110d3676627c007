#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The conversion of EventPackets, with messages of the same fields, and a recording that is forwarded to evpose-server; the node with
stand-ins for rclpy and event_camera_msgs."""

import ast
import dataclasses
import importlib
import pathlib
import sys
import tempfile
import threading
import types
import unittest
from unittest import mock

HERE = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parents[2] / "client/python/tests")]
from testing import evpose, run_evpose, server

from event_packets import PacketQueue, PacketReader
from ros_testing import FakeRos


@dataclasses.dataclass
class Packet:
    """The fields of event_camera_msgs/EventPacket."""

    seq: int
    events: bytes = b"\x01\x02"
    width: int = 640
    height: int = 480
    encoding: str = "evt3"
    is_bigendian: bool = False
    time_base: int = 0


def kinds(chunks):
    return ["gap" if isinstance(chunk, evpose.Discontinuity) else chunk for chunk in chunks]


class PacketReaderTest(unittest.TestCase):
    def setUp(self):
        self.reader = PacketReader(640, 480)

    def chunks(self, *packets):
        return kinds(chunk for packet in packets for chunk in self.reader.chunks(packet))

    def test_packets_in_order_are_sent_as_they_are(self):
        self.assertEqual(self.chunks(Packet(7, b"ab"), Packet(8, b"cd")), [b"ab", b"cd"])
        self.assertEqual((self.reader.num_packets, self.reader.num_lost), (2, 0))

    def test_a_jump_of_seq_is_a_discontinuity(self):
        self.assertEqual(self.chunks(Packet(1, b"ab"), Packet(4, b"cd"), Packet(5, b"ef")), [b"ab", "gap", b"cd", b"ef"])
        self.assertEqual(self.reader.num_lost, 2)

    def test_a_publisher_that_starts_again_is_a_discontinuity(self):
        self.assertEqual(self.chunks(Packet(5000, b"ab"), Packet(0, b"cd"), Packet(1, b"ef")), [b"ab", "gap", b"cd", b"ef"])
        self.assertEqual(self.reader.num_lost, 0)

    def test_a_publisher_that_starts_again_at_a_number_above_0_is_a_discontinuity(self):
        self.assertEqual(self.chunks(Packet(500, b"ab"), Packet(3, b"cd"), Packet(4, b"ef")), [b"ab", "gap", b"cd", b"ef"])
        self.assertEqual(self.reader.num_repeated, 0)

    def test_a_packet_that_is_only_counted_is_a_gap(self):
        self.assertEqual(self.chunks(Packet(1, b"ab")), [b"ab"])
        self.assertEqual([self.reader.note_seq(2), self.reader.note_seq(2)], [True, False])
        self.assertEqual(self.chunks(Packet(3, b"cd")), ["gap", b"cd"])
        self.assertEqual((self.reader.num_packets, self.reader.num_lost, self.reader.num_repeated), (2, 0, 1))

    def test_repeated_and_overtaken_packets_are_not_sent(self):
        self.assertEqual(self.chunks(Packet(5, b"ab"), Packet(6, b"cd"), Packet(6, b"cd"), Packet(5, b"ab"), Packet(7, b"ef")),
                         [b"ab", b"cd", b"ef"])
        self.assertEqual(self.reader.num_repeated, 2)

    def test_a_packet_of_half_a_word_is_a_gap(self):
        self.assertEqual(self.chunks(Packet(1, b"ab"), Packet(2, b"abc"), Packet(3, b"cd")), [b"ab", "gap", b"cd"])
        self.assertEqual(self.reader.num_refused, 1)

    def test_an_empty_packet_keeps_the_gap_for_the_next_one(self):
        self.assertEqual(self.chunks(Packet(1, b"ab"), Packet(3, b""), Packet(4, b"cd")), [b"ab", "gap", b"cd"])

    def test_big_endian_words_are_swapped(self):
        self.assertEqual(self.chunks(Packet(1, b"abcd", is_bigendian=True)), [b"badc"])

    def test_lists_and_arrays_of_numbers_are_bytes(self):
        self.assertEqual(self.chunks(Packet(1, [1, 255])), [b"\x01\xff"])

    def test_another_encoding_or_size_is_an_error(self):
        with self.assertRaisesRegex(evpose.InvalidArgumentError, "'libcaer'"):
            self.chunks(Packet(1, encoding="libcaer"))
        with self.assertRaisesRegex(evpose.InvalidArgumentError, "1280x480 pixels, but the camera file of 640x480"):
            self.chunks(Packet(1, width=1280))


class PacketQueueTest(unittest.TestCase):
    def test_a_packet_without_room_is_dropped_and_marked(self):
        queue = PacketQueue(PacketReader(640, 480), max_bytes=4)
        for packet in (Packet(1, b"ab"), Packet(2, b"cd"), Packet(3, b"ef")):
            queue.put(packet)
        chunks = iter(queue)
        self.assertEqual(kinds([next(chunks), next(chunks)]), [b"ab", b"cd"])
        queue.put(Packet(4, b"gh"))
        self.assertEqual((queue.reader.num_packets, queue.reader.num_lost), (3, 0))
        queue.put(Packet(5, b"ij"))
        queue.end()
        self.assertEqual(kinds(chunks), ["gap", b"gh", b"ij"])
        self.assertEqual(queue.num_dropped, 1)

    def test_the_reader_waits_for_packets(self):
        queue = PacketQueue(PacketReader(640, 480), max_bytes=100)
        seen = []
        thread = threading.Thread(target=lambda: seen.extend(queue))
        thread.start()
        queue.put(Packet(1, b"ab"))
        queue.end()
        thread.join()
        self.assertEqual(seen, [b"ab"])

    def test_packets_after_the_end_are_not_sent(self):
        queue = PacketQueue(PacketReader(640, 480), max_bytes=100)
        queue.put(Packet(1, b"ab"))
        queue.end()
        queue.put(Packet(2, b"cd"))
        self.assertEqual(kinds(queue), [b"ab"])

    def test_a_wrong_packet_is_reported_to_the_caller(self):
        with self.assertRaises(evpose.InvalidArgumentError):
            PacketQueue(PacketReader(640, 480), max_bytes=100).put(Packet(1, encoding="mono"))


class SceneTest(unittest.TestCase):
    def setUp(self):
        self.directory = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        run_evpose("simulate", "--object", "cube", "--camera", "vga", "--duration", "0.2", "--out", self.directory)
        self.server = server.Server("--log-level", "error", directory=self.directory)
        self.addCleanup(lambda: self.server.is_ended or self.server.kill())
        self.client = evpose.connect(self.server.address)
        self.addCleanup(self.client.close)
        self.camera = evpose.read_camera(self.directory / "camera.yaml")
        self.model = self.client.upload_model(self.directory / "model.obj")
        data = (self.directory / "recording.raw").read_bytes()
        self.words = data[data.index(b"% end\n") + 6:]

    def track(self, events):
        session = self.client.create_session(self.model, self.camera, evpose.Encoding.EVT3)
        with session.track(events) as track:
            poses = track.read_all()
        poses["latency_s"] = 0.0
        return poses, track.summary

    def packets(self):
        """The recording in packets that end at any word, as the SDK's buffers do."""
        size = 4098
        return [Packet(100 + i, self.words[begin:begin + size]) for i, begin in enumerate(range(0, len(self.words), size))]


class ForwardTest(SceneTest):
    def forward(self, packets):
        queue = PacketQueue(PacketReader(640, 480), max_bytes=1 << 30)
        for packet in packets:
            queue.put(packet)
        queue.end()
        return self.track(queue)

    def test_forwarded_poses_are_those_of_the_recording(self):
        expected, _ = self.track([self.words])
        self.assertGreater(len(expected), 50)
        poses, summary = self.forward(self.packets())
        self.assertEqual(poses.tobytes(), expected.tobytes())
        self.assertEqual(summary.health.time_backsteps, 0)

    def test_after_a_gap_no_event_has_a_wrong_time(self):
        packets = self.packets()
        lost = len(packets) // 2
        poses, summary = self.forward(packets[:lost] + packets[lost + 1:])
        self.assertEqual(summary.health.time_backsteps, 0)
        self.assertGreater(summary.health.dropped_events, 0)  # those before the first time after the gap
        expected, _ = self.track([self.words])
        self.assertLessEqual(max(poses["t_us"]), max(expected["t_us"]))


class NodeTest(SceneTest):
    def run_node(self, packets, **parameters):
        """Runs the node with these packets, then shuts ROS down. Returns what it has logged."""
        logged, feeds = [], threading.Event()

        def on_log(text):
            logged.append(text)
            feeds.set()

        ros = FakeRos({"server": self.server.address, "camera": str(self.directory / "camera.yaml"), "overload": "block",
                       "model": str(self.directory / "model.obj"), "memory_bytes": 1 << 30, **parameters}, on_log)

        def publish():
            feeds.wait()
            for packet in packets:
                ros.subscriptions["events"](packet)
            ros.is_down.set()

        thread = threading.Thread(target=publish)
        thread.start()
        self.addCleanup(thread.join)
        self.addCleanup(feeds.set)
        ros.run("event_forwarder")
        return logged

    def test_the_node_forwards_a_recording(self):
        expected, _ = self.track([self.words])
        packets = self.packets()
        logged = self.run_node(packets, keep_session=True, object_id="part")
        self.assertEqual(logged[-1], f"{len(packets)} packets, {len(expected)} poses; 0 packets lost, 0 dropped, 0 damaged")
        session = self.client.session(logged[0].removeprefix("feeds "))
        self.assertEqual([(pose.object_id, pose.translation_m.tolist()) for pose in session.watch_poses()],
                         [("part", translation.tolist()) for translation in expected["translation_m"]])

    def test_the_session_is_deleted_and_wrong_packets_end_the_node_with_a_reason(self):
        before = len(self.client.list_sessions())
        with self.assertRaisesRegex(SystemExit, "evpose_events: .*1280x480 pixels, but the camera file of 640x480"):
            self.run_node([Packet(1), Packet(2, width=1280), Packet(3)])
        self.assertEqual(len(self.client.list_sessions()), before)

    def test_wrong_parameters_end_the_node_with_a_reason(self):
        for parameters, words in (({"model": ""}, "the parameter model is required"), ({"overload": "drop"}, "'drop' is neither"),
                                  ({"camera": "/no-such-file"}, "/no-such-file"), ({"token_file": "/no-such-token"}, "/no-such-token")):
            with self.assertRaisesRegex(SystemExit, f"evpose_events: .*{words}"):
                self.run_node([], **parameters)


class RunTest(unittest.TestCase):
    def test_an_error_in_a_callback_ends_the_work(self):
        def spin(node):
            raise ZeroDivisionError("in a callback")

        ros = FakeRos({}, print)
        ros.spin = spin
        is_stopped = threading.Event()
        self.addCleanup(is_stopped.set)
        node = types.SimpleNamespace(work=is_stopped.wait, stop=is_stopped.set)
        with mock.patch.dict(sys.modules, ros.modules()):
            run = importlib.import_module("evpose_node").run
            with self.assertRaisesRegex(ZeroDivisionError, "in a callback"):
                run(lambda: node, "node")
        self.assertTrue(is_stopped.is_set())


class ReadmeTest(unittest.TestCase):
    def test_the_parameters_are_documented(self):
        tree = ast.parse((HERE / "event_forwarder.py").read_text())
        parameters = next(node.value for node in tree.body if isinstance(node, ast.Assign) and node.targets[0].id == "_PARAMETERS")
        readme = (HERE / "README.md").read_text()
        for key in (key.value for key in parameters.keys):
            self.assertIn(f"`{key}`", readme)


if __name__ == "__main__":
    unittest.main()
