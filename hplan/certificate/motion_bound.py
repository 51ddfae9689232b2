r"""Motion bounds: how far a checker's moving bodies travel, and how far tracking errors displace them.

Of a planar arm the bound of a link, and of two parts of the arm as one is seen from the other, is in
`hplan.certificate.clearance_proof`.

**A general (non-planar) arm.** A body's points are at most :math:`R_{bj}` from the axis of joint j, whatever the
configuration (`hplan.collision.reach`). About the middle of a piece of the motion they are at most :math:`\rho_{bj}`
from it, by a ball that holds the body; and what lies between the joint and the body changes that, within the piece, by
no more than the body travels by the joints after j alone. So within the piece it is at most

.. math:: r_{bj} = \min(R_{bj}, \rho_{bj} + \tfrac12 \sum_{k > j} R_{bk} \max |q_k'|),

and no point of the body travels farther than :math:`\sum_j r_{bj} \max |q_j'|`, the rates being those of the cubic in
its own parameter, by the hull of its derivative's Bezier points. Of two bodies of the robot the joints that carry both
do not count, and of the others the travels of both add up. Joints that are off by their deviations move a body by no
more than :math:`\sum_j R_{bj} \delta_j`. (Of joints that slide, a deviation in rad counts as so many metres.)
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, Record, frozen
from hplan.base.kernels import kernel
from hplan.collision import flat_bodies as flat
from hplan.collision.arm_pairs import moving_bodies
from hplan.collision.coal_scene import CoalScene
from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.flat_bodies import FlatBodies
from hplan.collision.placed_bodies import place_joints
from hplan.collision.reach import carriers, reach
from hplan.collision.touching_pairs import SelfPairs
from hplan.collision.vectors import cross, dot, sub
from hplan.robot.base_shapes import GROUND, TURRET
from hplan.robot.model import Robot, made_once
from hplan.robot.self_contact import pair_rates, pair_sway
from hplan.robot.tracking import TrackingModel
from hplan.scene.limits import FARTHEST_M

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
    """(pieces, dof) bounds of |velocity| within each cubic: it lies in the hull of its Bezier points [rad/s]."""
    with np.errstate(over="ignore", invalid="ignore"):
        fastest: FloatArray = 3.0 * np.abs(np.diff(bezier, axis=1)).max(axis=1) / duration[:, None]
    return fastest


def pair_sways(checker: CoalScene, deviations: FloatArray) -> FloatArray:
    """Tracking-error displacement bound of each pair, of (k, dof) deviations [rad] -> (pairs, k) [m]."""
    if checker.own_bodies is not None:
        moving = _moving_bodies(checker.robot, checker.own_bodies)
        return moving.sways(checker.robot, deviations)[moving.of_pairs(checker)]
    mover_of, others = movers(checker)
    return sways(checker.robot, others, deviations)[mover_of]


def largest_pair_sway(robot: Robot, deviation: FloatArray) -> float:
    """By how much anything of a robot may come nearer to anything, itself too, with joints off by (dof,) [m]."""
    if robot.planar is None:
        return 2.0 * float((reach(robot, _beyond(robot, deviation)) @ deviation).max(initial=0.0))
    own = robot.cached("movers of its own", lambda: movers(CoalScene(robot, ()))[1])
    turning = [(TURRET, GROUND)] if robot.has_yaw else []
    return float(sways(robot, [*own, *turning], deviation[None]).max())


def sways(robot: Robot, others: Sequence[tuple[int, int]], deviations: FloatArray) -> FloatArray:
    """(bodies, k) tracking-error displacement bounds of the moving bodies [m]: of the links, then of the others."""
    found = [pair_sway(robot, part, other, deviations) for part, other in others]
    return np.column_stack([robot.sway(deviations), *found]).T


def off_axis(checker: CoalScene, others: Sequence[tuple[int, int]], turns: FloatArray) -> FloatArray:
    """(bodies, k) how much farther than its axis a link that is no capsule moves as joints turn by (k, dof) [m].

    A ball about a point of the axis moves as that point does; what is at most r from the axis by r times the link's
    turn more, which is at most the sum of the turns of the joints before it. Seen from another link, that one's own
    turn comes to it.
    """
    arm = checker.robot.arm
    reach = arm.half_widths * {"capsule": 0.0, "urdf": 1.0, "box": math.sqrt(2.0)}[checker.links]
    turned = np.cumsum(np.abs(turns), axis=1)[:, checker.robot.arm_slice].T
    found = [reach[link] * turned[link] for link in range(arm.link_count)]
    for part, other in others:
        own = reach[part] * turned[part] if part >= 0 else np.zeros(len(turns))
        found.append(own + (reach[part] * turned[other] if part >= 0 and other >= 0 else 0.0))
    return np.array(found)


def movers(checker: CoalScene) -> tuple[IntArray, list[tuple[int, int]]]:
    """The moving body of each pair, and those after the links: a part, and the body from which its motion is seen.

    The links as seen from the ground come first.
    """
    first, links, obstacles = len(checker.pairs) - len(checker.own_others), len(checker.link_names), checker.own_first
    # Each shape meets all obstacles, one after the other: the first pair of each says what the moving body is.
    shapes = [checker.pairs[pair][0] for pair in range(0, first, max(obstacles, 1))]
    own = zip((mover for mover, _ in checker.pairs[first:]), checker.own_others, strict=True)
    parts = [(mover if mover < links else TURRET, other) for mover, other in (*((m, GROUND) for m in shapes), *own)]
    movers = list(dict.fromkeys([*((link, GROUND) for link in range(links)), *parts]))
    numbers = {mover: number for number, mover in enumerate(movers)}
    mover_of = np.array([numbers[part] for part in parts], dtype=np.int64)
    counts = np.repeat([obstacles, 1], [len(shapes), len(checker.own_others)])
    return np.repeat(mover_of, counts), movers[links:]


def at_rows(sway: FloatArray, pieces: int) -> FloatArray:
    """(bodies, pieces + 1) the larger displacement bound of the two pieces at each row, from those of the pieces."""
    if sway.shape[1] == 1:
        return np.repeat(sway, pieces + 1, axis=1)
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
    first = len(checker.pairs) - len(checker.own_others)
    obstacles = np.array([obstacle for _, obstacle in checker.pairs[:first]], dtype=np.int64)
    groups = np.concatenate([group_of[obstacles], np.full(len(checker.own_others), -1)])
    together = np.column_stack([mover_of, groups])
    added, number = np.unique(together[groups >= 0], axis=0, return_inverse=True)
    mover_of = mover_of.copy()
    mover_of[groups >= 0] = len(moved) + number.ravel()
    movers, parts = added.T
    return mover_of, np.concatenate([moved, moved[movers] + travels[parts]]), np.concatenate([nearer, nearer[movers]])


def motion_of_movers(
    checker: CoalScene, bezier: FloatArray, deviations: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """The moving bodies of a checker's pairs along a motion, and what tracking errors do.

    Args:
        bezier: (pieces, 4, dof) Bezier points of the motion's cubics.
        deviations: (k, dof) largest deviations of the joints [rad, m].

    Returns:
        (pairs,) the moving body of each pair; (bodies, pieces) how far each travels in each piece; (bodies, k) by how
        much deviations may bring its pairs nearer [m].
    """
    robot = checker.robot
    if checker.own_bodies is not None:
        moving = _moving_bodies(robot, checker.own_bodies)
        return moving.of_pairs(checker), moving.travels(robot, bezier, deviations), moving.sways(robot, deviations)
    mover_of, others = movers(checker)
    rates = 3.0 * np.diff(bezier, axis=1)
    bounds = [link_bounds(robot, rates), *(pair_rates(robot, part, other, rates) for part, other in others)]
    moved, nearer = np.column_stack(bounds).T, sways(robot, others, deviations)
    if checker.links != "capsule":
        moved = moved + off_axis(checker, others, np.abs(rates).max(axis=1))
        nearer = nearer + off_axis(checker, others, deviations)
    return mover_of, moved, nearer


def link_bounds(robot: Robot, rates: FloatArray) -> FloatArray:
    """(pieces, links) largest distance that any axis point of a link can travel within each cubic [m].

    The bound of `hplan.certificate.clearance_proof`; `rates` are the (pieces, 3, dof) Bezier points of the derivative.
    """
    arm = robot.arm
    return _travels(rates, robot.yaw_joints, arm.signs, arm.lengths, robot.yaw_radius)


@kernel
def _travels(
    rates: FloatArray, first: int, signs: FloatArray, lengths: FloatArray, yaw_radius: FloatArray
) -> FloatArray:
    """The compiled part of `link_bounds`; what is no number stays none."""
    result, turned = np.empty((rates.shape[0], len(lengths))), np.empty(rates.shape[1])
    for piece in range(rates.shape[0]):
        swing = 0.0
        for i in range(len(turned)):
            turned[i] = 0.0
            if first:
                swing = _larger(swing, abs(rates[piece, i, 0]))
        bound = 0.0
        for k in range(len(lengths)):
            turn = 0.0
            for i in range(len(turned)):
                turned[i] += signs[k] * rates[piece, i, first + k]
                turn = _larger(turn, abs(turned[i]))
            bound += lengths[k] * turn
            result[piece, k] = bound + swing * yaw_radius[k] if first else bound
    return result


@kernel
def _larger(first: float, second: float) -> float:
    """The larger of two numbers; none where one of them is none."""
    return second if second > first or second != second else first


@dataclass(frozen=True, eq=False)
class _MovingBodies(Record):
    """Moving bodies of a general (non-planar) arm: each that joints move, then each pair of the robot's own.

    Attributes:
        alone: How many are one body; in the order in which checkers have them.
        first: (bodies,) the body; of a pair one of the two.
        second: (bodies,) the other body of a pair; -1 where there is none.
        counts: (bodies, dof) 1 for the joints that move the first and not the second, or the other way; else 0.
    """

    alone: int
    first: IntArray
    second: IntArray
    counts: FloatArray

    def of_pairs(self, checker: CoalScene) -> IntArray:
        """(pairs,) the moving body of each pair of a checker."""
        among = np.repeat(np.arange(self.alone), checker.own_first)
        return np.concatenate([among, np.arange(self.alone, len(self.first))])

    def travels(self, robot: Robot, bezier: FloatArray, deviations: FloatArray) -> FloatArray:
        """(bodies, pieces) how far each travels in each of (pieces, 4, dof) cubics at most [m]."""
        rates = 3.0 * np.abs(np.diff(bezier, axis=1)).max(axis=1)
        middles = 0.125 * (bezier[:, 0] + bezier[:, 3]) + 0.375 * (bezier[:, 1] + bezier[:, 2])
        bodies, bounds = FlatBodies.of(robot), reach(robot, _beyond(robot, deviations))
        found = _body_travels(np.ascontiguousarray(middles), rates, bounds, bodies.movers, bodies.numbers)
        travels = np.empty((len(self.first), len(bezier)))
        _of_movers(found, self.first, self.second, self.counts, travels)
        return travels

    def sways(self, robot: Robot, deviations: FloatArray) -> FloatArray:
        """(bodies, k) how far (k, dof) deviations displace each at most [m]."""
        sways: FloatArray = self._counted(reach(robot, _beyond(robot, deviations))) @ deviations.T
        return sways

    def _counted(self, by_body: FloatArray) -> FloatArray:
        """(..., moving bodies, dof) what joints do to those, from (..., bodies, dof) what they do to bodies."""
        second = np.where((self.second >= 0)[:, None], by_body[..., self.second, :], 0.0)
        counted: FloatArray = np.where(self.counts > 0.0, by_body[..., self.first, :] + second, 0.0)
        return counted


@made_once
def _moving_bodies(robot: Robot, pairs: SelfPairs) -> _MovingBodies:
    """The moving bodies of a robot with these pairs of its own; found once."""
    bodies = collision_bodies(robot)
    alone = [(body, -1) for body in itertools.chain(*moving_bodies(robot).values())]
    both = np.array([*alone, *pairs.checked], dtype=np.int64).reshape(-1, 2)
    counts = np.zeros((len(both), robot.dof))
    for row, pair in enumerate(both.tolist()):
        first, second = (set(carriers(robot, bodies[body].joint)) if body >= 0 else set[int]() for body in pair)
        counts[row, sorted(first ^ second)] = 1.0
    return _MovingBodies(len(alone), frozen(both[:, 0].copy()), frozen(both[:, 1].copy()), frozen(counts))


def _beyond(robot: Robot, deviations: FloatArray) -> float:
    """How far joints that slide may be beyond their limits: one of few numbers, for which `reach` is known [m]."""
    largest = float(deviations.max(initial=0.0)) if any(robot.slides) else 0.0
    return 2.0 ** math.ceil(math.log2(max(largest, 1e-3))) if largest > 0.0 else 0.0


@kernel
def _of_movers(found: FloatArray, first: IntArray, second: IntArray, counts: FloatArray, travels: FloatArray) -> None:
    """Fill in (movers, pieces) how far each travels, from (pieces, bodies, dof) how far joints move bodies."""
    for mover in range(len(first)):
        one, other = first[mover], second[mover]
        for piece in range(len(found)):
            total = 0.0
            for j in range(found.shape[2]):
                if counts[mover, j] > 0.0:
                    total += found[piece, one, j] + (found[piece, other, j] if other >= 0 else 0.0)
            travels[mover, piece] = total


@kernel
def _body_travels(
    middles: FloatArray, rates: FloatArray, reach: FloatArray, bodies: FloatArray, numbers: FloatArray
) -> FloatArray:
    """(pieces, bodies, dof) how far each joint's motion moves each body within each piece at most [m].

    Args:
        middles: (pieces, dof) configurations in the middle of the pieces.
        rates: (pieces, dof) largest rates of the joints within them.
        reach: (bodies, dof) motion-bound coefficients R.
        bodies: As `FlatBodies.movers`.
        numbers: As `FlatBodies`.
    """
    pieces, dof = middles.shape
    joints = int(numbers[flat.JOINTS])
    result, frames = np.zeros((pieces, len(reach), dof)), np.empty((dof + 1, 12))
    for piece in range(pieces):
        place_joints(middles[piece], numbers, frames)
        for b in range(len(reach)):
            x, y, z = bodies[b, flat.BALL], bodies[b, flat.BALL + 1], bodies[b, flat.BALL + 2]
            j, outer = int(bodies[b, flat.JOINT]), 0.0
            of_body = frames[j]
            at = (
                of_body[9] + of_body[0] * x + of_body[1] * y + of_body[2] * z,
                of_body[10] + of_body[3] * x + of_body[4] * y + of_body[5] * z,
                of_body[11] + of_body[6] * x + of_body[7] * y + of_body[8] * z,
            )
            while j < dof:
                own, f = joints + flat.JOINT_SIZE * j, frames[j]
                tx, ty, tz = numbers[own + flat.TURN], numbers[own + flat.TURN + 1], numbers[own + flat.TURN + 2]
                if tx == 0.0 and ty == 0.0 and tz == 0.0:
                    result[piece, b, j] = rates[piece, j]
                else:
                    axis = (
                        f[0] * tx + f[1] * ty + f[2] * tz,
                        f[3] * tx + f[4] * ty + f[5] * tz,
                        f[6] * tx + f[7] * ty + f[8] * tz,
                    )
                    off = cross(axis, sub(at, (f[9], f[10], f[11])))
                    radius = math.sqrt(dot(off, off)) + bodies[b, flat.BALL_RADIUS] + 0.5 * outer
                    result[piece, b, j] = min(reach[b, j], radius) * rates[piece, j]
                outer += reach[b, j] * rates[piece, j]
                j = int(numbers[own + flat.PARENT])
    return result
