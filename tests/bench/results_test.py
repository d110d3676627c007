#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The table of models in results.py, from runs with known figures."""
import unittest

import results

NO_POSE = float("nan")


def run(seed, outcome, error):
    return {"seed": seed, "outcome": outcome, "position_rmse_of_depth": error, "events_per_s": 1e6, "rotation_median_deg": 0.1,
            "rotation_p95_deg": 0.2, "longest_wrong_tracking_s": 0.0, "longest_weak_wrong_tracking_s": 0.0, "compute_ratio": 0.5}


def row(model, *runs):
    return {"model": model, "runs": list(runs), "preparation_s": 0.01, "triangles": 12, "mean_elements": 9.0}


def cells(*rows):
    """The cells of the table's rows, by the titles of the columns."""
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in results.models({"models": list(rows)}).splitlines()]
    return [dict(zip(lines[0], line, strict=True)) for line in lines[2:]]


class ModelsTableTest(unittest.TestCase):
    def test_the_largest_error_of_all_tessellations_is_the_worst(self):
        [line] = cells(row("cube-coarse", run(1, "kept", 0.001), run(2, "kept", 0.003)),
                       row("cube-fine", run(1, "kept", 0.004), run(2, "kept", 0.002)))
        self.assertEqual(line["shape"], "cube")
        self.assertEqual(line["kept"], "4 of 4")
        self.assertEqual(line["worst recording"], "seed 1, fine")
        self.assertEqual(line["position RMSE, % of depth: mean, worst"], "0.250, 0.400")

    def test_a_lost_recording_is_worse_than_a_weak_one_and_than_any_error(self):
        [line] = cells(row("t_slot-medium", run(1, "weak", 0.009), run(2, "lost", 0.001), run(3, "kept", 0.020)))
        self.assertEqual(line["shape"], "t_slot")
        self.assertEqual(line["worst recording"], "seed 2, medium")
        self.assertEqual(line["kept"], "1 of 3, 1 weak")

    def test_a_recording_without_any_pose_is_the_worst(self):
        for runs in ((run(1, "lost", NO_POSE), run(2, "lost", 0.02)), (run(2, "lost", 0.02), run(1, "lost", NO_POSE))):
            [line] = cells(row("cube-coarse", *runs))
            self.assertEqual(line["worst recording"], "seed 1, coarse")
            self.assertEqual(line["position RMSE, % of depth: mean, worst"], "-, -")

    def test_models_that_are_not_prepared_are_named(self):
        refused = {"model": "cube-fine", "error": "refused"}
        self.assertEqual(cells(refused)[0]["kept"], "not prepared")
        [line] = cells(row("cube-coarse", run(1, "kept", 0.001)), refused)
        self.assertEqual(line["kept"], "1 of 1; refused: 1")
        self.assertEqual(line["worst recording"], "seed 1, coarse")


if __name__ == "__main__":
    unittest.main()
