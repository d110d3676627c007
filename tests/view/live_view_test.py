#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`evpose view` and `evpose replay --view` in a browser, with sessions whose events come through a pipe.

  live_view_test.py --bin DIRECTORY_OF_THE_BUILD [unittest arguments]

A test writes the events in blocks, each after the page has shown the one before, so that no test depends on the pace of the machine.
"""

import os
import pathlib
import subprocess
import sys
import tempfile
import urllib.request

from browser import PageServer
from view_case import START_US, ViewTest, main, read_poses, server, shown_pose

from checks import poll
from event_blocks import BLOCK_US, BlockPipe

ROW = "document.querySelector('#session-list .session:not(.head)')"
SHOWN = "imageToUs"  # the time of the events that the page has drawn
TRACKED = "instantUs"  # the time of the latest pose or health of the session


class LiveTest(ViewTest):
    def setUp(self):
        self.scratch = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        self.out = self.scratch / "out.jsonl"

    def begin(self, start):
        """Calls start(stdin), which starts a program that reads the recording from there, and sends the first block."""
        self.camera = self.enterContext(BlockPipe(self.recording, start))
        self.camera.send()

    def stream(self, address, **options):
        """Sends the recording to a server, in the background."""
        command = [server.EVPOSE, "stream", "-", *self.inputs, "--server", address, "--spool", self.scratch / "spool", "--out", self.out]
        self.begin(lambda stdin: subprocess.Popen(command, stdin=stdin, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **options))
        self.addCleanup(self.camera.reader.wait)
        self.addCleanup(self.camera.reader.kill)

    def wait(self, page, condition, what, clock=SHOWN):
        """Waits for a condition of the page. Meanwhile the camera sends a block whenever the page is up to the last one: the clock has
        reached its second half, because its last millisecond is sent together with the next block."""

        def holds():
            if value := condition():
                return value
            if int(page.data.get(clock, 0)) > self.camera.sent_us - BLOCK_US // 2:
                self.assertIsNotNone(self.camera.next_end_us, f"the recording has ended before: {what}")
                self.camera.send()
            return None

        return page.wait(holds, what)

    def wait_for_images(self, page, count):
        before = int(page.data["imagesDrawn"])
        self.wait(page, lambda: int(page.data["imagesDrawn"]) >= before + count, f"{count} more images")

    def wait_for_first_image(self, page):
        # There are no images of the events before the page watches them.
        self.wait(page, lambda: int(page.data.get("imagesDrawn", 0)) > 0, "the first image", TRACKED)

    def open_session(self, page):
        page.wait(lambda: page.run(f"return {ROW} !== null"), "a session in the list")
        page.run(f"{ROW}.click()")
        self.wait_for_first_image(page)

    def wait_for_badge(self, page, text):
        page.wait(lambda: page.run("return document.getElementById('live-badge').textContent").startswith(text), text)


class LiveView(LiveTest):
    def setUp(self):
        super().setUp()
        self.server = server.Server("--log-level", "error", "--shutdown-timeout", "1", directory=self.scratch, store="sqlite")
        # Started again, it has the same address.
        self.server.command[self.server.command.index("127.0.0.1:0")] = self.server.address
        self.addCleanup(lambda: self.server.kill())
        self.gateway = self.serve_page("--server", self.server.address)

    def assert_same_poses(self):
        self.camera.send_rest()
        self.assertEqual(self.camera.reader.wait(), 0)
        self.assertEqual(read_poses(self.out), self.poses)

    def test_shows_the_poses_of_the_stream(self):
        page = self.open_page(self.gateway.url)
        self.stream(self.server.address)
        self.open_session(page)
        self.choose_window(page, "1 ms")  # less than an image has, so that the page shows the events of the newest one only
        # Before, the cube is slower, and a third of the events is noise.
        self.camera.send_until(START_US + 350_000)
        self.wait(page, lambda: int(page.data["imageTUs"]) > START_US + 350_000 and (shown_pose(page) or {}).get("state") == "TRACKING", "a pose")
        samples = []
        for _ in range(4):
            self.wait_for_images(page, 4)
            samples.append(shown_pose(page))
            self.assert_overlay_lies_on_the_events(page)
        self.assert_same_poses()
        for shown in samples:
            self.assert_is_sent(shown)
        self.assert_silent(page)

    def test_survives_a_killed_server(self):
        page = self.open_page(self.gateway.url)
        self.stream(self.server.address)
        self.open_session(page)
        self.wait_for_images(page, 4)
        session = page.data["session"]
        self.server.kill()
        before = int(page.data["imageTUs"])
        self.server.start()
        self.wait(page, lambda: int(page.data["imageTUs"]) > before, "images of the server that was started again", TRACKED)
        self.wait_for_images(page, 4)
        self.assertEqual(page.data["session"], session)
        self.assert_same_poses()
        self.assert_silent(page)

    def test_a_suspended_page_delays_nobody(self):
        suspended = self.open_page(self.gateway.url)
        page = self.open_page(self.gateway.url)
        self.stream(self.server.address)
        self.open_session(suspended)
        self.open_session(page)
        suspended.suspend()
        try:
            self.wait_for_images(page, 40)
        finally:
            suspended.resume()
        newest = int(page.data["imageTUs"])
        suspended.wait(lambda: int(suspended.data["imageTUs"]) >= newest, "the images of the other page")
        self.assert_same_poses()
        self.assert_silent(page)
        self.assertEqual(suspended.data["errors"], "0")


class LiveViewWithToken(LiveTest):
    def test_the_token_does_not_reach_the_page(self):
        tokens = server.write_tokens(self.scratch / "tokens", ["lab"])
        tracker = server.Server("--log-level", "error", "--token-file", str(tokens), directory=self.scratch)
        self.addCleanup(tracker.kill)
        secret = server.token("lab")
        with_token = {"env": {**os.environ, "EVPOSE_TOKEN": secret}}
        gateway = self.serve_page("--server", tracker.address, **with_token)
        page = self.open_page(gateway.url, records_network=True)
        self.stream(tracker.address, **with_token)
        self.open_session(page)
        self.wait(page, lambda: int(page.data["imagesDrawn"]) > 10 and shown_pose(page), "images and poses")
        self.camera.send_rest()
        self.assertEqual(self.camera.reader.wait(), 0)
        self.wait_for_badge(page, "ended: ")
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


class ReplayView(LiveTest):
    def test_shows_the_replay_until_its_end(self):
        browser, opened = self.scratch / "xdg-open", self.scratch / "opened"
        browser.write_text(f'#!/bin/sh\necho "$1" >{opened}.new\nmv {opened}.new {opened}\n', encoding="utf-8")
        browser.chmod(0o755)
        # The address is on standard error.
        command = ["sh", "-c", 'exec "$@" 2>&1', "sh", server.EVPOSE, "replay", "-", *self.inputs, "--view", "--out", self.out]
        environment = {**os.environ, "PATH": f"{self.scratch}:{os.environ['PATH']}"}
        self.begin(lambda stdin: PageServer(command, stdin=stdin, env=environment))
        gateway = self.camera.reader
        self.addCleanup(gateway.stop)
        page = self.open_page(gateway.url)
        self.wait_for_first_image(page)
        samples = []
        for _ in range(5):
            self.wait_for_images(page, 4)
            if shown := shown_pose(page):
                samples.append(shown)
        poll(opened.exists, "the address in the browser")
        self.assertEqual(opened.read_text(encoding="utf-8").strip(), gateway.url)
        self.camera.send_rest()
        self.wait_for_badge(page, "ended: ")
        self.assertEqual(gateway.process.wait(), 0)
        self.assertEqual(read_poses(self.out), self.poses)
        self.assertGreater(len(samples), 2)
        for shown in samples:
            self.assert_is_sent(shown)


if __name__ == "__main__":
    main(sys.argv[1:])
