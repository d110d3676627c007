#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Options and environment with which a server must not start, and must say why."""

import unittest

import server

DURATIONS = ["--attach-timeout", "--session-expiry", "--shutdown-notice", "--shutdown-timeout", "--stream-idle-timeout",
             "--upload-timeout", "--response-timeout", "--listener-timeout", "--model-cpu-seconds"]


class OptionTest(server.AdversaryTest):
    def test_durations_are_finite(self):
        for option in DURATIONS:
            for value in ("nan", "inf", "-1", "1e300"):
                with self.subTest(f"{option} {value}"):
                    self.assertIn(option, self.assert_not_started(f"{option}={value}", status=2))

    def test_threads_that_cannot_be_made_are_an_error(self):
        line = self.assert_not_started("--workers", "1024", prlimit=[f"--as={3 << 30}"], status=1)
        self.assertIn("thread", line)


if __name__ == "__main__":
    unittest.main()
