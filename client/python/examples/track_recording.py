#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Prints the poses of an object in a recording: time in seconds, position in metres, rotation x y z w, state."""
import argparse
import os
import sys

import evpose

parser = argparse.ArgumentParser(description=__doc__)
for name, what in (("server", "HOST:PORT"), ("recording", "RAW or DAT file"), ("model", "OBJ, PLY or STL"), ("camera", "YAML")):
    parser.add_argument(name, help=what)
given = parser.parse_args()
try:
    with evpose.connect(given.server) as client, evpose.Recording(given.recording) as recording:
        model = client.upload_model(given.model)
        with client.create_session(model, evpose.read_camera(given.camera), recording.encoding) as session:
            for pose in session.track(recording):
                print(f"{1e-6 * pose.t_us:.6f}", *pose.translation_m, *pose.quaternion_xyzw, pose.state.name, flush=True)
except evpose.EvposeError as error:
    sys.exit(f"track_recording: {error}")
except BrokenPipeError:  # the reader of the poses has ended
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
