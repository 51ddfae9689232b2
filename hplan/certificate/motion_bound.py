r"""Motion bounds: travel of moving bodies and displacement by tracking errors.

A body's points are at most :math:`R_{bj}` from the axis of joint j at any configuration
(`hplan.collision.motion_coefficients`). In the middle of a segment of the motion they are at most :math:`\rho_{bj}`
from it, by a ball that contains the body. The joints between joint j and the body change this distance, within the
segment, by no more than the body travels by the joints after j alone. So within the segment it is at most

.. math:: r_{bj} = \min(R_{bj}, \rho_{bj} + \tfrac12 \sum_{k > j} R_{bk} \max |q_k'|),

and no point of the body travels farther than :math:`\sum_j r_{bj} \max |q_j'|`. The rates are those of the segment in
its own parameter, bounded by the hull of its derivative's Bezier points.

A second bound accounts for joints that cancel each other's motion. In the middle, joint j moves a point by :math:`J_j`
per unit, and all joints together move the centre of the ball at :math:`v = \sum_j q_j' J_j` and rotate the body at
:math:`\omega` (without the joint about whose axis the body is round: its motion by that joint changes nothing).
Elsewhere in the segment rates differ by at most :math:`\varepsilon_j`, and configurations by at most half of :math:`m_j
= \max |q_j'|`. Rotating joint k by an angle changes the :math:`J_j` of any point by no more than that angle times the R
of the outer one of the two joints: a joint k inside j rotates body and axis as a whole, a joint k outside j leaves the
axis of j unchanged. So the travel is at most

.. math:: |v| + |\omega| \rho_b + \sum_j |J_j| \varepsilon_j
    + \sum_j m_j (\tfrac12 R_{bj} m_j + \sum_{k > j} R_{bk} m_k),

with :math:`\rho_b` the radius of the ball, and :math:`|J_j|` at most the distance of the axis from the centre plus that
radius. The smaller of the two bounds is used.

For two bodies of the robot the joints that carry both do not count, and the travels of both by the other joints add up:
these are the last joints of each, and both bounds hold for them alone, relative to the body that carries both. Pairs of
bodies of the same two links at similar distances share one moving body (`ArmParts.motion_groups`), which travels as far
as the farthest of them. Joint deviations displace a body by no more than :math:`\sum_j R_{bj} \delta_j`. (For prismatic
joints, a deviation in rad counts as the same number in metres.)
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, TableArray
from hplan.base.kernels import kernel
from hplan.collision.coal_arm import arm_parts
from hplan.collision.coal_scene import CoalScene
from hplan.collision.compiled_bodies import joint_table
from hplan.collision.compiled_placements import place_joints
from hplan.collision.motion_coefficients import ON_AXIS
from hplan.geometry.vectors import cross, dot, moved_on, placed_point, rotate, sub, vector_of
from hplan.robot.model import Robot
from hplan.robot.tracking import TrackingModel
from hplan.scene.limits import FARTHEST_M
from hplan.trajectory.cubics import cubic_at

#: Replaces rates that are NaN or larger [rad, m]: products of it stay finite.
_UNBOUNDED: Final = 1e150

#: Maximum number of segments that share one bound; fewer if a joint would move farther than `_TURN` in them [rad, m].
_TOGETHER: Final = 8
_TURN: Final = 0.03

#: Larger than any distance between a robot and a scene [m].
_FARTHEST: Final = 100.0 * FARTHEST_M


def largest_deviations(robot: Robot, tracking: TrackingModel, speeds: FloatArray) -> FloatArray:
    """Maximum joint deviations at given speeds [rad, m].

    (k, dof) for (k, dof) speeds [rad/s, m/s]. A revolute joint's deviation is at most a whole turn; a prismatic joint's
    is the model's, capped at a distance beyond all obstacles. Unknown speeds (NaN) get these maxima.
    """
    with np.errstate(over="ignore"):
        largest: FloatArray = np.fmin(tracking.deviations(speeds), np.where(robot.slides, _FARTHEST, math.tau))
    return largest


def fastest(bezier: FloatArray, duration: FloatArray) -> FloatArray:
    """(pieces, dof) bounds of |velocity| within each segment [rad/s].

    The velocity lies in the hull of its Bezier points.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        fastest: FloatArray = (bezier.shape[1] - 1.0) * np.abs(np.diff(bezier, axis=1)).max(axis=1) / duration[:, None]
    return fastest


