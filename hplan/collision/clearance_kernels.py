r"""The compiled part of `hplan.collision.clearance_field`: the clearance of each link, and motions shown clear.

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
from hplan.base.kernels import inlined, kernel
from hplan.collision.distances import point_segment, segment_box, segment_hull, segment_segment
from hplan.collision.obstacle_rows import BOX, GATE, HULL, LOT, NODE, PAIR, POINT, SEGMENT


@kernel
def _links_apart(q: FloatArray, first: int, chain: FloatArray, inner: int, outer: int) -> float:
    """Distance between the axes of two links, in the plane; the end of the inner one is the origin, its direction x."""
    x, y, angle = 0.0, 0.0, 0.0
    along, up = 0.0, 0.0
    for k in range(inner + 1, outer + 1):
        x, y = x + along, y + up
        angle += chain[k, 2] * q[first + k] + chain[k, 3]
        along, up = chain[k, 0] * math.cos(angle), chain[k, 0] * math.sin(angle)
    length = chain[inner, 0]
    distance: float = segment_segment(x, y, 0.0, along, up, 0.0, -length, 0.0, 0.0, length, 0.0, 0.0)
    return distance


@kernel
def _segment_distance(
    x: float, y: float, z: float, ux: float, uy: float, uz: float,
    solids: FloatArray, s: int, data: FloatArray, limit: float,
) -> float:  # fmt: skip
    """Distance of a segment from the core of a row that is a point, a segment or a hull; any above the limit beyond."""
    if solids[s, 0] == POINT:
        apart: float = point_segment(solids[s, 6], solids[s, 7], solids[s, 8], x, y, z, ux, uy, uz)
    elif solids[s, 0] == SEGMENT:
        apart = segment_segment(
            x, y, z, ux, uy, uz, solids[s, 6], solids[s, 7], solids[s, 8],
            solids[s, 9] - solids[s, 6], solids[s, 10] - solids[s, 7], solids[s, 11] - solids[s, 8],
        )  # fmt: skip
    else:
        apart = segment_hull(
            x, y, z, ux, uy, uz, data, int(solids[s, 6]), int(solids[s, 7]), int(solids[s, 8]), limit
        )  # fmt: skip
    return apart


@kernel
def link_clearances(
    q: FloatArray, chain: FloatArray, base: FloatArray, solids: FloatArray, data: FloatArray, result: FloatArray
) -> None:
    """Clearance of each link at one configuration."""
    first = 1 if base[9] > 0.0 else 0
    yaw_cos, yaw_sin = 1.0, 0.0
    if first:
        yaw_cos, yaw_sin = math.cos(q[0]), math.sin(q[0])
    fx, fy = yaw_cos * base[3] - yaw_sin * base[4], yaw_sin * base[3] + yaw_cos * base[4]
    gx, gy = yaw_cos * base[6] - yaw_sin * base[7], yaw_sin * base[6] + yaw_cos * base[7]
    x, y, z = yaw_cos * base[0] - yaw_sin * base[1], yaw_sin * base[0] + yaw_cos * base[1], base[2]
    angle = 0.0
    for k in range(chain.shape[0]):
        angle += chain[k, 2] * q[first + k] + chain[k, 3]
        along, up = chain[k, 0] * math.cos(angle), chain[k, 0] * math.sin(angle)
        ux, uy, uz = along * fx + up * gx, along * fy + up * gy, along * base[5] + up * base[8]
        mx, my, mz = x + 0.5 * ux, y + 0.5 * uy, z + 0.5 * uz
        half_length = 0.5 * chain[k, 0]
        least = math.inf
        following = 0
        while following < solids.shape[0]:
            s = following
            dx, dy, dz = solids[s, 2] - mx, solids[s, 3] - my, solids[s, 4] - mz
            within = least + half_length + solids[s, 5]
            if dx * dx + dy * dy + dz * dz > within * within:
                # Its bounding ball is farther than the nearest so far.
                following = int(solids[s, 20]) if solids[s, 0] >= NODE else s + 1
                continue
            following = s + 1
            kind = solids[s, 0]
            distance = math.inf
            if kind == POINT:
                distance = point_segment(solids[s, 6], solids[s, 7], solids[s, 8], x, y, z, ux, uy, uz)
            elif kind == SEGMENT:
                distance = segment_segment(
                    x, y, z, ux, uy, uz, solids[s, 6], solids[s, 7], solids[s, 8],
                    solids[s, 9] - solids[s, 6], solids[s, 10] - solids[s, 7], solids[s, 11] - solids[s, 8],
                )  # fmt: skip
            elif kind == BOX:
                ox, oy, oz = x - solids[s, 2], y - solids[s, 3], z - solids[s, 4]
                distance = segment_box(
                    ox * solids[s, 9] + oy * solids[s, 10] + oz * solids[s, 11],
                    ox * solids[s, 12] + oy * solids[s, 13] + oz * solids[s, 14],
                    ox * solids[s, 15] + oy * solids[s, 16] + oz * solids[s, 17],
                    ux * solids[s, 9] + uy * solids[s, 10] + uz * solids[s, 11],
                    ux * solids[s, 12] + uy * solids[s, 13] + uz * solids[s, 14],
                    ux * solids[s, 15] + uy * solids[s, 16] + uz * solids[s, 17],
                    solids[s, 6],
                    solids[s, 7],
                    solids[s, 8],
                )
            elif kind == HULL:
                distance = segment_hull(
                    x, y, z, ux, uy, uz, data, int(solids[s, 6]), int(solids[s, 7]), int(solids[s, 8]),
                    least + solids[s, 1],
                )  # fmt: skip
            elif kind == GATE:
                if not solids[s, 6] <= k <= solids[s, 7]:
                    following = int(solids[s, 20])
                elif solids[s, 8] > 0.0:
                    # What turns with the arm plane, from the link as it stands at yaw 0.
                    distance = _segment_distance(
                        yaw_cos * x + yaw_sin * y, yaw_cos * y - yaw_sin * x, z,
                        yaw_cos * ux + yaw_sin * uy, yaw_cos * uy - yaw_sin * ux, uz,
                        solids, s + 1, data, least + solids[s, 1],
                    )  # fmt: skip
                    following = int(solids[s, 20])
            elif kind == PAIR:
                if k == solids[s, 7]:
                    apart = _links_apart(q, first, chain, int(solids[s, 6]), k) - solids[s, 8]
                    distance = 0.5 * apart + chain[k, 1]  # less the half-width, below
            elif point_segment(solids[s, 2], solids[s, 3], solids[s, 4], x, y, z, ux, uy, uz) > least + solids[s, 5]:
                following = int(solids[s, 20])
            elif kind == LOT:
                for p in range(int(solids[s, 6]), int(solids[s, 7]), 3):
                    distance = min(distance, point_segment(data[p], data[p + 1], data[p + 2], x, y, z, ux, uy, uz))
            least = min(least, distance - solids[s, 1])
        result[k] = least - chain[k, 1]
        x, y, z = x + ux, y + uy, z + uz


@kernel
def clearances_along(
    points: FloatArray, chain: FloatArray, base: FloatArray, solids: FloatArray, data: FloatArray, result: FloatArray
) -> None:
    """Clearance of each link at (n, dof) configurations, written into (n, links)."""
    for i in range(points.shape[0]):
        link_clearances(points[i], chain, base, solids, data, result[i])


@kernel
def mark_near(
    path: FloatArray, chain: FloatArray, base: FloatArray, solids: FloatArray, distance: float, near: BoolArray
) -> None:
    """Mark the rows whose bounding ball comes within a distance of a link at some configuration."""
    first = 1 if base[9] > 0.0 else 0
    for i in range(path.shape[0]):
        yaw_cos, yaw_sin = 1.0, 0.0
        if first:
            yaw_cos, yaw_sin = math.cos(path[i, 0]), math.sin(path[i, 0])
        fx, fy = yaw_cos * base[3] - yaw_sin * base[4], yaw_sin * base[3] + yaw_cos * base[4]
        gx, gy = yaw_cos * base[6] - yaw_sin * base[7], yaw_sin * base[6] + yaw_cos * base[7]
        x, y, z = yaw_cos * base[0] - yaw_sin * base[1], yaw_sin * base[0] + yaw_cos * base[1], base[2]
        angle = 0.0
        for k in range(chain.shape[0]):
            angle += chain[k, 2] * path[i, first + k] + chain[k, 3]
            along, up = chain[k, 0] * math.cos(angle), chain[k, 0] * math.sin(angle)
            ux, uy, uz = along * fx + up * gx, along * fy + up * gy, along * base[5] + up * base[8]
            for s in range(solids.shape[0]):
                if not near[s]:
                    reach = point_segment(solids[s, 2], solids[s, 3], solids[s, 4], x, y, z, ux, uy, uz)
                    near[s] = reach <= distance + solids[s, 5] + chain[k, 1]
            x, y, z = x + ux, y + uy, z + uz


@kernel
def smallest(values: FloatArray) -> float:
    """Smallest of a few values."""
    least = math.inf
    for value in values:
        least = min(least, value)
    return least


@inlined
def proven_advance(clear: FloatArray, bounds: FloatArray, margin: float) -> float:
    """The share of a motion, at most 1, that cannot use up any link's clearance; -1 where the margin is not kept."""
    advance = 1.0
    for k in range(len(clear)):
        if not clear[k] >= margin:  # so that nothing that is no number passes
            advance = -1.0
            break
        if bounds[k] * advance > clear[k]:
            advance = clear[k] / bounds[k]
    return advance


