#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Each shape is a closed surface with matching normals, and the files are reproducible."""
import collections
import contextlib
import io
import pathlib
import sys
import tempfile
import unittest

import generate
from part import cross, sub
from shapes import SHAPES

SIDES = 24


def key(point):
    return tuple(round(x, 5) + 0.0 for x in point)


class ShapesTest(unittest.TestCase):
    def test_there_are_many(self):
        self.assertGreaterEqual(len(SHAPES), 20)

    def test_surfaces_are_closed_and_enclose_a_volume(self):
        for name, shape in SHAPES.items():
            edges, volume = collections.Counter(), 0.0
            for points, _ in shape(SIDES).triangles:
                volume += sum(a * b for a, b in zip(points[0], cross(points[1], points[2]))) / 6
                corners = [key(p) for p in points]
                for k in range(3):
                    edges[corners[k], corners[k - 2]] += 1
            open_edges = [edge for edge, count in edges.items() if edge[0] != edge[1] and edges[edge[::-1]] != count]
            self.assertEqual(open_edges[:3], [], f"{name} has {len(open_edges)} open edges")
            self.assertGreater(volume, 1000, name)  # cubic millimetres

    def test_normals_point_out_of_their_triangles(self):
        for name, shape in SHAPES.items():
            for points, normals in shape(SIDES).triangles:
                face = cross(sub(points[1], points[0]), sub(points[2], points[0]))
                length = sum(x * x for x in face) ** 0.5
                for normal in normals:
                    self.assertAlmostEqual(sum(x * x for x in normal), 1.0, 6, name)
                    # Most turn by half of 15 degrees; the facets at the back of the blade by up to 45.
                    self.assertGreater(sum(a * b for a, b in zip(face, normal)), 0.7 * length, f"{name} at {points}")

    def test_files_are_the_same_each_time(self):
        with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stderr(io.StringIO()):
            contents = []
            for run in ("first", "second"):
                directory = pathlib.Path(folder, run)
                sys.argv = ["generate.py", str(directory), "torus"]
                generate.main()
                contents.append({path.name: path.read_bytes() for path in directory.iterdir()})
            self.assertEqual(set(contents[0]),
                             {"models.json", "torus-coarse.stl", "torus-medium.obj", "torus-fine.stl", "torus-reference.obj"})
            self.assertEqual(contents[0], contents[1])


if __name__ == "__main__":
    unittest.main()
