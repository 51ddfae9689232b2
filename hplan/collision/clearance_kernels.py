r"""Kernels of `hplan.collision.clearance_field`: the clearance of each link, and motions verified collision-free.

Clearance at a configuration is only a sample. It becomes a proof with a bound on motion: while a joint-space segment
is traversed, no axis point of link :math:`k` moves farther than

.. math:: |\Delta q_0| \, \varrho_k + \sum_{i \le k} L_i \, |\Delta \varphi_i|,

with :math:`\varphi_i` the absolute angle of link :math:`i` in the plane and :math:`\varrho_k` its largest distance
from the yaw axis. So a link with clearance :math:`d` stays clear for the part of the motion whose bound is below
:math:`d` (conservative advancement).

Where the arm can touch itself (`hplan.robot.self_contact`), two links count half of their distance, for the outer one:
neither moves farther than the bound of the outer one, so together they use up no more than twice that.
"""

from __future__ import annotations

import math

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray
from hplan.base.deadline import is_up
from hplan.base.kernels import any_int, inlined, kernel
from hplan.collision import obstacle_rows as row
from hplan.collision.body_kernels import body_clearances
from hplan.collision.body_motions import body_bounds, body_piece_is_clear, body_shown_part, mark_near_bodies
from hplan.collision.distances import Vector, point_segment, segment_box, segment_hull, segment_segment
from hplan.collision.motion_cover import body_keeps_margin
from hplan.collision.obstacle_rows import OF_BODIES
from hplan.collision.obstacle_rows import FieldArrays as FieldArrays

_FIRST_ROW = any_int(0)

#: Most evaluations of the clearance along one motion.
_MOST_LOOKS = any_int(1_000_000)

#: Numbers of a link of a planar arm; other arms have other rows (`hplan.collision.flat_bodies`).
LINK = any_int(6)


@kernel
def _links_apart(q: FloatArray, first: int, chain: FloatArray, inner: int, outer: int) -> float:
    """Distance between the axes of two links; x is along the inner one, from its end, and z across the arm plane."""
    x, y, angle = 0.0, 0.0, 0.0
    along, up = 0.0, 0.0
    for k in range(inner + 1, outer + 1):
        x, y = x + along, y + up
        angle += chain[k, 2] * q[first + k] + chain[k, 3]
        along, up = chain[k, 0] * math.cos(angle), chain[k, 0] * math.sin(angle)
    length = chain[inner, 0]
    aside = chain[outer, 4] - chain[inner, 4]
    distance: float = segment_segment((x, y, aside), (along, up, 0.0), (-length, 0.0, 0.0), (length, 0.0, 0.0))
    return distance


@kernel
def _core_distance(start: Vector, u: Vector, solids: FloatArray, s: int, data: FloatArray, limit: float) -> float:
    """Distance of a segment from the core of a row that is a point, a segment or a hull; any above the limit beyond."""
    ax, ay, az = solids[s, row.SHAPE], solids[s, row.SHAPE + 1], solids[s, row.SHAPE + 2]
    bx, by, bz = solids[s, row.SECOND_END], solids[s, row.SECOND_END + 1], solids[s, row.SECOND_END + 2]
    if solids[s, row.KIND] == row.POINT:
        apart: float = point_segment((ax, ay, az), start, u)
    elif solids[s, row.KIND] == row.SEGMENT:
        apart = segment_segment(start, u, (ax, ay, az), (bx - ax, by - ay, bz - az))
    else:
        apart = segment_hull(start, u, data, int(ax), int(ay), int(az), limit)
    return apart


