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
    """A line for each shape, and one for all."""
    def line(title, rows):
        starts = [start for row in rows for start in row.get("starts", [])]
        waits_ms = [1e-3 * (start["right_us"] - start["moved_us"]) for start in starts if is_found(start)]
        wrong = [start for start in starts if start["wrong_at_us"] >= 0]
        longest_ms = max((1e-3 * start["longest_wrong_us"] for start in wrong), default=0.0)
        searches_ms = [1e3 * search["compute_s"] for row in rows for search in row.get("searches", []) if search["has_moved"]]
        poses = sum(start["poses"][state] for start in starts for state in ("tracking", "degraded", "ambiguous"))
        ambiguous = sum(start["poses"]["ambiguous"] for start in starts)
        return [title, f"{len(waits_ms)} of {len(starts)}", cell(statistics.median(waits_ms), 0) if waits_ms else "-",
                f"{len(wrong)}, {longest_ms:.0f}", cell(100 * ambiguous / poses, 0) if poses else "-",
                f"{cell(statistics.median(searches_ms), 0)} / {cell(max(searches_ms), 0)}" if searches_ms else "-"]

    models_of = {shape: [row for row in result["models"] if shape_of(row["model"]) == shape]
                 for shape in distinct(shape_of(row["model"]) for row in result["models"])}
    return table(["shape", "found", "wait, median, ms", "starts with a wrong pose as TRACKING, and its longest time, ms",
                  "AMBIGUOUS, % of the poses", "one search, median / longest, ms of processor time"],
                 [line(shape, rows) for shape, rows in models_of.items()] + [line("all", result["models"])])
