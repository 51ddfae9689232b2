r"""Kernels for the segment of a motion verified by one configuration.

Let joints move with rates :math:`\dot q` at a configuration that the motion passes at time 0. A body lies in a ball;
its points have the velocities :math:`v + \omega \times x` there, :math:`x` from its centre. Let a plane with unit
normal :math:`n` have the body ahead of it by :math:`d`, and an obstacle behind it. At time :math:`s` no point of the
body has come nearer to the plane than

.. math:: d - s \, \max_x \left(-n \cdot (v + \omega \times x)\right) - \tfrac{1}{2} s^2 A,
    \qquad \max_x \left(-n \cdot (v + \omega \times x)\right) \le -n \cdot v + |n \times \omega| \, r,

by Taylor's theorem along :math:`n`. :math:`A` bounds the accelerations of the body's points over the whole motion
(`hplan.collision.compiled_twists.motion_bends`) and :math:`r` is the ball's radius, for a rounded body the radius of
its core's ball: the rounding adds the same to all distances from planes. So until this bound, minus half of the margin,
is used up, the two stay half of the margin apart; for the time before, the same holds with reversed velocities. Points
also move no farther, in any direction, than the motion-bound coefficients of the joints allow
(`hplan.collision.motion_coefficients`). The first bound is strong for bodies that move along a surface or away from it,
the second for bodies that are far away.

A self-collision pair is expressed in the inner body's frame, in which only the joints between the two bodies move the
outer one. If neither body carries the other, only the motion-bound coefficients are used.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray, TableArray
from hplan.base.kernels import any_int, inline, kernel
from hplan.collision import compiled_obstacles as row
from hplan.collision.compiled_clearance import (
    NO_ROW,
    BodyArrays,
    difference,
    is_box_beyond,
    is_thin,
    nearest_leaf,
    off_body,
    off_row,
    plane_behind,
    pose_of,
    segment_of,
    span_of,
    tilt_clearance,
    tilting_axis,
)
from hplan.collision.compiled_obstacles import FieldArrays
from hplan.collision.compiled_placements import PLACED, place_bodies
from hplan.collision.compiled_twists import MOVING, TWIST, find_twists
from hplan.geometry.convex_distance import NEAREST, NO_TABLE, SEPARATING, WORK, Span, Wanted, core_distance
from hplan.geometry.planes import NO_PLANE, is_behind
from hplan.geometry.segment_distance import point_segment
from hplan.geometry.sweep import Sweep, used_up
from hplan.geometry.vectors import Vector, cross, dot, sub, turned_back, vector_of

_FIRST_COVER_ROW = any_int(0)

#: Relative tolerance: a distance may be returned too small by this fraction of itself.
_ROUGH = 2e-2

#: The lower bound is close enough to the distance if its square is at least this multiple of the vector's squared
#: length.
_SURELY_ROUGH = (1.0 - _ROUGH) ** 2


class Part(NamedTuple):
    """Segment of a motion around a configuration.

    Attributes:
        back: Length of the segment before the configuration, in the motion's parameter.
        forward: Length of the segment after it; both are negative if the configuration itself violates the margin.
    """

    back: float
    forward: float


class Moving(NamedTuple):
    """An arm in motion.

    Attributes:
        arm: The arm among obstacles.
        bends: (bodies, 2) upper bounds of the speed and of the acceleration of each moving body's points.
        margin: Required clearance [m].
    """

    arm: BodyArrays
    bends: FloatArray
    margin: float


@kernel
def moving_arm(field: FieldArrays, dof: int, bends: FloatArray, margin: float) -> Moving:
    """Prepare an arm in motion, not placed yet."""
    bodies, frames, work = field.bodies, np.empty((dof + 1, MOVING)), np.empty(WORK + 6)
    placed = np.empty(len(bodies), PLACED)
    return Moving(
        BodyArrays(bodies, field.pairs, field.joints, field.points, field.solids, field.data, placed, frames, work),
        bends,
        margin,
    )


@kernel
def part_shown_clear(q: FloatArray, rates: FloatArray, moving: Moving, back: float, forward: float) -> Part:
    """Segment of a motion that cannot use up any moving body's clearance.

    Args:
        q: (dof,) configuration.
        rates: (dof,) joint rates there.
        moving: The arm in motion.
        back: Requested length of the segment before; the result is no longer.
        forward: Requested length of the segment after; the result is no longer.
    """
    arm, bends = moving.arm, moving.bends
    bodies, pairs, solids, placed, margin = arm.bodies, arm.pairs, arm.solids, arm.placed, moving.margin
    place_bodies(q, bodies, arm.joints, arm.frames, placed)
    find_twists(rates, arm.joints, arm.frames)
    count, part = len(bodies), Part(back, forward)
    # From the tip on: bodies carried by more joints move farther and are in contact more often.
    for turn in range(count + len(pairs)):
        k = count - 1 - turn if turn < count else turn
        if k < count:
            if bodies[k].is_checked:
                # The first row whose ball comes near. (Inlined, because a call with all arrays costs more than a few
                # rows.)
                x, y, z = vector_of(placed[k].centre)
                ball, axis = bodies[k].ball_radius, bodies[k].axis_radius
                lasts = margin + max(part.back, part.forward) * bends[k, 0]
                start, along = segment_of(placed, k)
                s = _FIRST_COVER_ROW
                while s < len(solids):
                    solid = solids[s]
                    centre = vector_of(solid.centre)
                    dx, dy, dz, around = centre[0] - x, centre[1] - y, centre[2] - z, lasts + solid.bound
                    within = ball + around
                    if (
                        dx * dx + dy * dy + dz * dz <= within * within
                        and point_segment(centre, start, along) <= axis + around
                        and not is_box_beyond(solids, s, (-dx, -dy, -dz), lasts + ball)
                    ):
                        part = _of_body(moving, k, s, part)
                        break
                    s = solid.next if solid.kind >= row.NODE else s + 1
        else:
            pair = pairs[k - count]
            x, y, z = sub(vector_of(placed[pair.outer].centre), vector_of(placed[pair.inner].centre))
            beyond = pair.ball_distance + margin + max(part.back, part.forward) * bends[k, 0]
            if x * x + y * y + z * z < beyond * beyond:
                part = _of_tilt(moving, k, part) if pair.tilt_m > 0.0 else _of_pair(moving, k, part)
        if part.forward < 0.0:
            break
    return part


@inline
def _spin(frames: FloatArray, joint: int) -> Vector:
    return frames[joint, TWIST], frames[joint, TWIST + 1], frames[joint, TWIST + 2]


@inline
def _drift(frames: FloatArray, joint: int) -> Vector:
    return frames[joint, TWIST + 3], frames[joint, TWIST + 4], frames[joint, TWIST + 5]


class _Motion(NamedTuple):
    """Velocities of a moving body.

    Plain numbers only, because arrays taken out of tuples cost more than the computation on them.

    Attributes:
        velocity: Velocity of the centre of the body's ball.
        spin: Angular velocity.
        core: Radius of the ball without the body's rounding [m].
        speed: Upper bound of the points' speed now.
        most: Upper bound of the points' speed over the whole motion.
        bend: Upper bound of the points' acceleration.
        margin: Required clearance [m].
    """

    velocity: Vector
    spin: Vector
    core: float
    speed: float
    most: float
    bend: float
    margin: float


@kernel
def _sufficient_distance(motion: _Motion, part: Part) -> float:
    """Distance sufficient for a segment in any direction of motion [m]."""
    back, forward, bend = part.back, part.forward, 0.5 * motion.bend
    after = min(forward * motion.most, forward * motion.speed + forward * forward * bend)
    before = min(back * motion.most, back * motion.speed + back * back * bend)
    farthest: float = max(motion.margin, 0.5 * motion.margin + max(after, before))
    return farthest


@kernel
def _sweep(motion: _Motion, part: Part) -> Sweep:
    bend = 0.5 * motion.bend
    return Sweep(
        motion.velocity, motion.spin, motion.core, part.back, part.forward,
        part.back * part.back * bend, part.forward * part.forward * bend, motion.most, motion.margin,
    )  # fmt: skip


@kernel
def _clearance_duration(clear: float, speed: float, most: float, bend: float, asked: float) -> float:
    """Duration that a clearance lasts, at most the requested one."""
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
def _verified_segment(motion: _Motion, direction: Vector, distance: float, part: Part) -> Part:
    """Part of a segment verified by two bodies' separation along a direction."""
    if not distance >= motion.margin:
        return Part(-1.0, -1.0)
    length = math.sqrt(dot(direction, direction))
    along, turning = 0.0, motion.most
    if length > 0.0:
        across = cross(direction, motion.spin)
        along = dot(direction, motion.velocity) / length
        turning = motion.core * math.sqrt(dot(across, across)) / length
    return Part(
        _clearance_duration(distance - 0.5 * motion.margin, turning + along, motion.most, motion.bend, part.back),
        _clearance_duration(distance - 0.5 * motion.margin, turning - along, motion.most, motion.bend, part.forward),
    )


