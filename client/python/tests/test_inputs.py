#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Cameras, recordings, arrays of events, transforms, and the classification of errors."""

import dataclasses
import json
import os
import pathlib
import tempfile
import threading
import unittest

import numpy as np
from testing import ROOT, evpose, message_of, run_evpose

from evpose.channel import parse_address
from evpose.files import to_duration_ns
from evpose.recordings import parse_header
from evpose.stream.feed import EventFeed
from evpose.stream.outbox import FeedPoint, Outbox, RetainOptions, make_chunk
from evpose.stream.retry import Advice, Backoff, advise_on
from evpose.types import SessionConfig
from evpose.v1 import error_reason_pb2, geometry_pb2, session_pb2

CAMERA_INFO = """image_width: 640
image_height: 480
camera_name: camera
camera_matrix: {rows: 3, cols: 3, data: [600.5, 0, 319.5, 0, 601, 239.5, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 1e-5, 0.001, -0.002, 0]}
"""
# Nested lists of YAML aliases: printed in full, a40 would have 2^41 numbers.
ALIASES = "a0: &a0 [1, 1]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 41))


class InputTest(unittest.TestCase):
    def setUp(self):
        self.directory = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))

    def write(self, name, content):
        path = self.directory / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path


class CameraTest(InputTest):
    def read(self, text):
        return evpose.read_camera(self.write("camera.yaml", text))

    def test_camera_info(self):
        camera = self.read(CAMERA_INFO)
        self.assertEqual(camera, evpose.Camera(640, 480, 600.5, 601.0, 319.5, 239.5, (-0.1, 1e-5, 0.001, -0.002, 0.0)))
        message = camera.to_proto()
        self.assertEqual((message.width_px, message.fy_px, message.cx_px, list(message.distortion)),
                         (640, 601.0, 319.5, [-0.1, 1e-5, 0.001, -0.002, 0.0]))

    def test_the_file_of_evpose_simulate_and_one_without_distortion(self):
        run_evpose("simulate", "--camera", "vga", "--duration", "0.001", "--out", self.directory / "scene")
        self.assertEqual(evpose.read_camera(self.directory / "scene/camera.yaml").width_px, 640)
        self.assertEqual(self.read(CAMERA_INFO[:CAMERA_INFO.index("distortion_model")]).distortion, ())

    def test_the_output_of_evpose_camera(self):
        values = {"width": 640, "height": 480, "lens_model": "brown", "fx_px": 600.5, "fy_px": 601, "cx_px": 319.5, "cy_px": 239.5,
                  "distortion": [-0.1, 1e-5, 0.001, -0.002, 0]}
        self.assertEqual(self.read(json.dumps(values)), self.read(CAMERA_INFO))
        fisheye = self.read(json.dumps({**values, "lens_model": "fisheye", "distortion": [0.1, 0.2, 0.3, 0.4]}))
        self.assertEqual((fisheye.lens_model, fisheye.distortion), ("fisheye", (0.1, 0.2, 0.3, 0.4)))
        for change in ((), ("plumb_bob", "equidistant", "[-0.1, 1e-5, 0.001, -0.002, 0]", "[0.01, 0, 0, 0]", "cols: 5", "cols: 4")):
            text = CAMERA_INFO
            for old, new in zip(change[::2], change[1::2]):
                text = text.replace(old, new)
            path = self.write("camera.yaml", text)
            written = self.write("camera.json", run_evpose("camera", path, "--json"))
            self.assertEqual(evpose.read_camera(written), evpose.read_camera(path))

    def test_lens_models_of_ros(self):
        def read(model, numbers):
            text = CAMERA_INFO.replace("distortion_model: plumb_bob\n", model).replace("[-0.1, 1e-5, 0.001, -0.002, 0]", str(numbers))
            camera = self.read(text)
            return camera.lens_model, list(camera.distortion)

        eight = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]
        self.assertEqual(read("distortion_model: rational_polynomial\n", eight), ("rational", eight))
        self.assertEqual(read("distortion_model: rational_polynomial\n", eight + [0] * 6), ("rational", eight))
        self.assertEqual(read("distortion_model: equidistant\n", eight[:4]), ("fisheye", eight[:4]))
        self.assertEqual(read("", eight[:4]), ("brown", eight[:4]))
        self.assertEqual(read("", [0] * 14), ("brown", []))
        for model, numbers, words in (("", eight, "is missing, and distortion_coefficients has 8 numbers"),
                                      ("distortion_model: rational_polynomial\n", eight + [0, 0, 0, 9], "has 12 numbers"),
                                      ("distortion_model: equidistant\n", eight[:3], "has 3 numbers")):
            self.assertIn(words, message_of(evpose.InvalidArgumentError, read, model, numbers))

    def test_lens_models_of_the_api(self):
        for name, numbers in (("brown", 5), ("rational", 8), ("fisheye", 4)):
            message = evpose.Camera(640, 480, 600.0, 600.0, 320.0, 240.0, (0.1,) * numbers, name).to_proto()
            self.assertEqual((message.lens_model, len(message.distortion)),
                             (geometry_pb2.LensModel.Value(f"LENS_MODEL_{name.upper()}"), numbers))

    def test_four_coefficients_of_the_brown_model_are_sent_as_five(self):
        camera = self.read(CAMERA_INFO.replace("-0.002, 0]", "-0.002]"))
        self.assertEqual(list(camera.to_proto().distortion), [-0.1, 1e-5, 0.001, -0.002, 0.0])

    def test_wrong_files_name_the_file_and_the_key(self):
        for old, new, words in (
                ("image_width: 640", "", "image_width: None is not a number"),
                ("image_width: 640", "image_width: 640.5", "image_width: 640.5 is not a whole number"),
                ("600.5, 0,", "600.5, 1,", "without skew"),
                ("600.5,", "-600.5,", "fx_px and fy_px must be positive"),
                ("600.5,", ".nan,", "fx_px is not a finite number"),
                ("600.5,", "", "camera_matrix: has 8 numbers"),
                ("0, 0, 1]", "0, 0, 2]", "camera_matrix: must be [fx"),
                ("plumb_bob", "ladybug", "distortion_model: 'ladybug'"),
                ("plumb_bob", "none", "set it to plumb_bob"),
                ("-0.002, 0]", "-0.002, 0, 0]", "distortion has 6 numbers"),
                ("600.5,", f"1{'0' * 400},", "is not a number"),
                ("distortion_model: plumb_bob", ALIASES + "distortion_model: *a40", "distortion_model: [[[...], [...]], [[...], [...]]] is not a text"),
                ("image_width: 640", ALIASES + "image_width: *a40", "image_width: [[[...], [...]], [[...], [...]]] is not a number"),
                ("-0.1,", "x,", "distortion_coefficients: 'x' is not a number"),
                ("image_width: 640", "{", "neither YAML nor JSON"),
                ("image_width: 640", "image_width: !!int ''", "neither YAML nor JSON"),
                ("image_width: 640", "image_width: !!bool 640", "neither YAML nor JSON"),
                ("image_width: 640", "image_width: !!timestamp 640", "neither YAML nor JSON"),
                (CAMERA_INFO, "text", "it has no keys"),
                (CAMERA_INFO, " " * 100_001, "larger than 100000 bytes"),
                (CAMERA_INFO, "\x00", "camera.yaml")):
            with self.subTest(words):
                message = message_of(evpose.InvalidArgumentError, self.read, CAMERA_INFO.replace(old, new))
                self.assertIn(words, message)
                self.assertIn("camera.yaml", message)
        self.assertIn("no such file", message_of(evpose.NotFoundError, evpose.read_camera, self.directory / "none.yaml"))
        self.assertIn("cannot be read", message_of(evpose.InvalidArgumentError, evpose.read_camera, self.directory))

    def test_a_camera_with_wrong_numbers(self):
        for changes, words in (({"width_px": 0}, "width_px"), ({"lens_model": "omni"}, "'omni'"), ({"distortion": (1.0,)}, "1 numbers"),
                               ({"distortion": (float("inf"),) * 5}, "finite"), ({"cy_px": float("nan")}, "cy_px")):
            values = {"width_px": 640, "height_px": 480, "fx_px": 600.0, "fy_px": 600.0, "cx_px": 320.0, "cy_px": 240.0, **changes}
            with self.assertRaises(evpose.InvalidArgumentError) as caught:
                evpose.Camera(**values)
            self.assertIn(words, str(caught.exception))

    def test_sensor_profiles(self):
        self.assertEqual(evpose.read_sensor_profile(ROOT / "deploy/sensors/evk4.yaml"), evpose.SensorProfile())
        wrong = self.write("sensor.yaml", "blur_px: 1\n")
        self.assertIn("pixel_noise_px", message_of(evpose.InvalidArgumentError, evpose.read_sensor_profile, wrong))

    def test_every_constant_of_a_sensor_profile_is_sent(self):
        text = (ROOT / "deploy/sensors/evk4.yaml").read_text()
        profile = evpose.read_sensor_profile(self.write("sensor.yaml", text.replace("uncertainty: 1", "uncertainty: 0.3")))
        self.assertEqual(profile, evpose.SensorProfile(uncertainty=0.3))
        camera = evpose.Camera(640, 480, 600.0, 600.0, 320.0, 240.0)
        sent = SessionConfig(evpose.Encoding.EVT3, camera, (), sensor=profile).to_proto().tracker.sensor
        self.assertEqual({field.name: value for field, value in sent.ListFields()}, dataclasses.asdict(profile))
        self.assertEqual([field.name for field in sent.DESCRIPTOR.fields], [field.name for field in dataclasses.fields(profile)])
        earlier = self.write("sensor.yaml", text.replace("uncertainty: 1", ""))
        self.assertEqual(evpose.read_sensor_profile(earlier), evpose.SensorProfile())

    def test_wrong_sensor_profiles_name_the_file_and_the_key(self):
        text = (ROOT / "deploy/sensors/evk4.yaml").read_text()
        for content, words in ((text + "gain: 2\n", "gain is not a field of a sensor profile"),
                               (text.replace("blur_px: 0.47", "blur_px: wide"), "blur_px: 'wide' is not a number"),
                               ("text", "it has no keys"), ("", "it has no keys"), ("[" * 50_000, "neither YAML nor JSON"),
                               (" " * 100_001, "larger than 100000 bytes"), (b"\xff", "cannot be read")):
            with self.subTest(words):
                message = message_of(evpose.InvalidArgumentError, evpose.read_sensor_profile, self.write("sensor.yaml", content))
                self.assertIn(words, message)
                self.assertIn("sensor.yaml", message)
        self.assertIn("no such file", message_of(evpose.NotFoundError, evpose.read_sensor_profile, self.directory / "none.yaml"))