@kernel
def _box_distance(start: Vector, u: Vector, solids: FloatArray, s: int) -> float:
    """Distance of a segment from a row that is a box, in the box's frame."""
    offset = (
        start[0] - solids[s, row.CENTRE],
        start[1] - solids[s, row.CENTRE + 1],
        start[2] - solids[s, row.CENTRE + 2],
    )
    first = (solids[s, row.AXES], solids[s, row.AXES + 1], solids[s, row.AXES + 2])
    second = (solids[s, row.AXES + 3], solids[s, row.AXES + 4], solids[s, row.AXES + 5])
    third = (solids[s, row.AXES + 6], solids[s, row.AXES + 7], solids[s, row.AXES + 8])
    distance: float = segment_box(
        (_dot(offset, first), _dot(offset, second), _dot(offset, third)),
        (_dot(u, first), _dot(u, second), _dot(u, third)),
        (solids[s, row.SHAPE], solids[s, row.SHAPE + 1], solids[s, row.SHAPE + 2]),
    )
    return distance


@inlined
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _arm_plane(q: FloatArray, base: FloatArray) -> tuple[int, float, float, Vector, Vector, Vector]:
    """First planar joint, cosine and sine of the yaw, shoulder, and the plane's forward and upward axis."""
    first, cos, sin = 0, 1.0, 0.0
    if base[9] > 0.0:
        first, cos, sin = 1, math.cos(q[0]), math.sin(q[0])
    shoulder = (base[10] + (cos * base[0] - sin * base[1]), base[11] + (sin * base[0] + cos * base[1]), base[2])
    forward = (cos * base[3] - sin * base[4], sin * base[3] + cos * base[4], base[5])
    upward = (cos * base[6] - sin * base[7], sin * base[6] + cos * base[7], base[8])
    return first, cos, sin, shoulder, forward, upward


