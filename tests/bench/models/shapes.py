# SPDX-License-Identifier: Apache-2.0
"""The shapes of the benchmark, in millimetres. Each is a function of the number of facets of a whole circle."""
import math

from part import Part, add, arc, circle, cross, hole, line, rounded, scaled, unit

X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
LYING = ((0, 0, 1), (1, 0, 0), (0, 1, 0))  # images of the axes: z lies along y
BACK = ((0, 0, 1), (0, 1, 0), (-1, 0, 0))  # z lies along -x
FORTH = ((0, 0, -1), (0, 1, 0), (1, 0, 0))  # z lies along x
DOWN = ((1, 0, 0), (0, -1, 0), (0, 0, -1))  # half a turn about x


def profile(corners, radii, sides):
    """Open polygon of (radius, z) for revolve()."""
    return rounded(corners, radii, sides, closed=False)


def bracket(n):
    """An L of two plates with three holes, an inner fillet of 8 mm and an outer one of 14 mm."""
    part = Part(n)
    length, width, height, thick, inner = 70.0, 50.0, 60.0, 6.0, 8.0
    shape = rounded([(0, 0), (length, 0), (length, thick), (thick, thick), (thick, height), (0, height)],
                    [inner + thick, 0, 0, inner, 0, 0], n)
    edge = [p for stroke in shape for p in stroke.points]
    for stroke in shape:
        if len(stroke.points) > 2:  # the fillets
            part.grid([[(p[0], p[1], z) for p in stroke.points] for z in (0.0, width)],
                      [[(q[0], q[1], 0.0) for q in stroke.normals]] * 2)
    ring = [p for i, p in enumerate(edge) if math.dist(p, edge[i - 1]) > 1e-9]
    part.flat(ring, [], lambda p: (p[0], p[1], width), Z)
    part.flat([(p[1], p[0]) for p in reversed(ring)], [], lambda p: (p[1], p[0], 0.0), (0, 0, -1))
    left, right = inner + thick, length
    plate(part, [(left, 0.0), (right, 0.0), (right, width), (left, width)], [((36, 14), 4.5), ((52, 36), 4.5)], n,
          lambda p, side: (p[0], thick if side else 0.0, width - p[1]), lambda q: (q[0], 0.0, -q[1]), (0, 1, 0))
    part.flat([(0, 0), (width, 0), (width, thick), (0, thick)], [], lambda p: (length, p[1], width - p[0]), X)
    plate(part, [(left, 0.0), (height, 0.0), (height, width), (left, width)], [((40, 25), 11.0)], n,
          lambda p, side: (thick if side else 0.0, p[0], p[1]), lambda q: (0.0, q[0], q[1]), (1, 0, 0))
    part.flat([(0, 0), (width, 0), (width, thick), (0, thick)], [], lambda p: (p[1], height, p[0]), Y)
    return part


def plate(part, outline, holes, n, place, turn, normal):
    """Both sides of a plane plate with round holes, and their walls. place(p, is_front), turn(normal in the plane)."""
    rings = [hole(centre, radius, n)[0] for centre, radius in holes]
    cut = [ring.points[:-1] for ring in rings]
    part.flat(outline, cut, lambda p: place(p, True), normal)
    part.flat([(p[1], p[0]) for p in reversed(outline)], [[(p[1], p[0]) for p in reversed(ring)] for ring in cut],
              lambda p: place((p[1], p[0]), False), scaled(normal, -1.0))
    for ring in rings:
        normals = [turn(q) for q in ring.normals]
        part.grid([[place(p, False) for p in ring.points], [place(p, True) for p in ring.points]], [normals, normals])


def flange(n):
    bolts = [hole((32 * math.cos(math.pi * k / 3), 32 * math.sin(math.pi * k / 3)), 4.0, n) for k in range(6)]
    part = Part(n).extrude(circle((0, 0), 42.0, n), [hole((0, 0), 12.0, n)] + bolts, 0.0, 9.0)
    # The hub is a shell of its own that stands on the disc.
    hub = profile([(12, 9), (20, 9), (18, 34), (12, 34), (12, 9)], [0, 0, 2, 0, 0], n)
    return part.take(Part(n).revolve(hub))


