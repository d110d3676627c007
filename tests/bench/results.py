#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs benchmarks and prints their tables as Markdown, each with the commit, the machine and the command that measured it.

  tests/bench/results.py [SECTION ...]          prints to standard output
  tests/bench/results.py --update [SECTION ...] replaces the sections between their marks in core/experiments/RESULTS.md

Without --quick, a run takes hours; with it, minutes, of few trials and short recordings, and the tables say so. Needs a release build.
Sections of the page that were not run keep their text.
"""
import argparse
import json
import os
import re
import subprocess
import sys
import tempfile

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
PAGE = os.path.join(ROOT, "core/experiments/RESULTS.md")
EVPOSE = os.path.join(ROOT, "build/release/client/cli/evpose")


def table(header, rows):
    lines = [header, ["---"] * len(header)] + rows
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def tracking(result):
    rows = []
    for scenario in result["scenarios"]:
        for estimator in scenario["estimators"]:
            summary = estimator["summary"]
            rows.append([
                scenario["scenario"], estimator["name"], f"{100 * summary['position_rmse_of_depth']:.3f}",
                f"{summary['rotation_median_deg']:.2f} / {summary['rotation_p95_deg']:.2f}",
                f"{100 * summary['coverage_ratio']:.2f}", f"{summary['losses']:.0f}", f"{summary['nees_median']:.1f}",
            ])
    return table(["scenario", "estimator", "position RMSE, % of depth", "rotation median / p95, deg", "good poses, % of the time",
                  "losses", "NEES, median"], rows)


def first_pose(result):
    rows = [[row["object"], f"{row['spurious']} / {row['missing']}", row["method"], str(row["trials"]),
             f"{100 * row['success_ratio']:.1f}", f"{row['median_ms']:.1f} / {row['worst_ms']:.1f}"] for row in result["rows"]]
    return table(["object", "spurious / missing lines", "method", "trials", "right, %", "time median / worst, ms"], rows)


def from_events(result):
    rows = [[row["object"], str(row["starts"]), str(row["right"]), str(row["wrong"]), str(row["none"]),
             f"{row['first_pose_median_ms']:.1f}", f"{row['longest_wrong_ms']:.0f}"] for row in result["rows"]]
    return table(["object", "starts", "right from 50 ms of events", "wrong", "none", "events until the pose, median, ms",
                  "longest wrong, ms"], rows)


def synthetic(result):
    rows = [[row["sweep"], f"{row['value']:g}", row["method"], str(row["trials"]),
             f"{row['rotation_to_bound']:.2f} / {row['translation_to_bound']:.2f}"] for row in result["rows"]]
    return table(["sweep", "value", "method", "trials", "rotation / translation error over the Cramer-Rao bound"], rows)


def speed(result):
    rows = [[row["part"], row["what"], str(row["scene"]), row["measure"], f"{row[row['measure']]:.3f}"] for row in result["rows"]]
    return table(["part", "what", "scene", "measure", "value"], rows)


# name: (what prints it, arguments, arguments of --quick)
SECTIONS = {
    "tracking": (tracking, ["bench", "tracking", "--seeds", "1", "--paths", "1", "--estimators", "mixture,static-mm"],
                 ["--duration", "0.2"]),
    "first-pose": (first_pose, ["bench", "initialization"], ["--trials", "10", "--methods", "evpose,ransac"]),
    "from-events": (from_events, ["bench", "initialization", "--from-events"], ["--starts", "5", "--duration", "0.5", "--returns", "0"]),
    "synthetic": (synthetic, ["bench", "synthetic", "--sweeps", "outliers"], ["--trials", "20"]),
    "speed": (speed, ["bench", "speed", "--parts", "decode,windows,associate,estimate,track"], ["--duration", "0.05"]),
}


def without_null(pairs):
    """A benchmark writes null for a figure that no run has."""
    return {key: float("nan") if value is None else value for key, value in pairs}


def fail(message):
    print(f"results.py: {message}", file=sys.stderr)
    sys.exit(1)


def machine():
    with open("/proc/cpuinfo", encoding="utf-8") as file:
        model = re.search(r"^model name\s*: (.*)$", file.read(), re.M)
    return f"{model.group(1) if model else 'unknown processor'}, {os.cpu_count()} cores"


def run(name, is_quick):
    to_table, arguments, quick = SECTIONS[name]
    arguments = arguments + (quick if is_quick else [])
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "table.json")
        json_arguments = ["--json", path] if name == "speed" else ["--json"]
        done = subprocess.run([EVPOSE] + arguments + json_arguments, stdout=subprocess.PIPE, text=True, check=False)
        if done.returncode != 0:
            fail(f"evpose {' '.join(arguments)} ended with status {done.returncode}")
        if name == "speed":
            with open(path, encoding="utf-8") as file:
                result = json.load(file, object_pairs_hook=without_null)
        else:
            result = json.loads(done.stdout, object_pairs_hook=without_null)
    version = subprocess.run([EVPOSE, "--version"], stdout=subprocess.PIPE, text=True, check=True).stdout.strip()
    kind = "A quick run, for the order of magnitude only: measured" if is_quick else "Measured"
    return f"{kind} with `evpose {' '.join(arguments)}`, {version}, on {machine()}.\n\n{to_table(result)}\n"


def update(texts):
    with open(PAGE, encoding="utf-8") as file:
        page = file.read()
    for name, text in texts.items():
        mark = f"<!-- results: {name} -->\n"
        if page.count(mark) != 1:
            fail(f"{PAGE} must have the mark {mark.strip()} once")
        begin = page.index(mark) + len(mark)
        page = page[:begin] + text + page[page.index("<!-- end -->", begin):]
    with open(PAGE + ".new", "w", encoding="utf-8") as file:
        file.write(page)
    os.replace(PAGE + ".new", PAGE)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", metavar="SECTION", help=", ".join(SECTIONS))
    parser.add_argument("--quick", action="store_true", help="few trials, short recordings")
    parser.add_argument("--update", action="store_true", help="write into core/experiments/RESULTS.md")
    arguments = parser.parse_args()
    unknown = [name for name in arguments.sections if name not in SECTIONS]
    if unknown:
        parser.error(f"no section {', '.join(unknown)}; there are {', '.join(SECTIONS)}")
    if not os.access(EVPOSE, os.X_OK):
        fail("build first: cmake --preset release && cmake --build --preset release --target evpose")
    texts = {name: run(name, arguments.quick) for name in arguments.sections or SECTIONS}
    if arguments.update:
        update(texts)
        return
    for name, text in texts.items():
        print(f"## {name}\n\n{text}")


if __name__ == "__main__":
    main()
