#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Draws the results of `evpose bench synthetic` and `evpose bench tracking`, from their JSON and the traces of the latter.

  evpose bench synthetic --json >synthetic.json
  evpose bench tracking --seeds 1 --paths 1 --json --traces traces.csv >tracking.json
  tests/bench/plot.py synthetic.json tracking.json --traces traces.csv --out pictures

Writes pictures/synthetic.png, pictures/tracking.png (all scenarios) and pictures/SCENARIO.png (poses and errors over time of the first
run of each scenario of the traces). Needs python3-matplotlib, which Debian installs for its own interpreter; status 77 without it.
"""
import argparse
import csv
import json
import math
import os
import sys

try:
    import matplotlib
    matplotlib.use("Agg")
    from matplotlib import pyplot
except ImportError:
    print("plot.py: matplotlib is missing: install python3-matplotlib (deploy/install-dependencies.sh --test)", file=sys.stderr)
    sys.exit(77)

# The colours of Okabe and Ito, which most colour-blind people can distinguish, and three more.
COLORS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8C564B", "#7F7F7F", "#6A3D9A"]
MARKERS = ["o", "s", "^", "v", "D", "p", "X"]
REFERENCE = {"color": "black", "linestyle": "--"}  # truth and targets
DPI = 100
LEGEND_COLUMNS = 6
LEGEND_ROW_PX = 20
# A line is interrupted where there is no pose for longer, seconds.
LONGEST_GAP_S = 0.02
# Ratios to the bound above this are not shown: least squares with outliers.
HIGHEST_RATIO = 2.6


def fail(message):
    print(f"plot.py: {message}", file=sys.stderr)
    sys.exit(1)


def number(value):
    """The benchmarks write null, and an empty cell, for a value that does not exist."""
    return math.nan if value is None or value == "" else float(value)


def save(figure, path):
    """Draws the legend of all panels below them, each name once, and writes the picture."""
    handles = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels()):
            handles.setdefault(label, handle)
    columns = min(len(handles), LEGEND_COLUMNS)
    height = (LEGEND_ROW_PX * math.ceil(len(handles) / columns) + 20) / (DPI * figure.get_figheight())
    figure.get_layout_engine().set(rect=(0.0, height, 1.0, 1.0 - height))
    figure.legend(handles.values(), handles.keys(), loc="lower center", ncols=columns, fontsize=9)
    figure.savefig(path, dpi=DPI)
    pyplot.close(figure)


def new_figure(rows, columns, title, panel_width=480, panel_height=280):
    figure, axes = pyplot.subplots(rows, columns, squeeze=False, layout="constrained",
                                   figsize=(columns * panel_width / DPI, (rows * panel_height + 80) / DPI))
    figure.suptitle(title)
    return figure, axes


# Title, unit, key in a row and in its bound, whether it is divided by the bound.
SYNTHETIC_PANELS = [
    ("Median rotation error", "Err_R, deg", "rotation_median_deg", False),
    ("Mean rotation error", "Err_R, deg", "rotation_mean_deg", False),
    ("Median translation error", "Err_T", "translation_median_ratio", False),
    ("Mean translation error", "Err_T", "translation_mean_ratio", False),
    ("Median rotation error over the bound's", "ratio", "rotation_median_deg", True),
    ("Median translation error over the bound's", "ratio", "translation_median_ratio", True),
]
SWEEP_AXES = {"noise": ("noise, px", 1.0), "outliers": ("outliers, %", 100.0), "lines": ("lines", 1.0)}


def method_style(method, methods):
    """A method as its released code computes it (NAME-released) has the colour of NAME, hollow markers and dashes."""
    base = method.removesuffix("-released")
    index = methods.index(base if base in methods else method)
    is_released = method != base
    color = COLORS[index % len(COLORS)]
    return {"color": color, "marker": MARKERS[index % len(MARKERS)], "linestyle": "--" if is_released else "-",
            "markerfacecolor": "none" if is_released else color, "markersize": 5, "linewidth": 1.4}


def draw_synthetic_panel(axes, rows, methods, sweep, panel):
    title, unit, key, is_ratio = panel
    label, scale = SWEEP_AXES.get(sweep, (sweep, 1.0))
    bounds = {scale * row["value"]: number(row["bound"][key]) for row in rows if row["bound"]}
    for method in methods:
        points = [(scale * row["value"], number(row[key])) for row in rows if row["method"] == method]
        if is_ratio:
            points = [(x, y / bounds[x]) for x, y in points if x in bounds]
        axes.plot([x for x, _ in points], [y for _, y in points], label=method, **method_style(method, methods))
    bound_y = [1.0 if is_ratio else y for y in bounds.values()]
    axes.plot(list(bounds), bound_y, label="Cramer-Rao bound", color="black", linestyle=":", linewidth=1.4)
    axes.set(title=title, xlabel=label, ylabel=unit)
    axes.set_xlim(left=0.0)
    if not is_ratio:
        axes.set_yscale("log")
    # Without noise the errors are rounding errors, far below the rest.
    if bound_y:
        axes.set_ylim(bottom=0.5 * min(bound_y), top=HIGHEST_RATIO if is_ratio else None)
    axes.grid(alpha=0.3)


def draw_synthetic(result, folder):
    """A column for each sweep, a row for each panel."""
    rows = result["rows"]
    sweeps = list(dict.fromkeys(row["sweep"] for row in rows))
    methods = list(dict.fromkeys(row["method"] for row in rows))
    figure, axes = new_figure(len(SYNTHETIC_PANELS), len(sweeps),
                              f"Pose from labelled events: {result['trials']} trials, seed {result['seed']}")
    for column, sweep in enumerate(sweeps):
        for row, panel in enumerate(SYNTHETIC_PANELS):
            draw_synthetic_panel(axes[row][column], [r for r in rows if r["sweep"] == sweep], methods, sweep, panel)
    save(figure, os.path.join(folder, "synthetic.png"))


# Title, unit, value of a summary, target of a scenario, whether the axis is logarithmic.
TRACKING_PANELS = [
    ("Position, RMSE", "% of depth", lambda s: 100 * number(s["position_rmse_of_depth"]),
     lambda t: 100 * t["position_rmse_of_depth"], True),
    ("Rotation, median", "deg", lambda s: number(s["rotation_median_deg"]), lambda t: t["rotation_median_deg"], True),
    ("Rotation, 95th percentile", "deg", lambda s: number(s["rotation_p95_deg"]), lambda t: t["rotation_p95_deg"], True),
    ("NEES, median", "", lambda s: number(s["nees_median"]), lambda t: t["nees_median"], True),
    ("Time without a good pose", "%", lambda s: 100 * (1 - number(s["coverage_ratio"])),
     lambda t: 100 * (1 - t["coverage_ratio"]), True),
    ("Losses", "", lambda s: number(s["losses"]), lambda t: t["losses"], False),
]


def draw_tracking(result, folder):
    """The summaries of all scenarios, one below the other, the first one at the top."""
    scenarios = result["scenarios"]
    estimators = list(dict.fromkeys(e["name"] for scenario in scenarios for e in scenario["estimators"]))
    runs = scenarios[0]["estimators"][0]["summary"]["runs"]
    figure, axes = new_figure(2, 3, f"Tracking: means of {runs} run{'' if runs == 1 else 's'}", 560, max(200, 110 + 20 * len(scenarios)))
    for panel, (title, unit, value, target, is_logarithmic) in zip(axes.flat, TRACKING_PANELS):
        for index, name in enumerate(estimators):
            points = [(value(e["summary"]), y) for y, s in enumerate(scenarios) for e in s["estimators"] if e["name"] == name]
            panel.plot([x for x, _ in points], [y for _, y in points], label=name, linestyle="none",
                       marker=MARKERS[index % len(MARKERS)], color=COLORS[index % len(COLORS)], markersize=5)
        for y, scenario in enumerate(scenarios):
            x = target(scenario["targets"])
            panel.plot([x, x], [y - 0.4, y + 0.4], label="target", **REFERENCE)
        panel.set_yticks(range(len(scenarios)), [scenario["scenario"] for scenario in scenarios], fontsize=8)
        panel.set_ylim(len(scenarios) - 0.5, -0.5)
        panel.set(title=title, xlabel=unit)
        if is_logarithmic:
            panel.set_xscale("log")
        panel.grid(alpha=0.3)
    save(figure, os.path.join(folder, "tracking.png"))


def with_gaps(times, values, longest_gap_s):
    """Inserts NaN where the time between two points is longer, so that the line is interrupted there."""
    x, y = [], []
    for i, (time, value) in enumerate(zip(times, values)):
        if i > 0 and time - times[i - 1] > longest_gap_s:
            x.append(time)
            y.append(math.nan)
        x.append(time)
        y.append(value)
    return x, y


TRACE_POSES = [(f"Position, {axis}", "m", f"{axis}_m") for axis in "xyz"] + [
    (f"Rotation since the start, about {axis}", "deg", f"rotation_{axis}_deg") for axis in "xyz"]
# The errors, with the key of the target and its factor.
TRACE_ERRORS = [
    ("Position error", "% of depth", "position_of_depth_percent", lambda t: 100 * t["position_rmse_of_depth"]),
    ("Rotation error", "deg", "rotation_error_deg", lambda t: t["rotation_p95_deg"]),
    ("NEES of the published covariance", "", "nees", lambda t: t["nees_median"]),
]


def draw_lines(panel, traces, key):
    for index, (name, rows) in enumerate(traces.items()):
        if name == "truth":
            continue
        times = [row["time_s"] for row in rows]
        # Traces are downsampled: the distance of their points may exceed the longest gap.
        steps = sorted(after - before for before, after in zip(times, times[1:]))
        step_s = steps[len(steps) // 2] if steps else 0.0
        x, y = with_gaps(times, [row[key] for row in rows], LONGEST_GAP_S + 1.5 * step_s)
        panel.plot(x, y, label=name, color=COLORS[(index - 1) % len(COLORS)], linewidth=1.2)


def draw_traces(name, traces, scenario, folder):
    title = f"{name}: {scenario['description']}; seed 1, path 1" if scenario else f"{name}; seed 1, path 1"
    figure, axes = new_figure(3, 3, title)
    truth = traces.get("truth", [])
    for panel, (label, unit, key) in zip(axes.flat, TRACE_POSES):
        draw_lines(panel, traces, key)
        # The truth is drawn above the estimates, which are visible in its gaps.
        panel.plot([row["time_s"] for row in truth], [row[key] for row in truth], label="truth", linewidth=1.2, **REFERENCE)
        panel.set(title=label, xlabel="time, s", ylabel=unit)
        panel.grid(alpha=0.3)
    for panel, (label, unit, key, target) in zip(axes.flat[len(TRACE_POSES):], TRACE_ERRORS):
        draw_lines(panel, traces, key)
        panel.set_yscale("log")
        if scenario:
            value = target(scenario["targets"])
            panel.axhline(value, label="target", **REFERENCE)
            panel.set_ylim(bottom=1e-3 * value)
        panel.set(title=label, xlabel="time, s", ylabel=unit)
        panel.grid(alpha=0.3)
    save(figure, os.path.join(folder, f"{name}.png"))


def read_traces(path):
    """{scenario: {estimator: [row]}}, in the order of the file: the truth first."""
    traces = {}
    with open(path, encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            scenario, estimator = row.pop("scenario"), row.pop("estimator")
            traces.setdefault(scenario, {}).setdefault(estimator, []).append({key: number(value) for key, value in row.items()})
    return traces


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", nargs="*", metavar="JSON", help="output of evpose bench synthetic or tracking with --json")
    parser.add_argument("--traces", metavar="CSV", help="file of evpose bench tracking --traces")
    parser.add_argument("--out", default=".", metavar="DIR", help="directory of the pictures; it is made")
    arguments = parser.parse_args()
    if not arguments.results and not arguments.traces:
        parser.error("nothing to draw: give JSON files or --traces")
    os.makedirs(arguments.out, exist_ok=True)
    scenarios = {}
    for path in arguments.results:
        with open(path, encoding="utf-8") as file:
            result = json.load(file)
        if "scenarios" in result:
            scenarios = {scenario["scenario"]: scenario for scenario in result["scenarios"]}
            draw_tracking(result, arguments.out)
        elif result.get("rows") and "sweep" in result["rows"][0]:
            draw_synthetic(result, arguments.out)
        else:
            fail(f"{path} is not the JSON of evpose bench synthetic or tracking")
    if arguments.traces:
        for name, traces in read_traces(arguments.traces).items():
            draw_traces(name, traces, scenarios.get(name), arguments.out)


if __name__ == "__main__":
    main()
