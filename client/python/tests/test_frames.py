#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Poses in the frame of a world and of an object: the same as those that the command evpose writes."""

import json
import pathlib
import tempfile
import unittest

import numpy as np
from testing import evpose, run_evpose

_UPPER = np.triu_indices(6)


def read_pose(line):
    """Returns a line of a .jsonl file as a pose, and the name of its transform."""
    fields = json.loads(line)
    covariance = np.zeros((6, 6))
    covariance[_UPPER] = covariance.T[_UPPER] = fields["covariance_upper"]
    pose = evpose.Pose(
        seq=fields["pose_seq"], object_id=fields["object_id"], t_us=fields["t_us"], translation_m=np.array(fields["translation_m"]),
        quaternion_xyzw=np.array(fields["quaternion_xyzw"]), covariance=covariance, twist=np.array(fields["twist"]),
        state=evpose.TrackState[fields["state"]], num_events=fields["num_events"], explained_ratio=fields["explained_ratio"],
        residual_rms_px=fields["residual_rms_px"], latency_s=0.0,
        alternatives=tuple(
            evpose.Alternative(evpose.Transform.from_quaternion(each["translation_m"], each["quaternion_xyzw"]), each["log_likelihood_ratio"])
            for each in fields["alternatives"]))
    return pose, fields["transform"]


class TransformTest(unittest.TestCase):
    def test_a_product_with_the_inverse_is_the_identity(self):
        a = evpose.Transform.from_quaternion([1.0, -2.0, 3.0], [0.5, -0.5, 0.5, 0.5])
        b = evpose.Transform.from_quaternion([0.1, 0.2, 0.3], [0.6, 0.0, 0.0, 0.8])
        np.testing.assert_allclose((a @ b).matrix, a.matrix @ b.matrix, atol=1e-15)
        np.testing.assert_allclose((a @ b @ b.inverse()).matrix, a.matrix, atol=1e-15)


class FrameTest(unittest.TestCase):
    def assert_same(self, pose, expected):
        for name in ("translation_m", "quaternion_xyzw", "covariance", "twist"):
            scale = np.abs(getattr(expected, name)).max()
            np.testing.assert_allclose(getattr(pose, name), getattr(expected, name), atol=1e-12 * scale, err_msg=name)
        self.assertEqual((pose.seq, pose.t_us, pose.state), (expected.seq, expected.t_us, expected.state))
        self.assertEqual(len(pose.alternatives), len(expected.alternatives))

    def test_poses_are_those_of_the_command(self):
        directory = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        run_evpose("simulate", "--object", "cube", "--camera", "vga", "--duration", "0.1", "--out", directory / "cube")
        mount = evpose.Transform.from_quaternion([0.5, -1.0, 2.0], [0.5, -0.5, 0.5, 0.5])
        (directory / "mount.txt").write_text(" ".join(map(repr, [*mount.translation_m.tolist(), *mount.quaternion_xyzw.tolist()])))
        poses = {}
        for options in ([], ["--world-from-camera", directory / "mount.txt"], ["--pose", "object-from-camera"]):
            run_evpose("replay", directory / "cube/recording.raw", "--model", directory / "cube/model.obj", "--camera",
                       directory / "cube/camera.yaml", "--out", directory / "poses.jsonl", *options)
            lines = (directory / "poses.jsonl").read_text().splitlines()
            self.assertGreater(len(lines), 10)
            for line in lines:
                pose, transform = read_pose(line)
                poses.setdefault(transform, []).append(pose)
        self.assertEqual(list(poses), ["camera_from_object", "world_from_object", "object_from_camera"])
        for pose, in_world, of_camera in zip(*poses.values()):
            self.assert_same(evpose.in_world(pose, mount), in_world)
            self.assert_same(evpose.of_camera(pose), of_camera)
            self.assert_same(evpose.of_camera(of_camera), pose)

    def test_alternatives_are_converted(self):
        transform = evpose.Transform.from_quaternion([0.1, -0.2, 1.5], [0.5, 0.5, -0.5, 0.5])
        pose = evpose.Pose(
            seq=1, object_id="part", t_us=5, translation_m=transform.translation_m, quaternion_xyzw=transform.quaternion_xyzw,
            covariance=np.eye(6), twist=np.ones(6), state=evpose.TrackState.AMBIGUOUS, num_events=1, explained_ratio=0.5,
            residual_rms_px=0.5, latency_s=0.0, alternatives=(evpose.Alternative(transform, -1.0),))
        for converted in (evpose.in_world(pose, transform.inverse()), evpose.of_camera(pose)):
            alternative = converted.alternatives[0]
            np.testing.assert_array_equal(alternative.camera_from_object.matrix, converted.camera_from_object.matrix)
            self.assertEqual(alternative.log_likelihood_ratio, -1.0)


if __name__ == "__main__":
    unittest.main()
