#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""flicker.py on trajectories whose wrong periods are known."""
import pathlib
import tempfile
import unittest

import flicker

HALF_TURN = (0.0, 0.0, 1.0, 0.0)
NO_TURN = (0.0, 0.0, 0.0, 1.0)


class WrongTimesTest(unittest.TestCase):
    def wrong_times_ms(self, poses):
        """`poses`: (time in ms, state, x in m, quaternion); the true pose is at rest at a depth of 1 m."""
        with tempfile.TemporaryDirectory() as folder:
            truth = pathlib.Path(folder, "truth.tum")
            truth.write_text("# t x y z qx qy qz qw\n" + "".join(f"{t / 1000} 0 0 1 0 0 0 1\n" for t in range(20)), encoding="utf-8")
            table = pathlib.Path(folder, "poses.csv")
            lines = [f"{t * 1000},{state},{x},0,1,{','.join(str(q) for q in turn)}" for t, state, x, turn in poses]
            table.write_text("\n".join(["t_us,state,tx_m,ty_m,tz_m,qx,qy,qz,qw", *lines]) + "\n", encoding="utf-8")
            return flicker.wrong_times_ms(table, truth)

    def test_right_poses_have_no_wrong_period(self):
        self.assertEqual(self.wrong_times_ms([(t, "TRACKING", 0.049, NO_TURN) for t in range(10)]), [])

    def test_both_signs_of_a_quaternion_are_one_rotation(self):
        self.assertEqual(self.wrong_times_ms([(1, "TRACKING", 0, (0, 0, 0, -1))]), [])

    def test_each_period_has_its_duration(self):
        poses = [(t, "TRACKING", 0, HALF_TURN if t in (2, 3, 4, 7, 8) else NO_TURN) for t in range(10)]
        self.assertEqual(self.wrong_times_ms(poses), [2.0, 1.0])

    def test_a_wrong_position_counts(self):
        self.assertEqual(self.wrong_times_ms([(1, "TRACKING", 0.051, NO_TURN)]), [0.0])

    def test_poses_of_other_states_are_not_counted(self):
        self.assertEqual(self.wrong_times_ms([(t, "DEGRADED", 0, HALF_TURN) for t in range(10)]), [])


if __name__ == "__main__":
    unittest.main()
