#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Runs small benchmarks with the program given and checks that plot.py draws each of their figures. Status 77 without matplotlib."""
import pathlib
import struct
import subprocess
import sys
import tempfile
import unittest

PLOT = pathlib.Path(__file__).with_name("plot.py")
EVPOSE = ""


def plot(*arguments):
    return subprocess.run([sys.executable, PLOT, *arguments], stderr=subprocess.PIPE, text=True, check=False)


class PlotTest(unittest.TestCase):
    def setUp(self):
        self.directory = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))

    def bench(self, *arguments):
        """The file with the output of the benchmark."""
        path = self.directory / f"{arguments[0]}.json"
        with open(path, "w", encoding="utf-8") as file:
            subprocess.run([EVPOSE, "bench", *arguments, "--json"], stdout=file, stderr=subprocess.DEVNULL, check=True)
        return path

    def check_pictures(self, expected):
        """The folder has these PNG files, and each is `expected` pixels wide and at least 300 high."""
        pictures = {path.name: path.read_bytes() for path in (self.directory / "out").iterdir()}
        self.assertEqual(set(pictures), set(expected))
        for name, content in pictures.items():
            self.assertEqual(content[:8], b"\x89PNG\r\n\x1a\n", name)
            width, height = struct.unpack(">II", content[16:24])
            self.assertEqual(width, expected[name], name)
            self.assertGreater(height, 300, name)

    def test_draws_the_sweeps_of_the_synthetic_experiment(self):
        result = self.bench("synthetic", "--trials", "2", "--methods", "mixture,mm,mm-released", "--sweeps", "noise,outliers")
        done = plot(result, "--out", self.directory / "out")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.check_pictures({"synthetic.png": 960})

    def test_draws_the_scenarios_and_their_summary(self):
        traces = self.directory / "traces.csv"
        result = self.bench("tracking", "--scenarios", "normal,half-out", "--estimators", "mixture,static-mm", "--seeds", "1",
                            "--paths", "1", "--duration", "0.1", "--traces", traces)
        done = plot(result, "--traces", traces, "--out", self.directory / "out")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.check_pictures({"tracking.png": 1680, "normal.png": 1440, "half-out.png": 1440})

    def test_refuses_other_files(self):
        other = self.directory / "other.json"
        other.write_text('{"rows": [{"part": "decode"}]}', encoding="utf-8")
        done = plot(other, "--out", self.directory / "out")
        self.assertEqual(done.returncode, 1)
        self.assertIn("other.json", done.stderr)


if __name__ == "__main__":
    EVPOSE = sys.argv.pop(1)
    if plot("--help").returncode == 77:
        print("skipped: python3-matplotlib is missing")
        sys.exit(77)
    unittest.main()
