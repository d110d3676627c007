#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""capacity.py on cells whose result is known."""
import contextlib
import io
import unittest

import numpy

import capacity


CONSTANT = ["--rates", "1", "--shares", "1"]


def options(*words):
    return capacity.parse(["--half-s", "60", "--seeds", "2", *words])


class CapacityTest(unittest.TestCase):
    def most(self, servers, *words, max_sessions=100, cores=4):
        chosen = options(*words)
        return capacity.most_cameras(capacity.Servers(servers, cores, max_sessions, 0.95), capacity.camera_of(chosen), chosen)

    def test_sessions_fill_what_remains_after_the_loss_of_a_zone(self):
        """The four servers that remain take four sessions each."""
        self.assertEqual(self.most(6, *CONSTANT, "--costs", "1:0.1", "--session-s", "1e9", "--half-s", "600", max_sessions=4), 16)

    def test_cores_bound_the_cameras(self):
        """Three cameras of 1.33 cores are on time at a server of four cores, three of 1.34 cores never are."""
        fits, exceeds = (self.most(3, *CONSTANT, "--costs", f"1:{cores}", "--session-s", "1e9", max_sessions=3) for cores in (1.33, 1.34))
        self.assertEqual(fits, 6)
        self.assertLess(exceeds, 6)

    def test_a_camera_that_needs_more_than_a_server_does_not_fit(self):
        self.assertEqual(self.most(3, *CONSTANT, "--costs", "1:4.1"), 0)

    def test_cheaper_cameras_are_more(self):
        few, many = (self.most(3, "--costs", f"3:{cores}", max_sessions=40) for cores in (2.4, 0.6))
        self.assertGreater(few, 0)
        self.assertGreater(many, 2 * few)

    def test_cameras_that_change_together_need_more_servers(self):
        apart, together = (self.most(12, "--common", share, "--costs", "3:1.26", max_sessions=40) for share in ("0", "1"))
        self.assertLess(together, apart)

    def test_a_backlog_delays_until_it_is_processed(self):
        """Ten seconds of eight cores for one server of four need ten more seconds."""
        demands = numpy.zeros((30, 1))
        demands[:10] = 8
        cell = capacity.Cell(numpy.random.default_rng(1), capacity.Servers(1, 4, 1, 2), demands, 1e9)
        delayed = [cell.step(second)[0] for second in range(30)]
        self.assertEqual(delayed, [1] * 19 + [0] * 11)

    def test_a_refused_session_waits_for_the_next_try(self):
        cell = capacity.Cell(numpy.random.default_rng(1), capacity.Servers(1, 4, 1, 2), numpy.zeros((12, 2)), 1e9)
        cell.step(0)
        cell._server_of[:] = -1
        self.assertEqual([cell.step(second)[1] for second in (1, 2, 3, 4)], [1] * 4)

    def test_costs_are_linear_between_the_given_rates(self):
        camera = capacity.Camera([0.5, 1, 5.5], [0.2, 0.3, 0.5], 10, 0, [(1, 0.4), (10, 0.8)])
        numpy.testing.assert_allclose(camera.cores(), [0.2, 0.4, 0.6])
        self.assertAlmostEqual(camera.mean_cores(), 0.46)

    def test_demands_have_the_given_shares_and_dwell_times(self):
        camera = capacity.Camera([1, 2], [0.25, 0.75], dwell_s=10, common=0, costs=[(2, 1)])
        demands = camera.demands(numpy.random.default_rng(1), 400, 2000)
        self.assertEqual(set(numpy.unique(demands)), {0.5, 1.0})
        self.assertAlmostEqual((demands == 0.5).mean(), 0.25, delta=0.01)
        # A change draws the other rate in 2 * 0.25 * 0.75 of all cases.
        self.assertAlmostEqual((numpy.diff(demands, axis=0) != 0).mean(), 0.375 / 10, delta=0.002)

    def test_a_lost_server_has_no_sessions(self):
        servers = capacity.Servers(3, 4, 4, 0.9)
        before, after = capacity.simulate(1, servers, capacity.Camera([1], [1], 10, 0, [(1, 0.1)]), 12, options("--session-s", "1e9"), lost=1)
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
        for words, error in ((["--shares", "0.5", "0.4"], "their sum must be 1"), (["--servers", "2"], "3 zones"), (["--common", "2"], "between 0 and 1"),
                             (["--rates", "20", "--shares", "1"], "up to the highest of --rates")):
            with self.subTest(words), contextlib.redirect_stderr(io.StringIO()) as err, self.assertRaises(SystemExit):
                options(*words)
            self.assertIn(error, err.getvalue())


if __name__ == "__main__":
    unittest.main()
