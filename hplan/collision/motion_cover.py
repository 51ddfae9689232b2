r"""Kernels for arms of any kind: how much of a motion, before and after, a look at one configuration shows clear.

Let joints move with rates :math:`\dot q` at a configuration that the motion passes at time 0. A body lies in a ball;
its points have the velocities :math:`v + \omega \times x` there, :math:`x` from its centre. Let a plane with unit
normal :math:`n` have the body ahead of it by :math:`d`, and an obstacle behind it. At time :math:`s` no point of the
body has come nearer to the plane than

.. math:: d - s \, \max_x \left(-n \cdot (v + \omega \times x)\right) - \tfrac{1}{2} s^2 A,
    \qquad \max_x \left(-n \cdot (v + \omega \times x)\right) \le -n \cdot v + |n \times \omega| \, r,

by Taylor's theorem along :math:`n`, where :math:`A` bounds the accelerations of the body's points all along the motion
(`hplan.bodies.twists.motion_bends`) and :math:`r` is the ball's radius, of a body with a rounding that of its core: the
rounding adds the same to all distances from planes. So until that is used up the two stay apart; and for the time
before, the same holds with the velocities reversed. Nor do points move farther than the reaches of joints allow
(`hplan.bodies.reach`), in whichever direction. What moves along a surface, or away from it, has far to go by the first
bound; what is far away has by the second.

A pair of the arm's own bodies is looked at from the inner one, in whose frame only the joints between them move the
other. Where neither carries the other, the reaches alone are made use of.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.base.kernels import any_int, inlined, kernel
from hplan.bodies import flat_bodies as flat
from hplan.bodies.convex_distance import NEAREST, SEPARATING, WORK, Span, Wanted, core_distance
from hplan.bodies.placed_bodies import ALONG, CENTRE, PLACED, START, place_bodies
from hplan.bodies.sweep import Sweep, used_up
from hplan.bodies.twists import find_twists
from hplan.bodies.vectors import Vector, cross, dot, less, turned_back
from hplan.collision import obstacle_rows as row
from hplan.collision.body_kernels import NO_TABLE, BodyArrays, difference, pose_of, span_of
from hplan.collision.distances import signed_excess
from hplan.collision.obstacle_rows import FieldArrays

_FIRST_ROW = any_int(0)

#: By which fraction of itself a distance may be told too small.
_ROUGH = 2e-2


class Part(NamedTuple):
    """A part of a motion, before a configuration and after it.

    Attributes:
        back: How much of the motion before.
        forward: How much of it after; both below 0 where the configuration itself is not clear.
    """

    back: float
    forward: float


class Moving(NamedTuple):
    """An arm in motion.

    Attributes:
        arm: Where it is.
        twists: (dof + 1, 6) angular velocity of what each joint carries, and the velocity of the point of it that is at
            the origin; of the base zeros.
        bends: (movers, 2) how fast points of each mover move at most, and what their acceleration is at most.
        margin: Clearance asked for [m].
    """

    arm: BodyArrays
    twists: FloatArray
    bends: FloatArray
    margin: float


@kernel
def moving_arm(field: FieldArrays, dof: int, bends: FloatArray, margin: float) -> Moving:
    """An arm in motion, nowhere yet."""
    placed, frames = np.empty((int(field.base[flat.BODIES]), PLACED)), np.empty((dof + 1, 12))
    arm = BodyArrays(field.chain, field.base, field.solids, field.data, placed, frames, np.empty(WORK + 6))
    return Moving(arm, np.zeros((dof + 1, 6)), bends, margin)


@kernel
def part_shown_clear(q: FloatArray, rates: FloatArray, moving: Moving, back: float, forward: float) -> Part:
    """How much of a motion, before and after a configuration, cannot use up any mover's clearance there.

    Args:
        q: (dof,) configuration.
        rates: (dof,) rates of the joints there.
        moving: The arm.
        back: No more is asked for of the motion before.
        forward: The same after.
    """
    arm, twists = moving.arm, moving.twists
    place_bodies(q, arm.movers, arm.numbers, arm.frames, arm.placed)
    find_twists(rates, arm.numbers, arm.frames, twists)
    bodies = arm.placed.shape[0]
    part = Part(back, forward)
    # From the tip on: what is carried by more joints moves farther, and is in contact more often.
    for turn in range(arm.movers.shape[0]):
        k = bodies - 1 - turn if turn < bodies else turn
        if k < bodies:
            if arm.movers[k, flat.JOINT] < arm.numbers[flat.DOF]:
                part = _of_body(moving, k, part)
        else:
            part = _of_pair(moving, k, part)
        if part.forward < 0.0:
            break
    return part


@kernel
def body_keeps_margin(q: FloatArray, field: FieldArrays, margin: float) -> bool:
    """True if no mover's clearance at a configuration is below a margin."""
    moving = moving_arm(field, len(q), np.zeros((field.chain.shape[0], 2)), margin)
    still: Part = part_shown_clear(q, np.zeros(len(q)), moving, 0.0, 0.0)
    return still.forward >= 0.0


