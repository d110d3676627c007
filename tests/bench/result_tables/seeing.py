# SPDX-License-Identifier: Apache-2.0
"""The tables of results.py about what a person or a program sees of a session: the page of `evpose view`, images of events, the Python
client. Each has the goal of a figure beside its value."""
from result_tables.markdown import table


def page(result):
    """Of view_page.py --json: a value for each run."""
    def line(title, goal, key, decimals):
        return [title, goal, ", ".join(f"{run[key]:.{decimals}f}" for run in result["runs"])]

    return table([f"the page, at {result['mev_per_s']:.1f} Mev/s", "goal", "value"], [
        line("from the start of `evpose view` to the first image that is drawn, s", "1", "first_s", 2),
        line(f"images drawn per second, of {result['rate_hz']:.0f} that were asked for", "30", "rate_hz", 1),
        line("images that the gateway left out", "", "skipped", 0),
        line("from the newest event of an image to the frame that shows it, median, ms", "100", "delay_ms", 0),
        line("the same, 95 % quantile, ms", "", "delay_95_ms", 0),
        line("poses", "", "poses", 0),
        line("largest delay of the events at the pipe, ms", "", "late_ms", 1),
        line("age of the oldest event that waits at the end, ms", "", "age_ms", 1),
    ])


def watchers(result):
    """Of event_images.py --json."""
    goals = {"the first": "10", "each further": "1"}
    return table([f"watchers of images, at {result['mev_per_s']:.1f} Mev/s and {result['rate_hz']:.0f} Hz", "goal",
                  "% of a core of the server", "standard error", "pairs of slices"],
                 [[row["watchers"], goals[row["watchers"]], f"{row['more_percent']:.2f}", f"{row['error_percent']:.2f}", str(row["pairs"])]
                  for row in result["rows"]])


def python_client(result):
    """Of python_client.py --json."""
    rows = {row["kind"]: row for row in result["rows"]}
    raw, arrays = rows["raw"], rows["arrays"]
    return table(["the Python client", "goal", "RAW file", "arrays"], [
        ["Mev/s of its processor time", "10", f"{raw['mev_per_cpu_s']:.1f}", f"{arrays['mev_per_cpu_s']:.1f}"],
        ["Mev/s of wall time, with the server", "10", f"{raw['mev_per_wall_s']:.1f}", f"{arrays['mev_per_wall_s']:.1f}"],
        ["processor time over that of `evpose replay`", "", f"{result['ratio_to_replay']:.2f}", ""],
        ["the same of the whole process, with the start of the interpreter", "", f"{result['whole_process_ratio']:.2f}", ""],
    ])
