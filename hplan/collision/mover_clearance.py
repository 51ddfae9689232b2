"""Kernels for arms of any kind: the clearance of one mover, a body of the arm or a pair of its own bodies.

Movers are the bodies of the arm (`hplan.bodies.flat_bodies`) and, after them, the pairs of bodies that must not touch:
the distance of a pair is seen from one of the two, so that a joint that carries both does not count as motion. Bodies
and obstacles are hulls of points, grown by radii; their distance is that of the hulls (`hplan.bodies.convex_distance`)
less both radii. Bounding balls come first, then whatever direction separates by as much as is asked.

**Enough.** Each mover has a clearance that is enough: no more is looked for than is needed to tell whether there is
less. Where all that matters is how far a motion may go on, that saves most of the work.

**Depth.** Two hulls that share points are as far inside of each other as the least shift that takes them apart
(`hplan.bodies.penetration`), and the radii come to that. Where no clearance is asked for beyond the sign (`Look`),
the depth of the hulls counts as 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.base.kernels import any_int, inlined, kernel
from hplan.bodies import flat_bodies as flat
from hplan.bodies.convex_distance import NEAREST, ON_FIRST, WORK, Pose, Span, Wanted, core_distance
from hplan.bodies.penetration import penetration
from hplan.bodies.placed_bodies import ALONG, CENTRE, PLACED, START, place_bodies
from hplan.collision import obstacle_rows as row
from hplan.collision.distances import point_segment, signed_excess
from hplan.collision.obstacle_rows import FieldArrays

_FIRST_ROW = any_int(0)

#: In place of where the table of a hull's corners is: a single point has none.
NO_TABLE = any_int(0)


class Look(NamedTuple):
    """How exactly a clearance is looked for.

    Attributes:
        too_little: Where it is shown to be less, whatever is less may be told [m].
        fraction: By which fraction of itself it may be told too small.
        depth: Whether the depth of hulls in each other is to be known.
    """

    too_little: float
    fraction: float
    depth: bool


class BodyArrays(NamedTuple):
    """An arm of any kind among obstacles, and what is worked with.

    Attributes:
        movers: As `hplan.bodies.flat_bodies.FlatBodies`.
        numbers: The same.
        solids: As `hplan.collision.clearance_field.ClearanceField`.
        data: The same.
        placed: (bodies, 21) each body where it is.
        frames: (dof + 1, 12) frames of joints and base.
        work: (WORK + 6,) numbers, the last of them the direction in which what was found nearest to a body lies, and
            the body's point nearest to that.
    """

    movers: FloatArray
    numbers: FloatArray
    solids: FloatArray
    data: FloatArray
    placed: FloatArray
    frames: FloatArray
    work: FloatArray


@kernel
def placed_arm(q: FloatArray, field: FieldArrays) -> BodyArrays:
    """The arm at a configuration among obstacles."""
    movers, numbers, solids, data = field.chain, field.base, field.solids, field.data
    placed, frames = np.empty((int(numbers[flat.BODIES]), PLACED)), np.empty((len(q) + 1, 12))
    place_bodies(q, movers, numbers, frames, placed)
    return BodyArrays(movers, numbers, solids, data, placed, frames, np.empty(WORK + 6))


@inlined
def _pose_of(placed: FloatArray, b: int) -> Pose:
    return (
        placed[b, 0], placed[b, 1], placed[b, 2], placed[b, 3], placed[b, 4], placed[b, 5],
        placed[b, 6], placed[b, 7], placed[b, 8], placed[b, 9], placed[b, 10], placed[b, 11],
    )  # fmt: skip


@inlined
def _span_of(movers: FloatArray, b: int) -> Span:
    return int(movers[b, flat.FIRST]), int(movers[b, flat.LAST]), int(movers[b, flat.TABLE])


@inlined
def _difference(placed: FloatArray, j: int, i: int) -> Pose:
    """Where body j is as seen from body i."""
    a, b = placed[i], placed[j]
    x, y, z = b[9] - a[9], b[10] - a[10], b[11] - a[11]
    return (
        a[0] * b[0] + a[3] * b[3] + a[6] * b[6],
        a[0] * b[1] + a[3] * b[4] + a[6] * b[7],
        a[0] * b[2] + a[3] * b[5] + a[6] * b[8],
        a[1] * b[0] + a[4] * b[3] + a[7] * b[6],
        a[1] * b[1] + a[4] * b[4] + a[7] * b[7],
        a[1] * b[2] + a[4] * b[5] + a[7] * b[8],
        a[2] * b[0] + a[5] * b[3] + a[8] * b[6],
        a[2] * b[1] + a[5] * b[4] + a[8] * b[7],
        a[2] * b[2] + a[5] * b[5] + a[8] * b[8],
        a[0] * x + a[3] * y + a[6] * z,
        a[1] * x + a[4] * y + a[7] * z,
        a[2] * x + a[5] * y + a[8] * z,
    )


@kernel
def _body_clearance(arm: BodyArrays, b: int, enough: float, look: Look) -> float:
    """Clearance of a body from obstacles, or `enough` where it is no less [m]."""
    movers, solids, placed = arm.movers, arm.solids, arm.placed
    x, y, z = placed[b, CENTRE], placed[b, CENTRE + 1], placed[b, CENTRE + 2]
    ball, joint, least = movers[b, flat.BALL_RADIUS], movers[b, flat.JOINT], enough
    following = _FIRST_ROW
    while following < solids.shape[0]:
        s = following
        dx, dy, dz = solids[s, row.CENTRE] - x, solids[s, row.CENTRE + 1] - y, solids[s, row.CENTRE + 2] - z
        within = least + ball + solids[s, row.BOUND]
        kind = solids[s, row.KIND]
        if not within > 0.0 or dx * dx + dy * dy + dz * dz > within * within:
            following = int(solids[s, row.NEXT]) if kind >= row.NODE else s + 1
            continue
        following = s + 1
        if kind == row.GATE:
            if not solids[s, row.FIRST_LINK] <= joint <= solids[s, row.LAST_LINK]:
                following = int(solids[s, row.NEXT])
        elif kind == row.NODE or kind == row.LOT:
            start = (placed[b, START], placed[b, START + 1], placed[b, START + 2])
            along = (placed[b, ALONG], placed[b, ALONG + 1], placed[b, ALONG + 2])
            centre = (solids[s, row.CENTRE], solids[s, row.CENTRE + 1], solids[s, row.CENTRE + 2])
            if point_segment(centre, start, along) > least + movers[b, flat.AXIS_RADIUS] + solids[s, row.BOUND]:
                following = int(solids[s, row.NEXT])
            elif kind == row.LOT:
                least = _lot_clearance(arm, b, s, least, look)
        else:
            least = _row_clearance(arm, b, s, least, look)
        if not least >= look.too_little:
            break
    return least


@kernel
def _hull_clearance(arm: BodyArrays, k: int, other: tuple[FloatArray, Span, float], least: float, look: Look) -> float:
    """Clearance of a body from a hull grown by a radius, or `least` where it is no less."""
    points, other_span, radius = other
    movers, numbers, placed, work = arm.movers, arm.numbers, arm.placed, arm.work
    radii = radius + movers[k, flat.ROUNDING]
    span, pose = _span_of(movers, k), _pose_of(placed, k)
    wanted = Wanted(least + radii, look.too_little + radii, look.fraction, radii)
    distance = core_distance(numbers, span, pose, points, other_span, wanted, work)
    sign = 1.0
    if distance == 0.0 and look.depth and least + radii > 0.0:
        distance, sign = -penetration((numbers, span, pose, points, other_span), work), -1.0
    if least <= distance - radii:
        return least
    beyond: float = distance - radii
    for c in range(3):
        work[WORK + c], work[WORK + 3 + c] = sign * work[NEAREST + c], work[ON_FIRST + c]
    return beyond


@kernel
def _row_clearance(arm: BodyArrays, k: int, s: int, least: float, look: Look) -> float:
    """Clearance of a body from the solid of a row, or `least` where it is no less."""
    solids, data, placed, work = arm.solids, arm.data, arm.placed, arm.work
    x = placed[k, CENTRE] - solids[s, row.CENTRE]
    y = placed[k, CENTRE + 1] - solids[s, row.CENTRE + 1]
    z = placed[k, CENTRE + 2] - solids[s, row.CENTRE + 2]
    if solids[s, row.KIND] == row.BOX:
        # From the box to the centre of the body's ball, seen along its edges.
        away, square = (0.0, 0.0, 0.0), 0.0
        for c in range(3):
            a = row.AXES + 3 * c
            ax, ay, az = solids[s, a], solids[s, a + 1], solids[s, a + 2]
            beyond = signed_excess(ax * x + ay * y + az * z, solids[s, row.SHAPE + c])
            away = (away[0] + beyond * ax, away[1] + beyond * ay, away[2] + beyond * az)
            square += beyond * beyond
        within = least + arm.movers[k, flat.BALL_RADIUS] + solids[s, row.RADIUS]
        if square > within * within and within > 0.0:
            return least
        if square > 0.0:
            x, y, z = away
    work[NEAREST], work[NEAREST + 1], work[NEAREST + 2] = x, y, z
    first = int(solids[s, row.CORNERS])
    span = first, int(data[first - 2]), int(data[first - 1])
    return _hull_clearance(arm, k, (data, span, solids[s, row.RADIUS]), least, look)


@kernel
def _lot_clearance(arm: BodyArrays, k: int, s: int, least: float, look: Look) -> float:
    """Clearance of a body from the balls of a lot, or `least` where it is no less."""
    movers, solids, data, placed, work = arm.movers, arm.solids, arm.data, arm.placed, arm.work
    radius, thickness = solids[s, row.RADIUS], movers[k, flat.AXIS_RADIUS]
    start = (placed[k, START], placed[k, START + 1], placed[k, START + 2])
    along = (placed[k, ALONG], placed[k, ALONG + 1], placed[k, ALONG + 2])
    for p in range(int(solids[s, row.POINTS]), int(solids[s, row.POINTS_END]), 3):
        if point_segment((data[p], data[p + 1], data[p + 2]), start, along) < least + thickness + radius:
            for c in range(3):
                work[NEAREST + c] = placed[k, CENTRE + c] - data[p + c]
            least = _hull_clearance(arm, k, (data, (p, p + 3, NO_TABLE), radius), least, look)
    return least


@inlined
def _apart(movers: FloatArray, placed: FloatArray, k: int, enough: float) -> bool:
    """True if the balls of a pair show that it has a clearance."""
    j, i = int(movers[k, flat.OUTER]), int(movers[k, flat.INNER])
    dx = placed[j, CENTRE] - placed[i, CENTRE]
    dy = placed[j, CENTRE + 1] - placed[i, CENTRE + 1]
    dz = placed[j, CENTRE + 2] - placed[i, CENTRE + 2]
    within = enough + movers[k, flat.BALLS]
    apart: bool = dx * dx + dy * dy + dz * dz >= within * within
    return apart


@kernel
def _pair_clearance(arm: BodyArrays, k: int, enough: float, look: Look) -> float:
    """Clearance of a pair of the arm's own bodies, or `enough` where it is no less."""
    movers, numbers, placed, work = arm.movers, arm.numbers, arm.placed, arm.work
    j, i, touching = int(movers[k, flat.OUTER]), int(movers[k, flat.INNER]), movers[k, flat.TOUCHING]
    dx = placed[j, CENTRE] - placed[i, CENTRE]
    dy = placed[j, CENTRE + 1] - placed[i, CENTRE + 1]
    dz = placed[j, CENTRE + 2] - placed[i, CENTRE + 2]
    work[NEAREST] = placed[i, 0] * dx + placed[i, 3] * dy + placed[i, 6] * dz
    work[NEAREST + 1] = placed[i, 1] * dx + placed[i, 4] * dy + placed[i, 7] * dz
    work[NEAREST + 2] = placed[i, 2] * dx + placed[i, 5] * dy + placed[i, 8] * dz
    pose = _difference(placed, j, i)
    span, other = _span_of(movers, j), _span_of(movers, i)
    wanted = Wanted(enough + touching, look.too_little + touching, look.fraction, touching)
    distance = core_distance(numbers, span, pose, numbers, other, wanted, work)
    sign = 1.0
    if distance == 0.0 and look.depth:
        distance, sign = -penetration((numbers, span, pose, numbers, other), work), -1.0
    if enough <= distance - touching:
        return enough
    # As seen from the ground.
    for c in range(3):
        work[WORK + c], work[WORK + 3 + c] = 0.0, placed[i, 9 + c]
        for d in range(3):
            work[WORK + c] += sign * placed[i, 3 * c + d] * work[NEAREST + d]
            work[WORK + 3 + c] += placed[i, 3 * c + d] * work[ON_FIRST + d]
    beyond: float = distance - touching
    return beyond


@kernel
def mover_clearance(arm: BodyArrays, k: int, enough: float, look: Look) -> float:
    """Clearance of a mover, or `enough` where it is no less; of a body that no joint moves always [m]."""
    bodies = arm.placed.shape[0]
    if k >= bodies:
        if _apart(arm.movers, arm.placed, k, enough):
            return enough
        return _pair_clearance(arm, k, enough, look)
    if arm.movers[k, flat.JOINT] >= arm.numbers[flat.DOF]:
        return enough
    return _body_clearance(arm, k, enough, look)