@kernel
def link_clearances(q: FloatArray, field: FieldArrays, result: FloatArray) -> None:
    """Clearance of each link at one configuration; of a general (non-planar) arm, of each moving body."""
    if len(field) == OF_BODIES:
        body_clearances(q, field, result)
        return
    chain, base, solids, data = field.chain, field.base, field.solids, field.data
    first, cos, sin, shoulder, (fx, fy, fz), (gx, gy, gz) = _arm_plane(q, base)
    nx, ny, nz = fy * gz - fz * gy, fz * gx - fx * gz, fx * gy - fy * gx
    px, py, pz = shoulder
    angle = 0.0
    for k in range(chain.shape[0]):
        angle += chain[k, 2] * q[first + k] + chain[k, 3]
        along, up = chain[k, 0] * math.cos(angle), chain[k, 0] * math.sin(angle)
        ux, uy, uz = along * fx + up * gx, along * fy + up * gy, along * fz + up * gz
        x, y, z = px + chain[k, 4] * nx, py + chain[k, 4] * ny, pz + chain[k, 4] * nz
        mx, my, mz = x + 0.5 * ux, y + 0.5 * uy, z + 0.5 * uz
        half_length = 0.5 * chain[k, 0]
        least = math.inf
        following = _FIRST_ROW
        while following < solids.shape[0]:
            s = following
            cx, cy, cz = solids[s, row.CENTRE], solids[s, row.CENTRE + 1], solids[s, row.CENTRE + 2]
            dx, dy, dz = cx - mx, cy - my, cz - mz
            within = least + half_length + solids[s, row.BOUND]
            if dx * dx + dy * dy + dz * dz > within * within:
                # Its bounding ball is farther than the nearest so far.
                following = int(solids[s, row.NEXT]) if solids[s, row.KIND] >= row.NODE else s + 1
                continue
            following = s + 1
            kind = solids[s, row.KIND]
            distance = math.inf
            # (Points, segments and hulls without a call to `_core_distance`, which takes half as long again.)
            ax, ay, az = solids[s, row.SHAPE], solids[s, row.SHAPE + 1], solids[s, row.SHAPE + 2]
            if kind == row.POINT:
                distance = point_segment((ax, ay, az), (x, y, z), (ux, uy, uz))
            elif kind == row.SEGMENT:
                bx, by, bz = solids[s, row.SECOND_END], solids[s, row.SECOND_END + 1], solids[s, row.SECOND_END + 2]
                distance = segment_segment((x, y, z), (ux, uy, uz), (ax, ay, az), (bx - ax, by - ay, bz - az))
            elif kind == row.BOX:
                distance = _box_distance((x, y, z), (ux, uy, uz), solids, s)
            elif kind == row.HULL:
                limit = least + solids[s, row.RADIUS]
                distance = segment_hull((x, y, z), (ux, uy, uz), data, int(ax), int(ay), int(az), limit)
            elif kind == row.LINK_RANGE:
                if not solids[s, row.FIRST_LINK] <= k <= solids[s, row.LAST_LINK]:
                    following = int(solids[s, row.NEXT])
                elif solids[s, row.TURNS] > 0.0:
                    # What turns with the arm plane, from the link as it stands at yaw 0.
                    rx, ry = x - base[10], y - base[11]
                    distance = _core_distance(
                        (base[10] + (cos * rx + sin * ry), base[11] + (cos * ry - sin * rx), z),
                        (cos * ux + sin * uy, cos * uy - sin * ux, uz),
                        solids, s + 1, data, least + solids[s, row.RADIUS],
                    )  # fmt: skip
                    following = int(solids[s, row.NEXT])
            elif kind == row.PAIR:
                if k == solids[s, row.OUTER]:
                    apart = _links_apart(q, first, chain, int(solids[s, row.INNER]), k) - solids[s, row.TOUCHING]
                    distance = 0.5 * apart + chain[k, 1]  # less the half-width, below
            elif point_segment((cx, cy, cz), (x, y, z), (ux, uy, uz)) > least + solids[s, row.BOUND]:
                following = int(solids[s, row.NEXT])
            elif kind == row.NODE:
                if solids[s, row.IS_ROOT] > 0.0:
                    # What is near at once lets most of the tree be skipped.
                    distance = _descended(s, solids, data, (x, y, z), (ux, uy, uz))
            elif kind == row.LEAF:
                for p in range(int(solids[s, row.POINTS]), int(solids[s, row.POINTS_END]), 3):
                    point = point_segment((data[p], data[p + 1], data[p + 2]), (x, y, z), (ux, uy, uz))
                    distance = min(distance, point)
            least = min(least, distance - solids[s, row.RADIUS])
        result[k] = least - chain[k, 1]
        px, py, pz = px + ux, py + uy, pz + uz


@kernel
def _descended(s: int, solids: FloatArray, data: FloatArray, start: Vector, u: Vector) -> float:
    """Distance of a segment from the points of one leaf below a node: down the nearer child each time."""
    end = int(solids[s, row.NEXT])
    while solids[s, row.KIND] == row.NODE:
        s += 1
        if s >= end:
            return math.inf  # a field of some rows alone
        other = int(solids[s, row.NEXT])
        if other < end:
            here = (solids[s, row.CENTRE], solids[s, row.CENTRE + 1], solids[s, row.CENTRE + 2])
            there = (solids[other, row.CENTRE], solids[other, row.CENTRE + 1], solids[other, row.CENTRE + 2])
            if point_segment(there, start, u) < point_segment(here, start, u):
                s = other
        end = int(solids[s, row.NEXT])
    least = math.inf
    for p in range(int(solids[s, row.POINTS]), int(solids[s, row.POINTS_END]), 3):
        point = point_segment((data[p], data[p + 1], data[p + 2]), start, u)
        least = min(least, point)
    return least


@kernel
def clearances_along(points: FloatArray, field: FieldArrays, result: FloatArray) -> None:
    """Clearance of each link at (n, dof) configurations, written into (n, links)."""
    for i in range(points.shape[0]):
        if is_up(field.until):
            break
        link_clearances(points[i], field, result[i])


