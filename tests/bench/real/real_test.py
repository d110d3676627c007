#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Commands on a recording of a real sensor: a server tracks it without a prior, and a profile that it does not determine is refused.

  real_test.py --bin BUILD --data DIR

DIR has the recordings, as replays.py and calibration.py read them. Status 77 without them.
"""
import argparse
import os
import sys
import tempfile
import unittest

import calibration
import replays

ARGUMENTS = argparse.Namespace()
NAME = "shapes_rotation"


class RealRecordingTest(unittest.TestCase):
    def recording(self):
        directory = self.enterContext(tempfile.TemporaryDirectory())
        evpose = os.path.join(ARGUMENTS.bin, "client/cli/evpose")
        return calibration.Recording(evpose, NAME, os.path.join(ARGUMENTS.data, NAME), directory)

    def test_a_server_finds_the_object_without_a_prior_and_keeps_it(self):
        [row] = replays.measure(ARGUMENTS.bin, ARGUMENTS.data, [NAME])
        self.assertEqual(row["sent_events"], row["events"])
        self.assertLess(row["first_pose_s"], 0.25)
        self.assertEqual(row["losses"], 0)
        self.assertGreater(row["tracking_ratio"], 0.9)
        self.assertLess(row["median_px"], 0.4)
        self.assertLess(row["p95_px"], 1.0)

    def test_a_profile_that_the_recording_does_not_determine_is_refused_with_the_reason(self):
        """The recording has 1.4 s. No profile is written, so that the previous one stays in use."""
        recording = self.recording()
        row = calibration.fit_profile(recording, [])
        self.assertRegex(row["error"], "too little data to fit a sensor profile: [1-9][0-9]* passages of [1-9]")
        self.assertEqual(os.listdir(recording.directory), [])


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--bin", required=True)
    parser.add_argument("--data", required=True)
    ARGUMENTS, rest = parser.parse_known_args()
    if not os.path.isdir(os.path.join(ARGUMENTS.data, NAME)):
        print(f"skipped: {ARGUMENTS.data} has no {NAME}")
        sys.exit(77)
    unittest.main(argv=[sys.argv[0], *rest])
