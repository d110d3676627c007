#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The measures of calibrated cameras in self_calibration.py, and the tables of results.py for them and for real recordings."""
import pathlib
import sys
import unittest

import numpy as np

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))
import self_calibration as bench  # noqa: E402
from result_tables import cameras  # noqa: E402

SEEN = np.ones((9, 16))


def estimate(name, shift_px=0.0, k1=0.0):
    """The lens with another centre and coefficient k1."""
    fx, fy, cx, cy, model, coefficients, _ = bench.LENSES[name]
    return fx, fy, cx + shift_px, cy, model, [coefficients[0] + k1, *coefficients[1:]]


def cells(text):
    """The cells of the first row of a table, by the titles of the columns."""
    header, _, row = ([cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines()[:3])
    return dict(zip(header, row, strict=True))


class MeasuresTest(unittest.TestCase):
    def test_each_lens_has_one_direction_for_each_pixel(self):
        corners = np.array([[0.0, 0.0], [1279.0, 0.0], [0.0, 719.0], [1279.0, 719.0]])
        for name, (fx, fy, cx, cy, model, coefficients, _) in bench.LENSES.items():
            with self.subTest(name):
                self.assertEqual(len(coefficients), len(bench.COEFFICIENTS[model]))
                directions = bench.undistort(model, coefficients, (corners - (cx, cy)) / (fx, fy))
                np.testing.assert_allclose(bench.distort(model, coefficients, directions) * (fx, fy) + (cx, cy), corners, atol=1e-6)

    def test_a_rotation_absorbs_a_shift_of_the_centre_but_no_distortion(self):
        for name, lens in bench.LENSES.items():
            with self.subTest(name):
                self.assertLess(max(bench.projection_errors(lens, estimate(name), SEEN)), 1e-9)
                projection, rotated, distortion = bench.projection_errors(lens, estimate(name, shift_px=0.4), SEEN)
                self.assertAlmostEqual(projection, 0.4, places=9)
                self.assertLess(rotated, 0.08)
                self.assertLess(distortion, 1e-9)
        lens = bench.LENSES["standard"]
        projection, rotated, _ = bench.projection_errors(lens, estimate("standard", k1=0.01), SEEN)
        self.assertGreater(rotated, 0.9 * projection)

    def test_the_rotation_is_found(self):
        directions = np.array([[0.1, 0.2], [-0.5, 0.3], [0.4, -0.4], [0.0, 0.0]])
        turned = bench.rotated(directions, np.array([0.02, -0.01, 0.03]))
        self.assertGreater(np.abs(turned - directions).max(), 0.01)
        self.assertLess(bench.error_after_rotation(lambda points: points, directions, turned), 1e-9)

    def test_coefficients_that_stay_at_their_defaults_are_not_compared(self):
        truth = {"fx_px": 1000.0, "fy_fx": 1.0, "cx_px": 600.0, "cy_px": 300.0, "k1": 0.1, "k4": 0.4}
        values = {"fx_px": (1002.0, 1.0), "fy_fx": (1.0, None), "cx_px": (600.5, 0.5), "cy_px": (300.0, 0.5), "k1": (-0.3, 0.01)}
        self.assertEqual(bench.errors_in_sigmas({**values, "k4": (0.0, None)}, truth), [2.0, 1.0, 0.0])
        values["fy_fx"] = (1.0, 0.001)
        self.assertEqual(len(bench.errors_in_sigmas({**values, "k4": (0.4, 0.1)}, truth)), 6)

    def test_missed_goals_are_named(self):
        row = {"lens": "narrow", "seed": 2, **bench.GOALS}
        self.assertEqual(bench.missed_goals(row), [])
        row["centre_px"] = 0.42
        self.assertEqual(bench.missed_goals(row), ["narrow, seed 2: centre_px is 0.420, the goal 0.3"])


class TablesTest(unittest.TestCase):
    def test_a_recording_without_a_pose_has_its_events_alone(self):
        [row] = cameras.read('skipped: nothing\n{"recording": "board", "sensor": "dvs128", "seconds": 0.5, "events": 7, "first_pose_s": null, '
                            '"losses": 0, "tracking_ratio": null, "residual_px": null, "median_px": null, "p95_px": null}\n')
        line = cells(cameras.replays([row]))
        self.assertEqual((line["events"], line["first pose, s"]), ("7", "-"))

    def test_refused_profiles_are_named_below_the_cameras(self):
        poses = {"given_px": 0.3, "given_poses": 9, "own_px": None, "own_poses": 0, "ratio": None}
        error = "evpose calibrate: /d/a/recording.raw: too little data; record more"
        refused = {"recording": "a", "guess": "profile", "error": error, **poses}
        camera = {"recording": "a", "guess": 0.8, "error": None, "parameters": {"fx_px": {"value": 200.0, "standard_error": None}},
                  "not_determined": ["fx_px"], **poses, "own_px": 0.33, "own_poses": 8, "ratio": 1.1}
        text = cameras.real_cameras([camera, refused])
        line = cells(text)
        self.assertEqual((line["error of the first guess"], line["fx, px"], line["ratio"]), ("-20 %", "200.0 +- -", "1.10"))
        self.assertTrue(text.endswith("\n\n- a: too little data"))
        self.assertEqual(cells(cameras.real_cameras([{**refused, "guess": 1.2}]))["not determined"], "too little data")


if __name__ == "__main__":
    unittest.main()