@kernel
def mark_near(path: FloatArray, field: FieldArrays, distance: float, near: BoolArray) -> None:
    """Mark the rows whose bounding ball comes within a distance of a link at some configuration."""
    if len(field) == OF_BODIES:
        mark_near_bodies(path, field, distance, near)
        return
    chain, base, solids = field.chain, field.base, field.solids
    for i in range(path.shape[0]):
        if is_up(field.until):
            break
        first, _, _, (x, y, z), (fx, fy, fz), (gx, gy, gz) = _arm_plane(path[i], base)
        nx, ny, nz = fy * gz - fz * gy, fz * gx - fx * gz, fx * gy - fy * gx
        angle = 0.0
        for k in range(chain.shape[0]):
            angle += chain[k, 2] * path[i, first + k] + chain[k, 3]
            along, up = chain[k, 0] * math.cos(angle), chain[k, 0] * math.sin(angle)
            u = (along * fx + up * gx, along * fy + up * gy, along * fz + up * gz)
            start = (x + chain[k, 4] * nx, y + chain[k, 4] * ny, z + chain[k, 4] * nz)
            following = _FIRST_ROW
            while following < solids.shape[0]:
                s = following
                following = s + 1
                if not near[s]:
                    centre = (solids[s, row.CENTRE], solids[s, row.CENTRE + 1], solids[s, row.CENTRE + 2])
                    apart = point_segment(centre, start, u)
                    near[s] = apart <= distance + solids[s, row.BOUND] + chain[k, 1]
                    if not near[s] and solids[s, row.KIND] == row.NODE and solids[s, row.IS_ROOT] < 0.0:
                        following = int(solids[s, row.NEXT])
            x, y, z = x + u[0], y + u[1], z + u[2]


@kernel
def smallest(values: FloatArray) -> float:
    """Smallest of a few values."""
    least = math.inf
    for value in values:
        least = min(least, value)
    return least


@kernel
def keeps_margin(q: FloatArray, field: FieldArrays, margin: float) -> bool:
    """True if no clearance at a configuration is below a margin; how large they are is not looked for."""
    if len(field) == OF_BODIES:
        return body_keeps_margin(q, field, margin)
    clear = np.empty(field.chain.shape[0])
    link_clearances(q, field, clear)
    least: float = smallest(clear)
    return least >= margin


@inlined
def proven_advance(clear: FloatArray, bounds: FloatArray, margin: float) -> float:
    """The part of a motion, at most 1, that cannot use up any link's clearance; -1 where the margin is not kept."""
    advance = 1.0
    for k in range(len(clear)):
        if not clear[k] >= margin:  # so that nothing that is no number passes
            advance = -1.0
            break
        if bounds[k] * advance > clear[k]:
            advance = clear[k] / bounds[k]
    return advance


@kernel
def motion_bounds(turns: FloatArray, field: FieldArrays, result: FloatArray) -> None:
    """Largest displacement of any axis point of each link while all joints turn in proportion, by `turns` in all.

    Args:
        turns: (dof,) joint displacements.
        result: (links,) bounds, written [m].
    """
    if len(field) == OF_BODIES:
        body_bounds(turns, field.chain, field.base, result)
        return
    piece_bounds(straight_piece(np.zeros(len(turns)), turns), field.chain, field.base, result)


@kernel
def piece_bounds(piece: FloatArray, chain: FloatArray, base: FloatArray, result: FloatArray) -> None:
    """Largest speed of any axis point of each link while a piece's own parameter runs from 0 to 1 [m].

    As `motion_bounds`, from the hull of the derivative: each absolute link angle turns no faster than
    at the fastest of the derivative's three control points.
    """
    first = 1 if base[9] > 0.0 else 0
    swing = 0.0
    if first:
        for c in range(3):
            swing = max(swing, 3.0 * abs(piece[c + 1, 0] - piece[c, 0]))
    turn0, turn1, turn2, bound = 0.0, 0.0, 0.0, 0.0
    for k in range(chain.shape[0]):
        turn0 += chain[k, 2] * (piece[1, first + k] - piece[0, first + k])
        turn1 += chain[k, 2] * (piece[2, first + k] - piece[1, first + k])
        turn2 += chain[k, 2] * (piece[3, first + k] - piece[2, first + k])
        bound += 3.0 * chain[k, 0] * max(abs(turn0), abs(turn1), abs(turn2))
        result[k] = bound + swing * chain[k, 5]