@kernel
def motion_bounds(turns: FloatArray, chain: FloatArray, base: FloatArray, result: FloatArray) -> None:
    """Largest displacement of any axis point of each link while all joints turn in proportion, by `turns` in all.

    Args:
        turns: (dof,) joint displacements.
        chain: As in `ClearanceField`.
        base: As in `ClearanceField`.
        result: (links,) bounds, written [m].
    """
    first = 1 if base[9] > 0.0 else 0
    swing = abs(turns[0]) if first else 0.0
    radius = math.hypot(base[0], base[1])
    absolute, bound = 0.0, 0.0
    for k in range(chain.shape[0]):
        absolute += chain[k, 2] * turns[first + k]
        bound += chain[k, 0] * abs(absolute)
        radius += chain[k, 0]
        result[k] = bound + swing * radius


@kernel
def path_is_clear(
    path: FloatArray, chain: FloatArray, base: FloatArray, solids: FloatArray, data: FloatArray, margin: float
) -> bool:
    """Conservative advancement along every segment of a polyline."""
    for i in range(path.shape[0] - 1):
        if not segment_is_clear(path[i], path[i + 1], chain, base, solids, data, margin):
            return False
    return True


@kernel
def segment_is_clear(
    start: FloatArray,
    end: FloatArray,
    chain: FloatArray,
    base: FloatArray,
    solids: FloatArray,
    data: FloatArray,
    margin: float,
) -> bool:
    """Whether the straight joint-space motion is shown clear; `margin` is asked for wherever it is evaluated."""
    links, dof = chain.shape[0], start.shape[0]
    bounds, clear, q, turns = np.empty(links), np.empty(links), np.empty(dof), np.empty(dof)
    for i in range(dof):
        turns[i] = end[i] - start[i]
    motion_bounds(turns, chain, base, bounds)
    # The middle first: where a motion fails it often fails there.
    t, at_middle = 0.5, True
    while True:
        for i in range(dof):
            q[i] = start[i] + t * turns[i]
        link_clearances(q, chain, base, solids, data, clear)
        advance = proven_advance(clear, bounds, margin)
        if advance < 0.0:
            return False
        if t >= 1.0:
            return True
        t = 0.0 if at_middle else min(1.0, t + advance)
        at_middle = False
