# SPDX-License-Identifier: Apache-2.0
"""A tenant with a live camera: tracks a simulated cube at the camera's pace and collects poses and latencies.

It runs as a process of its own (`Camera`) with the C++ client, so that it does not compete with an adversary for the interpreter.
"""

import dataclasses
import hashlib
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time

import numpy
import yaml

import server
from api import EVT3

DURATION_S = 2
# Latencies below this one are mostly those of the machine's scheduler, and no reference for a ratio.
LATENCY_FLOOR_US = 2000


def recording():
    """Returns the directory of a simulated recording (tests share it in the build's directory)."""
    path = server.BIN / f"tests/adversary/cube_{DURATION_S}_s"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        made = tempfile.mkdtemp(dir=path.parent)
        subprocess.run([server.EVPOSE, "simulate", "--object", "cube", "--camera", "vga", "--duration", str(DURATION_S),
                        "--noise", "0.1", "--seed", "1", "--out", made], check=True, stdout=subprocess.DEVNULL)
        try:
            os.rename(made, path)
        except OSError:  # another test was faster
            shutil.rmtree(made)
    return path


def chunks():
    """Returns the events of the recording, EVT3, cut at each millisecond: pairs of the time since the first one (us) and bytes."""
    data = (recording() / "recording.raw").read_bytes()
    data = data[data.index(b"% end\n") + 6:]
    words = numpy.frombuffer(data, "<u2")
    high = numpy.where(words >> 12 == 8, numpy.arange(words.size), 0)
    is_low = words >> 12 == 6
    time_us = ((words[numpy.maximum.accumulate(high)] & 0xFFF).astype(int)[is_low] << 12) | (words[is_low] & 0xFFF)
    begins = numpy.flatnonzero(numpy.diff(time_us // 1000, prepend=-1))
    cuts = [0, *numpy.flatnonzero(is_low)[begins[1:]].tolist(), words.size]
    wraps = numpy.cumsum(numpy.diff(time_us, prepend=time_us[0]) < -(1 << 23))  # of the 24 bits of the sensor's clock
    times_us = (time_us + (wraps << 24))[begins] - time_us[0]
    return [(int(t_us), words[start:end].tobytes()) for t_us, start, end in zip(times_us, cuts, cuts[1:])]


def initial_pose():
    """Returns the true pose at the start of the recording."""
    _, x, y, z, qx, qy, qz, qw = map(float, (recording() / "truth.tum").read_text().split("\n", 1)[0].split())
    return {"translation_m": {"x": x, "y": y, "z": z}, "rotation": {"x": qx, "y": qy, "z": qz, "w": qw}}


def camera_model():
    """Returns the camera of the recording."""
    info = yaml.safe_load((recording() / "camera.yaml").read_text())
    matrix, distortion = ([float(number) for number in info[key]["data"]] for key in ("camera_matrix", "distortion_coefficients"))
    return {"width_px": info["image_width"], "height_px": info["image_height"], "fx_px": matrix[0], "cx_px": matrix[2],
            "fy_px": matrix[4], "cy_px": matrix[5], "distortion": distortion}


@dataclasses.dataclass
class Run:
    """One recording, tracked. `digest` is that of the file of all poses, and the latencies are those from the receipt of a chunk to its
    poses."""

    digest: str
    num_poses: int
    p50_us: float
    p99_us: float
    duration_s: float


def create(api):
    """Uploads the cube, and creates a session for the recording."""
    model = api.upload((recording() / "model.obj").read_bytes())
    objects = [{"object_id": "cube", "model": model.name, "initial_camera_from_object": initial_pose()}]
    return api("CreateSession", config={"encoding": EVT3, "camera": camera_model(), "objects": objects})


def track(address, tenant, is_pose_given):
    """Replays the recording at the camera's pace. Without a given pose, it begins with a search, an expensive step."""
    files = recording()
    poses = files.parent / f"poses_{os.getpid()}.csv"
    pose = initial_pose()
    numbers = " ".join(map(str, [*pose["translation_m"].values(), *pose["rotation"].values()]))
    environment = {**os.environ, "EVPOSE_TOKEN": server.token(tenant)} if tenant else None
    command = [server.EVPOSE, "replay", files / "recording.raw", "--model", files / "model.obj", "--camera", files / "camera.yaml",
               *(["--init-pose", numbers] if is_pose_given else []), "--server", address, "--connect-timeout", str(server.PATIENCE_S),
               "--rate", "1", "--json", "--out", poses]
    report = json.loads(subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True).stdout)
    digest = hashlib.sha256(poses.read_bytes()).hexdigest()
    poses.unlink()
    return Run(digest, report["poses"], 1e3 * report["latency_p50_ms"], 1e3 * report["latency_p99_ms"], report["wall_time_s"])


class Camera:
    """Starts the tenant as a process, which tracks the recording at least once, and again until `seconds` have passed."""

    def __init__(self, running, tenant=None, seconds=0.0, is_pose_given=True):
        options = [] if is_pose_given else ["--search"]
        command = [sys.executable, __file__, "--bin", str(server.BIN), running.address, tenant or "", str(seconds), *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE)

    def runs(self):
        """Waits for the end, and returns the runs."""
        out, _ = self.process.communicate()
        if self.process.returncode != 0:
            raise AssertionError(f"the tenant with the camera failed: status {self.process.returncode}")
        return [Run(**json.loads(line)) for line in out.splitlines()]


def assert_same_poses(test, alone, beside):
    """Checks runs beside an adversary against one without: the same poses to the bit in every run, at the camera's pace."""
    for run in beside:
        test.assertGreater(run.num_poses, 250 * DURATION_S)
        test.assertEqual((run.num_poses, run.digest), (alone.num_poses, alone.digest))
        test.assertLess(run.duration_s, 2 * alone.duration_s, "the session fell behind its camera")


def assert_undisturbed(test, alone, beside, p50_ratio, p99_ratio):
    """Checks the poses, and that latencies have a bounded ratio in the median run, because a pause of the machine disturbs single runs."""
    assert_same_poses(test, alone, beside)
    p50_us, p99_us = (statistics.median_high(latencies) for latencies in zip(*((run.p50_us, run.p99_us) for run in beside)))
    test.assertLessEqual(p50_us, p50_ratio * max(alone.p50_us, LATENCY_FLOOR_US / 10), (alone, beside))
    test.assertLessEqual(p99_us, p99_ratio * max(alone.p99_us, LATENCY_FLOOR_US), (alone, beside))


def main():
    address, tenant, seconds, *options = sys.argv[1:]
    end = time.monotonic() + float(seconds)
    while True:
        print(json.dumps(dataclasses.asdict(track(address, tenant, "--search" not in options))), flush=True)
        if time.monotonic() >= end:
            break


if __name__ == "__main__":
    main()