@kernel
def _of_body(moving: Moving, b: int, first: int, part: Part) -> Part:
    """Part of a segment verified by a body's clearance from obstacles.

    Rows before `first` are known to be far.
    """
    arm = moving.arm
    body, solids, placed, frames = arm.bodies[b], arm.solids, arm.placed, arm.frames
    centre, joint = vector_of(placed[b].centre), body.joint
    ball, thickness, thin = body.ball_radius, body.axis_radius, is_thin(arm.bodies, b)
    core = ball - body.rounding
    spin, at_origin = _spin(frames, joint), _drift(frames, joint)
    moved = cross(spin, centre)
    velocity = (at_origin[0] + moved[0], at_origin[1] + moved[1], at_origin[2] + moved[2])
    speed = math.sqrt(dot(velocity, velocity)) + core * math.sqrt(dot(spin, spin))
    motion = _Motion(velocity, spin, core, speed, moving.bends[b, 0], moving.bends[b, 1], moving.margin)
    enough = _sufficient_distance(motion, part)
    following, within_tree, visited, plane = first, first, NO_ROW, NO_PLANE
    while following < len(solids):
        s = following
        solid = solids[s]
        middle, kind = vector_of(solid.centre), solid.kind
        away = sub(centre, middle)
        within = enough + ball + solid.bound
        if dot(away, away) > within * within:
            following = solid.next if kind >= row.NODE else s + 1
            continue
        following = s + 1
        if is_box_beyond(solids, s, away, enough + ball):
            continue
        before = part
        if kind < row.NODE:
            clear, is_known = 0.0, False
            if kind != row.HULL:
                # Vector from the solid's core to the body's axis segment.
                x, y, z, _, shown = off_row(placed, b, solids, s)
                if shown > 0.0:
                    away, clear = (x, y, z), shown - solid.radius - thickness
                    if clear >= enough or clear >= used_up(_sweep(motion, part), away, math.sqrt(dot(away, away))):
                        continue
                    is_known = thin and shown * shown >= _SURELY_ROUGH * dot(away, away)
            part = (
                _verified_segment(motion, away, clear, part)
                if is_known
                else _of_row(moving, (b, s), away, motion, part)
            )
        elif kind == row.JOINT_RANGE:
            if not solid.first <= joint <= solid.last:
                following = solid.next
        elif is_behind(plane, middle, solid.bound) or _is_apart(
            motion, part, _off_axis(placed, b, middle), solid.bound + thickness
        ):
            following = solid.next
        elif kind == row.LEAF or s >= within_tree:
            leaf = s
            if kind == row.NODE:
                # The nearest leaf first: it shortens the segment most, so that most of the tree is far from the rest.
                within_tree, visited = solid.next, nearest_leaf(placed, b, solids, s)
                leaf = visited
            elif s == visited:
                continue
            if leaf != NO_ROW:
                part = _of_lot(moving, (b, leaf), motion, part)
                if not thin:
                    plane = plane_behind(arm, b)
                    plane = plane[0], plane[1] - used_up(_sweep(motion, part), plane[0], 1.0)
        if part.forward < 0.0:
            break
        if part.forward < before.forward or part.back < before.back:
            enough = _sufficient_distance(motion, part)
    return part


