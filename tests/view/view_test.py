#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`evpose view` in a browser: a simulated recording with its poses. live_view_test.py has the live sessions.

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

from browser import STATE_COLOURS
from view_case import DURATION_S, EVENTS_SCRIPT, START_US, ViewTest, evpose, main, read_poses, server, shown_pose

ROOT = pathlib.Path(__file__).resolve().parents[2]
HOME = "\ue011"


def has_ipv6():
    try:
        with socket.socket(socket.AF_INET6) as probe:
            probe.bind(("::1", 0))
        return True
    except OSError:
        return False


class RecordingTest(ViewTest):
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


class RecordingView(RecordingTest):
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
        self.page.press(HOME)
        self.page.wait(lambda: int(self.page.data["imageTUs"]) < START_US + 20000, "the beginning")
        # At 0.001 times the speed, the recording does not end before some images have been drawn. Then at 10 times the speed.
        self.page.press(*9 * "-", " ")
        self.page.wait_for_data(playing="true")
        begin = self.page.data
        self.page.wait(lambda: int(self.page.data["imagesDrawn"]) > int(begin["imagesDrawn"]) + 2, "images of the play")
        self.assertGreater(int(self.page.data["imageTUs"]), int(begin["imageTUs"]))
        self.assertEqual(self.page.data["playing"], "true")
        self.page.press(*12 * "=")
        self.page.wait(lambda: int(self.page.data["imageTUs"]) > START_US + DURATION_S * 1e6 - 50000, "the end")
        self.page.wait_for_data(playing="false")
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
            connection.putrequest("GET", path, skip_host=True, skip_accept_encoding=True)
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
        self.assertEqual(status("/app.js", Accept_Encoding="gzip")[1]["Content-Encoding"], "gzip")
        self.assertEqual(status("/app.js")[1]["Content-Encoding"], None)
        self.assertEqual(status("/", Host="rebound.example")[0] // 100, 4)
        self.assertEqual(status("/etc/passwd")[0], 404)
        upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec_WebSocket_Version": "13", "Sec_WebSocket_Key": "MDEyMzQ1Njc4OWFiY2RlZg=="}
        self.assertEqual(status("/stream", Origin=self.gateway.origin, **upgrade)[0], 101)
        self.assertEqual(status("/stream", Origin="http://evil.example", **upgrade)[0] // 100, 4)
        self.assertEqual(status("/stream", **upgrade)[0] // 100, 4)
        page = self.open_page(self.gateway.origin + "/#" + 32 * "0")
        page.wait_for_data(connection="refused")
        self.assertEqual(page.data.get("session"), None)

    def test_the_printed_address_of_any_listener_can_be_opened(self):
        for address, host in (("127.0.0.2:0", "127.0.0.2"), ("[::1]:0", "[::1]"), ("0.0.0.0:0", "127.0.0.1")):
            if "[" in address and not has_ipv6():
                continue
            gateway = self.serve_page(self.recording, *self.inputs, "--poses", self.poses_file, "--listen", address)
            self.assertTrue(gateway.url.startswith(f"http://{host}:"), gateway.url)
            self.page.driver.get(gateway.url)
            self.page.wait(lambda: int(self.page.data.get("imageNumber", 0)) > 0, f"the first image of {gateway.origin}")
            self.assert_silent(self.page)


class RecordingInAWorld(RecordingTest):
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


class PendingRecording(ViewTest):
    def test_the_page_states_what_is_read_and_then_shows_it(self):
        pipe = f"{self.dir}/camera.raw"
        os.mkfifo(pipe)
        page = self.open_page(self.serve_page(pipe, *self.inputs, "--poses", self.poses_file).url, records_network=True)
        notice = f"reading {self.poses_file}, the models and {pipe}"
        page.wait(lambda: any(isinstance(frame, str) and notice in frame for frame in page.received()), notice)
        pathlib.Path(pipe).write_bytes(pathlib.Path(self.recording).read_bytes())
        page.wait(lambda: int(page.data.get("imageNumber", 0)) > 0, "the first image")
        self.assert_silent(page)


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


if __name__ == "__main__":
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--picture")
    options, rest = parser.parse_known_args()
    PICTURE = options.picture
    main(rest)
