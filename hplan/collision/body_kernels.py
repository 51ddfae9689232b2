"""Kernels for arms of any kind: clearances of moving bodies at a configuration, and how they change with the joints.

Moving bodies are those of the arm (`hplan.collision.flat_bodies`) and, after them, its pairs of bodies not to touch:
the distance of a pair is seen from one of the two, so that a joint that carries both does not count as motion. Bodies
and obstacles are hulls of points, grown by radii; their distance is that of the hulls
(`hplan.collision.convex_distance`) less both radii. Bounding balls come first, then whatever direction separates by as
much as is asked.

**Enough.** Each moving body has a clearance that is enough: no more is looked for than is needed to tell whether there
is less. (`hplan.collision.motion_cover` finds how long a motion stays clear with far less work.)

**Depth.** Two hulls that share points are as far inside of each other as the least shift that takes them apart
(`hplan.collision.penetration`), and the radii come to that.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.base.kernels import any_int, inlined, kernel
from hplan.collision import flat_bodies as flat
from hplan.collision import obstacle_rows as row
from hplan.collision.convex_distance import NEAREST, ON_FIRST, WORK, Span, Wanted, core_distance
from hplan.collision.distances import point_segment, signed_excess
from hplan.collision.obstacle_rows import FieldArrays
from hplan.collision.penetration import penetration
from hplan.collision.placed_bodies import ALONG, CENTRE, PLACED, START, place_bodies
from hplan.collision.sweep import STILL
from hplan.collision.vectors import Pose, Vector, dot

_FIRST_ROW = any_int(0)

#: Larger clearances are not looked for [m].
FAR = 0.2

#: By which fraction of itself a clearance may be given too small.
EXACT = 1e-10

#: In place of where the table of a hull's corners is: a single point has none.
NO_TABLE = any_int(0)


class BodyArrays(NamedTuple):
    """An arm of any kind among obstacles, and what is worked with.

    Attributes:
        movers: As `hplan.collision.flat_bodies.FlatBodies`.
        solids: As `hplan.collision.clearance_field.ClearanceField`.
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
def _placed_arm(q: FloatArray, field: FieldArrays) -> BodyArrays:
    """The arm at a configuration among obstacles."""
    movers, numbers, solids, data = field.chain, field.base, field.solids, field.data
    placed, frames = np.empty((int(numbers[flat.BODIES]), PLACED)), np.empty((len(q) + 1, 12))
    place_bodies(q, movers, numbers, frames, placed)
    return BodyArrays(movers, numbers, solids, data, placed, frames, np.empty(WORK + 6))


@inlined
def pose_of(placed: FloatArray, b: int) -> Pose:
    """Where a body is."""
    return (
        placed[b, 0], placed[b, 1], placed[b, 2], placed[b, 3], placed[b, 4], placed[b, 5],
        placed[b, 6], placed[b, 7], placed[b, 8], placed[b, 9], placed[b, 10], placed[b, 11],
    )  # fmt: skip


@inlined
def span_of(movers: FloatArray, b: int) -> Span:
    """Which of the numbers are of a body."""
    return int(movers[b, flat.FIRST]), int(movers[b, flat.LAST]), int(movers[b, flat.TABLE])


@inlined
def difference(placed: FloatArray, j: int, i: int) -> Pose:
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
def _body_clearance(arm: BodyArrays, b: int, enough: float) -> float:
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
        if kind == row.LINK_RANGE:
            if not solids[s, row.FIRST_LINK] <= joint <= solids[s, row.LAST_LINK]:
                following = int(solids[s, row.NEXT])
        elif kind == row.NODE or kind == row.LEAF:
            start = (placed[b, START], placed[b, START + 1], placed[b, START + 2])
            along = (placed[b, ALONG], placed[b, ALONG + 1], placed[b, ALONG + 2])
            centre = (solids[s, row.CENTRE], solids[s, row.CENTRE + 1], solids[s, row.CENTRE + 2])
            if point_segment(centre, start, along) > least + movers[b, flat.AXIS_RADIUS] + solids[s, row.BOUND]:
                following = int(solids[s, row.NEXT])
            elif kind == row.LEAF:
                least = _leaf_clearance(arm, b, s, least)
        else:
            away = (-dx, -dy, -dz)
            if kind == row.BOX:
                # From the box to the centre of the body's ball.
                off, within = off_box(solids, s, away), least + ball + solids[s, row.RADIUS]
                square = dot(off, off)
                if square > within * within and within > 0.0:
                    continue
                if square > 0.0:
                    away = off
            least = _row_clearance(arm, (b, s), away, least)
    return least


