#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""capacity.py on cells whose result is known."""
import contextlib
import io
import unittest

import numpy

import capacity


def options(*words):
    return capacity.parse(["--half-s", "60", "--seeds", "2", *words])


class CapacityTest(unittest.TestCase):
    def most(self, servers, *words, max_sessions=100, cores=4):
        chosen = options(*words)
        return capacity.most_cameras(capacity.Servers(servers, cores, max_sessions, 0.95), capacity.camera_of(chosen), chosen)

    def test_constant_cameras_fill_what_remains_after_the_loss_of_a_zone(self):
        """Four cameras of one core for each server of the two zones that remain. One more does not fit, and one less always does."""
        most = self.most(6, "--rates", "1", "--shares", "1", "--cores-per-mev-s", "0.1", max_sessions=4)
        self.assertEqual(most, 16)

    def test_a_camera_that_needs_more_than_a_server_does_not_fit(self):
        self.assertEqual(self.most(3, "--rates", "1", "--shares", "1", "--cores-per-mev-s", "4.1"), 0)

    def test_cheaper_cameras_are_more(self):
        few, many = (self.most(3, "--cores-per-mev-s", cost, max_sessions=40) for cost in ("0.8", "0.2"))
        self.assertGreater(few, 0)
        self.assertGreater(many, 2 * few)

    def test_cameras_that_change_together_need_more_servers(self):
        apart, together = (self.most(12, "--common", share, "--cores-per-mev-s", "0.42", max_sessions=40) for share in ("0", "1"))
        self.assertLess(together, apart)

    def test_demands_have_the_given_shares_and_dwell_times(self):
        camera = capacity.Camera([1, 2], [0.25, 0.75], dwell_s=10, common=0, cores_per_mev_s=0.5)
        demands = camera.demands(numpy.random.default_rng(1), 400, 2000)
        self.assertEqual(set(numpy.unique(demands)), {0.5, 1.0})
        self.assertAlmostEqual((demands == 0.5).mean(), 0.25, delta=0.01)
        # A change draws the other rate in 2 * 0.25 * 0.75 of all cases.
        self.assertAlmostEqual((numpy.diff(demands, axis=0) != 0).mean(), 0.375 / 10, delta=0.002)

    def test_a_lost_server_has_no_sessions(self):
        servers = capacity.Servers(3, 4, 4, 0.9)
        before, after = capacity.simulate(1, servers, capacity.Camera([1], [1], 10, 0, 0.1), 12, options("--session-s", "1e9"), lost=1)
        self.assertEqual((before.delayed, before.waiting), (0, 0))
        # Two servers keep their four sessions each, and have no room for the other four.
        self.assertAlmostEqual(after.waiting, 4 / 12)

    def test_the_same_seed_gives_the_same_times(self):
        chosen = options()
        runs = [capacity.simulate(7, capacity.Servers(3, 4, 12, 0.9), capacity.camera_of(chosen), 20, chosen, 1) for _ in range(2)]
        self.assertEqual(*runs)

    def test_redis_limits(self):
        limits = capacity.redis_limits(options("--redis-gb", "3", "--session-mb", "8.3", "--redis-core", "0.005", "--redis-load", "0.5",
                                               "--written-mb-s", "0.5", "--network-gbit-s", "1"))
        self.assertEqual(limits, {"memory": 361, "processor": 100, "network": 125})

    def test_wrong_options_are_errors(self):
        for words, error in ((["--shares", "0.5", "0.4"], "their sum must be 1"), (["--servers", "2"], "3 zones"), (["--common", "2"], "between 0 and 1")):
            with self.subTest(words), contextlib.redirect_stderr(io.StringIO()) as err, self.assertRaises(SystemExit):
                options(*words)
            self.assertIn(error, err.getvalue())


if __name__ == "__main__":
    unittest.main()
