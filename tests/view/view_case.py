# SPDX-License-Identifier: Apache-2.0
"""What the tests of `evpose view` in a browser share: a simulated recording with its poses, and what a page shows of it."""

import json
import pathlib
import socket
import subprocess
import sys
import tempfile
import unittest

from browser import STATE_COLOURS, Page, PageServer, require, require_browser

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "adversary"))
import server  # reads --bin

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

    def wait(self, page, condition, what):
        return page.wait(condition, what)

    def assert_is_sent(self, shown):
        sent = next(pose for pose in self.poses if pose["pose_seq"] == shown["pose_seq"])
        self.assertEqual(shown, {name: sent[name] for name in shown})

    def choose_window(self, page, window):
        page.run("const select = document.getElementById('window-select'); select.value = arguments[0]; select.dispatchEvent(new Event('change'))", window)

    def assert_overlay_lies_on_the_events(self, page):
        """Compares an image of 1 to 5 ms of a tracked object, at 1 px of the screen for each of the sensor."""
        script = f"""const {{imageTUs, imageFromUs, imageToUs}} = document.documentElement.dataset;
            return imageToUs - imageFromUs > 5001 || imageToUs - imageFromUs < 1000 ? null : [imageTUs, ...(function () {{ {EVENTS_SCRIPT} }})(...arguments)];"""
        at, near, shifted = self.wait(page, lambda: page.run(script, STATE_COLOURS["tracking"], 3, 40), "an image of 1 to 5 ms")
        print(f"at {at} us: {100 * near:.0f} % of the cells with events are within 3 px of the overlay, {100 * shifted:.0f} % of it moved by 40 px")
        self.assertGreater(near, 0.6)
        self.assertLess(shifted, 0.5 * near)

    def assert_silent(self, page):
        self.assertEqual(page.console_errors(), [])
        self.assertEqual(page.foreign_requests(), [])
        self.assertEqual(page.data["errors"], "0")


def main(arguments):
    """Runs the tests of the program with these arguments, or ends it as skipped without a browser or without the page."""
    require_browser()
    with socket.socket() as closed:  # without listen() it refuses connections
        closed.bind(("127.0.0.1", 0))
        address = "127.0.0.1:%d" % closed.getsockname()[1]
        answer = subprocess.run([server.EVPOSE, "view", "--server", address, "--connect-timeout", "0.001"], capture_output=True, text=True,
                                check=False)
    require("without its page" not in answer.stderr, "evpose was built without its page, because node or npm was missing")
    unittest.main(argv=[sys.argv[0], *arguments], verbosity=2)
