# SPDX-License-Identifier: Apache-2.0
"""Model files (OBJ, Mesh) that are small and slow to prepare, expensive to track, or malformed; and a harmless one of each format."""

import numpy

from api import message_type

CUBE = (
    "".join(f"v {x} {y} {z}\n" for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1))
    + "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
).encode()


def _rows(kind, values):
    return "".join(f"{kind} {' '.join(map(str, row))}\n" for row in values.tolist())


def padded_cube(size_bytes, number):
    """A cube in a file of this size; files of other numbers are other models."""
    head = CUBE + f"# {number} ".encode()
    return head + b"-" * (size_bytes - len(head))


def prism(sides, has_discs=True):
    """A prism whose edges are lines, with a small triangle inside that no rotation maps onto itself. With `sides` 1365 the file has
    161 kB, and each of the 1365 rotations must be compared with all of its 4095 lines. With `has_discs`, discs close its ends."""
    angles = numpy.arange(sides) * (2 * numpy.pi / sides)
    rim = numpy.column_stack([numpy.cos(angles), numpy.sin(angles)]).round(6)
    vertices = numpy.vstack([
        numpy.column_stack([rim, numpy.full(sides, -0.5)]),
        numpy.column_stack([rim, numpy.full(sides, 0.5)]),
        [[0, 0, -0.5], [0, 0, 0.5], [0.1, 0.2, 0], [0.3, 0.2, 0], [0.1, 0.25, 0.1]],
    ])
    here = numpy.arange(1, sides + 1)
    following = numpy.roll(here, -1)
    lines = numpy.vstack([
        numpy.column_stack([here, following]),
        numpy.column_stack([here + sides, following + sides]),
        numpy.column_stack([here, here + sides]),
    ])
    centre = 2 * sides + 1
    faces = [[centre + 2, centre + 3, centre + 4]]
    if has_discs:
        faces = numpy.vstack([
            numpy.column_stack([here, following, numpy.full(sides, centre)]),
            numpy.column_stack([here + sides, following + sides, numpy.full(sides, centre + 1)]),
            faces,
        ])
    return (_rows("v", vertices) + _rows("f", numpy.asarray(faces)) + _rows("l", lines)).encode()


def tangle(triangles, lines, seed=1):
    """Large random triangles and random lines: each line crosses the outlines of many triangles in every view."""
    random = numpy.random.default_rng(seed)
    vertices = random.uniform(-0.15, 0.15, (3 * triangles + 2 * lines, 3)).round(4)
    faces = numpy.arange(1, 3 * triangles + 1).reshape(-1, 3)
    ends = 3 * triangles + numpy.arange(1, 2 * lines + 1).reshape(-1, 2)
    return (_rows("v", vertices) + _rows("f", faces) + _rows("l", ends)).encode()


def grid(side):
    """A rough surface of 2 * side^2 triangles."""
    random = numpy.random.default_rng(1)
    y, x = numpy.divmod(numpy.arange((side + 1) ** 2), side + 1)
    vertices = numpy.column_stack([x * 0.001, y * 0.001, random.uniform(0, 0.002, x.size).round(4)]).round(4)
    corner = (numpy.arange(side)[:, None] * (side + 1) + numpy.arange(side) + 1).ravel()
    faces = numpy.vstack([
        numpy.column_stack([corner, corner + 1, corner + side + 1]),
        numpy.column_stack([corner + 1, corner + side + 2, corner + side + 1]),
    ])
    return (_rows("v", vertices) + _rows("f", faces)).encode()


def blob(rings):
    """A closed smooth body of 4 * rings^2 triangles: its contours are computed for every view."""
    theta = numpy.arange(1, rings) * (numpy.pi / rings)
    phi = numpy.arange(2 * rings) * (numpy.pi / rings)
    radius = 0.1 + 0.01 * numpy.sin(3 * theta)[:, None] * numpy.cos(2 * phi)
    body = numpy.stack([radius * numpy.sin(theta)[:, None] * numpy.cos(phi), radius * numpy.sin(theta)[:, None] * numpy.sin(phi),
                        radius * numpy.cos(theta)[:, None] * numpy.ones(phi.size)], axis=-1)
    vertices = numpy.vstack([body.reshape(-1, 3), [[0, 0, 0.1], [0, 0, -0.1]]]).round(7)
    here = numpy.arange(1, body[..., 0].size + 1).reshape(rings - 1, -1)
    beside = numpy.roll(here, -1, axis=1)
    top, bottom = here.size + 1, here.size + 2
    faces = numpy.vstack([
        numpy.column_stack([here[:-1].ravel(), here[1:].ravel(), beside[1:].ravel()]),
        numpy.column_stack([here[:-1].ravel(), beside[1:].ravel(), beside[:-1].ravel()]),
        numpy.column_stack([numpy.full(phi.size, top), here[0], beside[0]]),
        numpy.column_stack([numpy.full(phi.size, bottom), beside[-1], here[-1]]),
    ])
    return (_rows("v", vertices) + _rows("f", faces)).encode()


def mesh(**more):
    """A cube as the message Mesh, with more fields or with other values of its own."""
    positions = [coordinate for line in CUBE.decode().splitlines() if line[0] == "v" for coordinate in map(float, line[2:].split())]
    corners = [[int(word) - 1 for word in line[2:].split()] for line in CUBE.decode().splitlines() if line[0] == "f"]
    triangles = [index for a, b, c, d in corners for index in (a, b, c, a, c, d)]
    return message_type("evpose.v1.Mesh")(**{"positions": positions, "triangles": triangles, **more}).SerializeToString()


# Meshes that must be refused with INVALID_ARGUMENT.
MALFORMED_MESHES = {
    "empty": b"",
    "no message": bytes(1000),
    "cut": mesh()[:-1],
    "corner beyond the last": mesh(triangles=[0, 1, 8]),
    "corner 2^32 - 1": mesh(triangles=[0, 1, 2**32 - 1]),
    "two corners": mesh(triangles=[0, 1]),
    "two coordinates": mesh(positions=[0.0, 0.0]),
    "not a number": mesh(positions=[float("nan")] * 24),
    "infinite": mesh(positions=[float("inf")] * 24),
    "corners without normals": mesh(corner_normals=[1] * 36),
    "line beyond the last point": mesh(lines=[0, 2**32 - 1]),
    "edges without faces": mesh(edges=[{"curve": 1, "points": [0, 1]}]),
    "faces without normals": mesh(faces=[{"shape": 5}] * 6, triangle_faces=[i // 2 for i in range(12)]),
    "300000 edges without points": mesh(edges=[{}] * 300_000),
    "300000 faces": mesh(faces=[{"shape": 5}] * 300_000),
}
# Files that must be refused with INVALID_ARGUMENT, whatever else they cost.
MALFORMED = {
    "empty": b"",
    "no faces": b"v 0 0 0\n",
    "corner 0": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n",
    "corner beyond the last": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99\n",
    "corner 2^64": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 18446744073709551616\n",
    "not a number": b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    "infinite": b"v inf 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    "zeros": bytes(100_000),
    "face of 200000 corners": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf" + b" 1" * 200_000 + b"\n",
}
