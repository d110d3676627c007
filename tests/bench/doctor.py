#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Detections and false alarms of evpose doctor on simulated recordings.

Each defect is simulated on several sensors and with several seeds; the table has the number of recordings in which its check reports advice
or a problem, and the problems and the advice that other checks report. Needs a release build; about 10 minutes.
"""
import argparse
import json
import pathlib
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
SENSORS = {"128x128": (128, 128, 150), "240x180": (240, 180, 200), "346x260": (346, 260, 290), "640x480": "vga", "1280x720": "evk4"}
# Name, check that must report it (None: none must), options of the simulation.
SCENES = [
    ("clean", None, ()),
    ("clean, textured background", None, ("--textured-background",)),
    ("clean, pauses", None, ("--motion", "rests")),
    ("clean, threshold 0.12", None, ("--threshold", "0.12")),
    ("clean, threshold 0.5", None, ("--threshold", "0.5")),
    ("clean, noise of 0.5 Hz", None, ("--background-activity", "0.5")),
    ("clean, flicker of 5 %", None, ("--flicker", "0.05")),
    ("100 hot pixels", "hot-pixels", ("--hot-pixels", "100")),
    ("flicker of 30 %", "flicker", ("--flicker", "0.3")),
    ("flicker of 60 %", "flicker", ("--flicker", "0.6")),
    ("noise of 30 Hz", "noise", ("--background-activity", "30")),
    ("blur of 1 px", "focus", ("--lens-blur", "1")),
    ("blur of 2 px", "focus", ("--lens-blur", "2")),
    ("no motion", "event-rate", ("--speed", "0")),
]
CAMERA = """image_width: {w}
image_height: {h}
camera_name: sensor
camera_matrix: {{rows: 3, cols: 3, data: [{f}, 0, {cx}, 0, {f}, {cy}, 0, 0, 1]}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}}
"""


def diagnose(evpose, folder, sensor, seed, options):
    """The results by check, of one simulated recording."""
    camera = SENSORS[sensor]
    if not isinstance(camera, str):
        width, height, focal_px = camera
        path = folder / "sensor.yaml"
        path.write_text(CAMERA.format(w=width, h=height, f=focal_px, cx=width / 2 - 0.5, cy=height / 2 - 0.5))
        camera = path
    scene = folder / "scene"
    subprocess.run([evpose, "simulate", "--object", "cube", "--camera", camera, "--duration", "0.6", "--seed", str(seed), *options,
                    "--out", scene], check=True, capture_output=True)
    done = subprocess.run([evpose, "doctor", scene / "recording.raw", "--model", scene / "model.obj", "--camera",
                           scene / "camera.yaml", "--json"], check=False, capture_output=True, text=True)
    if not done.stdout:
        raise RuntimeError(done.stderr.strip())
    return {check["check"]: check["result"] for check in json.loads(done.stdout)["checks"]}


def print_table(evpose, seeds):
    print("| scene | check | reported, of | not checked | other problems | other advice |\n" + "| --- " * 6 + "|")
    for name, expected, options in SCENES:
        reported = unchecked = 0
        problems, advice = {}, {}
        for sensor in SENSORS:
            for seed in range(1, seeds + 1):
                with tempfile.TemporaryDirectory() as folder:
                    results = diagnose(evpose, pathlib.Path(folder), sensor, seed, options)
                reported += results.get(expected) in ("advice", "problem")
                unchecked += results.get(expected) == "not checked"
                for check, result in results.items():
                    if check != expected and result in ("problem", "advice"):
                        counts = problems if result == "problem" else advice
                        counts[check] = counts.get(check, 0) + 1
        total = len(SENSORS) * seeds
        cells = [f"{reported}, {total}" if expected else f"-, {total}", unchecked if expected else "-", problems or "none", advice or "none"]
        print(f"| {name} | {expected or '-'} | " + " | ".join(str(cell).replace("'", "") for cell in cells) + " |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build/release", help="directory of the build")
    parser.add_argument("--seeds", type=int, default=3)
    arguments = parser.parse_args()
    evpose = arguments.bin / "client/cli/evpose"
    if not evpose.exists():
        sys.exit(f"{evpose}: build first: cmake --preset release && cmake --build --preset release")
    print_table(evpose, arguments.seeds)


if __name__ == "__main__":
    main()
