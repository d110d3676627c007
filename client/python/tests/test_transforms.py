#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Transforms, and poses at other times than their own."""

import unittest

import numpy as np
from testing import evpose, message_of

from evpose.stream.feed import EventFeed
from evpose.stream.outbox import FeedPoint


class TransformTest(unittest.TestCase):
    def test_quaternions_and_matrices(self):
        numbers = np.random.default_rng(1)
        for q in [*numbers.normal(size=(200, 4)), *np.eye(4), [1, 1e-9, 0, 0], [0, 0, 1, -1e-9]]:
            q = np.asarray(q) / np.linalg.norm(q)
            transform = evpose.Transform.from_quaternion([1, 2, 3], q)
            self.assertGreaterEqual(transform.quaternion_xyzw[3], 0.0)
            self.assertAlmostEqual(abs(float(transform.quaternion_xyzw @ q)), 1.0, places=14)
            matrix = transform.matrix
            np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-14)
            np.testing.assert_allclose(evpose.Transform.from_matrix(matrix).quaternion_xyzw, transform.quaternion_xyzw, atol=1e-14)
            self.assertEqual(matrix[:3, 3].tolist(), [1, 2, 3])
        quarter = evpose.Transform.from_quaternion([0, 0, 0], [0, 0, np.sqrt(0.5), np.sqrt(0.5)])  # about z: x becomes y
        np.testing.assert_allclose(quarter.rotation @ [1, 0, 0], [0, 1, 0], atol=1e-15)

    def test_perturbations(self):
        start = evpose.Transform.from_quaternion([0.1, -0.2, 1.5], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
        same = start.perturbed(np.zeros(6))
        np.testing.assert_array_equal(same.translation_m, start.translation_m)
        np.testing.assert_allclose(same.quaternion_xyzw, start.quaternion_xyzw, atol=1e-15)
        for angle in (1e-9, 0.1, -3.0):
            turned = start.perturbed([0.02, 0, -0.01, 0, 0, angle])
            np.testing.assert_allclose(turned.translation_m, [0.12, -0.2, 1.49], atol=1e-15)
            c, s = np.cos(angle), np.sin(angle)
            np.testing.assert_allclose(turned.rotation, np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ start.rotation, atol=1e-14)
        self.assertIn("tangent", message_of(evpose.InvalidArgumentError, start.perturbed, np.zeros(5)))

    def test_the_pose_at_another_time_follows_its_twist(self):
        pose = evpose.Pose(1, "object", 1_000_000, np.array([0.1, -0.2, 1.5]), np.array([0, 0, 0, 1.0]), np.eye(6),
                           np.array([2.0, 0, -1.0, 0, 0, 10.0]), evpose.TrackState.TRACKING, 1, 1.0, 0.5, 0.001, ())
        later = pose.at(1_010_000)
        np.testing.assert_allclose(later.translation_m, [0.12, -0.2, 1.49], atol=1e-15)
        np.testing.assert_allclose(later.quaternion_xyzw, [0, 0, np.sin(0.05), np.cos(0.05)], atol=1e-15)

    def test_wrong_transforms(self):
        make = evpose.Transform.from_quaternion
        for t, q, words in (([0, 0], [0, 0, 0, 1], "3 numbers"), ([0, 0, 0], [0, 0, 0, 1.1], "its norm is 1.1"),
                            ([0, 0, np.nan], [0, 0, 0, 1], "finite"), ([0, 0, "a"], [0, 0, 0, 1], "translation_m: is not an array of numbers"),
                            ([0, 0, 0], [[0], [0, 1]], "quaternion_xyzw: is not an array of numbers")):
            self.assertIn(words, message_of(evpose.InvalidArgumentError, make, t, q))
        for matrix, words in ((np.eye(3), "shape (3, 3)"), (2 * np.eye(4), "not a rotation"), (np.diag([1, 1, -1, 1]), "reflection"),
                              ([["a"]], "transform: is not an array of numbers")):
            self.assertIn(words, message_of(evpose.InvalidArgumentError, evpose.Transform.from_matrix, matrix))

    def test_a_wrong_transform_is_not_sent(self):
        for wrong, words in ((evpose.Transform(np.zeros(2), np.array([0, 0, 0, 1.0])), "translation_m: has the shape (2,)"),
                             (evpose.Transform(np.zeros(3), np.full(4, np.inf)), "quaternion_xyzw: every number must be finite")):
            tracked = evpose.TrackedObject("models/1", initial_camera_from_object=wrong)
            self.assertIn(words, message_of(evpose.InvalidArgumentError, tracked.to_proto))
            feed = EventFeed([], evpose.Encoding.FLAT64, (640, 480), 1 << 20, False, FeedPoint())
            self.assertIn(words, message_of(evpose.InvalidArgumentError, feed.reset_pose, evpose.PoseReset(wrong)))
        for reference, words in (([0, 0, 1], "shape (3,), but must have 4 numbers"), ([0, 0, 0, np.nan], "finite")):
            tracked = evpose.TrackedObject("models/1", reference_quaternion_xyzw=reference)
            self.assertIn("reference_quaternion_xyzw: ", message_of(evpose.InvalidArgumentError, tracked.to_proto))
            self.assertIn(words, message_of(evpose.InvalidArgumentError, tracked.to_proto))


if __name__ == "__main__":
    unittest.main()