class RecordingTest(InputTest):
    def test_headers(self):
        for text, expected in (
                (b"% evt 3.0\n% geometry 640x480\n% end\n", (evpose.Encoding.EVT3, 640, 480)),
                (b"% format EVT3;height=720;width=1280\n% end\n", (evpose.Encoding.EVT3, 1280, 720)),
                (b"% endianness little\n% evt 2.1\n% format EVT21;height=720;width=1280\n", (evpose.Encoding.EVT21, 1280, 720)),
                (b"% date 2020\r\n% evt 2.0\r\n", (evpose.Encoding.EVT2, None, None)),
                (b"% Data file containing CD events\n% Version 2\n% Width 304\n% Height 240\n", (evpose.Encoding.DAT, 304, 240)),
                (b"% format FLAT64;height=100;width=200\n% end\n", (evpose.Encoding.FLAT64, 200, 100))):
            is_dat = expected[0] == evpose.Encoding.DAT
            header = parse_header(text + (b"\x00\x08" if is_dat else b"") + b"\x01\x80%x")
            self.assertEqual(header, (*expected, len(text) + 2 * is_dat), text)

    def test_wrong_headers_name_the_line(self):
        for text, words in (
                (b"", "there is no header"), (b"\x00\x80", "there is no header"), (b"% date 2020\n", "names no format"),
                (b"% date\n% evt 4.0\n", "header line 2: EVT 4.0"), (b"% format EVT4;width=3\n", "header line 1: the format 'EVT4'"),
                (b"% evt 3.0\n% format EVT2\n", "header line 2: states EVT2, but line 1 states EVT3"),
                (b"% evt 3.0\n% geometry 640x\n", "header line 2: the height"),
                (b"% evt 3.0\n% width " + b"9" * 5000 + b"\n", "header line 2: the width '999"),
                (b"% evt 3.0\n% geometry 640x480\n% width 641\n", "header line 3: states width 641, but line 2 states 640"),
                (b"% Data file containing events\n% Version 1\n\x00\x08", "header line 2: version 1"),
                (b"% Data file containing events\n\x05\x08", "type 5"), (b"% Data file containing events\n", "ends before the two bytes"),
                (b"% evt 2.1\n% endianness legacy\n", "'legacy'"), (b"% evt 3.0\n" + b"% pad\n" * 11000, "longer than 65536")):
            with self.subTest(words):
                self.assertIn(words, message_of(evpose.InvalidArgumentError, parse_header, text))

    def test_chunks_are_whole_words_and_together_the_file(self):
        data = bytes(range(256)) * 40
        for encoding, word in ((b"EVT3", 2), (b"EVT2", 4), (b"FLAT64", 8)):
            path = self.write("recording.raw", b"% format " + encoding + b"\n% end\n" + data + b"\x01")
            with evpose.Recording(path, chunk_bytes=1000) as recording:
                for _ in range(2):  # a file can be read again
                    chunks = list(recording)
                    self.assertEqual(b"".join(chunks), data)
                    self.assertTrue(all(len(chunk) % word == 0 and len(chunk) <= 1000 for chunk in chunks))

    def test_a_file_that_changes_while_it_is_read(self):
        content = b"% evt 3.0\n% end\n" + bytes(10_000)

        def truncate(path):
            os.truncate(path, 5000)

        def append(path):
            with open(path, "ab") as file:
                file.write(bytes(8))

        def write(path):
            later_ns = os.stat(path).st_mtime_ns + 10**9
            os.utime(path, ns=(later_ns, later_ns))

        def replace(path):
            self.write("other.raw", content).rename(path)

        for change, words in ((truncate, "its size was 10016 bytes and is 5000"), (append, "and is 10024"), (write, "was written to"),
                              (replace, "another file has replaced it")):
            with self.subTest(change.__name__):
                path = self.write("recording.raw", content)
                with evpose.Recording(path, chunk_bytes=1000) as recording:
                    chunks = iter(recording)
                    self.assertEqual(len(next(chunks)), 1000)
                    change(path)
                    message = message_of(evpose.DataLossError, list, chunks)
                self.assertIn(words, message)
                self.assertIn("recording.raw: changed while it was read", message)

    def test_a_pipe(self):
        path = self.directory / "pipe"
        os.mkfifo(path)
        data = bytes(range(256)) * 1000

        def write():
            with open(path, "wb", buffering=0) as pipe:
                pipe.write(b"% evt 3.0\n% en")
                pipe.write(b"d\n" + data[:1001])
                pipe.write(data[1001:])

        thread = threading.Thread(target=write)
        thread.start()
        with evpose.Recording(path) as recording:
            self.assertEqual(b"".join(recording), data)
            self.assertIn("only once", message_of(evpose.InvalidArgumentError, list, recording))
        thread.join()

    def test_files_that_are_no_recordings(self):
        self.assertIn("no such file", message_of(evpose.NotFoundError, evpose.Recording, self.directory / "none.raw"))
        self.assertIn("cannot be read", message_of(evpose.InvalidArgumentError, evpose.Recording, self.directory))
        for content, words in ((b"\x7fELF", "there is no header"), (b"t,x,y,p\n", "`evpose convert FILE recording.raw` makes one"), (b"% evt 3.0\n% end\n", "a header but no events"), (b"", "no header")):
            path = self.write("file.raw", content)
            message = message_of(evpose.InvalidArgumentError, evpose.Recording, path)
            self.assertIn(words, message)
            self.assertIn("file.raw", message)
        self.assertIn("multiple of 8", message_of(evpose.InvalidArgumentError, evpose.Recording, path, 12))


