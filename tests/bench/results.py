#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs benchmarks and prints their tables as Markdown, each with the commit, the machine, its load and the command that measured it.

  tests/bench/results.py [SECTION ...]          prints to standard output
  tests/bench/results.py --update [SECTION ...] replaces the sections between their marks in core/experiments/RESULTS.md

Without SECTION all tables of the page are measured: hours, or with --quick minutes, of few trials and short recordings, and the tables
say so. Needs a release build and a machine that does nothing else. Sections that were not run keep their text. --check compares the
page with the sections without running anything: each table of the page must stand between the marks of a section.
"""
import argparse
import hashlib
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import textwrap

from result_tables import cameras, models, seeing
from result_tables.markdown import cell, distinct, table

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
PAGE = os.path.join(ROOT, "core/experiments/RESULTS.md")
EVPOSE = os.path.join(ROOT, "build/release/client/cli/evpose")
MARK = "<!-- results: %s -->\n"
END = "<!-- end -->"
COLUMNS = 140  # tests/lint/check_tree.py


def tracking(result):
    rows = []
    for scenario in result["scenarios"]:
        summaries = {estimator["name"]: estimator["summary"] for estimator in scenario["estimators"]}
        ours, published = summaries["mixture"], summaries["static-mm"]
        lost = f"lost, {100 * published['coverage_ratio']:.0f} %"
        rows.append([
            f"{scenario['scenario']}: {scenario['description']}", f"**{cell(100 * ours['position_rmse_of_depth'], 3)}**",
            f"**{cell(ours['rotation_median_deg'], 2)} / {cell(ours['rotation_p95_deg'], 2)}**",
            f"{cell(100 * ours['coverage_ratio'], 2)} %", f"{ours['losses']:.0f}",
            f"{cell(ours['nees_median'], 1)} / {100 * ours['nees_inside_95_ratio']:.0f} %",
            lost if published["losses"] else cell(100 * published["position_rmse_of_depth"], 3),
        ])
    return table(["scenario", "position RMSE, % of depth", "rotation median / p95, deg", "good poses", "losses",
                  "NEES, median / inside 95 %", "paper's MM, position"], rows)


def first_pose(result):
    rows = result["rows"]
    objects = distinct(row["object"] for row in rows)
    lines = []
    for method in distinct(row["method"] for row in rows):
        cells, times, trials = [], [], set()
        for name in objects:
            found = [row for row in rows if row["object"] == name and row["method"] == method]
            cells.append(", ".join(f"{100 * row['success_ratio']:.1f}".removesuffix(".0") for row in found) or "-")
            times.append(f"{cell(found[-1]['median_ms'], 1)} / {cell(found[-1]['worst_ms'], 1)}" if found else "-")
            trials.update(row["trials"] for row in found)
        lines.append([method, " or ".join(str(count) for count in sorted(trials))] + cells)
        if method == "evpose":
            clutter = f"{rows[-1]['spurious']}/{rows[-1]['missing']}"
            lines.append([f"its time, median / worst, ms, at {clutter}", ""] + times)
    return table(["method", "trials"] + objects, lines)


def from_events(result):
    rows = result["rows"]
    returns = [[entry["tracked_us"] for entry in row["returns"]] for row in rows]
    worst_ms = [cell(max(times) / 1000, 0) if times and not any(t != t for t in times) else "-" for times in returns]
    return table([""] + [row["object"] for row in rows], [
        ["right pose from at most 50 ms of events"] + [f"{row['right']} of {row['starts']}" for row in rows],
        ["wrong first poses"] + [str(row["wrong"]) for row in rows],
        ["no pose within 250 ms"] + [str(row["none"]) for row in rows],
        ["events until the first pose, median, ms"] + [cell(row["first_pose_median_ms"], 1) for row in rows],
        ["its reprojection error, px"] + [cell(row["reprojection_mean_right_px"], 2) for row in rows],
        ["longest time of wrong poses, ms"] + [cell(row["longest_wrong_ms"], 0) for row in rows],
        [f"tracked again after a second of absence, worst of {len(returns[0])}, ms"] + worst_ms,
    ])


def synthetic(result):
    values = distinct(row["value"] for row in result["rows"])
    lines = []
    for method in distinct(row["method"] for row in result["rows"]):
        found = {row["value"]: row for row in result["rows"] if row["method"] == method}
        lines.append([method] + [f"{found[v]['rotation_to_bound']:.2f} / {found[v]['translation_to_bound']:.2f}" for v in values])
    return table(["outliers"] + [f"{100 * value:g} %" for value in values], lines)


def part(result, name):
    return [row for row in result["rows"] if row["part"] == name]


def by_scene(rows, lines):
    """A column for each scene of the rows; a line for each (title, text of a row)."""
    scenes = distinct(row["scene"] for row in rows)
    return [f"{scene} Mev/s" for scene in scenes], [
        [title] + [next((text(row) for row in rows if row["scene"] == scene and wanted(row)), "-") for scene in scenes]
        for title, wanted, text in lines]


def decoding(result):
    rows = part(result, "decode")
    scenes = distinct(row["scene"] for row in rows)
    lines = []
    for what in distinct(row["what"] for row in rows):
        found = {row["scene"]: row for row in rows if row["what"] == what}
        lines.append([what] + [f"{found[s]['ns_per_event']:.2f} / {found[s]['memcpy_ratio']:.1f}" for s in scenes])
    return table(["ns per event / times memcpy of the same bytes"] + [f"{scene} Mev/s" for scene in scenes], lines)


def tracking_speed(result):
    def line(title, name, text, what=None):
        return title, lambda row: row["part"] == name and (what is None or row["what"] == what), text

    def real_time(row):
        return f"{row['real_time_ratio']:.3f}"

    def cost(row):
        return f"{row['cost_ratio']:.1f}"

    rows = [row for name in ("track", "windows", "associate", "estimate") for row in part(result, name)]
    scenes, lines = by_scene(rows, [
        line("processor time per sensor time", "track", real_time),
        line("windows alone", "windows", real_time),
        line("association alone", "associate", real_time, "lines x1"),
        line("estimation alone", "estimate", real_time, "lines x1"),
        line("cost factor of association with 16 times the lines", "associate", cost, "lines x16"),
        line("cost factor of estimation with 16 times the lines", "estimate", cost, "lines x16"),
    ])
    return table(["tracking"] + scenes, lines)


def service_path(result):
    def line(title, key, decimals, name="path"):
        return title, lambda row: row["part"] == name, lambda row: cell(row.get(key, float("nan")), decimals)

    scenes, lines = by_scene(part(result, "path") + part(result, "memory"), [
        line("throughput, Mev/s", "mev_per_s", 1),
        line("throughput over that of the tracker alone", "tracker_ratio", 2),
        line("processor time of the client for 10^9 events, s", "client_cpu_s_per_gev", 0),
        line("processor time of the server for 10^9 events, s", "server_cpu_s_per_gev", 0),
        line("memory of a session, MB", "mb_per_session", 1, "memory"),
    ])
    return table(["from EVT3 to poses at the client"] + scenes, lines)


def service_latency(result):
    row = part(result, "latency")[0]
    return table(["pose at the client, ms, at the sensor's pace", "median", "99 %"], [
        [title, cell(row[f"{key}_p50_ms"], 2), cell(row[f"{key}_p99_ms"], 2)] for title, key in (
            ("after the end of the chunk that completes the window", "chunk"), ("after the end of the window", "window"),
            ("thereof within the server", "server"))])


def service_sessions(result):
    rows = part(result, "sessions")
    return table(["concurrent sessions"] + [row["what"] for row in rows],
                 [["processor time of the server per session, over that of a single one"] +
                  [cell(row["to_one_ratio"], 2) for row in rows]])


def event_rates(output):
    """`output` of event_rate.sh --json: a JSON object per line."""
    rows = [json.loads(line) for line in output.splitlines()]
    conditions = distinct(row["condition"] for row in rows)
    lines = []
    for name in distinct(row["object"] for row in rows):
        cells = []
        for condition in conditions:
            found = [100 * row["position_rmse_of_depth"] for row in rows if row["object"] == name and row["condition"] == condition]
            cells.append(f"{statistics.mean(found):.3f}, {max(found):.3f}")
        lines.append([name] + cells)
    header = []
    for condition in conditions:
        rates = [row["mev_per_s"] for row in rows if row["condition"] == condition]
        header.append(f"{condition}, {min(rates):.0f} to {max(rates):.0f} Mev/s")
    return table(["position RMSE, % of depth: mean, worst"] + header, lines)


def flicker(result):
    lines = []
    for name in distinct(row["object"] for row in result["rows"]):
        cells = []
        for light in distinct(row["light"] for row in result["rows"]):
            found = [row["wrong_ms"] for row in result["rows"] if (row["object"], row["light"]) == (name, light)]
            wrong = [max(times) for times in found if times]
            cells.append(f"{len(wrong)} of {len(found)}" + (f", {cell(max(wrong), 0)} ms" if wrong else ""))
        lines.append([name] + cells)
    header = [f"modulation of {light}" for light in distinct(row["light"] for row in result["rows"])]
    return table(["recordings with a wrong pose as TRACKING, longest period"] + header, lines)


def real(result):
    """Two lines for each recording, and one for the absent objects."""
    rows = []
    for recording in result["recordings"]:
        for start, runs in (("none", recording["searched"]), ("reference", recording["given"])):
            rows.append([
                recording["recording"], start, f"{runs['found']} of {runs['starts']}", f"{runs['first_wrong']}",
                f"{cell(1000 * runs['wait_median_s'], 1)} / {cell(1000 * runs['wait_longest_s'], 0)}",
                cell(1000 * runs["compute_median_s"], 1), cell(1000 * runs["longest_wrong_tracking_s"], 0),
                f"{100 * runs['right_ratio']:.1f} %", f"{runs['losses']}",
                f"{cell(runs['median_error_px'], 2)} / {cell(runs['p95_error_px'], 2)}",
            ])
    absent = result["absent"]
    tracked = [run for run in absent if run["found"]]
    pairs = len({(run["object"], run["recording"]) for run in absent})
    longest = f", the longest for {1000 * max(run['longest_wrong_tracking_s'] for run in tracked):.0f} ms" if tracked else ""
    text = table(["recording", "prior", "found", "first pose wrong", "wait, median / longest, ms", "processor time until then, ms",
                  "longest wrong while TRACKING, ms", "right", "losses", "error, median / p95 of the worst run, px"], rows)
    return (f"{text}\n\nAbsent objects: TRACKING in {len(tracked)} of {len(absent)} searches for {pairs} pairs of an object and a recording"
            f"{longest}, {sum(run['duration_s'] for run in absent):.1f} s searched.")


def read_json(text):
    # A benchmark writes null for a figure that no run has.
    return json.loads(text, object_pairs_hook=lambda pairs: {k: float("nan") if v is None else v for k, v in pairs})


def cmake_value(name):
    """The value of a variable of the release build; empty without one."""
    try:
        with open(os.path.join(ROOT, "build/release/CMakeCache.txt"), encoding="utf-8") as file:
            found = re.search(rf"^{name}:\w+=(.*)$", file.read(), re.M)
    except OSError:
        return ""
    return found.group(1) if found else ""


class Run:
    """A command, and the sections of the page that its output fills."""

    def __init__(self, command, quick, sections, read=read_json, setup=(), needs=""):
        self.command, self.quick, self.sections, self.read = command, quick, sections, read
        self.setup = setup  # command that makes its input
        self.needs = needs  # directory of input that is not part of the project; without it the sections are skipped

    def output(self, arguments):
        """Returns what the command with these arguments prints."""
        return self.read(output_of(arguments))

    def arguments(self, is_quick):
        """Returns the command; with --quick, the options of `quick` replace those of the same name."""
        command = list(self.command)
        for option, value in self.quick if is_quick else ():
            if option in command:
                command[command.index(option) + 1] = value
            else:
                command += [option, value]
        return command


class ModelsRun(Run):
    """Runs the models shape by shape. The output for each shape is kept beside the models, and is used again for the same program, files,
    arguments and machine, so that an interrupted measurement of hours continues."""

    def output(self, arguments):
        return {"models": self.rows(arguments, self.shapes(arguments))}

    def folder(self, arguments):
        return os.path.join(ROOT, arguments[arguments.index("--models") + 1])

    def shapes(self, arguments):
        """The entries of models.json by shape."""
        with open(os.path.join(self.folder(arguments), "models.json"), encoding="utf-8") as file:
            entries = json.load(file)
        names = distinct(models.shape_of(entry["name"]) for entry in entries)
        return {name: [entry for entry in entries if models.shape_of(entry["name"]) == name] for name in names}

    def rows(self, arguments, shapes, more=None):
        """The rows of all `shapes`. `more` returns further arguments for one of them."""
        folder = self.folder(arguments)
        with open(EVPOSE, "rb") as file:
            program = hashlib.sha256(file.read())
        program.update(machine().encode())
        rows = []
        for shape, variants in shapes.items():
            command = arguments + (more(shape) if more else []) + ["--names", ",".join(entry["name"] for entry in variants)]
            key = program.copy()
            key.update(json.dumps(command).encode())
            for path in distinct(path for entry in variants for path in (entry["file"], entry["reference"])):
                with open(os.path.join(folder, path), "rb") as file:
                    key.update(file.read())
            kept = os.path.join(folder, "results", f"{shape}-{key.hexdigest()[:16]}.json")
            rows += self.shape(kept, command)["models"]
        return rows

    def shape(self, kept, arguments):
        """Returns the output of the command, which the file `kept` has if it was run before."""
        if not os.path.exists(kept):
            text = output_of(arguments)
            os.makedirs(os.path.dirname(kept), exist_ok=True)
            with open(kept + ".new", "w", encoding="utf-8") as file:
                file.write(text)
            os.replace(kept + ".new", kept)
        with open(kept, encoding="utf-8") as file:
            return self.read(file.read())


class FirstPosesRun(ModelsRun):
    """First poses of the medium tessellation of each shape."""

    def shapes(self, arguments):
        return {name: [entry for entry in entries if entry["name"].endswith("-medium")]
                for name, entries in super().shapes(arguments).items()}


class AbsentPosesRun(FirstPosesRun):
    """The same; each shape is searched for in the recordings of the next one."""

    def rows(self, arguments, shapes, more=None):
        names = list(shapes)
        following = dict(zip(names, names[1:] + names[:1], strict=True))
        return super().rows(arguments, shapes, lambda shape: ["--shown", shapes[following[shape]][0]["name"]])


BENCH = ["evpose", "bench"]
GENERATE_MODELS = ["tests/bench/models/generate.py", "build/bench-models"]
FIRST_POSES = BENCH + ["models", "--models", "build/bench-models", "--first-pose", "--seeds", "2", "--duration", "0.8", "--starts", "10",
                       "--recordings", "build/bench-models/recordings-first-pose"]
QUICK_FIRST_POSES = [("--seeds", "1"), ("--starts", "2")]
# Recordings that are not part of the project, in the folder EVPOSE_SHARED_DATA of CMake.
REAL = os.path.join(cmake_value("EVPOSE_SHARED_DATA"), "real")
RUNS = [
    Run(BENCH + ["tracking", "--seeds", "1", "--paths", "1", "--estimators", "mixture,static-mm"], [("--duration", "0.2")],
        {"tracking": tracking}),
    Run(["tests/bench/event_rate.sh"], [("--objects", "cube"), ("--seeds", "31")], {"event-rate": event_rates}, read=str),
    Run(["tests/bench/flicker.py"], [("--objects", "book"), ("--seeds", "1")], {"flicker": flicker}),
    # All tessellations of a shape are tracked on the same recordings.
    ModelsRun(BENCH + ["models", "--models", "build/bench-models", "--seeds", "3", "--recordings", "build/bench-models/recordings"],
              [("--seeds", "1"), ("--duration", "0.2")], {"models": models.models}, setup=GENERATE_MODELS),
    FirstPosesRun(FIRST_POSES + ["--scene", "standard"], QUICK_FIRST_POSES, {"first-pose-models": models.first_poses},
                  setup=GENERATE_MODELS),
    FirstPosesRun(FIRST_POSES + ["--scene", "occluder"], QUICK_FIRST_POSES, {"first-pose-occluder": models.first_poses},
                  setup=GENERATE_MODELS),
    FirstPosesRun(FIRST_POSES + ["--scene", "moving-background"], QUICK_FIRST_POSES, {"first-pose-moving-background": models.first_poses},
                  setup=GENERATE_MODELS),
    AbsentPosesRun(FIRST_POSES, QUICK_FIRST_POSES, {"first-pose-absent": models.first_poses}, setup=GENERATE_MODELS),
    Run(BENCH + ["real", REAL, "--absent-starts", "8"], [("--starts", "3"), ("--parts", "present")], {"real": real}, needs=REAL),
    Run(["tests/bench/real/replays.py", "--bin", "build/release", REAL], [("--recording", "shapes_rotation")],
        {"real-replays": cameras.replays}, read=cameras.read, needs=REAL),
    Run(["tests/bench/real/calibration.py", "build/release/client/cli/evpose", REAL], [("--recording", "shapes_rotation")],
        {"real-cameras": cameras.real_cameras}, read=cameras.read, needs=REAL),
    Run(["tests/bench/self_calibration.py", "build/release/client/cli/evpose", "--seeds", "1"], [("--lens", "narrow"), ("--duration", "2")],
        {"simulated-cameras": cameras.simulated_cameras}, read=cameras.read),
    Run(BENCH + ["initialization"], [("--trials", "10"), ("--methods", "evpose,ransac")], {"first-pose": first_pose}),
    Run(BENCH + ["initialization", "--from-events"], [("--starts", "5"), ("--duration", "0.5"), ("--returns", "1")],
        {"from-events": from_events}),
    Run(BENCH + ["initialization", "--from-events", "--detector", "lsd", "--returns", "0"],
        [("--starts", "5"), ("--duration", "0.5")], {"from-events-lsd": from_events}),
    Run(BENCH + ["synthetic", "--sweeps", "outliers"], [("--trials", "20")], {"synthetic": synthetic}),
    Run(BENCH + ["speed", "--parts", "decode,windows,associate,estimate,track"],
        [("--duration", "0.05"), ("--repetitions", "1")], {"speed": decoding, "tracking-speed": tracking_speed}),
    Run(BENCH + ["speed", "--parts", "path,latency,sessions,memory"], [("--duration", "0.05"), ("--repetitions", "1")],
        {"service-path": service_path, "service-latency": service_latency, "service-sessions": service_sessions}),
    Run(["tests/bench/view_page.py", "--repetitions", "3"], [("--repetitions", "1"), ("--seconds", "2")], {"view-page": seeing.page}),
    Run(["tests/bench/event_images.py"], [("--repetitions", "1")], {"event-images": seeing.watchers}),
    Run(["tests/bench/python_client.py", "--core", "1"], [("--repetitions", "1"), ("--seconds", "0.2")],
        {"python-client": seeing.python_client}),
]
SECTIONS = [name for run in RUNS for name in run.sections]


def fail(message):
    print(f"results.py: {message}", file=sys.stderr)
    sys.exit(1)


def machine():
    with open("/proc/cpuinfo", encoding="utf-8") as file:
        model = re.search(r"^model name\s*: (.*)$", file.read(), re.M)
    return f"{model.group(1) if model else 'unknown processor'}, {os.cpu_count()} cores"


def output_of(arguments):
    """Returns the JSON that the command prints. `bench speed`, `bench models` and `bench real` write it to a file."""
    program = [EVPOSE if arguments[0] == "evpose" else os.path.join(ROOT, arguments[0])]
    if arguments[0].endswith(".py"):
        program.insert(0, sys.executable)  # the benchmarks of pages and clients need Debian's packages: /usr/bin/python3
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "table.json")
        writes_file = arguments[1:3] in (["bench", "speed"], ["bench", "models"], ["bench", "real"])
        done = subprocess.run(program + arguments[1:] + (["--out", path] if writes_file else ["--json"]),
                              stdout=subprocess.PIPE, text=True, check=False, cwd=ROOT)
        if done.returncode != 0:
            fail(f"{' '.join(arguments)} ended with status {done.returncode}")
        if not writes_file:
            return done.stdout
        with open(path, encoding="utf-8") as file:
            return file.read()


def measure(run, sections, is_quick):
    arguments = run.arguments(is_quick)
    if run.setup:
        subprocess.run([os.path.join(ROOT, run.setup[0])] + run.setup[1:], cwd=ROOT, stderr=subprocess.DEVNULL, check=True)
    version = subprocess.run([EVPOSE, "--version"], stdout=subprocess.PIPE, text=True, check=True).stdout.strip()
    load = os.getloadavg()[0]
    result = run.output(arguments)
    kind = "A quick run, for the order of magnitude only: measured" if is_quick else "Measured"
    command = " ".join("DIR" if argument == REAL else argument for argument in arguments)
    source = textwrap.fill(f"{kind} with `{command}`, {version}, on {machine()}, at a load of {load:.1f} before it.", COLUMNS,
                           break_long_words=False, break_on_hyphens=False)
    return {name: f"{source}\n\n{run.sections[name](result)}\n" for name in sections}


def read_page():
    with open(PAGE, encoding="utf-8") as file:
        return file.read()


def check(page):
    """Each section has its mark once, and no table stands outside."""
    for name in SECTIONS:
        if page.count(MARK % name) != 1:
            fail(f"{PAGE} must have the mark {(MARK % name).strip()} once")
    outside = re.sub(r"<!-- results: .*?<!-- end -->", "", page, flags=re.S)
    lines = [line for line in outside.splitlines() if line.startswith("|")]
    if lines:
        fail(f"{PAGE} has a table outside the marks: {lines[0]}")
    unknown = set(re.findall(r"<!-- results: (\S+) -->", page)) - set(SECTIONS)
    if unknown:
        fail(f"{PAGE} has marks of unknown sections: {', '.join(sorted(unknown))}")


def replace(page, texts):
    for name, text in texts.items():
        begin = page.index(MARK % name) + len(MARK % name)
        page = page[:begin] + text + page[page.index(END, begin):]
    return page


def update(texts):
    with open(PAGE + ".new", "w", encoding="utf-8") as file:
        file.write(replace(read_page(), texts))
    os.replace(PAGE + ".new", PAGE)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", metavar="SECTION", help=", ".join(SECTIONS))
    parser.add_argument("--quick", action="store_true", help="few trials, short recordings")
    parser.add_argument("--update", action="store_true", help="write into core/experiments/RESULTS.md")
    parser.add_argument("--check", action="store_true", help="check the marks of the page and measure nothing")
    arguments = parser.parse_args()
    unknown = [name for name in arguments.sections if name not in SECTIONS]
    if unknown:
        parser.error(f"no section {', '.join(unknown)}; there are {', '.join(SECTIONS)}")
    check(read_page())
    if arguments.check:
        return
    if not os.access(EVPOSE, os.X_OK):
        fail("build first: cmake --preset release && cmake --build --preset release")
    for run in RUNS:
        wanted = [name for name in run.sections if name in (arguments.sections or SECTIONS)]
        if not wanted:
            continue
        if run.needs and not os.path.isdir(os.path.join(ROOT, run.needs)):
            print(f"results.py: {run.needs} does not exist: {', '.join(wanted)} is skipped", file=sys.stderr)
            continue
        # Each run is written when it is done: the next ones take hours.
        texts = measure(run, wanted, arguments.quick)
        if arguments.update:
            update(texts)
        else:
            for name, text in texts.items():
                print(f"## {name}\n\n{text}", flush=True)


if __name__ == "__main__":
    main()
