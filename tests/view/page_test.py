#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The page of evpose view in a browser, against the fake gateway of client/view/page/dev.
page_test.py FAKE_GATEWAY.mjs DIST [unittest arguments]"""

import json
import shutil
import sys
import unittest
import urllib.parse

from browser import OVERLAY_SCRIPT, STATE_COLOURS, Page, PageServer, require, require_browser

START_US = 16_000_000  # of the fake recording
STEP_US = 2000
LEFT, RIGHT, HOME, END = "\ue012", "\ue014", "\ue011", "\ue010"


class PageTest(unittest.TestCase):
    """Each test class has a gateway with these options and a browser; each test loads the page again."""

    OPTIONS = ()
    BROWSER = ()

    @classmethod
    def setUpClass(cls):
        cls.server = PageServer(["node", GATEWAY, "--dist", DIST, *cls.OPTIONS])
        cls.addClassCleanup(cls.server.stop)
        cls.page = Page("about:blank", arguments=cls.BROWSER)
        cls.addClassCleanup(cls.page.close)
        cls.page.set_theme("dark")

    def load(self, url=None, width=1280, height=720):
        self.page.resize(width, height)
        self.page.driver.get("about:blank")
        self.page.driver.get(url or self.server.url)

    def setUp(self):
        self.load()
        self.addCleanup(self.check_silence)

    def check_silence(self):
        self.assertEqual(self.page.console_errors(), [])
        self.assertEqual(self.page.foreign_requests(), [])
        self.assertEqual(self.page.data["errors"], "0")

    def check_only_the_connection_broke(self):
        # Chromium itself reports the broken WebSocket to the console.
        self.assertEqual([message for message in self.page.console_errors() if "WebSocket" not in message], [])

    def images_drawn(self):
        return int(self.page.data["imagesDrawn"])

    def wait_for_images(self, count=1):
        first = self.images_drawn()
        self.page.wait(lambda: self.images_drawn() >= first + count, f"{count} more images")

    def assert_pose_is_that_of_the_stream(self, t_us=None):
        shown = self.page.pose
        sent = self.server.get(f"/test/pose?object={shown['object'].replace(' ', '%20')}&t_us={shown['tUs']}&seq={shown['seq']}")
        self.assertEqual([float(x) for x in shown["p"].split()], sent["p"])
        self.assertEqual([float(x) for x in shown["q"].split()], sent["q"])
        self.assertEqual(shown["state"], sent["state"])
        if t_us is not None:
            self.assertEqual(int(shown["tUs"]), t_us)

    def overlay(self, image, index=0):
        return self.page.run(OVERLAY_SCRIPT, image["segments"][index], STATE_COLOURS[image["outlines"][index]["state"]], 1280)


class LivePage(PageTest):
    OPTIONS = ("--objects", "2")

    def setUp(self):
        super().setUp()
        self.wait_for_images()

    def test_shows_the_pose_of_the_stream(self):
        self.page.wait(lambda: self.page.pose.get("tUs"), "a pose")
        for _ in range(3):
            before = self.page.pose["tUs"]
            self.assert_pose_is_that_of_the_stream()
            self.page.wait(lambda: self.page.pose["tUs"] not in ("", before), "the next pose")

    def test_acknowledges_every_image(self):
        before, drawn = self.server.get("/test/figures")["acknowledged"], self.images_drawn()
        self.wait_for_images(10)
        drawn = self.images_drawn() - drawn
        self.page.wait(lambda: self.server.get("/test/figures")["acknowledged"] >= before + drawn, f"acknowledgements of {drawn} images")

    def test_connects_again(self):
        before = self.server.get("/test/figures")["connections"]
        self.server.get("/test/drop")
        self.page.wait(lambda: self.server.get("/test/figures")["connections"] > before, "another connection")
        self.page.wait_for_data(connection="connected")
        self.wait_for_images(3)
        self.assertEqual(self.page.data["session"], "sessions/bench-1")
        self.check_only_the_connection_broke()

    def test_another_session_is_opened_again(self):
        self.page.press("l")
        rows = "[...document.querySelectorAll('#session-list .session:not(.head)')]"
        self.page.wait(lambda: self.page.run(f"return {rows}.length") == 3, "three sessions")
        self.page.run(f"{rows}[2].click()")
        self.page.wait_for_data(session="sessions/<b>cell 7</b>")
        before, images = self.server.get("/test/figures")["connections"], self.images_drawn()
        self.server.get("/test/drop")
        self.page.wait(lambda: self.server.get("/test/figures")["connections"] > before, "another connection")
        self.page.wait_for_data(connection="connected")
        # The gateway shows the session of its address first.
        self.page.wait(lambda: self.images_drawn() > images, "an image of the new connection")
        self.page.wait_for_data(session="sessions/<b>cell 7</b>")
        self.check_only_the_connection_broke()

    def test_refused_key_is_explained(self):
        for url, connection, text in (
            (self.server.origin + "/#wrong", "refused", "This page was refused"),
            (self.server.origin + "/#%", "refused", "This page was refused"),
            (self.server.origin + "/", "no-key", "The address has no key"),
        ):
            self.load(url)
            self.page.wait_for_data(connection=connection)
            self.assertIn(text, self.page.run("return document.getElementById('connection').textContent"))

    def send(self, message):
        self.server.get("/test/text?message=" + urllib.parse.quote(json.dumps(message)))

    def text(self, element):
        return self.page.run("return document.getElementById(arguments[0]).textContent", element)

    def test_shows_notices_and_the_end(self):
        self.send({"type": "notice", "level": "error", "text": "the server <i>does not</i> answer"})
        self.page.wait(lambda: "the server <i>does not</i> answer" in self.text("notices"), "the notice")
        self.send({"type": "end", "reason": "the client closed the session"})
        self.page.wait(lambda: self.text("live-badge") == "ended: the client closed the session", "the end")

    def test_a_damaged_message_is_reported_and_the_next_ones_are_shown(self):
        self.server.get("/test/damage")
        self.page.wait_for_data(errors="1")
        self.page.wait(lambda: "a binary message of the gateway is damaged" in self.text("notices"), "the notice")
        self.wait_for_images(3)
        self.load()
        self.wait_for_images()

    def test_keys(self):
        self.page.press("?")
        self.assertTrue(self.page.run("return document.getElementById('help').open"))
        self.page.press("d")
        self.assertEqual(self.page.data["theme"], "dark", "the help takes no other key")
        self.page.press("?")
        self.assertFalse(self.page.run("return document.getElementById('help').open"))
        self.page.press("d")
        self.assertEqual(self.page.data["theme"], "light")
        self.page.press("d")
        self.assertEqual(self.page.data["theme"], "dark")
        self.page.press("2")
        self.page.wait(lambda: self.page.pose["object"] == "hex nut", "the second object")
        window = "return document.getElementById('window-select').value"
        self.assertEqual(self.page.run(window), "33 ms")
        self.page.press("]", "]", "[")
        self.assertEqual(self.page.run(window), "50 ms")
        has_overlay = """const c = document.getElementById('overlay');
            return c.getContext('2d').getImageData(0, 0, c.width, c.height).data.some((x) => x !== 0)"""
        self.page.wait(lambda: self.page.run(has_overlay), "the edges")
        self.page.press("o")
        self.wait_for_images(2)
        self.assertEqual(self.page.run(has_overlay), False)

    def test_freezes_while_images_go_on(self):
        self.page.press(" ")
        self.page.wait(lambda: "frozen" in self.page.run("return document.getElementById('live-badge').textContent"), "the badge")
        frozen = self.page.data["imageNumber"]
        before = self.server.get("/test/figures")["acknowledged"]
        self.page.wait(lambda: self.server.get("/test/figures")["acknowledged"] > before + 5, "acknowledgements")
        self.assertEqual(self.page.data["imageNumber"], frozen)
        self.page.press(" ")
        self.page.wait(lambda: self.page.data["imageNumber"] != frozen, "the next image")

    def test_fits_into_narrow_and_wide_screens(self):
        for width, height in ((360, 740), (390, 844), (768, 1024), (1280, 720), (1920, 1080)):
            self.load(width=width, height=height)
            self.wait_for_images()
            self.assertEqual(self.page.run("return document.documentElement.scrollWidth"), width)
            beyond = self.page.run("""return [...document.querySelectorAll('.panel, header > *, .panel-head > *, .plot, canvas')]
                .filter((node) => node.offsetParent !== null && node.id !== 'cells' && node.getBoundingClientRect().right > innerWidth + 1)
                .map((node) => node.id || node.className)""")
            self.assertEqual(beyond, [], f"{width} x {height}")
            if width >= 1280:
                self.assertEqual(self.page.run("return document.documentElement.scrollHeight"), height)


class SessionsPage(PageTest):
    OPTIONS = ("--list",)

    def test_names_are_text_and_a_click_opens(self):
        rows = "[...document.querySelectorAll('#session-list .session:not(.head)')]"
        self.page.wait(lambda: self.page.run(f"return {rows}.length") == 3, "three sessions")
        self.assertEqual(self.page.run(f"return {rows}[2].querySelector('.name').textContent"), "sessions/<b>cell 7</b>")
        self.page.run(f"{rows}[2].click()")
        self.page.wait_for_data(session="sessions/<b>cell 7</b>")
        self.wait_for_images()
        self.assertEqual(self.page.run("return document.querySelector('#session-list b, #title b')"), None)
        self.page.press("l")
        self.page.wait(lambda: self.page.run("return !document.getElementById('chooser').hidden"), "the list")

    def test_fits_into_a_phone(self):
        self.load(width=360, height=740)
        self.page.wait(lambda: self.page.run("return document.querySelectorAll('#session-list .session').length") == 4, "the sessions")
        self.assertEqual(self.page.run("return document.documentElement.scrollWidth"), 360)


class EndedSessionPage(PageTest):
    OPTIONS = ("--gone",)

    def test_shows_the_reason_and_the_list(self):
        self.page.wait(lambda: "there is no such session" in self.page.run("return document.getElementById('notices').textContent"), "the notice")
        self.page.wait(lambda: self.page.run("return !document.getElementById('chooser').hidden"), "the list")
        self.page.wait(lambda: self.page.run("return document.querySelectorAll('#session-list .session').length") == 4, "the sessions")


class RecordingPage(PageTest):
    OPTIONS = ("--mode", "recording", "--truth")

    def setUp(self):
        super().setUp()
        self.wait_for_instant(START_US)

    def wait_for_instant(self, t_us):
        self.page.wait(lambda: self.page.data.get("instantUs") == str(t_us) and self.page.data.get("imageTUs") == str(t_us), f"the instant {t_us}")

    def scrub(self, t_us):
        self.page.run(
            """const scrubber = document.getElementById('scrubber');
            scrubber.value = arguments[0];
            for (const type of ['input', 'change']) scrubber.dispatchEvent(new Event(type));""",
            (t_us - START_US) // 100,
        )
        self.wait_for_instant(t_us)

    def test_scrubbing_shows_the_pose_of_the_instant(self):
        for t_us in (START_US + 1_000_000, START_US + 9_000_100, START_US + 3_300_000):
            self.scrub(t_us)
            self.assert_pose_is_that_of_the_stream(t_us - t_us % STEP_US)

    def test_overlay_lies_on_the_segments(self):
        self.page.press("t")  # the truth would be drawn over the estimate
        for t_us, state in ((START_US + 1_000_000, "tracking"), (START_US + 4_800_000, "ambiguous"), (START_US + 9_500_000, "tracking")):
            self.scrub(t_us)
            image = self.server.get("/test/image")
            self.assertEqual(image["number"], int(self.page.data["imageNumber"]))
            index = next(i for i, outline in enumerate(image["outlines"]) if not outline["truth"])
            self.assertEqual(image["outlines"][index]["state"], state)
            found = self.overlay(image, index)
            self.assertGreater(found["points"], 500)
            # A dotted line has the colour in 2 of 5 px, and round ends.
            self.assertGreater(found["hits"], (0.97 if state == "tracking" else 0.4) * found["points"])
            self.assertEqual(found["stray"], 0)
            self.assertGreater(found["pixels"], 0.5 * found["points"])

    def test_a_lost_object_has_no_overlay_and_a_reason(self):
        self.page.press("t")
        self.scrub(START_US + 2_300_000)
        image = self.server.get("/test/image")
        self.assertEqual([outline for outline in image["outlines"] if not outline["truth"]], [])
        self.assertEqual(self.overlay({"segments": [[]], "outlines": [{"state": "tracking"}]})["pixels"], 0)
        self.page.wait(lambda: "lost" in self.page.run("return document.getElementById('objects').textContent"), "the state")
        self.assertIn("the events contradict the pose", self.page.run("return document.getElementById('changes').textContent"))

    def load_on_a_phone(self):
        self.load(width=360, height=740)
        self.page.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True, "maxTouchPoints": 2})
        self.addCleanup(self.page.driver.execute_cdp_cmd, "Emulation.setTouchEmulationEnabled", {"enabled": False})
        self.wait_for_instant(START_US)

    def test_the_reason_of_a_loss_can_be_read_on_a_phone(self):
        self.load_on_a_phone()
        visible = """const node = [...document.querySelectorAll('.change .reason')].find(({textContent}) => textContent.includes(arguments[0]));
            node.scrollIntoView();
            const box = node.getBoundingClientRect();
            return box.height > 0 && box.left >= 0 && box.right <= innerWidth && node.scrollWidth <= node.clientWidth
                && document.elementFromPoint(box.left + 4, box.top + 4) === node"""
        self.assertTrue(self.page.run(visible, "the events contradict the pose"))
        self.page.run("document.getElementById('timeline').scrollIntoView({block: 'center'})")
        width = self.page.run("return document.getElementById('timeline').clientWidth")
        lost = 24 + (width - 24) * 2.3 / 10  # the bar begins beside the number of the object
        self.page.touch([self.page.point("#timeline", lost / width)])
        tip = "const tip = document.getElementById('timeline-tip'); return tip.hidden ? '' : tip.textContent"
        self.assertIn("the events contradict the pose", self.page.run(tip))
        self.page.touch([self.page.point("#timeline-info", 0.5)])
        self.assertEqual(self.page.run(tip), "")

    def test_fingers_enlarge_and_move_the_picture(self):
        self.load_on_a_phone()
        # Translation and scale of the cells, relative to the whole picture.
        place = "const {a, e, f} = new DOMMatrix(getComputedStyle(document.getElementById('cells')).transform); return [a, e, f]"
        whole = self.page.run(place)
        x, y = self.page.point("#stage", 0.5)
        y += 60
        self.page.touch([(x - 20, y)], [(x - 20, y), (x + 20, y)], [(x - 60, y), (x + 20, y)], [(x - 60, y), (x + 60, y)])
        self.page.wait(lambda: abs(self.page.run(place)[0] / whole[0] - 3) < 0.01, "three times the size")
        _, left, top = self.page.run(place)
        self.page.touch([(x, y)], [(x + 30, y + 10)], [(x + 40, y + 20)])
        self.page.wait(lambda: self.page.run(place)[1:] == [left + 40, top + 20], "another place")
        self.page.double_click("#stage", 0.5)
        self.page.wait(lambda: self.page.run(place) == whole, "the whole picture")

    def test_steps(self):
        self.page.press(RIGHT)
        self.wait_for_instant(START_US + STEP_US)
        self.page.press(RIGHT)
        self.wait_for_instant(START_US + 2 * STEP_US)
        self.page.press(LEFT)
        self.wait_for_instant(START_US + STEP_US)
        self.assert_pose_is_that_of_the_stream(START_US + STEP_US)
        self.page.press(END)
        self.wait_for_instant(START_US + 10_000_000)
        self.page.press(HOME)
        self.wait_for_instant(START_US)

    def test_plots_the_event_rate_of_the_instant(self):
        self.scrub(START_US + 5_000_000)
        rate = """const plot = [...document.querySelectorAll('.plot')].find((node) => node.querySelector('b').textContent === 'Event rate');
            return plot?.querySelector('.key').textContent ?? ''"""
        self.page.wait(lambda: self.page.run(rate) == "2.00", "2 Mev/s in the middle of the recording")

    PLOTTED = "return [...document.querySelectorAll('.plot .key')].map((node) => node.textContent)"

    def plotted(self):
        """The values beside the titles of the plots."""
        return self.page.run(self.PLOTTED)

    def change_theme(self):
        self.addCleanup(self.page.run, "localStorage.clear()")  # The next test begins in the dark theme.
        other = "light" if self.page.data["theme"] == "dark" else "dark"
        self.page.press("d")
        self.page.wait_for_data(theme=other)

    def has_all_values(self):
        values = self.plotted()
        return len(values) > 9 and not any("–" in value or value == "" for value in values)

    def test_plots_remain_in_another_theme(self):
        self.scrub(START_US + 1_000_000)
        self.page.wait(self.has_all_values, "values in all plots")
        before = self.plotted()
        self.change_theme()
        self.page.wait(lambda: self.plotted() == before, f"the values {before}")

    def show_instant_of_plot(self, plot, share, seconds):
        """Clicks into a plot and waits for the instant that this place then has, seconds after the beginning."""
        self.page.click(f".plot:nth-of-type({plot}) .u-over", share)
        low, high = START_US + (seconds - 0.15) * 1e6, START_US + (seconds + 0.15) * 1e6
        self.page.wait(lambda: low < int(self.page.data["imageTUs"]) < high, f"the instant {seconds} s")

    def test_plots_show_the_chosen_part_until_a_double_click(self):
        self.scrub(START_US + 1_000_000)
        self.page.wait(self.has_all_values, "values in all plots")
        self.show_instant_of_plot(1, 0.7, 7)
        self.page.drag(".plot .u-over", 0.2, 0.6)
        for share, seconds in ((0.25, 3), (0.5, 4), (0.75, 5)):
            for plot, step in ((1, 0), (3, 0.1)):
                self.show_instant_of_plot(plot, share + step, seconds + 4 * step)
            self.change_theme()
        self.page.double_click(".plot .u-over", 0.5)
        self.show_instant_of_plot(1, 0.25, 2.5)
        self.change_theme()
        for plot, share in ((1, 0.75), (3, 0.9)):
            self.show_instant_of_plot(plot, share, 10 * share)

    def test_a_selection_keeps_the_keys_that_it_uses(self):
        is_kept = """const event = new KeyboardEvent('keydown', {key: arguments[0], bubbles: true, cancelable: true});
            return document.getElementById('window-select').dispatchEvent(event)"""
        for key in (" ", "Home", "ArrowLeft"):
            self.assertTrue(self.page.run(is_kept, key), key)
        self.assertFalse(self.page.run(is_kept, "]"))
        self.assertEqual(self.page.data["playing"], "false")

    def test_plays_and_pauses(self):
        self.page.press("-", "-", "-", " ")
        self.page.wait_for_data(playing="true")
        self.page.wait(lambda: int(self.page.data["instantUs"]) > START_US, "a later instant")
        self.page.press(" ")
        self.page.wait_for_data(playing="false")
        self.assert_pose_is_that_of_the_stream()

    def test_plays_from_the_beginning_after_the_end(self):
        self.page.press(END)
        self.wait_for_instant(START_US + 10_000_000)
        self.page.press("-", "-", "-", "-", "-", "-", " ")
        self.page.wait_for_data(playing="true")
        self.page.wait(lambda: int(self.page.data["instantUs"]) < START_US + 5_000_000, "an instant in the first half")
        self.page.press(" ")
        self.page.wait_for_data(playing="false")

    def test_a_click_into_a_plot_or_the_time_line_shows_that_instant(self):
        for selector, share in ((".plot-box .u-over", 0.25), ("#timeline", 0.8)):
            self.page.click(selector, share)
            low, high = START_US + (share - 0.05) * 1e7, START_US + (share + 0.05) * 1e7
            self.page.wait(lambda: low < int(self.page.data["imageTUs"]) < high, f"an instant at {share} of the recording")

    def test_keeps_the_instant_after_a_lost_connection(self):
        self.scrub(START_US + 4_000_000)
        before, images = self.server.get("/test/figures")["connections"], self.images_drawn()
        self.server.get("/test/drop")
        self.page.wait(lambda: self.server.get("/test/figures")["connections"] > before, "another connection")
        self.page.wait_for_data(connection="connected")
        # The gateway shows the beginning of the recording first.
        self.page.wait(lambda: self.images_drawn() > images, "an image of the new connection")
        self.wait_for_instant(START_US + 4_000_000)
        self.check_only_the_connection_broke()


class PageInAnotherFrame(PageTest):
    def setUp(self):
        super().setUp()
        self.wait_for_images()

    def space(self):
        """The frame of the 3D view, and the poses of the camera and of the selected object in it: x y z, qw qx qy qz."""
        data = self.page.run("return {...document.getElementById('space').dataset}")
        return data["frame"], [[float(x) for x in data[name].split()] for name in ("camera", "object")]

    def stream(self):
        numbers = [float(x) for x in f"{self.page.pose['p']} {self.page.pose['q']}".split()]
        return numbers[:3] + [-x if numbers[3] < 0 else x for x in numbers[3:]]

    def wait_for_poses(self, camera=None, thing=None):
        """Waits until the 3D view has the poses of the camera and of the object; None: the pose of the stream."""
        def is_close(pose, expected):
            return len(pose) == 7 and all(abs(a - b) < 1e-9 for a, b in zip(pose, expected))

        self.page.wait(
            lambda: self.page.pose.get("tUs") and all(map(is_close, self.space()[1], (camera or self.stream(), thing or self.stream()))),
            "the camera and the object at their places",
        )

    def text(self, element):
        return self.page.run("return document.getElementById(arguments[0]).textContent", element)


class PageInTheFrameOfAWorld(PageInAnotherFrame):
    OPTIONS = ("--mode", "recording", "--objects", "2", "--frame", "base")

    def test_shows_camera_and_objects_in_the_world(self):
        for key in ("2", "1", "d"):
            self.page.press(key)
            self.wait_for_poses(camera=[0.2, -0.3, 1.1, 0.5, 0.5, -0.5, 0.5])
        self.assertEqual(self.space()[0], "base")
        self.assertEqual(self.text("pose-transform"), "base_from_object")
        self.page.press("p")
        self.page.wait(lambda: self.text("relative-button") == "base frame", "the plots of absolute positions")


class PageInTheFrameOfAnObject(PageInAnotherFrame):
    OPTIONS = ("--mode", "recording", "--objects", "2", "--frame", "object")

    def test_shows_the_camera_in_the_frame_of_the_selected_object(self):
        for key in ("2", "1"):
            self.page.press(key)
            self.wait_for_poses(thing=[0, 0, 0, 1, 0, 0, 0])
        self.assertEqual(self.space()[0], "object")
        self.assertEqual(self.text("pose-transform"), "object_from_camera")


class PageWithoutWebGl(PageTest):
    BROWSER = ("--disable-3d-apis",)

    def test_says_so_and_shows_the_rest(self):
        self.wait_for_images(3)
        self.assertEqual(self.page.data["webgl"], "no")
        self.assertIn("does not start WebGL 2", self.page.run("return document.getElementById('space-message').innerText"))
        self.page.wait(lambda: self.page.pose.get("tUs"), "a pose")
        self.assert_pose_is_that_of_the_stream()


if __name__ == "__main__":
    GATEWAY, DIST = sys.argv[1:3]
    require(shutil.which("node"), "node is missing: deploy/install-dependencies.sh --test installs it")
    require_browser()
    unittest.main(argv=[sys.argv[0], *sys.argv[3:]], verbosity=2)