class EventsTest(InputTest):
    def test_words(self):
        events = evpose.make_events([1, 639], [2, 479], [0, 1], [5, 0x7FFFFFFF])
        words = np.frombuffer(evpose.events_to_bytes(events), "<u8")
        self.assertEqual(words.tolist(), [5 << 32 | 1 << 18 | 2 << 4, 0x7FFFFFFF << 32 | 639 << 18 | 479 << 4 | 1])

    def test_other_names_and_types_of_fields(self):
        expected = evpose.events_to_bytes(evpose.make_events([3], [4], [1], [7]))
        for fields in ([("x", "u2"), ("y", "u2"), ("p", "i2"), ("t", "i8")], [("t_us", "u4"), ("y", "i8"), ("x", "u1"), ("on", "?")],
                       [("timestamp", "u8"), ("x", "i2"), ("y", "i2"), ("polarity", "?")]):
            events = np.zeros(1, dtype=fields)
            for name in events.dtype.names:
                events[name] = {"x": 3, "y": 4, "t": 7, "t_us": 7, "timestamp": 7}.get(name, 1)
            self.assertEqual(evpose.events_to_bytes(events), expected)
        self.assertEqual(evpose.events_to_bytes(np.zeros(0, evpose.EVENT_DTYPE)), b"")

    def test_times_continue_across_arrays_and_wrap(self):
        encoder = evpose.FlatEncoder()
        first, second = (evpose.make_events([0], [0], [0], [t]) for t in (0xFFFFFFFF, 0x100000001))
        encoder.encode(first)
        self.assertEqual(np.frombuffer(encoder.encode(second), "<u8").tolist(), [1 << 32])
        late = evpose.make_events([0], [0], [0], [0x100000001 + (1 << 31)])
        self.assertIn("event 0 is 2147483648 us after", message_of(evpose.InvalidArgumentError, encoder.encode, late))

    def test_wrong_arrays_name_the_field_and_the_index(self):
        def encode(events):
            return evpose.FlatEncoder(640, 480).encode(events)

        good = {"x": [0, 639], "y": [0, 479], "p": [0, 1], "t_us": [0, 1]}
        self.assertEqual(len(encode(evpose.make_events(**good))), 16)
        for change, words in (({"x": [0, 640]}, "x of event 1 is 640"), ({"y": [480, 0]}, "y of event 0 is 480"),
                              ({"t_us": [1 << 32, 0]}, "the first time is 4294967296"), ({"t_us": [-1, 0]}, "the first time is -1"),
                              ({"t_us": [5, -1]}, "time of event 1 is negative"), ({"t_us": [0, 1 << 31]}, "event 1 is 2147483648 us after")):
            events = evpose.make_events(**{**good, **change})
            self.assertIn(words, message_of(evpose.InvalidArgumentError, encode, events))
        for change, words in (({"x": [-1, 0]}, "x of event 0 is -1"), ({"y": [0, 16384]}, "y of event 1 is 16384"),
                              ({"x": [0]}, "same length"), ({"t_us": [0.5, 1.0]}, "t_us has type float64")):
            self.assertIn(words, message_of(evpose.InvalidArgumentError, lambda: evpose.make_events(**{**good, **change})))
        self.assertIn("no field t or", message_of(evpose.InvalidArgumentError, encode, np.zeros(1, [("x", "u2"), ("y", "u2"), ("p", "u1")])))
        self.assertIn("no fields", message_of(evpose.InvalidArgumentError, encode, np.zeros(4)))
        self.assertIn("shape (2, 2)", message_of(evpose.InvalidArgumentError, encode, np.zeros((2, 2), evpose.EVENT_DTYPE)))