@kernel
def _off_axis(placed: TableArray, b: int, point: Vector) -> Vector:
    """Vector from a point to its nearest point on a body's axis."""
    start, along = segment_of(placed, b)
    start = sub(start, point)
    square, t = dot(along, along), 0.0
    if square > 0.0:
        t = min(1.0, max(0.0, -dot(start, along) / square))
    return start[0] + t * along[0], start[1] + t * along[1], start[2] + t * along[2]


@kernel
def _is_apart(motion: _Motion, part: Part, away: Vector, radii: float) -> bool:
    """Early-out: True if the core distance alone guarantees clearance over a segment.

    Holds for two balls, or for bodies inside capsules, with the sum of radii `radii`.
    """
    length = math.sqrt(dot(away, away))
    apart: bool = length > radii and length - radii >= used_up(_sweep(motion, part), away, length)
    return apart


@kernel
def _separation(moving: Moving, k: int, other: tuple[FloatArray, Span, float], motion: _Motion, part: Part) -> float:
    """Distance of a body from a rounded hull along the direction in the buffer; infinite if it lasts for a segment."""
    arm = moving.arm
    corners, other_span, radius = other
    radii = radius + arm.bodies[k].rounding
    wanted = Wanted(math.inf, motion.margin + radii, _ROUGH, radii, _sweep(motion, part))
    pose = pose_of(arm.frames, arm.bodies[k].joint)
    distance = core_distance(arm.points, span_of(arm.bodies, k), pose, corners, other_span, wanted, arm.work)
    beyond: float = distance - radii
    return beyond


