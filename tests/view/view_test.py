#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`evpose view` in a browser: a simulated recording with its poses, and live sessions of a server.

  view_test.py --bin DIRECTORY_OF_THE_BUILD [--picture FILE] [unittest arguments]

--picture keeps the picture that RecordingView.test_picture makes, that of the README:

  tests/view/view_test.py --bin build/release --picture "$PWD/deploy/view.png" RecordingView.test_picture
"""

import argparse
import http.client
import json
import os
import pathlib
import socket
import subprocess
import sys
import tempfile
import unittest
import urllib.request

from browser import STATE_COLOURS, Page, PageServer, require, require_browser

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "adversary"))
import server  # reads --bin

ROOT = pathlib.Path(__file__).resolve().parents[2]
START_US = 16_000_000  # evpose simulate --start
DURATION_S = 2
# Returns the share of the cells with events that is within `radius` px of the overlay, and of the overlay moved by `shift` px.
EVENTS_SCRIPT = """
const [colour, radius, shift] = arguments;
const cells = document.getElementById('cells'), overlay = document.getElementById('overlay');
const events = cells.getContext('2d').getImageData(0, 0, cells.width, cells.height).data;
const lines = overlay.getContext('2d').getImageData(0, 0, overlay.width, overlay.height).data;
const scale = overlay.width / cells.width;
const isColoured = (x, y) => {
  const i = 4 * (y * overlay.width + x);
  return lines[i + 3] > 200 && colour.every((value, k) => Math.abs(lines[i + k] - value) < 40);
};
const share = (moved) => {
  let total = 0, near = 0;
  for (let y = 0; y < cells.height; ++y) for (let x = 0; x < cells.width; ++x) {
    const i = 4 * (y * cells.width + x);
    if (events[i] === 0x10 && events[i + 1] === 0x15) continue;
    ++total;
    const cx = (x + 0.5) * scale + moved, cy = (y + 0.5) * scale + moved;
    search: for (let v = -radius; v <= radius; ++v) for (let u = -radius; u <= radius; ++u) {
      const px = Math.floor(cx + u), py = Math.floor(cy + v);
      if (px < 0 || py < 0 || px >= overlay.width || py >= overlay.height || !isColoured(px, py)) continue;
      ++near;
      break search;
    }
  }
  return total === 0 ? 0 : near / total;
};
return [share(0), share(shift)];
"""


def evpose(*arguments, **options):
    return subprocess.run([server.EVPOSE, *map(str, arguments)], check=True, capture_output=True, text=True, **options)


def read_poses(path):
    with open(path, encoding="utf-8") as file:
        return [json.loads(line) for line in file]


def shown_pose(page):
    """The pose that the page shows, as a line of `replay --out FILE.jsonl`; None if there is none."""
    data = page.pose
    if not data.get("tUs"):
        return None
    w, x, y, z = map(float, data["q"].split())
    return {
        "t_us": int(data["tUs"]),
        "pose_seq": int(data["seq"]),
        "translation_m": [float(value) for value in data["p"].split()],
        "quaternion_xyzw": [x, y, z, w],
        "state": data["state"].upper(),
    }


class ViewTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        scratch = tempfile.TemporaryDirectory()
        cls.addClassCleanup(scratch.cleanup)
        cls.dir = scratch.name
        evpose("simulate", "--object", "cube", "--camera", "vga", "--duration", DURATION_S, "--noise", 0.1, "--out", f"{cls.dir}/cube")
        cls.inputs = ["--model", f"{cls.dir}/cube/model.obj", "--camera", f"{cls.dir}/cube/camera.yaml"]
        cls.recording = f"{cls.dir}/cube/recording.raw"
        cls.poses_file = f"{cls.dir}/poses.jsonl"
        evpose("replay", cls.recording, *cls.inputs, "--out", cls.poses_file)
        cls.poses = read_poses(cls.poses_file)

    def open_page(self, url, **options):
        page = Page("about:blank", **options)
        self.addCleanup(page.close)
        page.set_theme("dark")
        page.driver.get(url)
        return page

    def serve_page(self, *arguments, **options):
        gateway = PageServer([server.EVPOSE, "view", *arguments], **options)
        self.addCleanup(gateway.stop)
        return gateway

    def scrub(self, t_us, end_us=START_US + DURATION_S * 1e6):
        self.page.run(
            """const [low, high, t] = arguments;
            const scrubber = document.getElementById('scrubber');
            scrubber.value = Math.round(scrubber.max * (t - low) / (high - low));
            for (const type of ['input', 'change']) scrubber.dispatchEvent(new Event(type));""",
            START_US, end_us, t_us,
        )
        # The scrubber spans the times of the events and poses, which begin and end a few milliseconds within the simulated time.
        self.page.wait(lambda: abs(int(self.page.data["imageTUs"]) - t_us) < 20000, f"about the instant {t_us}")
        return int(self.page.data["imageTUs"])

    def assert_is_sent(self, shown):
        sent = next(pose for pose in self.poses if pose["pose_seq"] == shown["pose_seq"])
        self.assertEqual(shown, {name: sent[name] for name in shown})

    def choose_window(self, page, window):
        page.run("const select = document.getElementById('window-select'); select.value = arguments[0]; select.dispatchEvent(new Event('change'))", window)

    def assert_overlay_lies_on_the_events(self, page):
        """Compares an image of 1 to 5 ms of a tracked object, at 1 px of the screen for each of the sensor."""
        script = f"""const {{imageTUs, imageFromUs, imageToUs}} = document.documentElement.dataset;
            return imageToUs - imageFromUs > 5001 || imageToUs - imageFromUs < 1000 ? null : [imageTUs, ...(function () {{ {EVENTS_SCRIPT} }})(...arguments)];"""
        # A live image shows the events since the previous one, which on a busy machine may be longer ago.
        at, near, shifted = page.wait(lambda: page.run(script, STATE_COLOURS["tracking"], 3, 40), "an image of 1 to 5 ms")
        print(f"at {at} us: {100 * near:.0f} % of the cells with events are within 3 px of the overlay, {100 * shifted:.0f} % of it moved by 40 px")
        self.assertGreater(near, 0.6)
        self.assertLess(shifted, 0.5 * near)

    def assert_silent(self, page):
        self.assertEqual(page.console_errors(), [])
        self.assertEqual(page.foreign_requests(), [])
        self.assertEqual(page.data["errors"], "0")


class RecordingView(ViewTest):
    def setUp(self):
        self.gateway = self.serve_page(
            self.recording, *self.inputs, "--poses", self.poses_file, "--truth", f"{self.dir}/cube/truth.tum"
        )
        self.page = self.open_page(self.gateway.url)
        self.page.wait(lambda: int(self.page.data.get("imageNumber", 0)) > 0, "the first image")

    def test_overlay_lies_on_the_events_and_poses_are_those_of_the_file(self):
        self.page.press("t")
        self.choose_window(self.page, "5 ms")
        self.page.wait(lambda: int(self.page.data["imageToUs"]) - int(self.page.data["imageFromUs"]) <= 5001, "an image of 5 ms")
        for share in (0.2, 0.5, 0.9):
            instant = self.scrub(START_US + share * DURATION_S * 1e6)
            shown = shown_pose(self.page)
            self.assert_is_sent(shown)
            self.assertEqual(shown["t_us"], max(pose["t_us"] for pose in self.poses if pose["t_us"] <= instant))
            self.assert_overlay_lies_on_the_events(self.page)
        self.assert_silent(self.page)

    def test_steps_from_pose_to_pose(self):
        self.scrub(START_US + 1e6)
        first = shown_pose(self.page)
        self.page.press("\ue014")
        self.page.wait(lambda: shown_pose(self.page)["pose_seq"] == first["pose_seq"] + 1, "the next pose")
        self.assert_is_sent(shown_pose(self.page))
        self.page.press("\ue012")
        self.page.wait(lambda: shown_pose(self.page) == first, "the former pose")
        self.assert_silent(self.page)

    def test_plays_to_the_end(self):
        self.page.press("\ue011")
        self.page.wait(lambda: int(self.page.data["imageTUs"]) < START_US + 20000, "the beginning")
        images, start_ms = self.page.run("return [Number(document.documentElement.dataset.imagesDrawn), performance.now()]")
        self.page.press(" ")
        self.page.wait(lambda: int(self.page.data["imageTUs"]) > START_US + DURATION_S * 1e6 - 50000, "the end")
        end_images, end_ms = self.page.run("return [Number(document.documentElement.dataset.imagesDrawn), performance.now()]")
        print(f"played {DURATION_S} s at 1x: {1000 * (end_images - images) / (end_ms - start_ms):.1f} images/s in {end_ms - start_ms:.0f} ms")
        self.page.wait_for_data(playing="false")
        self.assertGreater(end_images - images, 2)
        self.assert_silent(self.page)

    def serve_part(self, camera, duration_s):
        """Simulates a part with holes and a fillet, which a server finds and tracks without a prior, and returns the address of the page
        with it. The recording shows the exact surface; the tracker has a tessellation."""
        part = pathlib.Path(self.dir) / "bracket"
        subprocess.run([ROOT / "tests/bench/models/generate.py", part, "bracket"], check=True, capture_output=True)
        evpose("simulate", "--model", part / "bracket-reference.obj", "--camera", camera, "--distance", 0.24, "--duration", duration_s,
               "--noise", 0.1, "--out", part)
        # The page shows the name of the recording as it was given.
        inputs = ["bracket/recording.raw", "--model", "bracket/bracket-medium.obj", "--camera", "bracket/camera.yaml"]
        tracker = server.Server("--log-level", "error", directory=part)
        try:
            evpose("replay", *inputs, "--server", tracker.address, "--out", "bracket/poses.jsonl", cwd=self.dir)
        finally:
            tracker.kill()
        return self.serve_page(*inputs, "--poses", "bracket/poses.jsonl", cwd=self.dir).url

    def test_picture(self):
        # The picture of the README shows a sensor of a million pixels, whose simulation takes ten times as long.
        camera, duration_s = ("evk4", 1.0) if PICTURE else ("vga", 0.3)
        self.page.driver.get(self.serve_part(camera, duration_s))
        self.page.resize(1280, 720, scale=2)
        self.page.wait(lambda: int(self.page.data.get("imageNumber", 0)) > 0, "the first image")
        self.choose_window(self.page, "33 ms")
        for share in (0.5, 0.9):
            self.scrub(START_US + share * duration_s * 1e6, START_US + duration_s * 1e6)
        keys = "const keys = [...document.querySelectorAll('.plot .key')]; return keys.length > 9 && keys.every((key) => key.textContent !== '')"
        self.page.wait(lambda: self.page.run(keys), "values in all plots")
        self.assertIn("Event rate", self.page.run("return document.getElementById('plots').textContent"))
        self.assertEqual(shown_pose(self.page)["state"], "TRACKING")
        near, shifted = self.page.run(EVENTS_SCRIPT, STATE_COLOURS["tracking"], 6, 80)
        print(f"{100 * near:.0f} % of the cells with events are within 3 px of the overlay, {100 * shifted:.0f} % of it moved by 40 px")
        self.assertGreater(near, 2 * shifted)
        picture = PICTURE or f"{self.dir}/view.png"
        self.page.driver.save_screenshot(picture)
        self.assertGreater(os.path.getsize(picture), 20000)
        self.assert_silent(self.page)

    def test_other_hosts_origins_and_keys_are_refused(self):
        address = self.gateway.origin.removeprefix("http://")

        def status(path, **headers):
            connection = http.client.HTTPConnection(address)
            connection.putrequest("GET", path, skip_host=True)
            for name, value in {"Host": address, **headers}.items():
                connection.putheader(name.replace("_", "-"), value)
            connection.endheaders()
            response = connection.getresponse()
            connection.close()
            return response.status, response.headers

        code, headers = status("/")
        self.assertEqual(code, 200)
        self.assertIn("default-src 'none'", headers["Content-Security-Policy"])
        self.assertNotIn("unsafe", headers["Content-Security-Policy"])
        self.assertEqual(status("/", Host="rebound.example")[0] // 100, 4)
        self.assertEqual(status("/etc/passwd")[0], 404)
        upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec_WebSocket_Version": "13", "Sec_WebSocket_Key": "MDEyMzQ1Njc4OWFiY2RlZg=="}
        self.assertEqual(status("/stream", Origin=self.gateway.origin, **upgrade)[0], 101)
        self.assertEqual(status("/stream", Origin="http://evil.example", **upgrade)[0] // 100, 4)
        self.assertEqual(status("/stream", **upgrade)[0] // 100, 4)
        page = self.open_page(self.gateway.origin + "/#" + 32 * "0")
        page.wait_for_data(connection="refused")
        self.assertEqual(page.data.get("session"), None)


class RecordingInAWorld(ViewTest):
    def test_poses_and_camera_are_in_the_world_and_the_overlay_on_the_events(self):
        position, rotation = [0.5, -1.0, 2.0], [0.5, -0.5, 0.5, 0.5]
        mount, poses = f"{self.dir}/mount.yaml", f"{self.dir}/world.jsonl"
        pathlib.Path(mount).write_text(json.dumps({"frame_id": "base", "translation": position, "rotation": rotation}), encoding="utf-8")
        evpose("replay", self.recording, *self.inputs, "--world-from-camera", mount, "--out", poses)
        self.page = self.open_page(self.serve_page(self.recording, *self.inputs, "--poses", poses, "--world-from-camera", mount).url)
        self.page.wait(lambda: int(self.page.data.get("imageNumber", 0)) > 0, "the first image")
        self.choose_window(self.page, "5 ms")
        self.page.wait(lambda: int(self.page.data["imageToUs"]) - int(self.page.data["imageFromUs"]) <= 5001, "an image of 5 ms")
        self.scrub(START_US + 0.5 * DURATION_S * 1e6)
        shown = shown_pose(self.page)
        written = next(pose for pose in read_poses(poses) if pose["pose_seq"] == shown["pose_seq"])
        self.assertEqual(written["transform"], "base_from_object")
        for name in ("translation_m", "quaternion_xyzw"):
            for value, expected in zip(shown[name], written[name]):
                self.assertAlmostEqual(value, expected, 12)
        space = self.page.run("return {...document.getElementById('space').dataset}")
        self.assertEqual(space["frame"], "base")
        for value, expected in zip(map(float, space["camera"].split()), [*position, rotation[3], *rotation[:3]]):
            self.assertAlmostEqual(value, expected, 12)
        self.assert_overlay_lies_on_the_events(self.page)
        self.assert_silent(self.page)


class LossesOfARecording(ViewTest):
    def test_the_time_line_has_the_causes_of_the_file(self):
        # The events contradict this pose, so that the object is lost and found again.
        wrong = f"{START_US + 1000000} 0.05 0.05 0.6 0 0 0 1"
        files = [f"{self.dir}/losses.csv", f"{self.dir}/losses.jsonl"]
        for file in files:
            evpose("replay", self.recording, *self.inputs, "--reset-pose", wrong, "--out", file)
        poses = read_poses(files[1])
        found = [(before, pose) for before, pose in zip(poses, poses[1:]) if pose["lost_at_us"] != before["lost_at_us"]]
        self.assertEqual({pose["loss_cause"] for _, pose in found}, {"CONTRADICTED"})
        # The search after a loss gives poses of events before the loss, too.
        starts = [max(before["t_us"] + 1, pose["lost_at_us"]) if pose["lost_at_us"] < pose["t_us"] else before["t_us"] + 1 for before, pose in found]
        times = sorted(f"{t_us / 1e6:.3f} s" for t_us in starts)
        for file in files:
            page = self.open_page(self.serve_page(self.recording, *self.inputs, "--poses", file).url)
            page.wait(lambda: len(self.losses(page)) >= len(times), "the losses")
            self.assertEqual(sorted(time for time, _ in self.losses(page)), times)
            for _, reason in self.losses(page):
                self.assertIn("contradicted; no pose for ", reason)
            self.assert_silent(page)

    def losses(self, page):
        """The losses in the list of states: the time that is shown, and the reason."""
        return page.run(
            """return [...document.querySelectorAll('.change')]
              .filter((row) => row.querySelector('.state').textContent.includes('lost'))
              .map((row) => [row.querySelector('.numbers').textContent, row.querySelector('.reason').textContent]);"""
        )


class LiveView(ViewTest):
    def setUp(self):
        scratch = tempfile.TemporaryDirectory()
        self.addCleanup(scratch.cleanup)
        self.scratch = pathlib.Path(scratch.name)
        self.server = server.Server("--log-level", "error", "--shutdown-timeout", "1", directory=self.scratch, store="sqlite")
        # Started again, it has the same address.
        self.server.command[self.server.command.index("127.0.0.1:0")] = self.server.address
        self.addCleanup(lambda: self.server.kill())
        self.gateway = self.serve_page("--server", self.server.address)

    def replay(self, rate):
        """Sends the recording in the background, at this multiple of real time."""
        self.out = self.scratch / "out.jsonl"
        process = subprocess.Popen(
            [server.EVPOSE, "replay", self.recording, *self.inputs, "--server", self.server.address, "--rate", str(rate), "--out", self.out],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )
        self.addCleanup(process.wait)
        self.addCleanup(process.kill)
        return process

    def open_session(self, page):
        row = "document.querySelector('#session-list .session:not(.head)')"
        page.wait(lambda: page.run(f"return {row} !== null"), "a session in the list")
        page.run(f"{row}.click()")
        page.wait(lambda: int(page.data["imagesDrawn"]) > 0, "the first image")

    def wait_for_images(self, page, count):
        before = int(page.data["imagesDrawn"])
        page.wait(lambda: int(page.data["imagesDrawn"]) >= before + count, f"{count} more images")

    def assert_same_poses(self, replay):
        self.assertEqual(replay.wait(), 0)
        self.assertEqual(read_poses(self.out), self.poses)

    def test_shows_the_poses_of_the_stream(self):
        page = self.open_page(self.gateway.url)
        replay = self.replay(0.05)
        self.open_session(page)
        self.choose_window(page, "1 ms")  # less than an image has, so that the page shows the events of the newest one only
        # Before, the cube is slower, and a third of the events is noise.
        page.wait(lambda: int(page.data["imageTUs"]) > START_US + 350_000 and (shown_pose(page) or {}).get("state") == "TRACKING", "a pose")
        samples = []
        for _ in range(4):
            self.wait_for_images(page, 4)
            samples.append(shown_pose(page))
            self.assert_overlay_lies_on_the_events(page)
        self.assert_same_poses(replay)
        for shown in samples:
            self.assert_is_sent(shown)
        self.assert_silent(page)

    def test_survives_a_killed_server(self):
        page = self.open_page(self.gateway.url)
        replay = self.replay(0.1)
        self.open_session(page)
        self.wait_for_images(page, 4)
        session = page.data["session"]
        self.server.kill()
        before = int(page.data["imageTUs"])
        self.server.start()
        page.wait(lambda: int(page.data["imageTUs"]) > before, "images of the server that was started again")
        self.wait_for_images(page, 4)
        self.assertEqual(page.data["session"], session)
        self.assert_same_poses(replay)
        self.assert_silent(page)

    def test_a_suspended_page_delays_nobody(self):
        suspended = self.open_page(self.gateway.url)
        page = self.open_page(self.gateway.url)
        replay = self.replay(0.1)
        self.open_session(suspended)
        self.open_session(page)
        suspended.suspend()
        try:
            self.wait_for_images(page, 40)
        finally:
            suspended.resume()
        # The recording may have ended meanwhile, so that no further images follow the last one.
        newest = int(page.data["imageTUs"])
        suspended.wait(lambda: int(suspended.data["imageTUs"]) >= newest, "the images of the other page")
        self.assert_same_poses(replay)
        self.assert_silent(page)
        self.assertEqual(suspended.data["errors"], "0")


class LiveViewWithToken(ViewTest):
    def test_the_token_does_not_reach_the_page(self):
        scratch = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        tracker = server.Server("--log-level", "error", "--token-file", str(server.write_tokens(scratch / "tokens", ["lab"])), directory=scratch)
        self.addCleanup(tracker.kill)
        secret = server.token("lab")
        with_token = {"env": {**os.environ, "EVPOSE_TOKEN": secret}}
        gateway = self.serve_page("--server", tracker.address, **with_token)
        page = self.open_page(gateway.url, records_network=True)
        replay = subprocess.Popen(
            [server.EVPOSE, "replay", self.recording, *self.inputs, "--server", tracker.address, "--rate", "0.5"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **with_token,
        )
        self.addCleanup(replay.wait)
        self.addCleanup(replay.kill)
        row = "document.querySelector('#session-list .session:not(.head)')"
        page.wait(lambda: page.run(f"return {row} !== null"), "the session of the tenant")
        page.run(f"{row}.click()")
        page.wait(lambda: int(page.data["imagesDrawn"]) > 10 and shown_pose(page), "images and poses")
        self.assertEqual(replay.wait(), 0)
        page.wait(lambda: page.run("return document.getElementById('live-badge').textContent").startswith("ended: "), "the end")
        frames = page.received()
        texts = [frame for frame in frames if isinstance(frame, str)]
        for kind in ("hello", "sessions", "scene", "poses", "health", "end"):
            self.assertTrue(any(f'"type":"{kind}"' in text for text in texts), kind)
        self.assertTrue(any(isinstance(frame, bytes) for frame in frames))
        for name in ("/", "/app.js", "/app.css", "/licenses.txt"):
            with urllib.request.urlopen(gateway.origin + name) as response:
                frames += [response.read(), str(response.headers)]
        for frame in frames:
            self.assertNotIn(secret.removeprefix("evpose_"), frame if isinstance(frame, str) else frame.decode("latin-1"))


class ReplayView(ViewTest):
    def test_shows_the_replay_until_its_end(self):
        scratch = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        browser, opened, out = scratch / "xdg-open", scratch / "opened", scratch / "out.jsonl"
        browser.write_text(f'#!/bin/sh\necho "$1" >{opened}.new\nmv {opened}.new {opened}\n', encoding="utf-8")
        browser.chmod(0o755)
        # The address is on standard error.
        gateway = PageServer(
            ["sh", "-c", 'exec "$@" 2>&1', "sh", server.EVPOSE, "replay", self.recording, *self.inputs, "--rate", "0.1", "--view", "--out", out],
            env={**os.environ, "PATH": f"{scratch}:{os.environ['PATH']}"},
        )
        self.addCleanup(gateway.stop)
        page = self.open_page(gateway.url)
        samples = []
        for _ in range(5):
            before = int(page.data.get("imagesDrawn", 0))
            page.wait(lambda: int(page.data["imagesDrawn"]) >= before + 4, "4 more images")
            if shown := shown_pose(page):
                samples.append(shown)
        self.assertEqual(opened.read_text(encoding="utf-8").strip(), gateway.url)
        page.wait(lambda: page.run("return document.getElementById('live-badge').textContent").startswith("ended: "), "the end")
        self.assertEqual(gateway.process.wait(), 0)
        self.assertEqual(read_poses(out), self.poses)
        self.assertGreater(len(samples), 2)
        for shown in samples:
            self.assert_is_sent(shown)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--picture")
    options, rest = parser.parse_known_args()
    PICTURE = options.picture
    require_browser()
    with socket.socket() as closed:  # without listen() it refuses connections
        closed.bind(("127.0.0.1", 0))
        address = "127.0.0.1:%d" % closed.getsockname()[1]
        answer = subprocess.run([server.EVPOSE, "view", "--server", address, "--connect-timeout", "0.001"], capture_output=True, text=True, check=False)
    require("without its page" not in answer.stderr, "evpose was built without its page, because node or npm was missing")
    unittest.main(argv=[sys.argv[0], *rest], verbosity=2)
