#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Prints the poses of an object in a recording: time in seconds, position in metres, rotation x y z w, state.

usage: track_recording.py HOST:PORT RECORDING MODEL CAMERA
"""
import sys

import evpose

address, recording_path, model_path, camera_path = sys.argv[1:]
try:
    with evpose.connect(address) as client, evpose.Recording(recording_path) as recording:
        model = client.upload_model(model_path)
        session = client.create_session(model, evpose.read_camera(camera_path), recording.encoding)
        for pose in session.track(recording):
            print(f"{1e-6 * pose.t_us:.6f}", *pose.translation_m, *pose.quaternion_xyzw, pose.state.name)
        session.delete()
except evpose.EvposeError as error:
    sys.exit(f"track_recording: {error}")