@kernel
def _of_hull(moving: Moving, k: int, other: tuple[FloatArray, Span, float], motion: _Motion, part: Part) -> Part:
    """Part of a segment verified by the clearance from a rounded hull."""
    work, distance = moving.arm.work, _separation(moving, k, other, motion, part)
    if distance == math.inf:
        return part
    direction = (work[SEPARATING], work[SEPARATING + 1], work[SEPARATING + 2])
    return _verified_segment(motion, direction, distance, part)


@kernel
def _of_row(moving: Moving, place: tuple[int, int], away: Vector, motion: _Motion, part: Part) -> Part:
    """Part of a segment verified by the clearance from one primitive.

    Args:
        place: Indices of the body and of the primitive.
        away: A direction from the primitive to the body.
    """
    (k, s), arm = place, moving.arm
    solid, data, work = arm.solids[s], arm.data, arm.work
    work[NEAREST], work[NEAREST + 1], work[NEAREST + 2] = away
    first = solid.corners
    span = first, int(data[first - 2]), int(data[first - 1])
    return _of_hull(moving, k, (data, span, solid.radius), motion, part)


@kernel
def _of_lot(moving: Moving, place: tuple[int, int], motion: _Motion, part: Part) -> Part:
    """Part of a segment verified by the clearance from a leaf's balls.

    `place` are the indices of the body and of the leaf.
    """
    (k, s), arm = place, moving.arm
    solid, bodies, data, placed, work = arm.solids[s], arm.bodies, arm.data, arm.placed, arm.work
    radius, plane, used = solid.radius, NO_PLANE, 0.0
    radii, thin = radius + bodies[k].axis_radius, is_thin(bodies, k)
    if not thin:
        work[NEAREST], work[NEAREST + 1], work[NEAREST + 2] = _off_axis(placed, k, vector_of(solid.centre))
        lot = data, (solid.first, solid.last, NO_TABLE), radius
        if _separation(moving, k, lot, motion, part) == math.inf:
            return part
        plane = plane_behind(arm, k)
        used = used_up(_sweep(motion, part), plane[0], 1.0)
    for p in range(solid.first, solid.last, 3):
        point = data[p], data[p + 1], data[p + 2]
        if not thin and is_behind(plane, point, radius + used):
            continue
        off = _off_axis(placed, k, point)
        if not _is_apart(motion, part, off, radii):
            if thin:
                part = _verified_segment(motion, off, math.sqrt(dot(off, off)) - radii, part)
            else:
                work[NEAREST], work[NEAREST + 1], work[NEAREST + 2] = off
                part = _of_hull(moving, k, (data, (p, p + 3, NO_TABLE), radius), motion, part)
                used = used_up(_sweep(motion, part), plane[0], 1.0)
            if part.forward < 0.0:
                break
    return part


