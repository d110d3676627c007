#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Compares what `evpose models inspect` finds in the tessellations of each shape that generate.py has written.

  tests/bench/models/generate.py DIRECTORY
  tests/bench/models/compare_tessellations.py DIRECTORY [--check] [SHAPE ...]

A tessellation is no property of the object. So the straight lines, the curves, the boundaries and the symmetries must not depend on
it. The table has a row for each shape and a column for each quantity, with the values of the tessellations from coarse to fine, or one
value if all are equal; regions are counted by shape (plane cylinder cone sphere free). Marks: D the tessellations differ in lines,
curves or symmetry; B a closed surface has a boundary; F the repair ended with faults. With --check, the status is 1 if a row has one.
"""
import argparse
import json
import pathlib
import subprocess
import sys

TESSELLATIONS = ("coarse", "medium", "fine")


def inspect(program, directory, entry):
    command = [program, "models", "inspect", directory / entry["file"], "--scale", str(entry["metres_per_unit"]), "--json"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        sys.exit(f"{entry['file']}: {result.stderr.strip()}")
    return json.loads(result.stdout)


def symmetry_text(model):
    continuous = model["symmetry"]["continuous"]
    if continuous is None:
        return str(model["symmetry"]["discrete"])
    return continuous["kind"] + ("+flip" if continuous.get("is_flippable") else "")


def edges(model, kind):
    return (model["edges"][kind]["lines"], model["edges"][kind]["curves"])


def joined(values):
    texts = [str(value) for value in values]
    return texts[0] if len(set(texts)) == 1 else " / ".join(texts)


def row_of(name, models):
    """The cells of the table, and the marks."""
    creases = [edges(model, "crease") for model in models]
    boundaries = [edges(model, "boundary") for model in models]
    symmetries = [symmetry_text(model) for model in models]
    regions = [" ".join(str(model["regions"][shape]) for shape in ("plane", "cylinder", "cone", "sphere", "free")) for model in models]
    marks = ""
    if len(set(creases)) > 1 or len(set(symmetries)) > 1:
        marks += "D"
    if any(pair != (0, 0) for pair in boundaries):
        marks += "B"
    if any("faults" in notice for model in models for notice in model["notices"]):
        marks += "F"
    cells = [name, joined(lines for lines, _ in creases), joined(curves for _, curves in creases),
             joined(lines + curves for lines, curves in boundaries), joined(symmetries), joined(regions)]
    return cells, marks


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("directory", type=pathlib.Path)
    parser.add_argument("shapes", nargs="*", metavar="SHAPE")
    parser.add_argument("--bin", type=pathlib.Path, default=pathlib.Path("build/release"), help="build directory (default %(default)s)")
    parser.add_argument("--check", action="store_true", help="status 1 if a row has a mark")
    arguments = parser.parse_args()
    entries = {entry["name"]: entry for entry in json.loads((arguments.directory / "models.json").read_text(encoding="utf-8"))}
    program = arguments.bin / "client" / "cli" / "evpose"
    shapes = arguments.shapes or list(dict.fromkeys(name.rpartition("-")[0] for name in entries))
    print(f"{'shape':12}{'lines':>16}{'curves':>16}{'boundary':>10}{'symmetry':>26}  {'marks':6}regions", flush=True)
    marked = []
    for shape in shapes:
        models = [inspect(program, arguments.directory, entries[f"{shape}-{tessellation}"]) for tessellation in TESSELLATIONS]
        (name, lines, curves, boundary, symmetry, regions), marks = row_of(shape, models)
        print(f"{name:12}{lines:>16}{curves:>16}{boundary:>10}{symmetry:>26}  {marks:6}{regions}", flush=True)
        if marks:
            marked.append(f"{shape} {marks}")
    if marked:
        print(f"marked: {', '.join(marked)}")
    if arguments.check and marked:
        sys.exit(1)


if __name__ == "__main__":
    main()
