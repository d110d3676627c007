#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Reads the .mcap files of evpose with the libraries of Foxglove (npm: @mcap/core, @foxglove/rosmsg2-serialization) and compares them
with the JSON lines of the same session, to the bit. Status 77 (skipped) without node and npm, or if npm cannot install the packages."""

import base64
import json
import pathlib
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import unittest
import zlib

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "adversary"))
import server  # reads --bin

READER = "read_mcap.mjs"
EPOCH_NS = 1_700_000_000_250_000_000
CONFIRMED = ("TRACKING", "DEGRADED")


def install():
    """Installs the packages beside a copy of the reader, once per lock file, and returns the directory; None if that is not possible."""
    if not (shutil.which("node") and shutil.which("npm")):
        print("skipped: node and npm are missing (packages nodejs and npm)", file=sys.stderr)
        return None
    directory = server.BIN / "tests/mcap"
    directory.mkdir(parents=True, exist_ok=True)
    installed = directory / "installed-lock.json"
    lock = (HERE / "package-lock.json").read_text()
    for name in ("package.json", "package-lock.json", READER):
        shutil.copy(HERE / name, directory / name)
    if not installed.exists() or installed.read_text() != lock:
        done = subprocess.run(["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund"], cwd=directory, capture_output=True, text=True,
                              check=False)
        if done.returncode != 0:
            print(f"skipped: npm ci: {done.stderr}", file=sys.stderr)
            return None
        installed.write_text(lock)
    return directory


def read(path, *options):
    done = subprocess.run(["node", READER, path, *options], cwd=DIRECTORY, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise AssertionError(f"{READER} {path}: {done.stderr}")
    return json.loads(done.stdout)


def evpose(*arguments, status=0):
    """Runs the command evpose, which must end with this status."""
    done = subprocess.run([server.EVPOSE, *map(str, arguments)], capture_output=True, text=True, check=False)
    if done.returncode != status:
        raise AssertionError(f"evpose {arguments}: {done.stderr}")
    return done.stderr


def bits(numbers):
    return struct.pack(f"<{len(numbers)}d", *map(float, numbers))


def vector(value, names="xyz"):
    return [value[name] for name in names]


def full(upper):
    """Returns the 36 numbers of a symmetric matrix from its upper triangle."""
    matrix = [[0.0] * 6 for _ in range(6)]
    numbers = iter(upper)
    for row in range(6):
        for column in range(row, 6):
            matrix[row][column] = matrix[column][row] = next(numbers)
    return sum(matrix, [])


def count_pixels(png, width, height):
    """Returns the number of pixels with events of a PNG of two bits per pixel, whose size it checks."""
    assert png.startswith(b"\x89PNG\r\n\x1a\n")
    assert struct.unpack(">IIBB", png[16:26]) == (width, height, 2, 3)
    begin = png.index(b"IDAT") + 4
    rows = zlib.decompress(png[begin:begin + struct.unpack(">I", png[begin - 8:begin - 4])[0]])
    row_bytes = 1 + width // 4
    assert len(rows) == height * row_bytes
    count = 0
    for y in range(height):
        row = rows[y * row_bytes:(y + 1) * row_bytes]
        if row[0] == 0:  # the other rows repeat the one above
            above = sum(1 for byte in row[1:] for shift in (0, 2, 4, 6) if byte >> shift & 3)
        count += above
    return count


class McapTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.directory = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory()))
        evpose("simulate", "--object", "cube", "--camera", "vga", "--duration", "0.5", "--out", cls.directory)
        cls.replay = ("replay", cls.directory / "recording.raw", "--model", cls.directory / "model.obj", "--camera",
                      cls.directory / "camera.yaml")

    def lines(self, *options):
        """Returns the poses of a replay as JSON lines have them."""
        path = self.directory / "poses.jsonl"
        evpose(*self.replay, *options, "--out", path)
        return [json.loads(line) for line in path.read_text().splitlines()]

    def of_topic(self, file, topic):
        return [message for message in file["messages"] if message["topic"] == topic]

    def check_poses(self, file, lines, frame, name="object", epoch_ns=0):
        """Checks the messages of one object against its lines."""
        confirmed = [line for line in lines if line["state"] in CONFIRMED]
        self.assertGreater(len(confirmed), 100)
        poses, twists = (self.of_topic(file, f"/evpose/{name}/{what}") for what in ("pose", "twist"))
        self.assertEqual(len(poses), len(confirmed))
        self.assertEqual(len(twists), len(confirmed))
        self.assertEqual([message["sequence"] for message in poses], list(range(len(confirmed))))
        for line, pose, twist in zip(confirmed, poses, twists):
            time_ns = epoch_ns + 1000 * line["t_us"]
            self.assertEqual((pose["log_time_ns"], pose["publish_time_ns"]), (str(time_ns), str(time_ns)))
            for each in (pose["message"], twist["message"]):
                self.assertEqual(each["header"]["frame_id"], frame)
                stamp = each["header"]["stamp"]
                self.assertEqual(stamp["sec"] * 1_000_000_000 + stamp["nanosec"], time_ns)
            body = pose["message"]["pose"]
            self.assertEqual(bits(vector(body["pose"]["position"])), bits(line["translation_m"]))
            self.assertEqual(bits(vector(body["pose"]["orientation"], "xyzw")), bits(line["quaternion_xyzw"]))
            self.assertEqual(bits(body["covariance"]), bits(full(line["covariance_upper"])))
            velocity = twist["message"]["twist"]
            self.assertEqual(bits(vector(velocity["linear"]) + vector(velocity["angular"])), bits(line["twist"]))
        states = [json.loads(message["message"]["data"]) for message in self.of_topic(file, f"/evpose/{name}/state")]
        of_poses = [state for state in states if "pose_seq" in state]
        self.assertEqual([(state["pose_seq"], state["t_us"], state["state"], state["explained_ratio"]) for state in of_poses],
                         [(line["pose_seq"], line["t_us"], line["state"], line["explained_ratio"]) for line in lines])
        changes = [state for state in states if "pose_seq" not in state]
        self.assertIn("TRACKING", [state["state"] for state in changes])

    def check_scene(self, file, faces=12):
        self.assertEqual(file["header"]["profile"], "ros2")
        camera = self.of_topic(file, "/evpose/camera_info")
        self.assertEqual(len(camera), 1)
        self.assertEqual((camera[0]["message"]["width"], camera[0]["message"]["height"]), (640, 480))
        model = self.of_topic(file, "/evpose/object/model")
        self.assertEqual(len(model), 1)
        self.assertIn("durability: 1\n", file["topics"]["/evpose/object/model"]["qos"])
        triangles, edges = model[0]["message"]["markers"]
        self.assertEqual((triangles["type"], len(triangles["points"])), (11, 3 * faces))
        self.assertEqual((edges["type"], len(edges["points"])), (5, 24))
        self.assertEqual(triangles["header"]["frame_id"], "object")
        health = self.of_topic(file, "/diagnostics")
        self.assertGreater(len(health), 0)
        self.assertEqual([status["name"] for status in health[-1]["message"]["status"]], ["evpose", "evpose: object"])
        counts = {}
        for message in file["messages"]:
            counts[message["topic"]] = counts.get(message["topic"], 0) + 1
        self.assertEqual(file["statistics"]["by_topic"], counts)

    def test_the_poses_of_a_replay(self):
        lines = self.lines()
        path = self.directory / "poses.mcap"
        evpose(*self.replay, "--out", path)
        file = read(path)
        self.check_poses(file, lines, "evpose_camera")
        self.check_scene(file)
        for line, message in zip([line for line in lines if line["state"] in CONFIRMED], self.of_topic(file, "/tf")):
            (transform,) = message["message"]["transforms"]
            self.assertEqual((transform["header"]["frame_id"], transform["child_frame_id"]), ("evpose_camera", "object"))
            self.assertEqual(bits(vector(transform["transform"]["translation"])), bits(line["translation_m"]))
            self.assertEqual(bits(vector(transform["transform"]["rotation"], "xyzw")), bits(line["quaternion_xyzw"]))
        # A reader that seeks finds the messages from there on.
        middle_ns = 1000 * lines[len(lines) // 2]["t_us"]
        later = read(path, "--from", str(middle_ns))["messages"]
        self.assertEqual([message["log_time_ns"] for message in later],
                         sorted((each["log_time_ns"] for each in file["messages"] if int(each["log_time_ns"]) >= middle_ns), key=int))
        # A player without the index finds the same messages.
        stream = read(path, "--stream")
        self.assertTrue(stream["is_complete"])
        self.assertEqual(self.of_topic(stream, "/evpose/object/pose"), self.of_topic(file, "/evpose/object/pose"))

    def test_another_frame_and_epoch(self):
        world = self.directory / "world.yaml"
        world.write_text("frame_id: cell\ntranslation: {x: 1, y: 2, z: 3}\nrotation: {x: 0.5, y: 0.5, z: 0.5, w: 0.5}\n")
        path = self.directory / "world.mcap"
        evpose(*self.replay, "--world-from-camera", world, "--epoch", "1700000000.25", "--out", path)
        file = read(path)
        self.check_poses(file, self.lines("--world-from-camera", world), "cell", epoch_ns=EPOCH_NS)
        (static,) = self.of_topic(file, "/tf_static")
        (transform,) = static["message"]["transforms"]
        self.assertEqual((transform["header"]["frame_id"], transform["child_frame_id"]), ("cell", "evpose_camera"))
        self.assertEqual(bits(vector(transform["transform"]["translation"])), bits([1, 2, 3]))
        self.assertEqual(file["metadata"]["evpose"], {"epoch_ns": str(EPOCH_NS), "transform": "cell_from_object",
                                                      "camera_frame": "evpose_camera"})
        path = self.directory / "object.mcap"
        evpose(*self.replay, "--pose", "object-from-camera", "--out", path)
        self.check_poses(read(path), self.lines("--pose", "object-from-camera"), "object")

    def test_several_objects(self):
        replay = [each for each in self.replay if each not in ("--model", self.directory / "model.obj")]
        replay += ["--object", f"left-1={self.directory / 'model.obj'}", "--object", f"right={self.directory / 'model.obj'}"]
        lines = self.directory / "two.jsonl"
        for path in (lines, self.directory / "two.mcap", self.directory / "two-{object}.mcap"):
            evpose(*replay, "--out", path, status=1)  # only one of them is in view
        both = [json.loads(line) for line in lines.read_text().splitlines()]
        tracked = {line["object_id"] for line in both if line["state"] in CONFIRMED}
        self.assertGreater(len(tracked), 0)
        together = read(self.directory / "two.mcap")
        for object_id, name in (("left-1", "left_1"), ("right", "right")):
            own = [line for line in both if line["object_id"] == object_id]
            alone = read(self.directory / f"two-{object_id}.mcap")
            if object_id in tracked:
                self.check_poses(together, own, "evpose_camera", name)
                self.check_poses(alone, own, "evpose_camera", name)
            self.assertEqual({topic.split("/")[2] for topic in alone["topics"] if topic.count("/") == 3}, {name})

    def test_images_of_the_events(self):
        path = self.directory / "images.mcap"
        evpose(*self.replay, "--event-images", "2", "--rate", "1", "--out", path)
        file = read(path)
        self.check_poses(file, self.lines(), "evpose_camera")
        images, outlines = (self.of_topic(file, f"/evpose/events/{what}") for what in ("compressed", "annotations"))
        self.assertGreater(len(images), 0)
        self.assertEqual([image["log_time_ns"] for image in images], [outline["log_time_ns"] for outline in outlines])
        num_events, num_lines = 0, 0
        for image, outline in zip(images, outlines):
            self.assertEqual((image["message"]["format"], image["message"]["header"]["frame_id"]), ("png", "evpose_camera"))
            num_events += count_pixels(base64.b64decode(image["message"]["data"]), 640, 480)
            for points in outline["message"]["points"]:
                self.assertEqual(points["timestamp"], image["message"]["header"]["stamp"])
                self.assertEqual((points["type"], len(points["points"]) % 2), (4, 0))
                num_lines += len(points["points"]) // 2
                for point in points["points"]:
                    self.assertTrue(-100 < point["x"] < 740 and -100 < point["y"] < 580, point)
        self.assertGreater(num_events, 1000)
        self.assertGreater(num_lines, 3)

    def test_a_run_that_is_killed_and_continued(self):
        lines = self.lines()
        path = self.directory / "resumed.mcap"
        partial = self.directory / "resumed.mcap.partial"
        running = server.Server("--log-level", "error", directory=self.directory, store="sqlite")
        self.addCleanup(lambda: running.is_ended or running.kill())
        command = [server.EVPOSE, *self.replay, "--server", running.address, "--resume", self.directory / "resume.state", "--out", path]
        # Slowly, so that the run does not end before the kill.
        client = subprocess.Popen([*map(str, command), "--rate", "0.05"], stderr=subprocess.PIPE)
        server.poll(lambda: partial.exists() and any(m["topic"] == "/evpose/object/pose" for m in read(partial, "--stream")["messages"]),
                    "a pose in the file")
        client.send_signal(signal.SIGKILL)
        client.wait()
        client.stderr.close()
        self.assertFalse(path.exists())
        before = read(partial, "--stream")
        self.assertFalse(before["is_complete"])
        evpose(*command[1:])
        file = read(path)
        self.check_poses(file, lines, "evpose_camera")
        self.check_scene(file)

    def test_a_session_that_is_watched(self):
        lines = self.lines()
        running = server.Server("--log-level", "error", directory=self.directory)
        self.addCleanup(lambda: running.is_ended or running.kill())
        evpose(*self.replay, "--server", running.address, "--keep-session")
        name = subprocess.run([server.EVPOSE, "sessions", "list", "--server", running.address], capture_output=True, text=True,
                              check=True).stdout.split()[0]
        path = self.directory / "watched.mcap"
        evpose("watch", name, "--server", running.address, "--epoch", "1700000000.25", "--out", path)
        file = read(path)
        self.check_poses(file, lines, "evpose_camera", epoch_ns=EPOCH_NS)
        self.check_scene(file)
        evpose("watch", name, "--server", running.address, "--out", self.directory / "watched.jsonl")
        self.assertEqual([json.loads(line) for line in (self.directory / "watched.jsonl").read_text().splitlines()], lines)


if __name__ == "__main__":
    DIRECTORY = install()
    if DIRECTORY is None:
        sys.exit(77)
    unittest.main()