@kernel
def shown_part(piece: FloatArray, field: FieldArrays, margin: float, stride: float, looks: int) -> tuple[float, int]:
    """How much of a motion is verified to keep a margin, from its begin on, by conservative advancement.

    Args:
        piece: (4, dof) Bezier points of the motion.
        margin: Clearance asked for wherever it is evaluated [m].
        stride: No step is shorter than that: above 0 no proof near contact, but cheap, for optimisers.
        looks: Most evaluations of the clearance.

    Returns:
        The last place, from 0 to 1, with all before it verified, 0 without any; and how many evaluations it took.
    """
    if len(field) == OF_BODIES:
        return body_shown_part(piece, field, margin, stride, looks)
    links, dof = field.chain.shape[0], piece.shape[1]
    bounds, clear, q = np.empty(links), np.empty(links), np.empty(dof)
    piece_bounds(piece, field.chain, field.base, bounds)
    shown, t = 0.0, 0.0
    for used in range(looks):
        u = 1.0 - t
        w0, w1, w2, w3 = u * u * u, 3.0 * u * u * t, 3.0 * u * t * t, t * t * t
        for i in range(dof):
            q[i] = w0 * piece[0, i] + w1 * piece[1, i] + w2 * piece[2, i] + w3 * piece[3, i]
        link_clearances(q, field, clear)
        advance = proven_advance(clear, bounds, margin)
        if advance < 0.0:
            return shown, used + 1
        shown = t
        if t >= 1.0 or is_up(field.until):
            return shown, used + 1
        t = min(1.0, t + max(stride, advance))
    return shown, looks


@kernel
def straight_piece(start: FloatArray, end: FloatArray) -> FloatArray:
    """(4, dof) Bezier points of a straight motion at a steady rate."""
    piece = np.empty((4, len(start)))
    for i in range(len(start)):
        third = (end[i] - start[i]) / 3.0
        piece[0, i], piece[1, i], piece[2, i], piece[3, i] = start[i], start[i] + third, end[i] - third, end[i]
    return piece


@kernel
def piece_is_clear(piece: FloatArray, field: FieldArrays, margin: float, stride: float) -> bool:
    """True if a motion along a Bezier piece is verified to keep a margin (`shown_part`)."""
    if len(field) == OF_BODIES:
        return body_piece_is_clear(piece, field, margin, stride)
    shown, _ = shown_part(piece, field, margin, stride, _MOST_LOOKS)
    return shown == 1.0


@kernel
def path_is_clear(path: FloatArray, field: FieldArrays, margin: float) -> bool:
    """Conservative advancement along every segment of a polyline."""
    clear, i = True, 0
    while clear and i < path.shape[0] - 1:
        clear = segment_is_clear(path[i], path[i + 1], field, margin)
        i += 1
    return clear


@kernel
def segment_is_clear(start: FloatArray, end: FloatArray, field: FieldArrays, margin: float) -> bool:
    """True if the straight joint-space motion is verified to keep `margin`, which is asked for at what is evaluated."""
    if len(field) == OF_BODIES:
        return piece_is_clear(straight_piece(start, end), field, margin, 0.0)
    # Most motions that are checked fail, and often in the middle.
    q = np.empty(len(start))
    for i in range(len(start)):
        q[i] = 0.5 * (start[i] + end[i])
    if not keeps_margin(q, field, margin):
        return False
    return piece_is_clear(straight_piece(start, end), field, margin, 0.0)