@kernel
def off_box(solids: FloatArray, s: int, away: Vector) -> Vector:
    """From the nearest point of a row's box to a point, which is given from the box's centre."""
    off = (0.0, 0.0, 0.0)
    for c in range(3):
        a = row.AXES + 3 * c
        axis = (solids[s, a], solids[s, a + 1], solids[s, a + 2])
        beyond = signed_excess(dot(axis, away), solids[s, row.SHAPE + c])
        off = (off[0] + beyond * axis[0], off[1] + beyond * axis[1], off[2] + beyond * axis[2])
    return off


@kernel
def _hull_clearance(arm: BodyArrays, k: int, other: tuple[FloatArray, Span, float], least: float) -> float:
    """Clearance of a body from a hull grown by a radius, or `least` where it is no less."""
    points, other_span, radius = other
    movers, numbers, placed, work = arm.movers, arm.numbers, arm.placed, arm.work
    radii = radius + movers[k, flat.ROUNDING]
    span, pose = span_of(movers, k), pose_of(placed, k)
    wanted = Wanted(least + radii, -math.inf, EXACT, radii, STILL)
    distance = core_distance(numbers, span, pose, points, other_span, wanted, work)
    sign = 1.0
    if distance == 0.0 and least + radii > 0.0:
        distance, sign = -penetration((numbers, span, pose, points, other_span), work), -1.0
    if least <= distance - radii:
        return least
    beyond: float = distance - radii
    for c in range(3):
        work[WORK + c], work[WORK + 3 + c] = sign * work[NEAREST + c], work[ON_FIRST + c]
    return beyond


@kernel
def _row_clearance(arm: BodyArrays, place: tuple[int, int], away: Vector, least: float) -> float:
    """Clearance of a body from the solid of a row, or `least` where it is no less.

    Args:
        place: Numbers of the body and of the row.
        away: A direction from the solid to the body.
        least: What is enough [m].
    """
    (k, s), solids, data, work = place, arm.solids, arm.data, arm.work
    work[NEAREST], work[NEAREST + 1], work[NEAREST + 2] = away
    first = int(solids[s, row.CORNERS])
    span = first, int(data[first - 2]), int(data[first - 1])
    return _hull_clearance(arm, k, (data, span, solids[s, row.RADIUS]), least)


@kernel
def _leaf_clearance(arm: BodyArrays, k: int, s: int, least: float) -> float:
    """Clearance of a body from the balls of a leaf, or `least` where it is no less."""
    movers, solids, data, placed, work = arm.movers, arm.solids, arm.data, arm.placed, arm.work
    radius, thickness = solids[s, row.RADIUS], movers[k, flat.AXIS_RADIUS]
    start = (placed[k, START], placed[k, START + 1], placed[k, START + 2])
    along = (placed[k, ALONG], placed[k, ALONG + 1], placed[k, ALONG + 2])
    for p in range(int(solids[s, row.POINTS]), int(solids[s, row.POINTS_END]), 3):
        if point_segment((data[p], data[p + 1], data[p + 2]), start, along) < least + thickness + radius:
            for c in range(3):
                work[NEAREST + c] = placed[k, CENTRE + c] - data[p + c]
            least = _hull_clearance(arm, k, (data, (p, p + 3, NO_TABLE), radius), least)
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
def _pair_clearance(arm: BodyArrays, k: int, enough: float) -> float:
    """Clearance of a pair of the arm's own bodies, or `enough` where it is no less."""
    movers, numbers, placed, work = arm.movers, arm.numbers, arm.placed, arm.work
    j, i, touching = int(movers[k, flat.OUTER]), int(movers[k, flat.INNER]), movers[k, flat.TOUCHING]
    dx = placed[j, CENTRE] - placed[i, CENTRE]
    dy = placed[j, CENTRE + 1] - placed[i, CENTRE + 1]
    dz = placed[j, CENTRE + 2] - placed[i, CENTRE + 2]
    work[NEAREST] = placed[i, 0] * dx + placed[i, 3] * dy + placed[i, 6] * dz
    work[NEAREST + 1] = placed[i, 1] * dx + placed[i, 4] * dy + placed[i, 7] * dz
    work[NEAREST + 2] = placed[i, 2] * dx + placed[i, 5] * dy + placed[i, 8] * dz
    pose = difference(placed, j, i)
    span, other = span_of(movers, j), span_of(movers, i)
    wanted = Wanted(enough + touching, -math.inf, EXACT, touching, STILL)
    distance = core_distance(numbers, span, pose, numbers, other, wanted, work)
    sign = 1.0
    if distance == 0.0:
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
def _mover_clearance(arm: BodyArrays, movers: FloatArray, placed: FloatArray, k: int, enough: float) -> float:
    """Clearance of a moving body, or `enough` where it is no less; of a body that no joint moves always [m].

    Arrays of the arm are given besides, as what is taken out of tuples is counted.
    """
    if k >= placed.shape[0]:
        if _apart(movers, placed, k, enough):
            return enough
        return _pair_clearance(arm, k, enough)
    if movers[k, flat.JOINT] >= arm.frames.shape[0] - 1:
        return enough
    return _body_clearance(arm, k, enough)


