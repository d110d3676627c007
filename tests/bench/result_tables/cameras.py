# SPDX-License-Identifier: Apache-2.0
"""The tables of real recordings and of calibrated cameras, for results.py. Each function takes the rows of a command with --json."""
import json
import re

from result_tables.markdown import table


def read(output):
    """The rows of a command that prints one JSON object a line."""
    return [json.loads(line) for line in output.splitlines() if line.startswith("{")]


def cell(value, decimals, factor=1.0):
    return "-" if value is None else f"{factor * value:.{decimals}f}"


def reason(error):
    """The cause of an error of `evpose calibrate`, without the path of the recording and the remedy."""
    return re.sub(r"^\S*/\S+: ", "", error.removeprefix("evpose calibrate: ")).split(";")[0]


def replays(rows):
    return table(["recording", "sensor", "s", "events", "first pose, s", "losses", "TRACKING, % of the poses",
                  "reprojection error of the events, px", "distance from the reference, median / p95, px"],
                 [[row["recording"], row["sensor"], f"{row['seconds']:.2f}", f"{row['events']}", cell(row["first_pose_s"], 3),
                   f"{row['losses']}", cell(row["tracking_ratio"], 1, 100), cell(row["residual_px"], 2),
                   f"{cell(row['median_px'], 2)} / {cell(row['p95_px'], 2)}"] for row in rows])


def real_cameras(rows):
    """A row for each guess of the focal length; the profiles that could not be fitted are named below."""
    lines, refused = [], []
    for row in rows:
        is_profile = row["guess"] == "profile"
        if is_profile and row["error"]:
            refused.append(f"- {row['recording']}: {reason(row['error'])}")
            continue
        focal = row.get("parameters", {}).get("fx_px", {})
        error = cell(focal.get("standard_error"), 1)
        lines.append([row["recording"], "profile" if is_profile else f"{100 * (row['guess'] - 1):+.0f} %",
                      "-" if not focal else f"{focal['value']:.1f} +- {error}", cell(row["given_px"], 2), cell(row["own_px"], 2),
                      cell(row["ratio"], 2), f"{row['given_poses']}, {row['own_poses']}",
                      reason(row["error"]) if row["error"] else ", ".join(row.get("not_determined", []))])
    text = table(["recording", "error of the first guess", "fx, px", "given camera, px", "own camera, px", "ratio",
                  "poses while TRACKING", "not determined"], lines)
    return text + (f"\n\nNo profile could be fitted:\n\n{chr(10).join(refused)}" if refused else "")


def simulated_cameras(rows):
    return table(["lens, seed", "fx, %", "centre (its standard errors), px", "distortion, px", "projection, px", "after the best rotation, px",
                  "largest error, standard errors", "position over that with the true camera", "processor time, s"],
                 [[f"{row['lens']}, {row['seed']}", cell(row["focal_percent"], 3),
                   f"{cell(row['centre_px'], 2)} ({', '.join(cell(error, 2) for error in row['centre_error_px'])})",
                   cell(row["distortion_px"], 3), cell(row["projection_px"], 3), cell(row["rotated_px"], 3), cell(row["worst_sigmas"], 1),
                   cell(row["position_ratio"], 2), cell(row["cpu_s"], 0)] for row in rows])