class DurationTest(InputTest):
    def test_durations_that_are_none(self):
        self.assertEqual(to_duration_ns(0.25, "period_s", 0.01), 250_000_000)
        for value, words in ((float("nan"), "period_s is nan, but must be a finite number of at least 0.01 s"), (0.0, "period_s is 0.0"),
                             (float("inf"), "period_s is inf"), (1e300, "at most 315576000000"), ("x", "period_s: 'x' is not a number")):
            self.assertIn(words, message_of(evpose.InvalidArgumentError, to_duration_ns, value, "period_s", 0.01))
        camera = evpose.Camera(640, 480, 600.0, 600.0, 320.0, 240.0)
        for value in (float("nan"), float("inf"), -1.0):
            config = SessionConfig(evpose.Encoding.EVT3, camera, (), max_lag_s=value)
            self.assertIn("max_lag_s is", message_of(evpose.InvalidArgumentError, config.to_proto))


class AddressTest(InputTest):
    def test_address(self):
        self.assertEqual(parse_address("capture-7:50051"), ("capture-7", 50051))
        self.assertEqual(parse_address("[::1]:50051"), ("::1", 50051))
        for text, words in (("capture-7", "HOST:PORT is needed"), ("capture-7:0", "HOST:PORT is needed"),
                            ("http://capture-7:50051/", "give capture-7:50051"), ("HTTPS://capture-7:50051", "give capture-7:50051"),
                            ("http://localhost", "give localhost:PORT"), ("http://[::1]/v1", "give [::1]:PORT"), ("http://", "give HOST:PORT")):
            self.assertIn(words, message_of(evpose.InvalidArgumentError, parse_address, text))