def largest_pair_sway(robot: Robot, deviation: FloatArray) -> float:
    """Upper bound on the clearance loss caused by joint errors [m].

    `deviation` is (dof,). Self-collision pairs are included.
    """
    parts = arm_parts(robot, float(deviation.max(initial=0.0)), 0.0)
    _, reaches = parts.deviated_reaches(deviation)
    return float((reaches @ deviation).max(initial=0.0))


def at_rows(sway: FloatArray) -> FloatArray:
    """(bodies, k + 1) displacement bounds at the samples [m].

    At each sample the larger one of the adjacent segments' bounds, from `sway` (bodies, k); (bodies, 1) is returned as
    it is.
    """
    if sway.shape[1] == 1:
        return sway
    return np.maximum(np.column_stack([sway[:, :1], sway]), np.column_stack([sway, sway[:, -1:]]))


def with_obstacles(
    checker: CoalScene, mover_of: IntArray, moved: FloatArray, nearer: FloatArray, clock: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Add moving bodies for pairs with moving obstacles.

    A body and a group of obstacles with equal travel form a new moving body that travels as far as both together.

    Args:
        checker: The arm among the obstacles.
        mover_of: (pairs,) index of the moving body of each pair.
        moved: (bodies, pieces) travel of each body in each segment [m].
        nearer: (bodies, k) displacement bound of its pairs by tracking errors [m].
        clock: (pieces + 1,) times of the samples [s].

    Returns:
        `mover_of`, `moved` and `nearer` with the moving bodies added.
    """
    if checker.moving is None:
        return mover_of, moved, nearer
    travels, group_of = checker.moving.travels(clock)
    first = len(checker.pairs) - len(checker.parts.own)
    obstacles = np.array([obstacle for _, obstacle in checker.pairs[:first]], dtype=np.int64)
    groups = np.concatenate([group_of[obstacles], np.full(len(checker.parts.own), -1)])
    together = np.column_stack([mover_of, groups])
    added, number = np.unique(together[groups >= 0], axis=0, return_inverse=True)
    mover_of = mover_of.copy()
    mover_of[groups >= 0] = len(moved) + number.ravel()
    movers, parts = added.T
    return mover_of, np.concatenate([moved, moved[movers] + travels[parts]]), np.concatenate([nearer, nearer[movers]])


def motion_of_movers(
    checker: CoalScene, bezier: FloatArray, deviations: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Moving bodies of a checker's pairs, their travel and their tracking displacement.

    Args:
        checker: The arm among the obstacles.
        bezier: (pieces, 4 or 6, dof) Bezier points of the motion's segments.
        deviations: (k, dof) maximum joint deviations [rad, m].

    Returns:
        (pairs,) index of each pair's moving body, as in `ArmParts.motion_groups`; (movers, pieces) travel bound of each
        in each segment [m]; (movers, k) displacement bound of its pairs by deviations [m].
    """
    parts, robot = checker.parts, checker.robot
    of_bodies, reaches = parts.deviated_reaches(deviations)
    starts, motion = _group_segments(np.ascontiguousarray(bezier), _TOGETHER, _TURN)
    travels = _travels(motion, of_bodies, parts.rows, joint_table(robot), *parts.travellers, parts.motion_groups)
    order = np.argsort(parts.motion_groups, kind="stable")  # Every group has a member.
    first = np.searchsorted(parts.motion_groups[order], np.arange(len(travels)))
    nearer = (
        np.maximum.reduceat((reaches @ deviations.T)[order], first) if len(first) else np.zeros((0, len(deviations)))
    )
    pieces = np.diff(starts, append=len(bezier))
    return parts.motion_groups[checker.pair_movers], np.repeat(travels / pieces, pieces, axis=1), nearer


@kernel
def _group_segments(bezier: FloatArray, most: int, turn: float) -> tuple[IntArray, FloatArray]:
    """Group consecutive segments that share one bound.

    Args:
        bezier: (pieces, 4 or 6, dof) Bezier points.
        most: Maximum number of segments in a group.
        turn: Maximum joint motion in a group [rad, m].

    Returns:
        (groups,) indices of the first segments, and (4, groups, dof) for each group the configuration in the middle,
        the maximum joint rates, the rates in the middle, and the maximum difference of the rates from those.
    """
    pieces, points, dof = bezier.shape
    degree = points - 1.0
    fast, slow, starts = np.empty((pieces, dof)), np.empty((pieces, dof)), np.empty(pieces, dtype=np.int64)
    count, together, largest = 0, 0, 0.0
    for piece in range(pieces):
        rate = 0.0
        for j in range(dof):
            high, low = -_UNBOUNDED, _UNBOUNDED
            for n in range(points - 1):
                slope = degree * (bezier[piece, n + 1, j] - bezier[piece, n, j])
                if not abs(slope) < _UNBOUNDED:
                    high, low = _UNBOUNDED, -_UNBOUNDED
                    break
                high, low = max(high, slope), min(low, slope)
            fast[piece, j], slow[piece, j] = high, low
            rate = max(rate, high, -low)
        if piece == 0 or together == most or max(largest, rate) * (together + 1) > turn:
            starts[count] = piece
            count, together, largest = count + 1, 0, 0.0
        together, largest = together + 1, max(largest, rate)
    motion = np.empty((4, count, dof))
    for k in range(count):
        first, end = starts[k], starts[k + 1] if k + 1 < count else pieces
        times, middle = end - first, first + (end - first) // 2
        for j in range(dof):
            high, low = fast[first, j], slow[first, j]
            for piece in range(first + 1, end):
                high, low = max(high, fast[piece, j]), min(low, slow[piece, j])
            high, low = times * high, times * low
            at = bezier[middle, 0, j]
            if times % 2 == 1:
                p0, p1, p2, p3 = cubic_at(bezier, middle, j, 0.5)
                at = 0.125 * (p0 + p3) + 0.375 * (p1 + p2)
            motion[0, k, j] = at if abs(at) < _UNBOUNDED else 0.0
            motion[1, k, j], motion[2, k, j], motion[3, k, j] = max(high, -low), 0.5 * (high + low), 0.5 * (high - low)
    return starts[:count], motion


@kernel
def _travels(
    motion: FloatArray, reach: FloatArray, bodies: FloatArray, joints: TableArray,
    slots: IntArray, both: IntArray, alike: IntArray,
) -> FloatArray:  # fmt: skip
    """(movers, pieces) travel bound of each moving body within each segment [m].

    Args:
        motion: Joint motion, from `_group_segments`.
        reach: (bodies, dof) motion-bound coefficients R.
        bodies: Bodies, as in `ArmParts.rows`.
        joints: Joints from `joint_table`.
        slots: First array of `ArmParts.travellers`.
        both: Second array of `ArmParts.travellers`.
        alike: Moving body of each traveller, as in `ArmParts.motion_groups`.
    """
    _, pieces, dof = motion.shape
    # Taken out one by one they are known to be contiguous; rows of an unpacked array are not.
    middles, rates, paces, uneven = motion[0], motion[1], motion[2], motion[3]
    frames, axes, moved = np.empty((dof + 1, 12)), np.empty((dof, 3)), np.zeros((slots.max() + 1, pieces))
    slides = np.empty(dof, dtype=np.bool_)
    for piece in range(pieces):
        place_joints(middles[piece], joints, frames)
        for j in range(dof):
            joint = joints[j]
            f, axis = frames[j], vector_of(joint.axis)
            slides[j] = joint.slides
            if slides[j]:
                f, axis = frames[joint.parent], vector_of(joint.shift)
            axes[j] = rotate(f, axis)
        for b in range(len(reach)):
            j, outer, total, bent, turn, speed = int(bodies[b, 0]), 0.0, 0.0, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
            at = placed_point(frames[j], bodies[b], 1)
            while j < dof:
                f, rate, pace = frames[j], rates[piece, j], paces[piece, j]
                along = axis = (axes[j, 0], axes[j, 1], axes[j, 2])
                radius = near = reach[b, j]
                if not slides[j]:
                    along = cross(axis, sub(at, (f[9], f[10], f[11])))
                    near = min(near, math.sqrt(dot(along, along)) + bodies[b, 4])
                    radius = min(radius, near + 0.5 * outer)
                    if reach[b, j] > ON_AXIS:
                        turn = moved_on(turn, axis, pace)
                speed = moved_on(speed, along, pace)
                total += radius * rate
                bent += near * uneven[piece, j] + rate * (0.5 * reach[b, j] * rate + outer)
                outer += reach[b, j] * rate
                if slots[b, j] >= 0:
                    together = math.sqrt(dot(speed, speed)) + math.sqrt(dot(turn, turn)) * bodies[b, 4] + bent
                    moved[slots[b, j], piece] = together if together < total else total
                j = joints[j].parent
    travels = np.zeros((alike.max() + 1 if len(alike) else 0, pieces))
    for mover in range(len(both)):
        one, other, travel = both[mover, 0], both[mover, 1], travels[alike[mover]]
        for piece in range(pieces):
            total = 0.0
            if one >= 0:
                total += moved[one, piece]
            if other >= 0:
                total += moved[other, piece]
            travel[piece] = max(travel[piece], total)
    return travels
