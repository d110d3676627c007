# SPDX-License-Identifier: Apache-2.0
"""Parts as triangles with the exact normals of their surfaces: revolved and extruded outlines, tubes, grids."""
import math
import struct


def add(a, b):
    return tuple(x + y for x, y in zip(a, b))


def sub(a, b):
    return tuple(x - y for x, y in zip(a, b))


def scaled(a, factor):
    return tuple(x * factor for x in a)


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def unit(a):
    length = math.sqrt(sum(x * x for x in a))
    return scaled(a, 1.0 / length)


class Stroke:
    """A smooth piece of a plane curve: points, and the unit normals on its right-hand side, which is outside."""

    def __init__(self, points, normals):
        self.points, self.normals = points, normals


def line(p, q):
    normal = unit((q[1] - p[1], p[0] - q[0]))
    return Stroke([p, q], [normal, normal])


def arc(centre, radius, begin, end, sides):
    """From angle `begin` to `end`, counter-clockwise if `end` is larger; `sides` of a whole circle."""
    count = max(2, math.ceil(sides * abs(end - begin) / (2 * math.pi) - 1e-9))
    points, normals = [], []
    sign = 1.0 if end > begin else -1.0
    for i in range(count + 1):
        angle = begin + (end - begin) * i / count
        direction = (math.cos(angle), math.sin(angle))
        points.append(add(centre, scaled(direction, radius)))
        normals.append(scaled(direction, sign))
    return Stroke(points, normals)


def circle(centre, radius, sides):
    return [arc(centre, radius, 0.0, 2 * math.pi, sides)]


def hole(centre, radius, sides):
    return [arc(centre, radius, 2 * math.pi, 0.0, sides)]


def rounded(corners, radii, sides, closed=True):
    """A polygon with a fillet at each corner; radius 0 keeps it sharp. An open one keeps its ends."""
    count = len(corners)
    strokes, joints = [], []
    for i, corner in enumerate(corners):
        is_end = not closed and i in (0, count - 1)
        if is_end or radii[i] == 0:
            joints.append((corner, corner, None))
            continue
        back = unit(sub(corners[i - 1], corner))
        ahead = unit(sub(corners[(i + 1) % count], corner))
        half = 0.5 * math.acos(max(-1.0, min(1.0, back[0] * ahead[0] + back[1] * ahead[1])))
        along = radii[i] / math.tan(half)
        centre = add(corner, scaled(unit(add(back, ahead)), radii[i] / math.sin(half)))
        first, last = add(corner, scaled(back, along)), add(corner, scaled(ahead, along))
        begin = math.atan2(first[1] - centre[1], first[0] - centre[0])
        turn = math.atan2(last[1] - centre[1], last[0] - centre[0]) - begin
        turn = (turn + math.pi) % (2 * math.pi) - math.pi
        joints.append((first, last, arc(centre, radii[i], begin, begin + turn, sides)))
    for i in range(count if closed else count - 1):
        here, there = joints[i][1], joints[(i + 1) % count][0]
        if joints[i][2]:
            strokes.append(joints[i][2])
        if math.dist(here, there) > 1e-9:
            strokes.append(line(here, there))
    return strokes


def outline_of(strokes):
    points = []
    for stroke in strokes:
        points += [p for p in stroke.points if not points or math.dist(p, points[-1]) > 1e-9]
    if math.dist(points[0], points[-1]) <= 1e-9:
        points.pop()
    return points


def is_left(a, b, c):
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def with_bridges(outline, holes):
    """One polygon without holes: each hole is joined to the rest by a pair of edges, from its rightmost point."""
    polygon = list(outline)
    for ring in sorted(holes, key=lambda ring: -max(ring)[0]):
        start = max(range(len(ring)), key=lambda i: ring[i])
        ring = ring[start:] + ring[:start]
        polygon = join(polygon, ring)
    return polygon


def join(polygon, ring):
    p = ring[0]
    best, place = math.inf, None
    for i, a in enumerate(polygon):
        b = polygon[(i + 1) % len(polygon)]
        # Upward edges to the right of p bound the polygon there.
        if not (a[1] <= p[1] < b[1]):
            continue
        x = a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
        if p[0] <= x < best:
            best, place = x, i
    after = (place + 1) % len(polygon)
    reach = place if polygon[place][0] > polygon[after][0] else after
    triangle = (p, (best, p[1]), polygon[reach])
    if is_left(*triangle) < 0:
        triangle = (triangle[0], triangle[2], triangle[1])
    # The polygon may enter the triangle of sight: then its point in the smallest angle is seen from p.
    inside = [i for i, q in enumerate(polygon)
              if i != reach and q != polygon[reach] and all(is_left(triangle[k], triangle[(k + 1) % 3], q) >= 0 for k in range(3))]
    inside = [i for i in inside if is_left(polygon[i - 1], polygon[i], polygon[(i + 1) % len(polygon)]) <= 0] or []
    if inside:
        reach = min(inside, key=lambda i: (abs(polygon[i][1] - p[1]) / max(polygon[i][0] - p[0], 1e-12), math.dist(polygon[i], p)))
    return polygon[:reach + 1] + ring + [p] + polygon[reach:]


