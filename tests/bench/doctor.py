#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Detections and false alarms of evpose doctor.

Each defect is simulated on several sensors and with several seeds, by the simulator or by a change of its events; the table has the number of
recordings in which its check reports advice or a problem, and the problems and the advice that other checks report. With --real DIR, the
problems and the advice on real recordings follow: each RECORDING.raw below DIR, with the camera.yaml and model.obj beside it if it has them.
Needs a release build; about 20 minutes.
"""
import argparse
import json
import pathlib
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests"))
from processes import run_evpose, simulate  # noqa: E402

SENSORS = {"128x128": (128, 128, 150), "240x180": (240, 180, 200), "346x260": (346, 260, 290), "640x480": "vga", "1280x720": "evk4"}
SMALL_SENSORS = ("128x128", "240x180")  # for scenes with events in all pixels
CAMERA = """image_width: {w}
image_height: {h}
camera_name: sensor
camera_matrix: {{rows: 3, cols: 3, data: [{f}, 0, {cx}, 0, {f}, {cy}, 0, 0, 1]}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}}
"""


def dead_area(events):
    """No events in a square of 16 pixels, where the middle event is."""
    x, y, _, _ = events[len(events) // 2]
    left, top = x // 16 * 16, y // 16 * 16
    return [event for event in events if not (left <= event[0] < left + 16 and top <= event[1] < top + 16)]


def dead_rows(events):
    """No events in four rows through the middle of the events."""
    y = sorted(event[1] for event in events)[len(events) // 2]
    return [event for event in events if not y <= event[1] < y + 4]


def gap(events):
    """No events for 30 ms in the middle."""
    t_us = events[len(events) // 2][3]
    return [event for event in events if not t_us <= event[3] < t_us + 30_000]


def step_back(events):
    """The clock steps back by 0.2 s in the middle."""
    half = len(events) // 2
    return events[:half] + [(x, y, p, t_us - 200_000) for x, y, p, t_us in events[half:]]


def overflow(events):
    """The clock jumps by 2^24 us in the middle."""
    half = len(events) // 2
    return events[:half] + [(x, y, p, t_us + 2**24) for x, y, p, t_us in events[half:]]


def coarse_times(events):
    """Times are rounded down to multiples of 2 ms."""
    return [(x, y, p, t_us // 2000 * 2000) for x, y, p, t_us in events]



# Name, check that must report it (None: none must), options of the simulation, change of the events (None: none), sensors if not all.
SCENES = [
    ("clean", None, (), None),
    ("clean, textured background", None, ("--textured-background",), None),
    ("clean, pauses", None, ("--motion", "rests"), None),
    ("clean, threshold 0.12", None, ("--threshold", "0.12"), None),
    ("clean, threshold 0.5", None, ("--threshold", "0.5"), None),
    ("clean, noise of 0.5 Hz", None, ("--background-activity", "0.5"), None),
    ("clean, flicker of 5 %", None, ("--flicker", "0.05"), None),
    ("clean, thresholds 0.28 and 0.35", None, ("--threshold-off", "0.35"), None),
    ("100 hot pixels", "hot-pixels", ("--hot-pixels", "100"), None),
    ("flicker of 30 %", "flicker", ("--flicker", "0.3"), None),
    ("flicker of 60 %", "flicker", ("--flicker", "0.6"), None),
    ("noise of 30 Hz", "noise", ("--background-activity", "30"), None),
    ("blur of 1 px", "focus", ("--lens-blur", "1"), None),
    ("blur of 2 px", "focus", ("--lens-blur", "2"), None),
    ("no motion", "event-rate", ("--speed", "0"), None),
    ("OFF threshold 3 times that of ON", "polarity", ("--threshold", "0.2", "--threshold-off", "0.6"), None),
    ("ON threshold 3 times that of OFF", "polarity", ("--threshold", "0.6", "--threshold-off", "0.2"), None),
    ("OFF threshold 5 times that of ON", "polarity", ("--threshold", "0.15", "--threshold-off", "0.75"), None),
    ("dead square of 16 px, noise of 1 Hz", "dead-pixels", ("--background-activity", "1"), dead_area),
    ("4 dead rows, noise of 1 Hz", "dead-pixels", ("--background-activity", "1"), dead_rows),
    ("dead square of 16 px, events everywhere", "dead-pixels", ("--background-activity", "150"), dead_area, SMALL_SENSORS),
    ("4 dead rows, events everywhere", "dead-pixels", ("--background-activity", "150"), dead_rows, SMALL_SENSORS),
    ("gap of 30 ms", "clock", (), gap),
    ("step back of 0.2 s", "clock", (), step_back),
    ("overflow of 24 bits", "clock", (), overflow),
    ("times in steps of 2 ms", "time-step", (), coarse_times),
]


def change_events(evpose, recording, change):
    """Writes a CSV of the changed events beside the recording; returns its path."""
    plain = recording.with_suffix(".csv")
    run_evpose(evpose, "convert", recording, plain)
    heading, *lines = plain.read_text().splitlines()
    events = change([tuple(int(field) for field in line.split(",")) for line in lines])
    plain.write_text("\n".join([heading, *(f"{x},{y},{p},{t_us}" for x, y, p, t_us in events)]) + "\n")
    return plain


def doctor(evpose, recording, camera, model):
    """The results by check, of one recording."""
    command = [evpose, "doctor", recording, "--json"]
    if camera.exists():
        command += ["--camera", camera]
        if model.exists():
            command += ["--model", model]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if not done.stdout:
        raise RuntimeError(done.stderr.strip())
    return {check["check"]: check for check in json.loads(done.stdout)["checks"]}


def diagnose(evpose, folder, sensor, seed, options, change):
    """The results by check, of one simulated recording."""
    camera = SENSORS[sensor]
    if not isinstance(camera, str):
        width, height, focal_px = camera
        path = folder / "sensor.yaml"
        path.write_text(CAMERA.format(w=width, h=height, f=focal_px, cx=width / 2 - 0.5, cy=height / 2 - 0.5))
        camera = path
    scene = folder / "scene"
    simulate(evpose, scene, "--object", "cube", "--camera", camera, "--duration", "0.6", "--start", "1", "--seed", seed, *options)
    recording = scene / "recording.raw"
    if change is not None:
        recording = change_events(evpose, recording, change)
    return doctor(evpose, recording, scene / "camera.yaml", scene / "model.obj")


def print_row(evpose, seeds, scene):
    name, expected, options, change, *limited_to = scene
    sensors = limited_to[0] if limited_to else SENSORS
    reported = unchecked = 0
    problems, advice = {}, {}
    for sensor in sensors:
        for seed in range(1, seeds + 1):
            with tempfile.TemporaryDirectory() as folder:
                results = diagnose(evpose, pathlib.Path(folder), sensor, seed, options, change)
            result = results.get(expected, {"result": ""})["result"]
            reported += result in ("advice", "problem")
            unchecked += result == "not checked"
            for check, finding in results.items():
                if check != expected and finding["result"] in ("problem", "advice"):
                    counts = problems if finding["result"] == "problem" else advice
                    counts[check] = counts.get(check, 0) + 1
    total = len(sensors) * seeds
    cells = [f"{reported}, {total}" if expected else f"-, {total}", unchecked if expected else "-", problems or "none", advice or "none"]
    print(f"| {name} | {expected or '-'} | " + " | ".join(str(cell).replace("'", "") for cell in cells) + " |", flush=True)


def print_real(evpose, folder):
    print("\n| recording | problems | advice |\n" + "| --- " * 3 + "|")
    for recording in sorted(folder.rglob("*.raw")):
        results = doctor(evpose, recording, recording.with_name("camera.yaml"), recording.with_name("model.obj"))
        cells = []
        for result in ("problem", "advice"):
            found = [f"{name} ({finding['text']})" for name, finding in results.items() if finding["result"] == result]
            cells.append("; ".join(found) or "none")
        print(f"| {recording.relative_to(folder)} | {cells[0]} | {cells[1]} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build/release", help="directory of the build")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--real", type=pathlib.Path, help="folder of real recordings")
    parser.add_argument("--scenes", default="", help="only the scenes whose names contain this text; none: no simulation")
    arguments = parser.parse_args()
    evpose = arguments.bin / "client/cli/evpose"
    if not evpose.exists():
        sys.exit(f"{evpose}: build first: cmake --preset release && cmake --build --preset release")
    if arguments.scenes != "none":
        print("| scene | check | reported, of | not checked | other problems | other advice |\n" + "| --- " * 6 + "|")
        for scene in SCENES:
            if arguments.scenes in scene[0]:
                print_row(evpose, arguments.seeds, scene)
    if arguments.real is not None:
        print_real(evpose, arguments.real)


if __name__ == "__main__":
    main()
