# SPDX-License-Identifier: Apache-2.0
"""A headless Chromium for the tests of the page, and the processes that serve it."""

import base64
import json
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import urllib.request

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))
from checks import PATIENCE_S  # noqa: E402

CHROMIUM = shutil.which("chromium")
CHROMEDRIVER = shutil.which("chromedriver")
SKIPPED = 77  # SKIP_RETURN_CODE of these tests in CTest


def require(condition, what):
    """Ends the test program as skipped, with the reason, unless the condition holds."""
    if not condition:
        print(f"skipped: {what}", file=sys.stderr)
        sys.exit(SKIPPED)


def require_browser():
    require(CHROMIUM and CHROMEDRIVER, "chromium or chromedriver is missing: deploy/install-dependencies.sh --test installs them")
    try:
        import selenium  # noqa: F401
    except ImportError:
        require(False, "python3-selenium is missing: deploy/install-dependencies.sh --test installs it")


class PageServer:
    """A process that prints the address of its page in its first lines."""

    def __init__(self, command, **options):
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **options)
        self.lines = []
        for line in self.process.stdout:
            self.lines.append(line)
            words = [word for word in line.split() if word.startswith("http://")]
            if words:
                self.url = words[0]
                break
        else:
            raise AssertionError(f"{command[0]} ended without an address: {''.join(self.lines)}")
        self.origin = self.url.split("/#")[0]

    def get(self, path):
        with urllib.request.urlopen(self.origin + path) as response:
            return json.load(response)

    def stop(self):
        self.process.terminate()
        self.process.wait()
        self.process.stdout.close()