def triangulated(polygon):
    """Triangles of a counter-clockwise polygon, as points: ear clipping."""
    points = list(polygon)
    rest = list(range(len(points)))
    triangles = []
    at, failures = 0, 0
    while len(rest) > 3:
        count = len(rest)
        at %= count
        i, j, k = rest[at - 1], rest[at], rest[(at + 1) % count]
        if is_ear(points, rest, i, j, k) or failures > count:
            triangles.append((points[i], points[j], points[k]))
            rest.pop(at)
            failures = 0
            # The next corner but one: ears all around instead of a fan of needles.
            at += 1
        else:
            at += 1
            failures += 1
    triangles.append(tuple(points[i] for i in rest))
    return [t for t in triangles if is_left(*t) > 1e-12]


ON_EDGE = 1e-9  # square millimetres


def is_ear(points, rest, i, j, k):
    a, b, c = points[i], points[j], points[k]
    if is_left(a, b, c) <= 1e-12:
        return False
    low_x, high_x = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
    low_y, high_y = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
    for m in rest:
        q = points[m]
        if q[0] < low_x or q[0] > high_x or q[1] < low_y or q[1] > high_y or q in (a, b, c):
            continue
        # A point on an edge, up to rounding, would end as a junction in the middle of an edge.
        if is_left(a, b, q) >= -ON_EDGE and is_left(b, c, q) >= -ON_EDGE and is_left(c, a, q) >= -ON_EDGE:
            return False
    return True


