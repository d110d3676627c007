#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Tracks an object in a recording, and plots position and velocity with two standard deviations, and the share of explained events.
Curves have the confirmed poses only; crosses are the positions of AMBIGUOUS ones, which are one of several. It needs matplotlib."""
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
    is_ambiguous = poses["state"] == evpose.TrackState.AMBIGUOUS
    sigma_m = np.sqrt(np.diagonal(poses["covariance"], axis1=1, axis2=2))[:, :3]
    position_m = poses["translation_m"] - poses["translation_m"].mean(axis=0)
    figure, (position, speed, explained) = plt.subplots(3, 1, sharex=True, figsize=(8, 8), layout="constrained")
    for i, name in enumerate("xyz"):
        confirmed_mm = np.where(is_ambiguous, np.nan, 1e3 * position_m[:, i])
        [line] = position.plot(t_s, confirmed_mm, label=name)
        position.plot(t_s[is_ambiguous], 1e3 * position_m[is_ambiguous, i], "x", color=line.get_color(), alpha=0.5)
        position.fill_between(t_s, confirmed_mm - 2e3 * sigma_m[:, i], confirmed_mm + 2e3 * sigma_m[:, i], alpha=0.3)
        speed.plot(t_s, np.where(is_ambiguous, np.nan, poses["twist"][:, i]), label=name)
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
    shares = {state.name: 100 * np.mean(poses["state"] == state) for state in (evpose.TrackState.TRACKING, evpose.TrackState.AMBIGUOUS)}
    print(f"{len(poses)} poses" + "".join(f", {name} in {share:.1f} %" for name, share in shares.items()))


if __name__ == "__main__":
    main()
