#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measures the page of `evpose view` in a headless Chromium: its start, its frame rate, and its delay behind the events.

A server tracks a cube that a simulated EVK4 sees, with noise in every pixel: about 10 Mev/s, which `evpose stream` receives through a pipe
at the pace of the sensor. Server, client, gateway and browser share the machine. The figures are wall-clock times: run it on an idle
machine with a release build, which includes the package for Python.

Printed are: the time from the start of `evpose view SESSION` to the first image that the page has drawn, in a browser that is already open;
images drawn per second, with the plots, and the images that the gateway has left out; the delay from the newest event of an image to the
frame that shows it, median and 95 % quantile; the poses; and whether the session kept up with the sensor: how late the events were written,
and the age of the oldest event that waits at the server when the last one has been written. Tracking begins with the true pose.

The page asks for 32 images per second, and could not show that the machine makes more. Its request is changed to --rate. The delay ends when
the page has drawn the image: the browser composes it for the screen up to one frame later. Events are written to the pipe in blocks of
4.096 ms, at whose end the pace is exact.
"""
import argparse
import contextlib
import json
import pathlib
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/view"), str(ROOT / "tests")]
from browser import Page, PageServer, require_browser  # noqa: E402
from event_blocks import BlockPipe  # noqa: E402
from processes import Server, first_pose, simulate  # noqa: E402

# Notes for each drawn image its newest event (sensor time, us) and the wall-clock time of the frame (ms since 1970); the latest health; and
# asks for RATE_HZ images per second.
RECORD = """
window.drawn = [];
window.health = null;
const send = WebSocket.prototype.send;
const listening = new WeakSet();
WebSocket.prototype.send = function (text) {
  if (!listening.has(this)) {
    listening.add(this);
    this.addEventListener("message", ({ data }) => {
      if (typeof data === "string" && JSON.parse(data).type === "health") window.health = JSON.parse(data);
    });
  }
  const message = JSON.parse(text);
  if (message.type === "settings") text = JSON.stringify({ ...message, rate_hz: RATE_HZ });
  send.call(this, text);
};
new MutationObserver(() => {
  const data = document.documentElement.dataset;
  const last = window.drawn.at(-1);
  if (data.imageNumber && (!last || last[0] !== data.imageNumber))
    window.drawn.push([data.imageNumber, Number(data.imageToUs), performance.timeOrigin + performance.now()]);
}).observe(document, { attributes: true, subtree: true, attributeFilter: ["data-image-number"] });
"""


class Sensor(threading.Thread):
    """Sends a recording at the pace of the sensor. The pipe remains open."""

    def __init__(self, pipe):
        super().__init__(daemon=True)
        self.pipe = pipe
        self.late_s = 0.0
        self.begin_s = time.time() - pipe.next_end_us * 1e-6  # wall-clock time of sensor time 0

    def run(self):
        while self.pipe.next_end_us is not None:
            due_s = self.begin_s + self.pipe.next_end_us * 1e-6
            time.sleep(max(0.0, due_s - time.time()))
            self.pipe.send()
            self.late_s = max(self.late_s, time.time() - due_s)


def session_of(evpose, address, stream):
    """Waits for the one session of the server, which the process `stream` creates."""
    while stream.poll() is None:
        output = subprocess.run([evpose, "sessions", "list", "--server", address], capture_output=True, text=True, check=True).stdout
        names = [word for word in output.split() if word.startswith("sessions/")]
        if names:
            return names[0]
        time.sleep(0.05)
    raise RuntimeError("evpose stream has failed")


def queue_age_s(address, session):
    import evpose

    with evpose.connect(address) as client:
        return client.session(session).health().queue_age_s


def measure(evpose, scene, address, page):
    with contextlib.ExitStack() as cleanup:
        command = [evpose, "stream", "-", "--model", scene / "model.obj", "--camera", scene / "camera.yaml", "--init-pose", first_pose(scene),
                   "--server", address, "--json"]
        pipe = cleanup.enter_context(BlockPipe(scene / "recording.raw", lambda stdin: subprocess.Popen(
            command, stdin=stdin, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)))
        stream = pipe.reader
        cleanup.callback(stream.wait)
        cleanup.callback(stream.kill)
        sensor = Sensor(pipe)
        sensor.start()
        session = session_of(evpose, address, stream)
        begin_s = time.time()
        gateway = PageServer([evpose, "view", session, "--server", address])
        cleanup.callback(gateway.stop)
        page.driver.get(gateway.url)
        sensor.join()
        age_s = queue_age_s(address, session)
        drawn, health = page.run("return [window.drawn, window.health]")
        page.driver.get("about:blank")
        pipe.close()
        output = stream.communicate()[0]
    if stream.returncode != 0:
        raise RuntimeError("evpose stream has failed")
    report = json.loads(output)
    if report["poses"] == 0 or report["losses"] > 0:
        raise RuntimeError(f"the cube was not tracked: {report['poses']} poses, {report['losses']} losses")
    frames_s = [wall_ms * 1e-3 for _, _, wall_ms in drawn]
    delays_ms = [(wall_ms * 1e-3 - sensor.begin_s - to_us * 1e-6) * 1e3 for _, to_us, wall_ms in drawn]
    return {
        "first_s": frames_s[0] - begin_s,
        "rate_hz": (len(drawn) - 1) / (frames_s[-1] - frames_s[0]),
        "delay_ms": statistics.median(delays_ms),
        "delay_95_ms": statistics.quantiles(delays_ms, n=20)[-1],
        "skipped": health["link"]["images_skipped"],
        "poses": report["poses"],
        "late_ms": sensor.late_s * 1e3,
        "age_ms": age_s * 1e3,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build/release")
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--noise", type=float, default=11.5, help="events per second of a dark pixel")
    parser.add_argument("--rate", type=float, default=40.0, help="images per second that the page asks for")
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    arguments = parser.parse_args()
    require_browser()
    binaries = arguments.bin.resolve()
    evpose = binaries / "client/cli/evpose"
    sys.path.insert(0, str(binaries / "client/python"))
    page = Page("about:blank")
    try:
        run(arguments, binaries, evpose, page)
    finally:
        page.driver.quit()


def run(arguments, binaries, evpose, page):
    page.driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": RECORD.replace("RATE_HZ", str(arguments.rate))})
    with tempfile.TemporaryDirectory() as folder:
        scene = pathlib.Path(folder)
        made = simulate(evpose, scene, "--object", "cube", "--camera", "evk4", "--duration", arguments.seconds, "--background-activity",
                        arguments.noise)
        result = {"mev_per_s": float(re.search(r"([0-9.]+) Mev/s", made).group(1)), "rate_hz": arguments.rate, "runs": []}
        if not arguments.json:
            print(f"{result['mev_per_s']} Mev/s")
            print(f"{'first image s':>14}{'images/s':>10}{'skipped':>9}{'delay ms':>10}{'95 %':>8}{'poses':>8}{'sensor late ms':>16}"
                  f"{'queue ms':>10}")
        for _ in range(arguments.repetitions):
            with Server(binaries / "server/evpose-server", "--log-level", "off", "--max-session-cpu", "0") as server:
                figures = measure(evpose, scene, server.address, page)
            result["runs"].append(figures)
            if arguments.json:
                continue
            print(f"{figures['first_s']:14.2f}{figures['rate_hz']:10.1f}{figures['skipped']:9}{figures['delay_ms']:10.1f}"
                  f"{figures['delay_95_ms']:8.1f}{figures['poses']:8}{figures['late_ms']:16.1f}{figures['age_ms']:10.1f}", flush=True)
        if arguments.json:
            print(json.dumps(result))


if __name__ == "__main__":
    main()