def shaft(n):
    """Three diameters, a keyway in the thickest one."""
    half, depth, radius = 4.0, 4.0, 15.0
    side = math.sqrt(radius * radius - half * half)
    begin = math.asin(half / radius)
    notch = [arc((0, 0), radius, begin, 2 * math.pi - begin, n), line((side, -half), (radius - depth, -half)),
             line((radius - depth, -half), (radius - depth, half)), line((radius - depth, half), (side, half))]
    part = Part(n).extrude(notch, [], 0.0, 45.0)
    part.take(Part(n).revolve(profile([(0, 45), (10, 45), (10, 85), (0, 85)], [0, 0, 1.5, 0], n)))
    return part.take(Part(n).revolve(profile([(0, -30), (11, -30), (11, 0), (0, 0)], [0, 2, 0, 0], n)))


def bottle(n):
    return Part(n).revolve(profile([(0, 0), (33, 0), (33, 120), (12, 145), (12, 172), (15, 172), (15, 182), (0, 182)],
                                   [0, 8, 18, 10, 0, 0, 1.5, 0], n))


def mug(n):
    part = Part(n).revolve(profile([(0, 0), (38, 0), (42, 90), (38.5, 90), (34.5, 5), (0, 5)], [0, 5, 1.5, 1.5, 6, 0], n))
    centres, frames = [], []
    for i in range(n // 2 + 1):
        angle = -math.pi / 2 + math.pi * i / (n // 2)
        # The ends are within the wall.
        centres.append((37.2 + 24 * math.cos(angle), 0.0, 46 + 26 * math.sin(angle)))
        along = unit((-24 * math.sin(angle), 0.0, 26 * math.cos(angle)))
        frames.append(((along[2], 0.0, -along[0]), Y))
    return part.take(Part(n).tube(centres, frames, 5.5).caps(centres, frames, 0.0, 5.5))


def elbow(n):
    """A quarter of a torus with a wall, and a flange at each end."""
    centres, frames = [], []
    for i in range(n // 4 + 1):
        angle = 0.5 * math.pi * i / (n // 4)
        centres.append((50 * math.cos(angle), 0.0, 50 * math.sin(angle)))
        frames.append(((math.cos(angle), 0.0, math.sin(angle)), Y))
    part = Part(n).tube(centres, frames, 20.0).tube(centres, frames, 16.0, sign=-1.0).caps(centres, frames, 16.0, 20.0)
    rim = Part(n).revolve(profile([(16, 0), (28, 0), (28, 7), (16, 7), (16, 0)], [0] * 5, n))
    part.take(rim, DOWN, (50, 0, 0))
    return part.take(rim, BACK, (0, 0, 50))


def gear(n):
    teeth, strokes, corners = 18, [], []
    for k in range(teeth):
        for shift, radius in ((-0.30, 33.0), (-0.13, 41.0), (0.13, 41.0), (0.30, 33.0)):
            angle = 2 * math.pi * (k + shift) / teeth
            corners.append((radius * math.cos(angle), radius * math.sin(angle)))
    strokes = rounded(corners, [0] * len(corners), n)
    part = Part(n).extrude(strokes, [hole((0, 0), 9.0, n)], 0.0, 14.0)
    return part.take(Part(n).revolve(profile([(9, 14), (17, 14), (17, 24), (9, 24), (9, 14)], [0, 0, 1, 0, 0], n)))


def robot_link(n):
    """Two eyes of different size, joined by their common tangents."""
    length, large, small = 110.0, 28.0, 18.0
    tilt = math.acos((large - small) / length)
    window = rounded([(38, -9), (38, 9), (82, 6), (82, -6)], [4, 4, 4, 4], n)
    part = Part(n).extrude(eyes(large, small, length, tilt, n), [hole((0, 0), 13.0, n), hole((length, 0), 8.0, n), window], 0.0, 16.0)
    return part.take(Part(n).revolve(profile([(13, 16), (21, 16), (21, 30), (13, 30), (13, 16)], [0, 0, 3, 0, 0], n)))


def torus(n):
    return Part(n).revolve(circle((40, 0), 15.0, n))


def blob(n):
    """A closed free form: a sphere whose radius depends on the direction by a few smooth waves."""
    def point(u, v):
        polar, azimuth = math.pi * u, 2 * math.pi * v
        d = (math.sin(polar) * math.cos(azimuth), math.sin(polar) * math.sin(azimuth), -math.cos(polar))
        radius = 40 + 7 * d[0] * d[1] + 6 * d[2] ** 3 - 5 * d[0] ** 2 * d[2] + 4 * math.sin(3 * d[1] + 1)
        return scaled(d, radius)
    return Part(n).surface(point, n // 2, n)


def blade(n):
    """A twisted wing on a root block."""
    def point(u, v):
        angle = 2 * math.pi * v
        chord, twist = 34 - 12 * u, 0.2 + 0.8 * u
        x = 0.5 * chord * math.cos(angle)
        y = 0.16 * chord * math.sin(angle) * (1 + 0.4 * math.cos(angle)) + 0.05 * chord * (1 - math.cos(angle) ** 2)
        return (x * math.cos(twist) - y * math.sin(twist), x * math.sin(twist) + y * math.cos(twist), 90 * u)
    part = Part(n).surface(point, max(6, n // 3), n)
    part.lids(point, n, 0.0, 90.0)
    return part.take(Part(n).box((-22, -12, -16), (22, 12, 1)))


def satellite(n):
    part = Part(n).box((-22, -22, -28), (22, 22, 28))
    for side in (-1, 1):
        part.take(Part(n).box((-30, -18, -1), (30, 18, 1)), offset=(side * 60, 0, 4))
        part.take(Part(n).revolve(profile([(0, 0), (2, 0), (2, 9), (0, 9)], [0] * 4, n)),
                  BACK if side < 0 else FORTH, (side * 21.5, 0, 4))
    dish = Part(n)
    bowl = arc((0, 60), 60.0, -0.5 * math.pi, -0.5 * math.pi + 0.5, n * 2)
    back = arc((0, 60), 58.5, -0.5 * math.pi + 0.5, -0.5 * math.pi, n * 2)
    dish.revolve([bowl, line(bowl.points[-1], back.points[0]), back])
    dish.revolve(profile([(0, 1.5), (1.5, 1.5), (1.5, 22), (0, 22)], [0, 0, 0.5, 0], n))
    part.take(dish, offset=(0, 0, 30))
    return part.take(Part(n).revolve(profile([(0, 27), (4, 27), (4, 31), (0, 31)], [0] * 4, n)))


def panel(n):
    outline = rounded([(0, 0), (120, 0), (120, 80), (0, 80)], [8, 8, 8, 8], n)
    slot = rounded([(20, 14), (20, 24), (70, 24), (70, 14)], [5] * 4, n)
    window = rounded([(62, 38), (62, 68), (108, 68), (108, 38)], [5, 5, 5, 5], n)
    holes = [hole((26, 54), 15.0, n), hole((90, 19), 6.0, n), hole((106, 19), 4.0, n), slot, window]
    return Part(n).extrude(outline, holes, 0.0, 4.0)


def hex_nut(n):
    corners = [(20 * math.cos(math.pi * k / 3), 20 * math.sin(math.pi * k / 3)) for k in range(6)]
    return Part(n).extrude(rounded(corners, [0] * 6, n), [hole((0, 0), 10.0, n)], 0.0, 16.0)


def knob(n):
    part = Part(n).revolve(profile([(0, 0), (20, 0), (18, 16), (13, 20), (13, 30), (0, 30)], [0, 0, 5, 3, 3, 0], n))
    return part.take(Part(n).box((4, -1.5, 29), (16, 1.5, 31.5)))


def t_slot(n):
    quarter = [(15, -15), (15, -4), (11, -4), (11, -8), (6, -8), (6, 8), (11, 8), (11, 4), (15, 4), (15, 15)]
    corners, radii = [], []
    for turns in range(2):
        sign = 1 if turns == 0 else -1
        corners += [(sign * x, sign * y) for x, y in quarter]
        radii += [2, 0, 0, 0, 0, 0, 0, 0, 0, 2]
    return Part(n).extrude(rounded(corners, radii, n), [hole((0, 0), 3.0, n)], 0.0, 90.0)


def l_profile(n):
    """An angle of two legs with a slot in each, made of two shells."""
    part = Part(n)
    slot = rounded([(14, 20), (14, 28), (40, 28), (40, 20)], [4] * 4, n)
    leg = Part(n).extrude(rounded([(0, 0), (60, 0), (60, 48), (0, 48)], [0, 6, 6, 0], n), [slot], 0.0, 5.0)
    part.take(leg)
    return part.take(leg, BACK, (5, 0, 5))


def phone(n):
    """A box with rounded corners and edges, and a raised camera."""
    half, corner, edge, height = (36.0, 74.0), 10.0, 3.0, 9.0
    part = Part(n)
    levels = [(0.5 * math.pi * k / max(2, n // 4)) for k in range(max(2, n // 4) + 1)]

    def ring(angle, top):
        inset = edge * (1 - math.cos(angle))
        z = height - edge + edge * math.sin(angle) if top else edge - edge * math.sin(angle)
        wide, tall = half[0] - inset, half[1] - inset
        strokes = rounded([(-wide, -tall), (wide, -tall), (wide, tall), (-wide, tall)], [corner - inset] * 4, n)
        points = [(p[0], p[1], z) for stroke in strokes for p in stroke.points]
        rise = math.sin(angle) if top else -math.sin(angle)
        normals = [(q[0] * math.cos(angle), q[1] * math.cos(angle), rise) for stroke in strokes for q in stroke.normals]
        return points + points[:1], normals + normals[:1]
    rows = [ring(angle, False) for angle in reversed(levels)] + [ring(angle, True) for angle in levels]
    part.grid([row[0] for row in rows], [row[1] for row in rows])
    for row, normal in ((rows[-1][0], 1.0), (rows[0][0], -1.0)):
        edge_points = [(p[0], p[1]) for i, p in enumerate(row[:-1]) if math.dist(p, row[i - 1]) > 1e-9]
        if normal > 0:
            part.flat(edge_points, [], lambda p: (p[0], p[1], height), Z)
        else:
            part.flat([(y, x) for x, y in reversed(edge_points)], [], lambda p: (p[1], p[0], 0.0), (0, 0, -1))
    return part.take(Part(n).revolve(profile([(0, 8.5), (9, 8.5), (9, 11), (0, 11)], [0, 0, 0.8, 0], n)), offset=(18, 52, 0))


def funnel(n):
    return Part(n).revolve(profile([(8, 0), (10, 0), (10, 30), (45, 75), (45, 82), (43, 82), (43, 76), (8, 31), (8, 0)],
                                   [0, 0, 6, 4, 0, 0, 4, 6, 0], n))


def impeller(n):
    part = Part(n).revolve(profile([(0, 0), (45, 0), (45, 4), (16, 10), (10, 34), (0, 34)], [0, 0, 0, 10, 3, 0], n))
    steps = max(4, n // 6)
    for k in range(7):
        rows = []
        for i in range(steps + 1):
            radius = 12 + 32 * i / steps
            angle = 2 * math.pi * k / 7 + 0.9 * (i / steps) ** 1.3
            across = (-math.sin(angle), math.cos(angle), 0.0)
            rows.append(((radius * math.cos(angle), radius * math.sin(angle), 0.0), across, 30 - 14 * i / steps))
        wing(part, rows, 0.9)
    return part


def wing(part, rows, half):
    """A curved wall along `rows` of (foot, direction across, height)."""
    def corner(row, side, is_top):
        foot, across, high = row
        return add(add(foot, scaled(across, side * half)), (0.0, 0.0, high if is_top else 1.0))
    right = [[corner(r, -1, False) for r in rows], [corner(r, -1, True) for r in rows]]
    left = [[corner(r, 1, False) for r in reversed(rows)], [corner(r, 1, True) for r in reversed(rows)]]
    top = [[corner(r, -1, True) for r in rows], [corner(r, 1, True) for r in rows]]
    end = [[corner(rows[-1], -1, False), corner(rows[-1], 1, False)], [corner(rows[-1], -1, True), corner(rows[-1], 1, True)]]
    begin = [[corner(rows[0], 1, False), corner(rows[0], -1, False)], [corner(rows[0], 1, True), corner(rows[0], -1, True)]]
    bottom = [[corner(r, 1, False) for r in rows], [corner(r, -1, False) for r in rows]]
    for face in (right, left, top, bottom, end, begin):
        part.grid(face, normals_of(face))


def normals_of(points):
    """Normals of a grid by differences between neighbours."""
    normals = []
    for i in range(len(points)):
        row = []
        for k in range(len(points[i])):
            across = [b - a for a, b in zip(points[i][max(k - 1, 0)], points[i][min(k + 1, len(points[i]) - 1)])]
            along = [b - a for a, b in zip(points[max(i - 1, 0)][k], points[min(i + 1, len(points) - 1)][k])]
            row.append(unit(cross(across, along)))
        normals.append(row)
    return normals


def hinge(n):
    """Two leaves with three holes each, turned by 60 degrees, and their barrel."""
    holes = [hole((18, 12), 3.5, n), hole((18, 60), 3.5, n), hole((32, 36), 3.5, n)]
    leaf = Part(n).extrude(rounded([(5, 0), (44, 0), (44, 72), (5, 72)], [0, 7, 7, 0], n), holes, -1.5, 1.5)
    barrel = Part(n).revolve(profile([(2.5, 0), (6, 0), (6, 72), (2.5, 72), (2.5, 0)], [0] * 5, n))
    part = Part(n).take(leaf)
    cosine, sine = math.cos(math.radians(120)), math.sin(math.radians(120))
    part.take(leaf, ((cosine, 0, -sine), (0, 1, 0), (sine, 0, cosine)))
    return part.take(barrel, LYING)


def ball_joint(n):
    return Part(n).revolve([arc((0, 0), 18.0, -0.5 * math.pi, 0.5 * math.pi - 0.45, n),
                            *profile([(18 * math.sin(0.45), 18 * math.cos(0.45)), (6.5, 30), (6.5, 62), (12, 62), (12, 70), (0, 70)],
                                     [0, 4, 0, 0, 1, 0], n)])


def capsule(n):
    return Part(n).revolve([arc((0, -25), 18.0, -0.5 * math.pi, 0.0, n), line((18, -25), (18, 25)), arc((0, 25), 18.0, 0.0, 0.5 * math.pi, n)])


def cam(n):
    large, small, length = 26.0, 11.0, 30.0
    tilt = math.acos((large - small) / length)
    return Part(n).extrude(eyes(large, small, length, tilt, n), [hole((0, 0), 9.0, n), hole((length, 0), 4.0, n)], 0.0, 12.0)


def eyes(large, small, length, tilt, n):
    """Two circles and the straight lines that touch them at the angle `tilt`."""
    cosine, sine = math.cos(tilt), math.sin(tilt)
    return [arc((0, 0), large, tilt, 2 * math.pi - tilt, n),
            line((large * cosine, -large * sine), (length + small * cosine, -small * sine)),
            arc((length, 0), small, -tilt, tilt, n),
            line((length + small * cosine, small * sine), (large * cosine, large * sine))]


def tee(n):
    """Two pipes that penetrate each other."""
    pipe = Part(n).revolve(profile([(14, -45), (18, -45), (18, 45), (14, 45), (14, -45)], [0] * 5, n))
    branch = Part(n).revolve(profile([(10, 16), (13, 16), (13, 50), (10, 50), (10, 16)], [0] * 5, n))
    return pipe.take(branch, LYING)


def pulley(n):
    spokes = [hole((22 * math.cos(math.pi * k / 2), 22 * math.sin(math.pi * k / 2)), 6.0, n) for k in range(4)]
    part = Part(n).extrude(circle((0, 0), 32.0, n), [hole((0, 0), 8.0, n)] + spokes, -4.0, 4.0)
    rim = profile([(32, -9), (42, -9), (36, -2), (36, 2), (42, 9), (32, 9), (32, -9)], [0, 0, 1.5, 1.5, 0, 0, 0], n)
    return part.take(Part(n).revolve(rim))


def spring(n):
    turns, radius = 4, 22.0
    centres, frames = [], []
    steps = turns * n
    for i in range(steps + 1):
        angle = 2 * math.pi * turns * i / steps
        centres.append((radius * math.cos(angle), radius * math.sin(angle), 16.0 * angle / (2 * math.pi)))
        along = unit((-radius * math.sin(angle), radius * math.cos(angle), 16.0 / (2 * math.pi)))
        outward = (math.cos(angle), math.sin(angle), 0.0)
        frames.append((outward, cross(along, outward)))
    return Part(max(8, n // 3)).tube(centres, frames, 3.5).caps(centres, frames, 0.0, 3.5)


def fluted_vase(n):
    def point(u, v):
        angle = 2 * math.pi * v
        radius = (26 + 12 * math.sin(2.6 * u + 0.4) - 8 * u) * (1 + 0.05 * math.cos(8 * angle + 2 * u))
        return (radius * math.cos(angle), radius * math.sin(angle), 110 * u)
    return Part(n).surface(point, n, 2 * n).lids(point, 2 * n, 0.0, 110.0)


def heat_sink(n):
    corners = [(0, 0), (80, 0)]
    for k in range(7):
        right = 80 - 12 * k
        corners += [(right, 32), (right - 3, 32), (right - 3, 6), (right - 12, 6)] if k < 6 else [(right, 32), (0, 32)]
    return Part(n).extrude(rounded(corners, [0] * len(corners), n), [], 0.0, 50.0)


SHAPES = {function.__name__: function for function in (
    bracket, flange, shaft, bottle, mug, elbow, gear, robot_link, torus, blob, blade, satellite, panel, hex_nut, knob, t_slot,
    l_profile, phone, funnel, impeller, hinge, ball_joint, capsule, cam, tee, pulley, spring, fluted_vase, heat_sink)}