@kernel
def _of_tilt(moving: Moving, k: int, part: Part) -> Part:
    r"""Part of a segment in which the tool cannot tilt too far.

    The tilt changes by no more than the path of the tool axis on the unit sphere is long: its speed is
    :math:`|\omega \times u|` now, and its acceleration is bounded.
    """
    arm, margin = moving.arm, moving.margin
    clear = tilt_clearance(arm, k)
    if not clear >= margin:
        return Part(-1.0, -1.0)
    pair = arm.pairs[k - len(arm.bodies)]
    swept = cross(_spin(arm.frames, pair.carrier), tilting_axis(arm, k))
    speed, most, bend = pair.tilt_m * math.sqrt(dot(swept, swept)), moving.bends[k, 0], moving.bends[k, 1]
    return Part(
        _clearance_duration(clear - 0.5 * margin, speed, most, bend, part.back),
        _clearance_duration(clear - 0.5 * margin, speed, most, bend, part.forward),
    )


@kernel
def _of_pair(moving: Moving, k: int, part: Part) -> Part:
    """Part of a segment verified by the clearance of a self-collision pair."""
    arm = moving.arm
    bodies, points, placed, frames, work = arm.bodies, arm.points, arm.placed, arm.frames, arm.work
    pair = arm.pairs[k - len(bodies)]
    j, i, touching = pair.outer, pair.inner, pair.hull_distance
    outer, inner = bodies[j].joint, bodies[i].joint
    centre = vector_of(placed[j].centre)
    away = sub(centre, vector_of(placed[i].centre))
    spin = sub(_spin(frames, outer), _spin(frames, inner))
    at_origin = sub(_drift(frames, outer), _drift(frames, inner))
    moved = cross(spin, centre)
    velocity = (at_origin[0] + moved[0], at_origin[1] + moved[1], at_origin[2] + moved[2])
    core = bodies[j].ball_radius - bodies[j].rounding
    most, bend = moving.bends[k, 0], moving.bends[k, 1]
    seen = _Motion(velocity, spin, core, most, most, bend, moving.margin)
    if _is_apart(seen, part, away, pair.ball_distance):
        return part
    x, y, z, _, shown = off_body(placed, j, i)
    if shown > 0.0:
        away, clear = (x, y, z), shown - pair.axis_distance
        length = math.sqrt(dot(away, away))
        if clear > 0.0 and clear >= used_up(_sweep(seen, part), away, length):
            return part
        if is_thin(bodies, i) and is_thin(bodies, j) and shown * shown >= _SURELY_ROUGH * length * length:
            return _verified_segment(seen, away, clear, part)
    # Expressed in the inner body's frame.
    pose = pose_of(frames, inner)
    work[NEAREST], work[NEAREST + 1], work[NEAREST + 2] = turned_back(pose, away)
    motion = _Motion(turned_back(pose, velocity), turned_back(pose, spin), core, most, most, bend, moving.margin)
    wanted = Wanted(math.inf, moving.margin + touching, _ROUGH, touching, _sweep(motion, part))
    distance = core_distance(
        points, span_of(bodies, j), difference(frames, outer, inner), points, span_of(bodies, i), wanted, work
    )
    if distance == math.inf:
        return part
    direction = (work[SEPARATING], work[SEPARATING + 1], work[SEPARATING + 2])
    return _verified_segment(motion, direction, distance - touching, part)