class Part:
    """Triangles: three points each, and their normals; millimetres."""

    def __init__(self, sides):
        self.sides = sides  # of a whole circle
        self.triangles = []

    def triangle(self, points, normals):
        normal = cross(sub(points[1], points[0]), sub(points[2], points[0]))
        if sum(x * x for x in normal) > 1e-18:
            self.triangles.append((points, normals))

    def grid(self, points, normals):
        """Quadrilaterals between rows; counter-clockwise from outside with the columns to the right and the rows upwards."""
        for i in range(len(points) - 1):
            for k in range(len(points[i]) - 1):
                a, b, c, d = (i, k), (i, k + 1), (i + 1, k + 1), (i + 1, k)
                for corners in ((a, b, c), (a, c, d)):
                    self.triangle(tuple(points[y][x] for y, x in corners), tuple(normals[y][x] for y, x in corners))

    def flat(self, outline, holes, place, normal):
        """A plane face: a counter-clockwise outline seen from `normal`, clockwise holes; place((x, y)) is the point in space."""
        original = {}

        def turned(p):
            # The angle is one at which no two points of the shapes are in one row, as bridges need it.
            q = (p[0] * math.cos(0.3) - p[1] * math.sin(0.3), p[0] * math.sin(0.3) + p[1] * math.cos(0.3))
            original[q] = p
            return q
        polygon = with_bridges([turned(p) for p in outline], [[turned(p) for p in ring] for ring in holes])
        for corners in triangulated(polygon):
            self.triangle(tuple(place(original[p]) for p in corners), (normal, normal, normal))

    def revolve(self, strokes):
        """About z: strokes of (radius, z), with the outside on their right-hand side."""
        turns = [2 * math.pi * k / self.sides for k in range(self.sides)] + [0.0]
        for stroke in strokes:
            def ring(pair):
                return [(max(pair[0], 0.0) * math.cos(t), max(pair[0], 0.0) * math.sin(t), pair[1]) for t in turns]

            def ring_normals(pair):
                return [(pair[0] * math.cos(t), pair[0] * math.sin(t), pair[1]) for t in turns]
            self.grid([ring(p) for p in stroke.points], [ring_normals(n) for n in stroke.normals])
        return self

    def extrude(self, outline, holes, low, high):
        """Along z: counter-clockwise strokes of the outline and clockwise ones of each hole."""
        for strokes in [outline] + holes:
            for stroke in strokes:
                normals = [(n[0], n[1], 0.0) for n in stroke.normals]
                self.grid([[(p[0], p[1], z) for p in stroke.points] for z in (low, high)], [normals, normals])
        rings = [outline_of(strokes) for strokes in holes]
        edge = outline_of(outline)
        self.flat(edge, rings, lambda p: (p[0], p[1], high), (0.0, 0.0, 1.0))
        self.flat([(p[1], p[0]) for p in reversed(edge)], [[(p[1], p[0]) for p in reversed(ring)] for ring in rings],
                  lambda p: (p[1], p[0], low), (0.0, 0.0, -1.0))
        return self

    def box(self, low, high):
        corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
        return self.extrude(rounded(corners, [0] * 4, self.sides), [], low[2], high[2])

    def tube(self, centres, frames, radius, sign=1.0):
        """Circles about `centres`, in planes of two unit vectors each (right-handed with the direction of the path)."""
        turns = [2 * math.pi * k / self.sides for k in range(self.sides)] + [0.0]
        normals = [[add(scaled(u, math.cos(t)), scaled(v, math.sin(t))) for t in turns] for u, v in frames]
        points = [[add(c, scaled(n, radius)) for n in row] for c, row in zip(centres, normals)]
        if sign < 0:
            points, normals = [row[::-1] for row in points], [[scaled(n, -1.0) for n in row[::-1]] for row in normals]
        self.grid(points, normals)
        return self

    def caps(self, centres, frames, inner, outer):
        """Closes both ends of a tube by a disc, or between an inner and an outer tube by a ring."""
        for end, (u, v) in ((0, frames[0]), (-1, frames[-1])):
            along = cross(u, v) if end else scaled(cross(u, v), -1.0)
            turns = [2 * math.pi * k / self.sides for k in range(self.sides)] + [0.0]
            rows = [[add(centres[end], scaled(add(scaled(u, math.cos(t)), scaled(v, math.sin(t))), radius)) for t in turns]
                    for radius in ((outer, inner) if end else (inner, outer))]
            self.grid(rows, [[along] * len(turns)] * 2)
        return self

    def lids(self, function, columns, low, high):
        """Closes a surface() at u = 0 and u = 1, where it is plane."""
        for u, z, normal in ((0.0, low, (0.0, 0.0, -1.0)), (1.0, high, (0.0, 0.0, 1.0))):
            ring = [function(u, k / columns)[:2] for k in range(columns)]
            if u > 0:
                self.flat(ring, [], lambda p, z=z: (p[0], p[1], z), normal)
            else:
                self.flat([(y, x) for x, y in reversed(ring)], [], lambda p, z=z: (p[1], p[0], z), normal)
        return self

    def surface(self, function, rows, columns):
        """function(u, v) -> point, u in [0, 1], periodic in v with the period 1; v to the right and u upwards as in grid()."""
        step = 1e-5

        def normal(u, v):
            across = sub(function(u, v + step), function(u, v - step))
            along = sub(function(u + step, v), function(u - step, v))
            return unit(cross(across, along))
        places = [[(i / rows, k % columns / columns) for k in range(columns + 1)] for i in range(rows + 1)]
        self.grid([[function(u, v) for u, v in row] for row in places],
                  [[normal(min(max(u, 1e-4), 1 - 1e-4), v) for u, v in row] for row in places])
        return self

    def take(self, other, axes=((1, 0, 0), (0, 1, 0), (0, 0, 1)), offset=(0, 0, 0)):
        """Adds another part; `axes` are the images of its x, y and z axes."""
        def turn(p):
            return tuple(sum(p[k] * axes[k][i] for k in range(3)) for i in range(3))
        for points, normals in other.triangles:
            self.triangles.append((tuple(add(turn(p), offset) for p in points), tuple(turn(n) for n in normals)))
        return self


def write_stl(path, part, scale):
    with open(path, "wb") as file:
        file.write(b"evpose bench models".ljust(80) + struct.pack("<I", len(part.triangles)))
        for points, _ in part.triangles:
            numbers = [scale * x for p in points for x in p]
            file.write(struct.pack("<12fH", 0.0, 0.0, 0.0, *numbers, 0))


def write_obj(path, part, scale, with_normals):
    vertices, normals, lines = {}, {}, []
    for points, corner_normals in part.triangles:
        corners = []
        for p, n in zip(points, corner_normals):
            # Numbers are rounded, and -0 becomes 0, so that equal points have equal texts.
            vertex = vertices.setdefault(" ".join(f"{round(scale * x, 9) + 0.0:.9f}" for x in p), len(vertices) + 1)
            normal = normals.setdefault(" ".join(f"{round(x, 6) + 0.0:.6f}" for x in n), len(normals) + 1)
            corners.append(f"{vertex}//{normal}" if with_normals else str(vertex))
        if len({corner.partition("/")[0] for corner in corners}) == 3:
            lines.append("f " + " ".join(corners))
    with open(path, "w", encoding="ascii") as file:
        file.write("".join(f"v {text}\n" for text in vertices))
        if with_normals:
            file.write("".join(f"vn {text}\n" for text in normals))
        file.write("\n".join(lines) + "\n")
