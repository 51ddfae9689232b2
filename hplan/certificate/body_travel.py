r"""How far a robot's collision bodies travel along a motion of cubics: for general (non-planar) arms.

A body's points are at most :math:`R_{bj}` from the axis of joint j, whatever the configuration
(`hplan.collision.reach`). About the middle of a piece of the motion they are at most :math:`\rho_{bj}` from it, by a
ball that holds the body; and what lies between the joint and the body changes that, within the piece, by no more than
the body travels by the joints after j alone. So within the piece it is at most

.. math:: r_{bj} = \min(R_{bj}, \rho_{bj} + \tfrac12 \sum_{k > j} R_{bk} \max |q_k'|),

and no point of the body travels farther than :math:`\sum_j r_{bj} \max |q_j'|`, the rates being those of the cubic in
its own parameter, by the hull of its derivative's Bezier points. Of two bodies of the robot the joints that carry both
do not count, and of the others the travels of both add up.

Joints that are off by their deviations move a body by no more than :math:`\sum_j R_{bj} \delta_j`. (Of joints that
slide, a deviation in rad counts as so many metres.)
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray, frozen, readonly
from hplan.base.kernels import kernel
from hplan.collision.arm_pairs import moving_bodies
from hplan.collision.coal_scene import CoalScene
from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.reach import carriers, joint_axis, reach
from hplan.collision.touching_pairs import SelfPairs
from hplan.robot.model import Robot


class _Arm(NamedTuple):
    """A robot's joints and bodies as flat arrays.

    Attributes:
        parents: (dof,) the joint that carries each joint; -1 for the base.
        slides: (dof,) whether it slides.
        axes: (dof, 3) its axis in its own frame.
        places: (dof, 4, 3) its placement in the frame of the one that carries it: three rows of the rotation, the
            shift [m].
        joints: (bodies,) the joint that carries each body; -1 for the ground.
        balls: (bodies, 4) centre in that joint's frame and radius of a ball that holds it [m].
    """

    parents: IntArray
    slides: BoolArray
    axes: FloatArray
    places: FloatArray
    joints: IntArray
    balls: FloatArray


def body_motion(
    checker: CoalScene, pairs: SelfPairs, bezier: FloatArray, deviations: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """The moving bodies of a checker's pairs: each body, and each pair of the robot's own.

    Args:
        checker: A general (non-planar) arm, among obstacles.
        pairs: The pairs of its own that the checker has.
        bezier: (pieces, 4, dof) Bezier points of the motion's cubics.
        deviations: (k, dof) largest deviations of the joints [rad, m].

    Returns:
        (pairs,) the moving body of each pair; (movers, pieces) how far each travels in each piece; (movers, k) by how
        much deviations may bring its pairs nearer [m].
    """
    robot, movers = checker.robot, _movers(checker.robot, pairs)
    rates = 3.0 * np.abs(np.diff(bezier, axis=1)).max(axis=1)
    middles = 0.125 * (bezier[:, 0] + bezier[:, 3]) + 0.375 * (bezier[:, 1] + bezier[:, 2])
    bounds = reach(robot, _beyond(robot, deviations))
    travels = _travels(np.ascontiguousarray(middles), rates, bounds, _arm(robot))
    moved = _sums(travels, movers.first, movers.second, movers.counts)
    return _mover_of(checker, movers), moved, _of_movers(bounds, movers, deviations)


def body_sways(checker: CoalScene, pairs: SelfPairs, deviations: FloatArray) -> FloatArray:
    """(pairs, k) tracking-error displacement bounds of the pairs, of (k, dof) deviations of the joints [m]."""
    robot, movers = checker.robot, _movers(checker.robot, pairs)
    bounds = reach(robot, _beyond(robot, deviations))
    sways: FloatArray = _of_movers(bounds, movers, deviations)[_mover_of(checker, movers)]
    return sways


def _of_movers(bounds: FloatArray, movers: _Movers, deviations: FloatArray) -> FloatArray:
    """(movers, k) how far (k, dof) deviations take each moving body, by (bodies, dof) motion-bound coefficients [m]."""
    second = np.where((movers.second >= 0)[:, None], bounds[movers.second], 0.0)
    sways: FloatArray = ((bounds[movers.first] + second) * movers.counts) @ deviations.T
    return sways


def largest_body_sway(robot: Robot, deviation: FloatArray) -> float:
    """By how much anything of a robot may come nearer to anything, itself too, with joints off by (dof,) [m]."""
    return 2.0 * float((reach(robot, _beyond(robot, deviation)) @ deviation).max(initial=0.0))


def _beyond(robot: Robot, deviations: FloatArray) -> float:
    """How far joints that slide may be beyond their limits: one of few numbers, for which `reach` is known [m]."""
    largest = float(deviations.max(initial=0.0)) if _arm(robot).slides.any() else 0.0
    return 2.0 ** math.ceil(math.log2(max(largest, 1e-3))) if largest > 0.0 else 0.0


class _Movers(NamedTuple):
    """Movers of a checker's pairs.

    Attributes:
        alone: Numbers of the bodies that joints move, in the order in which the checker has them.
        first: (movers,) the body: one of those, then one of each pair of the robot's own.
        second: (movers,) the other body of such a pair; -1 where there is none.
        counts: (movers, dof) 1 for the joints that move the first and not the second, or the other way; else 0.
    """

    alone: tuple[int, ...]
    first: IntArray
    second: IntArray
    counts: FloatArray


def _movers(robot: Robot, pairs: SelfPairs) -> _Movers:
    """The moving bodies of a checker of a robot with these pairs of its own; found once."""
    return robot.cached(("movers", id(pairs)), lambda: _found_movers(robot, pairs))


def _found_movers(robot: Robot, pairs: SelfPairs) -> _Movers:
    bodies = collision_bodies(robot)
    alone = tuple(itertools.chain(*moving_bodies(robot).values()))
    both = np.array([*((body, -1) for body in alone), *pairs.checked], dtype=np.int64).reshape(-1, 2)
    counts = np.zeros((len(both), robot.dof))
    for row, pair in enumerate(both.tolist()):
        first, second = (set(carriers(robot, bodies[body].joint)) if body >= 0 else set[int]() for body in pair)
        counts[row, sorted(first ^ second)] = 1.0
    return _Movers(alone, frozen(both[:, 0].copy()), frozen(both[:, 1].copy()), frozen(counts))


def _mover_of(checker: CoalScene, movers: _Movers) -> IntArray:
    """(pairs,) the moving body of each pair."""
    alone, obstacles = len(movers.alone), checker.own_first
    return np.concatenate([np.repeat(np.arange(alone), obstacles), np.arange(alone, len(movers.first))])


def _arm(robot: Robot) -> _Arm:
    """The robot as flat arrays; made once."""
    return robot.cached("joints and bodies as arrays", lambda: _made_arm(robot))


def _made_arm(robot: Robot) -> _Arm:
    model, bodies = robot.model, collision_bodies(robot)
    axes = [joint_axis(robot, joint) for joint in range(robot.dof)]
    places = [np.vstack([place.rotation, place.translation]) for place in model.jointPlacements.tolist()[1:]]
    balls = np.zeros((len(bodies), 4))
    for number, body in enumerate(bodies):
        centre = 0.5 * (body.core.min(axis=0) + body.core.max(axis=0))
        radius = np.linalg.norm(body.core - centre, axis=1).max() + body.rounding
        balls[number] = *centre, radius * (1.0 + 1e-12)
    return _Arm(
        parents=readonly(np.array(model.parents.tolist()[1:]) - 1, np.int64),
        slides=readonly([slides for _, slides in axes], np.bool_),
        axes=readonly([axis for axis, _ in axes]),
        places=readonly(places),
        joints=readonly([body.joint for body in bodies], np.int64),
        balls=frozen(balls),
    )


@kernel
def _travels(middles: FloatArray, rates: FloatArray, reach: FloatArray, arm: _Arm) -> FloatArray:
    """(pieces, bodies, dof) how far each joint's motion moves each body within each piece at most [m].

    Args:
        middles: (pieces, dof) configurations in the middle of the pieces.
        rates: (pieces, dof) largest rates of the joints within them.
        reach: (bodies, dof) motion-bound coefficients R.
        arm: Joints and bodies.
    """
    parents, slides, axes, places, joints, balls = arm
    count, dof = middles.shape
    result = np.zeros((count, len(joints), dof))
    turn, origin, axis, at = np.empty((dof, 3, 3)), np.empty((dof, 3)), np.empty((dof, 3)), np.empty(3)
    for piece in range(count):
        for j in range(dof):
            _place_joint(j, middles[piece, j], parents, slides, axes, places, turn, origin, axis)
        for b in range(len(joints)):
            j = joints[b]
            if j < 0:
                continue
            for c in range(3):
                at[c] = origin[j, c]
                for d in range(3):
                    at[c] += turn[j, c, d] * balls[b, d]
            outer = 0.0
            while j >= 0:
                if slides[j]:
                    result[piece, b, j] = rates[piece, j]
                else:
                    along, square = 0.0, 0.0
                    for c in range(3):
                        along += axis[j, c] * (at[c] - origin[j, c])
                    for c in range(3):
                        off = at[c] - origin[j, c] - along * axis[j, c]
                        square += off * off
                    radius = math.sqrt(square) + balls[b, 3] + 0.5 * outer
                    result[piece, b, j] = min(reach[b, j], radius) * rates[piece, j]
                outer += reach[b, j] * rates[piece, j]
                j = parents[j]
    return result


@kernel
def _sums(travels: FloatArray, first: IntArray, second: IntArray, counts: FloatArray) -> FloatArray:
    """(movers, pieces) what the joints that count move a moving body's bodies by, of (pieces, bodies, dof) travels."""
    pieces, _, dof = travels.shape
    result = np.zeros((len(first), pieces))
    for mover in range(len(first)):
        a, b = first[mover], second[mover]
        for piece in range(pieces):
            total = 0.0
            for j in range(dof):
                if counts[mover, j] > 0.0:
                    total += travels[piece, a, j]
                    if b >= 0:
                        total += travels[piece, b, j]
            result[mover, piece] = total
    return result


