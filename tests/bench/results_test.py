#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The tables of models and of the page in results.py, from runs with known figures."""
import unittest

from result_tables import models, seeing

NO_POSE = float("nan")


def run(seed, outcome, error):
    return {"seed": seed, "outcome": outcome, "position_rmse_of_depth": error, "events_per_s": 1e6, "rotation_median_deg": 0.1,
            "rotation_p95_deg": 0.2, "longest_wrong_tracking_s": 0.0, "longest_weak_wrong_tracking_s": 0.0, "compute_ratio": 0.5}


def row(model, *runs):
    return {"model": model, "runs": list(runs), "preparation_s": 0.01, "triangles": 12, "mean_elements": 9.0}


def cells(*rows):
    """The cells of the table's rows, by the titles of the columns."""
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in models.models({"models": list(rows)}).splitlines()]
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


def start(right_us, wrong_at_us=-1, longest_wrong_us=0):
    return {"moved_us": 10_000, "right_us": right_us, "wrong_at_us": wrong_at_us, "longest_wrong_us": longest_wrong_us,
            "poses": {"tracking": 60, "degraded": 15, "ambiguous": 25 if right_us < 0 else 5}}


class FirstPosesTableTest(unittest.TestCase):
    def test_starts_are_found_within_the_limit_and_wrong_ones_are_counted(self):
        searches = [{"has_moved": True, "compute_s": 0.04}, {"has_moved": True, "compute_s": 0.09}, {"has_moved": False, "compute_s": 1.0}]
        starts = [start(30_000), start(310_000), start(310_001), start(-1, 20_000, 31_000)]
        result = {"models": [{"model": "cube-medium", "searches": searches, "starts": starts}, {"model": "mug-medium", "error": "refused"}]}
        lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in models.first_poses(result).splitlines()]
        self.assertEqual(lines[2], ["cube", "2 of 4", "160", "1, 31", "12", "65 / 90"])
        self.assertEqual(lines[3], ["mug", "0 of 0", "-", "0, 0", "-", "-"])
        self.assertEqual(lines[4], ["all", "2 of 4", "160", "1, 31", "12", "65 / 90"])


class SeeingTablesTest(unittest.TestCase):
    def lines(self, text):
        return [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines()[2:]]

    def test_the_page_has_a_value_of_each_run_beside_the_goal(self):
        figures = {"first_s": 0.625, "rate_hz": 31.24, "skipped": 2, "delay_ms": 11.4, "delay_95_ms": 36.0, "poses": 800, "late_ms": 0.31, "age_ms": 1.26}
        lines = self.lines(seeing.page({"mev_per_s": 10.2, "rate_hz": 40.0, "runs": [figures, {**figures, "rate_hz": 29.96}]}))
        self.assertIn(["images drawn per second, of 40 that were asked for", "30", "31.2, 30.0"], lines)
        self.assertIn(["from the newest event of an image to the frame that shows it, median, ms", "100", "11, 11"], lines)
        self.assertIn(["largest delay of the events at the pipe, ms", "", "0.3, 0.3"], lines)
        self.assertIn(["age of the oldest event that waits at the end, ms", "", "1.3, 1.3"], lines)

    def test_watchers_have_their_standard_error(self):
        rows = [{"watchers": "the first", "more_percent": 1.234, "error_percent": 0.456, "pairs": 20},
                {"watchers": "each further", "more_percent": 0.12, "error_percent": 0.051, "pairs": 18}]
        self.assertEqual(self.lines(seeing.watchers({"mev_per_s": 10.2, "rate_hz": 30.0, "rows": rows})),
                         [["the first", "10", "1.23", "0.46", "20"], ["each further", "1", "0.12", "0.05", "18"]])

    def test_the_python_client_has_its_throughput_in_both_times(self):
        rows = [{"kind": "raw", "mev_per_cpu_s": 50.04, "mev_per_wall_s": 17.2}, {"kind": "arrays", "mev_per_cpu_s": 29.0, "mev_per_wall_s": 12.0}]
        lines = self.lines(seeing.python_client({"rows": rows, "ratio_to_replay": 0.81, "whole_process_ratio": 1.3}))
        self.assertEqual(lines[:3], [["Mev/s of its processor time", "10", "50.0", "29.0"],
                                     ["Mev/s of wall time, with the server", "10", "17.2", "12.0"],
                                     ["processor time over that of `evpose replay`", "", "0.81", ""]])


if __name__ == "__main__":
    unittest.main()