class RetryTest(InputTest):
    def test_advice(self):
        again = Advice.TRY_AGAIN
        for error, advice in (
                (evpose.UnavailableError(""), again), (evpose.DeadlineExceededError("", reason="STREAM_IDLE"), again),
                (evpose.InternalError(""), again), (evpose.InternalError("", reason="STORE_FAILED"), Advice.GIVE_UP),
                (evpose.CancelledError(""), again), (evpose.AbortedError("", reason="POSES_EXPIRED"), again),
                (evpose.AbortedError("", reason="FENCED"), Advice.GIVE_UP), (evpose.DataLossError("", reason="CRC_MISMATCH"), again),
                (evpose.DataLossError("", reason="SESSION_DAMAGED"), Advice.GIVE_UP), (evpose.ResourceExhaustedError(""), Advice.GIVE_UP),
                (evpose.ResourceExhaustedError("", retry_in_s=1.0), again),
                (evpose.NotFoundError("", reason="SESSION_NOT_FOUND"), Advice.TRY_OTHER_SERVER),
                (evpose.NotFoundError("", reason="SESSION_DELETED"), Advice.GIVE_UP),
                (evpose.UnauthenticatedError("", reason="ACCESS_WITHDRAWN"), again),
                (evpose.UnauthenticatedError("", reason="BAD_TOKEN"), Advice.TRY_OTHER_AUTH_TOKEN),
                (evpose.PermissionDeniedError("", reason="WRONG_TOKEN"), Advice.TRY_OTHER_TOKEN),
                (evpose.InvalidArgumentError("", field="attach.last_pose_seq"), Advice.ATTACH_FROM_FIRST_POSE),
                (evpose.InvalidArgumentError("", field="events.seq"), Advice.GIVE_UP),
                (evpose.FailedPreconditionError("", reason="SEQ_GAP"), Advice.GIVE_UP)):
            self.assertIs(advise_on(error), advice, (error.code, error.reason))

    def test_delays_double_up_to_the_limit(self):
        for uniform, share in ((lambda: 0.0, 0.5), (lambda: 1.0, 1.0)):
            backoff = Backoff(evpose.RetryOptions(first_delay_s=1.0, max_delay_s=5.0), uniform)
            self.assertEqual([backoff.next() for _ in range(5)], [share * delay for delay in (1, 2, 4, 5, 5)])
            backoff.reset()
            self.assertEqual(backoff.next(), share)

    def test_options(self):
        for changes in ({"max_outage_s": -1.0}, {"first_delay_s": 0.0}, {"first_delay_s": 2.0, "max_delay_s": 1.0}):
            self.assertIn(next(reversed(changes)), message_of(evpose.InvalidArgumentError, lambda: evpose.RetryOptions(**changes)))
        for changes in ({"memory_bytes": 0}, {"attach_timeout_s": 0.0}):
            self.assertIn(next(iter(changes)), message_of(evpose.InvalidArgumentError, lambda: evpose.TrackOptions(**changes)))

    def test_positions_are_text(self):
        position = evpose.TrackPosition("sessions/1", "new", "old", 7, 2, FeedPoint(3, 24, 5), 16)
        self.assertEqual(evpose.TrackPosition.from_json(position.to_json()), position)
        self.assertIn("not the position", message_of(evpose.InvalidArgumentError, evpose.TrackPosition.from_json, '{"session": 1}'))
        good = json.loads(position.to_json())
        for change in ({"session": 1}, {"resume_token": None}, {"last_pose_seq": "7"}, {"lost_poses": True}, {"max_piece_bytes": -1},
                       {"durable": [3, float("inf"), 5]}, {"durable": [3, 24, "5"]}, {"durable": 3}, {"last_pose_seq": 1.5}, {"more": 1}):
            text = json.dumps({**good, **change})
            self.assertIn("give the text of TrackPosition.to_json()",
                          message_of(evpose.InvalidArgumentError, evpose.TrackPosition.from_json, text), change)
        for text in ("", "[]", "[" * 100_000, "{}"):
            self.assertIn("not the position", message_of(evpose.InvalidArgumentError, evpose.TrackPosition.from_json, text))

    def test_resets_that_wait_for_the_source_are_limited(self):
        feed = EventFeed([], evpose.Encoding.FLAT64, (640, 480), 1 << 20, False, FeedPoint())  # is not read
        reset = evpose.PoseReset(evpose.Transform.from_quaternion([0, 0, 1], [0, 0, 0, 1]))
        for _ in range(1000):
            feed.reset_pose(reset)
        self.assertIn("call reset_pose() less often", message_of(evpose.FailedPreconditionError, feed.reset_pose, reset))

    def test_an_outbox_keeps_chunks_until_they_are_durable(self):
        outbox = Outbox(1 << 20, FeedPoint(), RetainOptions(duration_s=0.0))
        point = FeedPoint()
        for i in range(3):
            chunk = make_chunk(point, bytes([i]) * 8)
            point = chunk.end
            self.assertTrue(outbox.append(chunk))
        self.assertEqual((outbox.last, outbox.kept_bytes), (point, 24))
        outbox.release(2)
        self.assertEqual((outbox.durable.seq, outbox.kept_bytes), (2, 8))
        with outbox.changed:
            self.assertEqual(outbox.get(3).payload, b"\x02" * 8)
            self.assertIn("chunk 2 again", message_of(evpose.DataLossError, outbox.get, 2))
        outbox.finish(None)
        with outbox.changed:
            self.assertIsNone(outbox.get(4))
            self.assertIn("has 4 chunks", message_of(evpose.FailedPreconditionError, outbox.get, 5))

    def test_a_full_outbox_waits_for_durable_chunks(self):
        outbox = Outbox(1, FeedPoint())  # a chunk that exceeds the limit is accepted when it is the only one
        first = make_chunk(FeedPoint(), b"\x00" * 8)
        second = make_chunk(first.end, b"\x01" * 8)
        self.assertTrue(outbox.append(first))
        results = []
        thread = threading.Thread(target=lambda: results.append((outbox.append(second), outbox.durable.seq)))
        thread.start()
        outbox.release(1)
        thread.join()
        self.assertEqual(results, [(True, 1)])
        thread = threading.Thread(target=lambda: results.append(outbox.append(make_chunk(second.end, b"\x02" * 8))))
        thread.start()
        outbox.close()
        thread.join()
        self.assertEqual(results[1], False)
        self.assertFalse(outbox.wait_for_demand(1))

    def test_durable_chunks_are_retained_for_a_time_and_up_to_a_size(self):
        now = [0.0]
        outbox = Outbox(1, FeedPoint(), RetainOptions(duration_s=5.0, max_bytes=3 * (8 + 512)), lambda: now[0])
        point = FeedPoint()
        for seq in range(1, 6):
            chunk = make_chunk(point, bytes([seq]) * 8)
            point = chunk.end
            self.assertTrue(outbox.append(chunk))
            outbox.release(seq)
            now[0] += 1.0
        self.assertEqual((outbox.first_seq, outbox.durable.seq, outbox.kept_bytes), (3, 5, 0))
        with outbox.changed:
            self.assertEqual(outbox.get(3).payload, bytes([3]) * 8)
        now[0] = 8.0
        self.assertTrue(outbox.append(make_chunk(point, b"\x06" * 8)))
        self.assertEqual(outbox.first_seq, 5)  # the others were reported 5 s ago
        with self.assertRaises(evpose.DataLossError) as caught, outbox.changed:
            outbox.get(4)
        self.assertEqual(caught.exception.reason, "ROLLED_BACK")
        for changes in ({"duration_s": -1.0}, {"max_bytes": -1}):
            self.assertIn(next(iter(changes)), message_of(evpose.InvalidArgumentError, lambda: evpose.RetainOptions(**changes)))

    def test_the_numbers_are_those_of_the_api(self):
        for enum, values, prefix in ((evpose.TrackState, session_pb2.TrackState, "TRACK_STATE_"),
                                     (evpose.Encoding, session_pb2.EventEncoding, "EVENT_ENCODING_"),
                                     (evpose.Overload, session_pb2.OverloadPolicy, "OVERLOAD_POLICY_"),
                                     (evpose.Estimator, session_pb2.Estimator, "ESTIMATOR_")):
            self.assertEqual({each.name: int(each) for each in enum if each},
                             {name.removeprefix(prefix): number for name, number in values.items() if number})
        self.assertIs(evpose.TrackState(99), evpose.TrackState.UNKNOWN)
        for reason in ("FENCED", "CRC_MISMATCH", "SESSION_NOT_FOUND", "ACCESS_WITHDRAWN", "WRONG_TOKEN", "ROLLED_BACK"):
            self.assertIn(reason, error_reason_pb2.ErrorReason.keys())


if __name__ == "__main__":
    unittest.main()
