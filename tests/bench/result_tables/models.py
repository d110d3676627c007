# SPDX-License-Identifier: Apache-2.0
"""The tables of model files, for results.py."""
import math
import statistics

from result_tables.markdown import cell, distinct, table

FOUND_WITHIN_US = 300_000  # as kFoundWithinUs of core/experiments/first_pose/first_pose_bench.h


def shape_of(model):
    """The shape in the name of a model, which ends with the tessellation: "t_slot" of "t_slot-fine"."""
    return model.rpartition("-")[0]


def worst_recording(variants):
    """Seed and tessellation of the worst run: lost before weak before kept, then the largest position error. A run without any pose, whose
    error is NaN, is the worst of its outcome. As `worst_seed` of `evpose bench models`, over all tessellations."""
    def badness(named_run):
        run = named_run[1]
        error = run["position_rmse_of_depth"]
        return ["kept", "weak", "lost"].index(run["outcome"]), math.inf if math.isnan(error) else error

    tessellation, run = max(((row["model"].rpartition("-")[2], run) for row in variants for run in row["runs"]), key=badness)
    return f"seed {run['seed']}, {tessellation}"


def models(result):
    """A line for each shape, over its tessellations and seeds."""
    rows = []
    found = [row for row in result["models"] if "error" not in row]
    for shape in distinct(shape_of(row["model"]) for row in result["models"]):
        variants = [row for row in found if shape_of(row["model"]) == shape]
        refused = [row["model"] for row in result["models"] if "error" in row and shape_of(row["model"]) == shape]
        runs = [run for row in variants for run in row["runs"]]
        if not runs:
            rows.append([shape, "not prepared"] + ["-"] * 8)
            continue

        def mean(key, decimals, factor=1.0, runs=runs):
            return cell(factor * statistics.mean(run[key] for run in runs), decimals)

        def worst(key, decimals, factor=1.0, runs=runs):
            # NaN, of a run without any pose, is the worst.
            return cell(factor * max((run[key] for run in runs), key=lambda value: math.inf if math.isnan(value) else value), decimals)

        kept = sum(run["outcome"] == "kept" for run in runs)
        weak = sum(run["outcome"] == "weak" for run in runs)
        rows.append([
            shape, f"{kept} of {len(runs)}" + (f", {weak} weak" if weak else "") + (f"; refused: {len(refused)}" if refused else ""),
            worst_recording(variants),
            f"{mean('position_rmse_of_depth', 3, 100)}, {worst('position_rmse_of_depth', 3, 100)}",
            f"{mean('rotation_median_deg', 2)} / {mean('rotation_p95_deg', 2)}",
            f"{worst('longest_wrong_tracking_s', 0, 1000)}, {worst('longest_weak_wrong_tracking_s', 0, 1000)}",
            f"{mean('events_per_s', 1, 1e-6)}: {worst('compute_ratio', 2)}",
            cell(1000 * max(row["preparation_s"] for row in variants), 0),
            f"{max(row['triangles'] for row in variants)}", cell(statistics.mean(row["mean_elements"] for row in variants), 0),
        ])
    return table(["shape", "kept", "worst recording", "position RMSE, % of depth: mean, worst", "rotation median / p95, deg",
                  "longest wrong while TRACKING, ms: determined poses, all", "Mev/s: processor time per sensor time, worst",
                  "preparation, ms, worst", "triangles, most", "elements"], rows)


def is_found(start):
    """As FirstPoseStart::is_found()."""
    return start["right_us"] >= 0 and start["moved_us"] >= 0 and start["right_us"] - start["moved_us"] <= FOUND_WITHIN_US


def first_poses(result):
    """A line for each shape, and one for all. `result` has the models of each scene by its name; in the last one, the object is absent."""
    scenes = list(result)
    absent = scenes[-1]
    present = scenes[:-1]

    def line(title, rows_of):
        starts = {scene: [start for row in rows_of[scene] for start in row.get("starts", [])] for scene in scenes}
        found = {scene: [start for start in starts[scene] if is_found(start)] for scene in present}
        waits_ms = [1e-3 * (start["right_us"] - start["moved_us"]) for start in found[scenes[0]]]
        searches_ms = [1e3 * search["compute_s"] for row in rows_of[scenes[0]] for search in row.get("searches", [])
                       if search["has_moved"]]
        wrong = {scene: [start for start in starts[scene] if start["wrong_at_us"] >= 0] for scene in scenes}
        longest_ms = {scene: max((1e-3 * start["longest_wrong_us"] for start in wrong[scene]), default=0.0) for scene in scenes}
        return [title] + [f"{len(found[scene])} of {len(starts[scene])}" for scene in present] + [
            cell(statistics.median(waits_ms), 0) if waits_ms else "-",
            f"{cell(statistics.median(searches_ms), 0)} / {cell(max(searches_ms), 0)}" if searches_ms else "-",
        ] + [f"{len(wrong[scene])}, {longest_ms[scene]:.0f}" for scene in present] + [
            f"{len(wrong[absent])} of {len(starts[absent])}, {longest_ms[absent]:.0f}"]

    shapes = distinct(shape_of(row["model"]) for row in result[scenes[0]])
    rows = [line(shape, {scene: [row for row in result[scene] if shape_of(row["model"]) == shape] for scene in scenes}) for shape in shapes]
    return table(["shape"] + [f"found, {scene}" for scene in present] +
                 ["wait, median, ms", "one search, median / longest, ms of processor time"] +
                 [f"starts with a wrong pose as TRACKING, and its longest time, ms: {scene}" for scene in present] +
                 ["the same: absent"], rows + [line("all", result)])
