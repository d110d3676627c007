#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes the models of `evpose bench models`: each shape at three tessellations, and once with the normals of its exact surface.

  tests/bench/models/generate.py DIRECTORY [SHAPE ...]

The tessellations are what a tracker gets; the recordings show the surface of the last file, SHAPE-reference.obj. models.json has
the list. The files are the same on every machine.
"""
import argparse
import json
import pathlib
import sys

from part import write_obj, write_stl
from shapes import SHAPES

# Facets of a whole circle: a preview, the usual default of CAD programs, and a fine export.
TESSELLATIONS = {"coarse": 24, "medium": 48, "fine": 120}
MILLIMETRES = 0.001


def write_shape(directory, name):
    """Returns the entries of the list. Every other file is in millimetres, as most CAD programs export."""
    entries = []
    for tessellation, sides in TESSELLATIONS.items():
        part = SHAPES[name](sides)
        in_metres = tessellation == "medium"
        file = f"{name}-{tessellation}." + ("obj" if in_metres else "stl")
        if in_metres:
            write_obj(directory / file, part, MILLIMETRES, with_normals=False)
        else:
            write_stl(directory / file, part, 1.0)
        entries.append({"name": f"{name}-{tessellation}", "file": file, "metres_per_unit": 1.0 if in_metres else MILLIMETRES,
                        "reference": f"{name}-reference.obj"})
        if tessellation == "fine":
            write_obj(directory / f"{name}-reference.obj", part, MILLIMETRES, with_normals=True)
    return entries


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("directory", type=pathlib.Path)
    parser.add_argument("shapes", nargs="*", metavar="SHAPE", help=", ".join(SHAPES))
    arguments = parser.parse_args()
    unknown = [name for name in arguments.shapes if name not in SHAPES]
    if unknown:
        parser.error(f"no shape {', '.join(unknown)}; there are {', '.join(SHAPES)}")
    arguments.directory.mkdir(parents=True, exist_ok=True)
    entries = []
    for name in arguments.shapes or SHAPES:
        print(name, file=sys.stderr)
        entries += write_shape(arguments.directory, name)
    (arguments.directory / "models.json").write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