@inlined
def _spin(twists: FloatArray, joint: int) -> Vector:
    return twists[joint, 0], twists[joint, 1], twists[joint, 2]


@inlined
def _drift(twists: FloatArray, joint: int) -> Vector:
    return twists[joint, 3], twists[joint, 4], twists[joint, 5]


@inlined
def _farthest(moving: Moving, k: int, speed: float, part: Part) -> float:
    """How far a mover's points move at most, or the margin."""
    most, bend = moving.bends[k, 0], 0.5 * moving.bends[k, 1]
    after = min(part.forward * most, part.forward * speed + part.forward * part.forward * bend)
    before = min(part.back * most, part.back * speed + part.back * part.back * bend)
    farthest: float = max(moving.margin, max(after, before))
    return farthest


@inlined
def _sweep(moving: Moving, k: int, motion: tuple[Vector, Vector, float], part: Part) -> Sweep:
    bend = 0.5 * moving.bends[k, 1]
    return Sweep(
        motion[0], motion[1], motion[2], part.back, part.forward,
        part.back * part.back * bend, part.forward * part.forward * bend, moving.bends[k, 0], moving.margin,
    )  # fmt: skip


@kernel
def _lasting(clear: float, speed: float, most: float, bend: float, asked: float) -> float:
    """How long a clearance lasts, no longer than is asked."""
    lasts: float = asked
    if clear < most * lasts:
        root = math.sqrt(speed * speed + 2.0 * bend * clear)
        slower = math.inf
        if speed > 0.0:
            slower = 2.0 * clear / (speed + root)
        elif bend > 0.0:
            slower = (root - speed) / bend
        lasts = min(lasts, max(clear / most, slower))
    return lasts


@kernel
def _left(moving: Moving, k: int, sweep: Sweep, distance: float, part: Part) -> Part:
    """What is left of a part where two bodies are apart by a distance along the direction in `work`."""
    if not distance >= moving.margin:
        return Part(-1.0, -1.0)
    work, most, bend = moving.arm.work, moving.bends[k, 0], moving.bends[k, 1]
    direction = (work[SEPARATING], work[SEPARATING + 1], work[SEPARATING + 2])
    length = math.sqrt(dot(direction, direction))
    along, turning = 0.0, most
    if length > 0.0:
        across = cross(direction, sweep.spin)
        along = dot(direction, sweep.velocity) / length
        turning = sweep.radius * math.sqrt(dot(across, across)) / length
    return Part(
        _lasting(distance, turning + along, most, bend, part.back),
        _lasting(distance, turning - along, most, bend, part.forward),
    )


