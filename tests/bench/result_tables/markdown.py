# SPDX-License-Identifier: Apache-2.0
"""Tables in Markdown."""


def table(header, rows):
    """Returns the lines of a table. `rows` are lists of cells, which are strings."""
    return "\n".join("| " + " | ".join(line) + " |" for line in [header, ["---"] * len(header), *rows])


def distinct(values):
    """Without repetitions, in order."""
    return list(dict.fromkeys(values))


def cell(value, decimals):
    """NaN stands for a figure that no run has."""
    return "-" if value != value else f"{value:.{decimals}f}"