@kernel
def _place_joint(
    j: int, q: float, parents: IntArray, slides: BoolArray, axes: FloatArray, places: FloatArray,
    turn: FloatArray, origin: FloatArray, axis: FloatArray,
) -> None:  # fmt: skip
    """Fill in a joint's frame in `base_link`, and its axis there, from those of the one that carries it."""
    above, local, moved = parents[j], np.empty((3, 3)), np.empty((3, 3))
    cos, sin = (1.0, 0.0) if slides[j] else (math.cos(q), math.sin(q))
    for r in range(3):  # Rodrigues' formula
        for c in range(3):
            cross = 0.0
            if (c + 1) % 3 == r:
                cross = axes[j, (c + 2) % 3]
            elif (r + 1) % 3 == c:
                cross = -axes[j, (r + 2) % 3]
            local[r, c] = (1.0 - cos) * axes[j, r] * axes[j, c] + sin * cross + (cos if r == c else 0.0)
    for r in range(3):
        for c in range(3):
            moved[r, c] = 0.0
            for d in range(3):
                moved[r, c] += places[j, r, d] * local[d, c]
    for r in range(3):
        shift = places[j, 3, r]
        if slides[j]:
            for d in range(3):
                shift += places[j, r, d] * axes[j, d] * q
        axis[j, r] = shift
    if above < 0:
        for r in range(3):
            origin[j, r] = axis[j, r]
            for c in range(3):
                turn[j, r, c] = moved[r, c]
    else:
        for r in range(3):
            origin[j, r] = origin[above, r]
            for d in range(3):
                origin[j, r] += turn[above, r, d] * axis[j, d]
            for c in range(3):
                turn[j, r, c] = 0.0
                for d in range(3):
                    turn[j, r, c] += turn[above, r, d] * moved[d, c]
    for r in range(3):
        axis[j, r] = 0.0
        for d in range(3):
            axis[j, r] += turn[j, r, d] * axes[j, d]