class Page:
    """A browser with one page."""

    def __init__(self, url, width=1280, height=720, arguments=(), records_network=False):
        from selenium import webdriver
        from selenium.webdriver.chrome.service import Service

        options = webdriver.ChromeOptions()
        options.binary_location = CHROMIUM
        for argument in ("--headless=new", "--no-sandbox", "--enable-unsafe-swiftshader", "--hide-scrollbars", *arguments):
            options.add_argument(argument)
        logs = {"browser": "ALL", **({"performance": "ALL"} if records_network else {})}
        options.set_capability("goog:loggingPrefs", logs)
        self.driver = webdriver.Chrome(service=Service(CHROMEDRIVER), options=options)
        self.resize(width, height)
        self.driver.get(url)

    def resize(self, width, height, scale=1):
        """Sets the size in CSS pixels, of which each has `scale` pixels of a screenshot in both directions."""
        self.driver.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride", {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": width < 500}
        )

    def set_theme(self, name):
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": name}]})

    def run(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    @property
    def data(self):
        """The state that the page exposes (client/view/page/README.md)."""
        return self.run("return {...document.documentElement.dataset}")

    @property
    def pose(self):
        return self.run("return {...document.getElementById('pose').dataset}")

    def wait(self, condition, what):
        from selenium.common.exceptions import TimeoutException
        from selenium.webdriver.support.ui import WebDriverWait

        try:
            return WebDriverWait(self.driver, PATIENCE_S, poll_frequency=0.05).until(lambda _: condition())
        except TimeoutException:
            raise AssertionError(f"in vain waited for: {what}; the page has {self.data}") from None

    def wait_for_data(self, **values):
        self.wait(lambda: values.items() <= self.data.items(), values)

    def press(self, *keys):
        from selenium.webdriver.common.action_chains import ActionChains

        chain = ActionChains(self.driver)
        for key in keys:
            chain.send_keys(key)
        chain.perform()

    def click(self, selector, share):
        """Clicks at point()."""
        from selenium.webdriver.common.action_chains import ActionChains

        chain = ActionChains(self.driver)
        chain.w3c_actions.pointer_action.move_to_location(*self.point(selector, share))
        chain.w3c_actions.pointer_action.click()
        chain.perform()

    def double_click(self, selector, share):
        from selenium.webdriver.common.action_chains import ActionChains

        chain = ActionChains(self.driver)
        chain.w3c_actions.pointer_action.move_to_location(*self.point(selector, share))
        chain.w3c_actions.pointer_action.double_click()
        chain.perform()

    def drag(self, selector, from_share, to_share):
        from selenium.webdriver.common.action_chains import ActionChains

        chain = ActionChains(self.driver)
        pointer = chain.w3c_actions.pointer_action
        pointer.move_to_location(*self.point(selector, from_share))
        pointer.pointer_down()
        pointer.move_to_location(*self.point(selector, to_share))
        pointer.pointer_up()
        chain.perform()

    def touch(self, *steps):
        """Sends the points of the fingers after each step: [(x, y), ...]. At the end they are lifted."""
        down = 0
        for points in [*steps, []]:
            kind = "touchEnd" if len(points) < down else "touchStart" if len(points) > down else "touchMove"
            down = len(points)
            touches = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(points)]
            self.driver.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})

    def point(self, selector, share):
        """The point at this share of the width of the first element that the selector finds, near its upper edge."""
        left, top, width = self.run("const box = document.querySelector(arguments[0]).getBoundingClientRect(); return [box.left, box.top, box.width]", selector)
        return int(left + share * width), int(top + 8)

    def console_errors(self):
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]

    def received(self):
        """What WebSockets have received since the previous call, texts and bytes. Requires `records_network`."""
        events = [json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance")]
        frames = [event["params"]["response"] for event in events if event["method"] == "Network.webSocketFrameReceived"]
        return [frame["payloadData"] if frame["opcode"] == 1 else base64.b64decode(frame["payloadData"]) for frame in frames]

    def foreign_requests(self):
        """Addresses outside the page's origin from which something was fetched."""
        return self.run(
            "return performance.getEntriesByType('resource').map((entry) => entry.name)"
            ".filter((name) => !name.startsWith(location.origin) && !name.startsWith('blob:'))"
        )

    def processes(self):
        """The ids of the browser's processes."""
        parents = {}
        for entry in filter(str.isdigit, os.listdir("/proc")):
            try:
                with open(f"/proc/{entry}/stat", encoding="utf-8") as file:
                    parents[int(entry)] = int(file.read().rsplit(")", 1)[1].split()[1])
            except OSError:
                continue
        found = [self.driver.service.process.pid]
        for pid in found:
            found += [child for child, parent in parents.items() if parent == pid]
        return found[1:]

    def suspend(self):
        for pid in self.processes():
            os.kill(pid, signal.SIGSTOP)

    def resume(self):
        for pid in self.processes():
            os.kill(pid, signal.SIGCONT)

    def close(self):
        self.driver.quit()


# Samples of the overlay: the share of points along the segments that have the colour, and the number of pixels of the colour that
# are farther than 4 px from all segments.
OVERLAY_SCRIPT = """
const [segments, colour, width] = arguments;
const canvas = document.getElementById('overlay');
const {data} = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
const scale = canvas.width / width;
const isColoured = (x, y) => {
  const i = 4 * (y * canvas.width + x);
  return data[i + 3] > 200 && colour.every((value, k) => Math.abs(data[i + k] - value) < 40);
};
const near = new Uint8Array(canvas.width * canvas.height);
let points = 0, hits = 0, stray = 0, pixels = 0;
for (let s = 0; s < segments.length; s += 4) {
  const [x1, y1, x2, y2] = segments.slice(s, s + 4).map((value) => (value + 0.5) * scale);
  const steps = Math.ceil(Math.hypot(x2 - x1, y2 - y1));
  for (let k = 0; k <= steps; ++k) {
    const x = Math.floor(x1 + (x2 - x1) * k / steps), y = Math.floor(y1 + (y2 - y1) * k / steps);
    for (let v = -4; v <= 4; ++v) for (let u = -4; u <= 4; ++u) {
      if (x + u >= 0 && x + u < canvas.width && y + v >= 0 && y + v < canvas.height) near[(y + v) * canvas.width + x + u] = 1;
    }
    if (x < 1 || y < 1 || x >= canvas.width - 1 || y >= canvas.height - 1) continue;
    ++points;
    if (isColoured(x, y) || isColoured(x - 1, y) || isColoured(x, y - 1) || isColoured(x + 1, y) || isColoured(x, y + 1)) ++hits;
  }
}
for (let y = 0; y < canvas.height; ++y) for (let x = 0; x < canvas.width; ++x) {
  if (!isColoured(x, y)) continue;
  ++pixels;
  if (!near[y * canvas.width + x]) ++stray;
}
return {points, hits, stray, pixels};
"""
# Colours of the dark theme (client/view/page/src/palette.ts).
STATE_COLOURS = {"tracking": [0x1F, 0xD6, 0xA0], "degraded": [0xF5, 0xB0, 0x2E], "ambiguous": [0xE4, 0x8F, 0xC0]}
