#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The page of a container with `evpose view`, in a headless Chromium.
page_watch.py ADDRESS REFERENCE.tum [--picture FILE]

Writes a line for each step, and waits for a line on standard input before the next one:
  open     the page is connected to its gateway; then a session may be started
  shown    the page has drawn images and shows poses of the session; then its server may be stopped
  again    the page has drawn images and shows later poses; then the session may end
  end      every pose that was shown is one of REFERENCE, and neither the page nor its console has reported an error
"""

import argparse
import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "view"))
from browser import Page, require_browser

IMAGES = 5
# Sessions of earlier replays are in the list, too.
SESSION = "[...document.querySelectorAll('#session-list .session')].find((row) => row.textContent.includes('attached'))"


def step(name):
    print(name, flush=True)
    if not sys.stdin.readline():
        sys.exit(f"the test has ended after the step {name}")


def read_tum(path):
    """The numbers of the poses, by time in microseconds."""
    poses = {}
    for line in path.read_text(encoding="ascii").splitlines():
        time, *numbers = line.split()
        poses[int(time.replace(".", ""))] = [float(number) for number in numbers]
    return poses


class Watch:
    def __init__(self, address, reference):
        self.page = Page("about:blank")
        self.reference = reference
        self.newest_us = 0
        self.page.driver.get(address)

    def open_session(self):
        self.page.wait(lambda: self.page.run(f"return {SESSION} !== undefined"), "the session in the list")
        self.page.run(f"{SESSION}.click()")

    def follow(self):
        """Waits for further images and for a pose later than the one before, which must be one of the reference."""
        first = int(self.page.data.get("imagesDrawn", 0))
        self.page.wait(lambda: int(self.page.data.get("imagesDrawn", 0)) >= first + IMAGES, f"{IMAGES} images")
        self.page.wait(lambda: int(self.page.pose.get("tUs") or 0) > self.newest_us, f"a pose after {self.newest_us} us")
        pose = self.page.pose
        self.newest_us = int(pose["tUs"])
        w, x, y, z = map(float, pose["q"].split())
        shown = [*map(float, pose["p"].split()), x, y, z, w]
        if shown != self.reference.get(self.newest_us):
            sys.exit(f"at {self.newest_us} us the page shows the pose {shown}, but it is {self.reference.get(self.newest_us)}")

    def check_errors(self):
        errors = self.page.console_errors() + self.page.foreign_requests()
        if errors or self.page.data["errors"] != "0":
            sys.exit(f"the page has reported {self.page.data['errors']} errors, the console {errors}")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("address")
    parser.add_argument("reference", type=pathlib.Path)
    parser.add_argument("--picture")
    arguments = parser.parse_args()
    require_browser()
    watch = Watch(arguments.address, read_tum(arguments.reference))
    try:
        watch.page.wait(lambda: watch.page.data.get("connection") == "connected", "the connection to the gateway")
        step("open")
        watch.open_session()
        watch.follow()
        step("shown")
        watch.follow()
        if arguments.picture:
            watch.page.driver.save_screenshot(arguments.picture)
        step("again")
        watch.check_errors()
        print("end", flush=True)
    finally:
        watch.page.close()


if __name__ == "__main__":
    main()
