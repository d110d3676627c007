#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Compares two files of `evpose bench speed --out FILE` row by row: how much worse the second is than the first.

  tests/bench/compare.py BEFORE.json AFTER.json [--worst RATIO]

Each row names the one of its numbers that it is compared by, and whether more of it is better: decoding its ratio to
memcpy in the same run, which the machine's load changes least, tracking its processor time per sensor time, the path
through a server its share of the tracker's own rate. A ratio above 1 is worse: slower, later or larger. Exit status 1
when a row is worse than RATIO, or is missing in AFTER; 2 for wrong usage or files that are not such tables.
"""
import argparse
import json
import math
import sys


def fail(message):
    print(f"compare.py: {message}", file=sys.stderr)
    sys.exit(2)


def measure(row):
    """(name, value, whether more is better)"""
    name = row["measure"]
    return name, float(row[name]), bool(row.get("more_is_better", False))


def load(path):
    try:
        with open(path, encoding="utf-8") as file:
            rows = json.load(file)["rows"]
        table = {(row["part"], row["what"], row["scene"]): measure(row) for row in rows}
    except OSError as error:
        fail(f"{path}: {error.strerror}")
    except (ValueError, KeyError, TypeError):
        fail(f"{path}: is not a table of `evpose bench speed --out`")
    if not table:
        fail(f"{path}: the table has no rows")
    return table


def worse_ratio(before, after, more_is_better):
    if more_is_better:
        before, after = after, before
    if before == after:
        return 1.0
    return after / before if before > 0.0 else math.inf


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before")
    parser.add_argument("after")
    parser.add_argument("--worst", type=float, default=math.inf, help="the greatest ratio that is no failure")
    arguments = parser.parse_args()
    before, after = load(arguments.before), load(arguments.after)
    failed = False
    print(f"{'part':12}{'what':14}{'scene':>6}  {'measure':22}{'before':>11}{'after':>11}{'ratio':>8}")
    for key, (name, old, more_is_better) in before.items():
        part, what, scene = key
        start = f"{part:12}{what:14}{scene:>6}  {name:22}{old:11.4f}"
        if key not in after:
            print(f"{start}{'missing':>11}")
            failed = True
            continue
        if after[key][0] != name:
            fail(f"{part} {what} {scene}: measured as {name} before, as {after[key][0]} after: make both tables anew")
        new = after[key][1]
        ratio = worse_ratio(old, new, more_is_better)
        is_worse = ratio > arguments.worst
        failed |= is_worse
        print(f"{start}{new:11.4f}{ratio:8.2f}{'  worse' if is_worse else ''}")
    for part, what, scene in (key for key in after if key not in before):
        print(f"{part:12}{what:14}{scene:>6}  new")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