@kernel
def body_clearances(q: FloatArray, field: FieldArrays, result: FloatArray) -> None:
    """Clearance of each moving body at a configuration, `FAR` where it is more; of fixed bodies always."""
    arm = _placed_arm(q, field)
    movers, placed = arm.movers, arm.placed
    for k in range(len(result)):
        result[k] = _mover_clearance(arm, movers, placed, k, FAR)


@kernel
def body_slopes(
    q: FloatArray, field: FieldArrays, joints: IntArray, enough: float, clear: FloatArray, gradient: FloatArray
) -> None:
    """Write the (bodies,) clearances, `enough` where there is more, and their (bodies, k) gradients by k joints.

    A gradient is the velocity of the nearest points along the line between them; zeros where there is enough.
    """
    arm = _placed_arm(q, field)
    movers, work, placed = arm.movers, arm.work, arm.placed
    bodies = placed.shape[0]
    for k in range(len(clear)):
        clear[k] = _mover_clearance(arm, movers, placed, k, enough)
        for m in range(len(joints)):
            gradient[k, m] = 0.0
        if not clear[k] < enough:
            continue
        outer, inner = k, -1
        if k >= bodies:
            outer, inner = int(movers[k, flat.OUTER]), int(movers[k, flat.INNER])
        n = (work[WORK], work[WORK + 1], work[WORK + 2])
        length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        if not length > 0.0:
            continue
        n = (n[0] / length, n[1] / length, n[2] / length)
        at = (work[WORK + 3], work[WORK + 4], work[WORK + 5])
        for m in range(len(joints)):
            gradient[k, m] = _rate(arm, outer, joints[m], n, at)
        if inner >= 0:
            # What carries both does not count, wherever the nearest point of the inner one is along the line.
            for m in range(len(joints)):
                if _carries(arm, inner, joints[m]):
                    gradient[k, m] -= _rate(arm, inner, joints[m], n, at)


@kernel
def _carries(arm: BodyArrays, b: int, joint: int) -> bool:
    """True if a joint moves a body."""
    numbers = arm.numbers
    first, dof, j = int(numbers[flat.JOINTS]), int(numbers[flat.DOF]), int(arm.movers[b, flat.JOINT])
    while j < dof and j != joint:
        j = int(numbers[first + flat.JOINT_SIZE * j + flat.PARENT])
    return j == joint and j < dof


@kernel
def _rate(arm: BodyArrays, b: int, joint: int, n: Vector, at: Vector) -> float:
    """Velocity in a direction of a body's point while a joint alone moves at unit rate [m/rad, m/m]."""
    if not _carries(arm, b, joint):
        return 0.0
    numbers, frames = arm.numbers, arm.frames
    own = int(numbers[flat.JOINTS]) + flat.JOINT_SIZE * joint
    tx, ty, tz = numbers[own + flat.TURN], numbers[own + flat.TURN + 1], numbers[own + flat.TURN + 2]
    if tx == 0.0 and ty == 0.0 and tz == 0.0:
        below, rate = int(numbers[own + flat.PARENT]), 0.0
        for r in range(3):
            for c in range(3):
                rate += n[r] * frames[below, 3 * r + c] * numbers[own + flat.SHIFT + c]
        return rate
    x = frames[joint, 0] * tx + frames[joint, 1] * ty + frames[joint, 2] * tz
    y = frames[joint, 3] * tx + frames[joint, 4] * ty + frames[joint, 5] * tz
    z = frames[joint, 6] * tx + frames[joint, 7] * ty + frames[joint, 8] * tz
    dx, dy, dz = at[0] - frames[joint, 9], at[1] - frames[joint, 10], at[2] - frames[joint, 11]
    moved: float = n[0] * (y * dz - z * dy) + n[1] * (z * dx - x * dz) + n[2] * (x * dy - y * dx)
    return moved


@kernel
def least_body_clearance(q: FloatArray, field: FieldArrays, enough: float) -> float:
    """The smallest clearance of all moving bodies at one configuration, or `enough` where it is no less [m]."""
    arm = _placed_arm(q, field)
    movers, placed = arm.movers, arm.placed
    bodies, least = placed.shape[0], enough
    for turn in range(movers.shape[0]):
        k = bodies - 1 - turn if turn < bodies else turn
        least = _mover_clearance(arm, movers, placed, k, least)
    return least
