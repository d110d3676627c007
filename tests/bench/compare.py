#!/usr/bin/env python3
"""Compares two files of `evpose bench speed --json FILE` row by row: the second's times over the first's.

  tests/bench/compare.py BEFORE.json AFTER.json [--worst RATIO]

Decoding is compared by its ratio to memcpy in the same run, which the machine's load changes least, everything else by
processor time per sensor time. Exit status 1 when a row took more than RATIO times as long, or is missing in AFTER; 2 for
wrong usage or files that are not such tables.
"""
import argparse
import json
import math
import sys


def fail(message):
    print(f"compare.py: {message}", file=sys.stderr)
    sys.exit(2)


def measure(row):
    return "memcpy_ratio" if "memcpy_ratio" in row else "real_time_ratio"


def load(path):
    try:
        with open(path, encoding="utf-8") as file:
            rows = json.load(file)["rows"]
        return {(row["part"], row["what"], row["scene"]): (measure(row), float(row[measure(row)])) for row in rows}
    except OSError as error:
        fail(f"{path}: {error.strerror}")
    except (ValueError, KeyError, TypeError):
        fail(f"{path}: is no table of `evpose bench speed --json`")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before")
    parser.add_argument("after")
    parser.add_argument("--worst", type=float, default=math.inf, help="the greatest ratio that is no failure")
    arguments = parser.parse_args()
    before, after = load(arguments.before), load(arguments.after)
    failed = False
    print(f"{'part':12}{'what':12}{'scene':>6}  {'measure':16}{'before':>10}{'after':>10}{'ratio':>8}")
    for key, (name, old) in before.items():
        part, what, scene = key
        start = f"{part:12}{what:12}{scene:>6}  {name:16}{old:10.4f}"
        if key not in after:
            print(f"{start}{'missing':>10}")
            failed = True
            continue
        new = after[key][1]
        ratio = new / old if old > 0.0 else math.inf
        slow = ratio > arguments.worst
        failed |= slow
        print(f"{start}{new:10.4f}{ratio:8.2f}{'  slower' if slow else ''}")
    for part, what, scene in (key for key in after if key not in before):
        print(f"{part:12}{what:12}{scene:>6}  new")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
