r"""Motion bounds: how far a checker's moving bodies travel, and how far tracking errors displace them.

A body's points are at most :math:`R_{bj}` from the axis of joint j, whatever the
configuration (`hplan.collision.reach`). About the middle of a piece of the motion they are at most :math:`\rho_{bj}`
from it, by a ball that holds the body; and what lies between the joint and the body changes that, within the piece, by
no more than the body travels by the joints after j alone. So within the piece it is at most

.. math:: r_{bj} = \min(R_{bj}, \rho_{bj} + \tfrac12 \sum_{k > j} R_{bk} \max |q_k'|),

and no point of the body travels farther than :math:`\sum_j r_{bj} \max |q_j'|`, the rates being those of the segment in
its own parameter, by the hull of its derivative's Bezier points.

Nor does it where joints undo what others do. In the middle, where joint j moves a point by :math:`J_j` for each unit,
all together move the centre of the ball at :math:`v = \sum_j q_j' J_j` and turn the body at :math:`\omega`. Elsewhere
in the piece rates differ by at most :math:`\varepsilon_j`, and configurations by half of :math:`m_j = \max |q_j'|` at
most. Turning joint k by an angle changes the :math:`J_j` of any point by no more than that times the R of the outer
one of the two joints: what is carried turns as a whole, what carries leaves the axis of j where it is. So the travel is
at most

.. math:: |v| + |\omega| \rho_b + \sum_j |J_j| \varepsilon_j
    + \sum_j m_j (\tfrac12 R_{bj} m_j + \sum_{k > j} R_{bk} m_k),

with :math:`\rho_b` the radius of the ball, and :math:`|J_j|` at most the distance of the axis from the centre and that
radius. The smaller bound of both counts.

Of two bodies of the robot the joints that carry both do not count, and of the others the travels of both add up: these
are the last joints of each, and both bounds hold for them alone, as seen from what carries both. Pairs of bodies of the
same two links that are about as far out are one mover (`ArmParts.alike`), which travels as far as the farthest of them.
Joints that are off by their deviations move a body by no more than :math:`\sum_j R_{bj} \delta_j`. (Of joints that
slide, a deviation in rad counts as so many metres.)
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.base.kernels import kernel
from hplan.collision import flat_bodies as flat
from hplan.collision.arm_pairs import ArmParts, arm_parts
from hplan.collision.coal_scene import CoalScene
from hplan.collision.flat_bodies import joints_alone
from hplan.collision.placed_bodies import place_joints
from hplan.collision.vectors import cross, dot, moved_on, placed_point, sub, turned
from hplan.robot.model import Robot
from hplan.robot.tracking import TrackingModel
from hplan.scene.limits import FARTHEST_M
from hplan.trajectory.cubics import cubic_at

#: In place of rates that are no numbers, or larger [rad, m]: their products are numbers.
_UNBOUNDED: Final = 1e150

#: So many pieces have one bound at most, and fewer where a joint would turn farther in them [rad, m].
_TOGETHER: Final = 8
_TURN: Final = 0.03

#: Farther than anything of a robot and a scene is apart [m].
_FARTHEST: Final = 100.0 * FARTHEST_M


def largest_deviations(robot: Robot, tracking: TrackingModel, speeds: FloatArray) -> FloatArray:
    """Largest deviations of the joints at (k, dof) speeds [rad/s, m/s], of the same shape [rad, m].

    Of a joint that turns none is larger than a whole turn; one that slides may be off as far as the model says, up to
    where it would meet anything. So it is where a speed is not known.
    """
    with np.errstate(over="ignore"):
        largest: FloatArray = np.fmin(tracking.deviations(speeds), np.where(robot.slides, _FARTHEST, math.tau))
    return largest


def fastest(bezier: FloatArray, duration: FloatArray) -> FloatArray:
    """(pieces, dof) bounds of |velocity| within each segment: it lies in the hull of its Bezier points [rad/s]."""
    with np.errstate(over="ignore", invalid="ignore"):
        fastest: FloatArray = (bezier.shape[1] - 1.0) * np.abs(np.diff(bezier, axis=1)).max(axis=1) / duration[:, None]
    return fastest


def pair_sways(checker: CoalScene, deviations: FloatArray) -> FloatArray:
    """Tracking-error displacement bound of each pair, of (k, dof) deviations [rad] -> (pairs, k) [m]."""
    _, reaches = _reaches(checker.parts, deviations)
    sways: FloatArray = reaches @ deviations.T
    return sways[_mover_of(checker)]


def largest_pair_sway(robot: Robot, deviation: FloatArray) -> float:
    """By how much anything of a robot may come nearer to anything, itself too, with joints off by (dof,) [m]."""
    parts = arm_parts(robot, "capsule", float(deviation.max(initial=0.0)), 0.0)
    _, reaches = _reaches(parts, deviation)
    return float((reaches @ deviation).max(initial=0.0))


def _mover_of(checker: CoalScene) -> IntArray:
    """(pairs,) what moves of each pair of a checker, as `ArmParts.movers` has it."""
    alone, own = len(checker.parts.shapes), len(checker.parts.own)
    return np.concatenate([np.repeat(np.arange(alone), checker.own_first), np.arange(alone, alone + own)])


def at_rows(sway: FloatArray) -> FloatArray:
    """(bodies, k + 1) the larger displacement bound of the pieces at each row, from those of k; (bodies, 1) of one."""
    if sway.shape[1] == 1:
        return sway
    return np.maximum(np.column_stack([sway[:, :1], sway]), np.column_stack([sway, sway[:, -1:]]))


def with_obstacles(
    checker: CoalScene, mover_of: IntArray, moved: FloatArray, nearer: FloatArray, clock: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Moving bodies where obstacles move too: a body and what moves alike make another, which travels as far as both.

    Args:
        mover_of: (pairs,) the moving body of each pair.
        moved: (bodies, pieces) how far each travels in each piece [m].
        nearer: (bodies, k) how much nearer tracking errors may bring its pairs [m].
        clock: (pieces + 1,) times of the rows [s].

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
    """What moves of a checker's pairs along a motion, and what tracking errors do.

    Args:
        bezier: (pieces, 4 or 6, dof) Bezier points of the motion's segments.
        deviations: (k, dof) largest deviations of the joints [rad, m].

    Returns:
        (pairs,) what moves of each pair, as `ArmParts.alike` has it; (movers, pieces) how far each travels in
        each piece; (movers, k) by how much deviations may bring its pairs nearer [m].
    """
    parts, robot = checker.parts, checker.robot
    of_bodies, reaches = _reaches(parts, deviations)
    starts, motion = _together(np.ascontiguousarray(bezier), _TOGETHER, _TURN)
    travels = _travels(motion, of_bodies, parts.rows, joints_alone(robot), *parts.travellers, parts.alike)
    nearer = np.zeros((len(travels), len(deviations)))
    np.maximum.at(nearer, parts.alike, reaches @ deviations.T)
    pieces = np.diff(starts, append=len(bezier))
    return parts.alike[_mover_of(checker)], np.repeat(travels / pieces, pieces, axis=1), nearer


def _reaches(parts: ArmParts, deviations: FloatArray) -> tuple[FloatArray, FloatArray]:
    """As `ArmParts.reaches`, where joints are off by (..., dof) deviations: sliding ones by one of few numbers."""
    largest = float(deviations.max(initial=0.0)) if any(parts.robot.slides) else 0.0
    return parts.reaches(2.0 ** math.ceil(math.log2(max(largest, 1e-3))) if largest > 0.0 else 0.0)


@kernel
def _together(bezier: FloatArray, most: int, turn: float) -> tuple[IntArray, FloatArray]:
    """Pieces that have one bound: where each of these longer ones begins, and how joints move within it.

    Args:
        bezier: (pieces, 4 or 6, dof) Bezier points.
        most: So many have one bound at most.
        turn: And no more than in which a joint moves so far.

    Returns:
        (longer pieces,) numbers of the first pieces, and (4, longer pieces, dof) in each the configuration in the
        middle, largest rates of the joints, rates in the middle, and by how much rates differ from those at most.
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
    motion: FloatArray, reach: FloatArray, bodies: FloatArray, numbers: FloatArray,
    slots: IntArray, both: IntArray, alike: IntArray,
) -> FloatArray:  # fmt: skip
    """(movers, pieces) how far each mover travels within each piece at most [m].

    Args:
        motion: How joints move, as `_together`.
        reach: (bodies, dof) motion-bound coefficients R.
        bodies: As `ArmParts.rows`.
        numbers: As `joints_alone`.
        slots: As `ArmParts.travellers`, as `both`.
        alike: The number of the mover that each of them is, as `ArmParts.alike`.
    """
    _, pieces, dof = motion.shape
    # Taken out one by one they are known to be contiguous, which rows of an array unpacked are not.
    middles, rates, paces, uneven = motion[0], motion[1], motion[2], motion[3]
    joints = int(numbers[flat.JOINTS])
    frames, axes, moved = np.empty((dof + 1, 12)), np.empty((dof, 3)), np.zeros((slots.max() + 1, pieces))
    slides = np.empty(dof, dtype=np.bool_)
    for piece in range(pieces):
        place_joints(middles[piece], numbers, frames)
        for j in range(dof):
            own = joints + flat.JOINT_SIZE * j
            f, c = frames[j], own + flat.TURN
            slides[j] = numbers[c] == 0.0 and numbers[c + 1] == 0.0 and numbers[c + 2] == 0.0
            if slides[j]:
                f, c = frames[int(numbers[own + flat.PARENT])], own + flat.SHIFT
            axes[j] = turned(f, (numbers[c], numbers[c + 1], numbers[c + 2]))
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
                    turn = moved_on(turn, axis, pace)
                speed = moved_on(speed, along, pace)
                total += radius * rate
                bent += near * uneven[piece, j] + rate * (0.5 * reach[b, j] * rate + outer)
                outer += reach[b, j] * rate
                if slots[b, j] >= 0:
                    together = math.sqrt(dot(speed, speed)) + math.sqrt(dot(turn, turn)) * bodies[b, 4] + bent
                    moved[slots[b, j], piece] = together if together < total else total
                j = int(numbers[joints + flat.JOINT_SIZE * j + flat.PARENT])
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