@kernel
def _of_body(moving: Moving, b: int, part: Part) -> Part:
    """What is left of a part that a body's clearance from obstacles lasts for."""
    arm, twists = moving.arm, moving.twists
    movers, solids, placed = arm.movers, arm.solids, arm.placed
    centre = (placed[b, CENTRE], placed[b, CENTRE + 1], placed[b, CENTRE + 2])
    ball, joint = movers[b, flat.BALL_RADIUS], int(movers[b, flat.JOINT])
    core = ball - movers[b, flat.ROUNDING]
    spin, at_origin = _spin(twists, joint), _drift(twists, joint)
    moved = cross(spin, centre)
    velocity = (at_origin[0] + moved[0], at_origin[1] + moved[1], at_origin[2] + moved[2])
    speed = math.sqrt(dot(velocity, velocity)) + core * math.sqrt(dot(spin, spin))
    motion = (velocity, spin, core)
    enough = _farthest(moving, b, speed, part)
    following = _FIRST_ROW
    while following < solids.shape[0]:
        s = following
        solid = (solids[s, row.CENTRE], solids[s, row.CENTRE + 1], solids[s, row.CENTRE + 2])
        apart = less(solid, centre)
        within = enough + ball + solids[s, row.BOUND]
        kind = solids[s, row.KIND]
        if dot(apart, apart) > within * within:
            following = int(solids[s, row.NEXT]) if kind >= row.NODE else s + 1
            continue
        following = s + 1
        before = part
        if kind == row.GATE:
            if not solids[s, row.FIRST_LINK] <= joint <= solids[s, row.LAST_LINK]:
                following = int(solids[s, row.NEXT])
        elif kind == row.NODE or kind == row.LOT:
            sweep = _sweep(moving, b, motion, part)
            if _is_beyond(moving, b, sweep, solid, solids[s, row.BOUND]):
                following = int(solids[s, row.NEXT])
            elif kind == row.LOT:
                part = _of_lot(moving, b, s, motion, part)
        else:
            part = _of_row(moving, b, s, motion, part)
        if part.forward < 0.0:
            break
        if part.forward < before.forward or part.back < before.back:
            enough = _farthest(moving, b, speed, part)
    return part


@kernel
def _is_beyond(moving: Moving, b: int, sweep: Sweep, centre: Vector, radius: float) -> bool:
    """True if the segment about which a body is shows that it keeps clear of a ball."""
    movers, placed = moving.arm.movers, moving.arm.placed
    x, y, z = placed[b, START] - centre[0], placed[b, START + 1] - centre[1], placed[b, START + 2] - centre[2]
    ux, uy, uz = placed[b, ALONG], placed[b, ALONG + 1], placed[b, ALONG + 2]
    square, t = ux * ux + uy * uy + uz * uz, 0.0
    if square > 0.0:
        t = min(1.0, max(0.0, -(x * ux + y * uy + z * uz) / square))
    direction = (x + t * ux, y + t * uy, z + t * uz)
    length = math.sqrt(dot(direction, direction))
    apart = length - radius - movers[b, flat.AXIS_RADIUS]
    beyond: bool = apart > 0.0 and apart >= used_up(sweep, direction, length)
    return beyond


@kernel
def _of_hull(
    moving: Moving, k: int, other: tuple[FloatArray, Span, float], motion: tuple[Vector, Vector, float], part: Part
) -> Part:
    """As `_of_body`, of a hull grown by a radius."""
    arm = moving.arm
    points, other_span, radius = other
    radii = radius + arm.movers[k, flat.ROUNDING]
    sweep = _sweep(moving, k, motion, part)
    wanted = Wanted(math.inf, moving.margin + radii, _ROUGH, radii, sweep)
    distance = core_distance(
        arm.numbers, span_of(arm.movers, k), pose_of(arm.placed, k), points, other_span, wanted, arm.work
    )
    if distance == math.inf:
        return part
    return _left(moving, k, sweep, distance - radii, part)


