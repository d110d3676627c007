#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""compare.py on tables that are good, worse, short, broken, or none."""
import json
import pathlib
import subprocess
import sys
import tempfile
import unittest

COMPARE = pathlib.Path(__file__).with_name("compare.py")


def decode(memcpy_ratio):
    return {"part": "decode", "what": "EVT3", "scene": "4", "measure": "memcpy_ratio", "memcpy_ratio": memcpy_ratio,
            "real_time_ratio": 99.0}


def path(tracker_ratio):
    return {"part": "path", "what": "EVT3", "scene": "10", "measure": "tracker_ratio", "more_is_better": True,
            "tracker_ratio": tracker_ratio}


class CompareTest(unittest.TestCase):
    def setUp(self):
        self.directory = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))

    def write(self, name, content):
        file = self.directory / name
        file.write_text(content if isinstance(content, str) else json.dumps({"rows": content}), encoding="utf-8")
        return str(file)

    def run_compare(self, before, after, *more):
        arguments = [sys.executable, str(COMPARE), self.write("before.json", before), self.write("after.json", after)]
        return subprocess.run([*arguments, *more], capture_output=True, text=True, check=False)

    def line(self, result, begin):
        lines = [line for line in result.stdout.splitlines() if line.startswith(begin)]
        self.assertEqual(len(lines), 1, result.stdout)
        return lines[0].split()

    def test_equal_tables_are_good(self):
        result = self.run_compare([decode(8.0), path(0.7)], [decode(8.0), path(0.7)], "--worst", "1.0")
        self.assertEqual(result.returncode, 0, result.stdout)
        self.assertEqual(self.line(result, "decode")[-3:], ["8.0000", "8.0000", "1.00"])

    def test_more_time_is_worse(self):
        result = self.run_compare([decode(8.0)], [decode(10.0)], "--worst", "1.2")
        self.assertEqual(result.returncode, 1)
        self.assertEqual(self.line(result, "decode")[-2:], ["1.25", "worse"])
        self.assertEqual(self.run_compare([decode(8.0)], [decode(10.0)], "--worst", "1.3").returncode, 0)
        self.assertEqual(self.run_compare([decode(8.0)], [decode(10.0)]).returncode, 0, "without --worst the table is printed only")

    def test_less_of_what_more_is_better_of_is_worse(self):
        result = self.run_compare([path(0.8)], [path(0.4)], "--worst", "1.5")
        self.assertEqual(result.returncode, 1)
        self.assertEqual(self.line(result, "path")[-2:], ["2.00", "worse"])
        self.assertEqual(self.run_compare([path(0.4)], [path(0.8)], "--worst", "1.0").returncode, 0)
        self.assertEqual(self.run_compare([path(0.4)], [path(0.0)], "--worst", "9.0").returncode, 1)

    def test_a_row_that_is_missing_fails_and_a_new_one_is_told(self):
        result = self.run_compare([decode(8.0), path(0.8)], [decode(8.0)])
        self.assertEqual(result.returncode, 1)
        self.assertEqual(self.line(result, "path")[-1], "missing")
        result = self.run_compare([decode(8.0)], [decode(8.0), path(0.8)])
        self.assertEqual(result.returncode, 0)
        self.assertEqual(self.line(result, "path")[-1], "new")

    def test_what_is_no_table_is_wrong_usage(self):
        good = [decode(8.0)]
        unmeasured = {"part": "decode", "what": "EVT3", "scene": "4", "memcpy_ratio": 8.0}
        for broken in ("", "{", "[]", "{}", '{"rows": 3}', '{"rows": [3]}', [{"part": "decode"}], [unmeasured],
                       [{**decode(8.0), "memcpy_ratio": "fast"}], []):
            for before, after, name in ((broken, good, "before.json"), (good, broken, "after.json")):
                result = self.run_compare(before, after)
                self.assertEqual(result.returncode, 2, broken)
                self.assertIn(name, result.stderr)
                self.assertNotIn("Traceback", result.stderr)

    def test_rows_measured_otherwise_are_wrong_usage(self):
        other = {**decode(8.0), "measure": "real_time_ratio"}
        result = self.run_compare([decode(8.0)], [other])
        self.assertEqual(result.returncode, 2)
        self.assertIn("memcpy_ratio before, as real_time_ratio after", result.stderr)

    def test_a_file_that_is_not_there_is_wrong_usage(self):
        missing = str(self.directory / "missing.json")
        result = subprocess.run([sys.executable, str(COMPARE), missing, missing], capture_output=True, text=True,
                                check=False)
        self.assertEqual(result.returncode, 2)
        self.assertIn("missing.json: No such file", result.stderr)
        self.assertEqual(subprocess.run([sys.executable, str(COMPARE)], capture_output=True, check=False).returncode, 2)


if __name__ == "__main__":
    unittest.main()
