#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Tracks an object in a recording, and plots position and velocity with two standard deviations, and the share of explained events.
It needs matplotlib."""
import argparse
import sys

import numpy as np

import evpose


def track(address, recording_path, model_path, camera_path):
    """Returns the poses as an array."""
    with evpose.connect(address) as client, evpose.Recording(recording_path) as recording:
        model = client.upload_model(model_path)
        with client.create_session(model, evpose.read_camera(camera_path), recording.encoding) as session:
            return session.track(recording).read_all()


def plot(plt, poses, path):
    t_s = 1e-6 * poses["t_us"]
    sigma_m = np.sqrt(np.diagonal(poses["covariance"], axis1=1, axis2=2))[:, :3]
    position_m = poses["translation_m"] - poses["translation_m"].mean(axis=0)
    figure, (position, speed, explained) = plt.subplots(3, 1, sharex=True, figsize=(8, 8), layout="constrained")
    for i, name in enumerate("xyz"):
        position.plot(t_s, 1e3 * position_m[:, i], label=name)
        position.fill_between(t_s, 1e3 * (position_m - 2 * sigma_m)[:, i], 1e3 * (position_m + 2 * sigma_m)[:, i], alpha=0.3)
        speed.plot(t_s, poses["twist"][:, i], label=name)
    position.set_ylabel("position less its mean [mm]\nwith 2 standard deviations")
    speed.set_ylabel("velocity [m/s]")
    explained.plot(t_s, 100 * poses["explained_ratio"])
    explained.set_ylabel("explained events [%]")
    explained.set_xlabel("time on the sensor's clock [s]")
    for axes in (position, speed):
        axes.legend()
    figure.savefig(path)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    for name, what in (("server", "HOST:PORT"), ("recording", "RAW or DAT file"), ("model", "OBJ, PLY or STL"), ("camera", "YAML"),
                       ("picture", "PNG file to write")):
        parser.add_argument(name, help=what)
    given = parser.parse_args()
    try:
        import matplotlib.pyplot as plt
    except ImportError:
        sys.exit("plot_poses: matplotlib is missing: install python3-matplotlib (Debian) or `pip install matplotlib`")
    try:
        poses = track(given.server, given.recording, given.model, given.camera)
    except evpose.EvposeError as error:
        sys.exit(f"plot_poses: {error}")
    if len(poses) == 0:
        sys.exit("plot_poses: no pose was found; `evpose replay` says why")
    plot(plt, poses, given.picture)
    print(f"{len(poses)} poses, state TRACKING in {100 * np.mean(poses['state'] == evpose.TrackState.TRACKING):.1f} %")


if __name__ == "__main__":
    main()