@kernel
def _of_row(moving: Moving, k: int, s: int, motion: tuple[Vector, Vector, float], part: Part) -> Part:
    """As `_of_body`, of the solid of a row."""
    arm = moving.arm
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
        if square > 0.0:
            x, y, z = away
            length = math.sqrt(square)
            apart = length - arm.movers[k, flat.BALL_RADIUS] - solids[s, row.RADIUS]
            if apart > 0.0 and apart >= used_up(_sweep(moving, k, motion, part), away, length):
                return part
    work[NEAREST], work[NEAREST + 1], work[NEAREST + 2] = x, y, z
    first = int(solids[s, row.CORNERS])
    span = first, int(data[first - 2]), int(data[first - 1])
    return _of_hull(moving, k, (data, span, solids[s, row.RADIUS]), motion, part)


@kernel
def _of_lot(moving: Moving, k: int, s: int, motion: tuple[Vector, Vector, float], part: Part) -> Part:
    """As `_of_body`, of the balls of a lot."""
    arm = moving.arm
    solids, data, placed, work = arm.solids, arm.data, arm.placed, arm.work
    radius = solids[s, row.RADIUS]
    for p in range(int(solids[s, row.POINTS]), int(solids[s, row.POINTS_END]), 3):
        sweep = _sweep(moving, k, motion, part)
        if not _is_beyond(moving, k, sweep, (data[p], data[p + 1], data[p + 2]), radius):
            for c in range(3):
                work[NEAREST + c] = placed[k, CENTRE + c] - data[p + c]
            part = _of_hull(moving, k, (data, (p, p + 3, NO_TABLE), radius), motion, part)
            if part.forward < 0.0:
                break
    return part


@kernel
def _of_pair(moving: Moving, k: int, part: Part) -> Part:
    """What is left of a part that the clearance of a pair of the arm's own bodies lasts for."""
    arm, twists = moving.arm, moving.twists
    movers, numbers, placed, work = arm.movers, arm.numbers, arm.placed, arm.work
    j, i, touching = int(movers[k, flat.OUTER]), int(movers[k, flat.INNER]), movers[k, flat.TOUCHING]
    centre = (placed[j, CENTRE], placed[j, CENTRE + 1], placed[j, CENTRE + 2])
    d = less(centre, (placed[i, CENTRE], placed[i, CENTRE + 1], placed[i, CENTRE + 2]))
    square, balls = dot(d, d), movers[k, flat.BALLS]
    beyond = balls + _farthest(moving, k, moving.bends[k, 0], part)
    if square >= beyond * beyond:
        return part
    core, outer, inner = (
        movers[j, flat.BALL_RADIUS] - movers[j, flat.ROUNDING],
        int(movers[j, flat.JOINT]),
        int(movers[i, flat.JOINT]),
    )
    spin = less(_spin(twists, outer), _spin(twists, inner))
    at_origin = less(_drift(twists, outer), _drift(twists, inner))
    moved = cross(spin, centre)
    velocity = (at_origin[0] + moved[0], at_origin[1] + moved[1], at_origin[2] + moved[2])
    length = math.sqrt(square)
    sweep = _sweep(moving, k, (velocity, spin, core), part)
    if length > balls and length - balls >= used_up(sweep, d, length):
        return part
    pose = pose_of(placed, i)
    # As seen from the inner body.
    seen = turned_back(pose, d)
    work[NEAREST], work[NEAREST + 1], work[NEAREST + 2] = seen
    sweep = _sweep(moving, k, (turned_back(pose, velocity), turned_back(pose, spin), core), part)
    wanted = Wanted(math.inf, moving.margin + touching, _ROUGH, touching, sweep)
    distance = core_distance(
        numbers, span_of(movers, j), difference(placed, j, i), numbers, span_of(movers, i), wanted, work
    )
    if distance == math.inf:
        return part
    return _left(moving, k, sweep, distance - touching, part)
