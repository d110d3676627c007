#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Arrays of poses, files of them, and their plot."""

import pathlib
import sys
import tempfile
import unittest

import numpy as np
from testing import ROOT, evpose

from evpose.poses import ALTERNATIVE_DTYPE, pose_from_message, poses_from_messages
from evpose.v1 import session_pb2

sys.path.append(str(ROOT / "client/python/examples"))
import plot_poses

AMBIGUOUS, TRACKING = evpose.TrackState.AMBIGUOUS, evpose.TrackState.TRACKING


def make_message(seq, state, num_alternatives=0):
    """Returns the message of a pose whose numbers depend on `seq`."""
    message = session_pb2.Pose(pose_seq=seq, object_id="part", t_us=1000 * seq, state=state)
    message.camera_from_object.translation_m.z = 1.0 + seq
    message.camera_from_object.rotation.w = 1.0
    message.covariance.upper_triangle.extend([1e-6] * 21)
    message.twist.linear_m_per_s.x = 0.5
    for i in range(num_alternatives):
        other = message.alternatives.add(log_likelihood_ratio=-0.5 * i)
        other.camera_from_object.translation_m.x = seq + 0.1 * i
        other.camera_from_object.rotation.x = 1.0
    return message


def make_poses(*messages):
    return poses_from_messages(messages, ["part"])


class PosesTest(unittest.TestCase):
    def setUp(self):
        self.directory = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))

    def test_an_array_has_the_alternatives_of_each_pose(self):
        messages = [make_message(1, TRACKING), make_message(2, AMBIGUOUS, 2), make_message(3, AMBIGUOUS, 4)]
        poses = make_poses(*messages)
        self.assertEqual(poses["num_alternatives"].tolist(), [0, 2, 4])
        for row, message in zip(poses, messages):
            pose = pose_from_message(message)
            alternatives = row["alternatives"][:row["num_alternatives"]]
            self.assertEqual(len(alternatives), len(pose.alternatives))
            for each, expected in zip(alternatives, pose.alternatives):
                self.assertEqual(each["translation_m"].tolist(), expected.camera_from_object.translation_m.tolist())
                self.assertEqual(each["quaternion_xyzw"].tolist(), expected.camera_from_object.quaternion_xyzw.tolist())
                self.assertEqual(each["log_likelihood_ratio"], expected.log_likelihood_ratio)
            unused = row["alternatives"][row["num_alternatives"]:]
            np.testing.assert_array_equal(unused, np.zeros(len(unused), dtype=ALTERNATIVE_DTYPE))

    def test_a_server_may_send_more_alternatives_than_an_array_has(self):
        [pose] = make_poses(make_message(1, AMBIGUOUS, 5))
        self.assertEqual(pose["num_alternatives"], 4)
        self.assertEqual(pose["alternatives"]["log_likelihood_ratio"].tolist(), [0.0, -0.5, -1.0, -1.5])

    def test_a_tum_file_has_no_ambiguous_poses(self):
        path = self.directory / "poses.tum"
        evpose.write_tum(path, make_poses(make_message(1, TRACKING), make_message(2, AMBIGUOUS, 1)))
        self.assertEqual(path.read_text(), "0.001000 0 0 2 0 0 0 1\n")
        with self.assertRaisesRegex(evpose.InvalidArgumentError, "poses.tum: every pose is AMBIGUOUS, and a TUM file has none"):
            evpose.write_tum(path, make_poses(make_message(3, AMBIGUOUS, 1)))
        self.assertEqual(path.read_text(), "0.001000 0 0 2 0 0 0 1\n", "the earlier file stays as it was")
        evpose.write_tum(path, make_poses())
        self.assertEqual(path.read_text(), "")

    def test_a_plot_has_ambiguous_poses_apart_from_the_curves(self):
        import matplotlib
        matplotlib.use("Agg")
        import matplotlib.pyplot as plt
        poses = make_poses(make_message(1, TRACKING), make_message(2, AMBIGUOUS, 1), make_message(3, TRACKING))
        plot_poses.plot(plt, poses, self.directory / "poses.png")
        self.addCleanup(plt.close)
        position, speed, _ = plt.gcf().axes
        curves, crosses = position.lines[0::2], position.lines[1::2]
        for line in [*curves, *speed.lines]:
            self.assertEqual(np.isnan(line.get_ydata()).tolist(), [False, True, False])
        for line in crosses:
            self.assertEqual((line.get_xdata().tolist(), line.get_marker()), ([0.002], "x"))


if __name__ == "__main__":
    unittest.main()
