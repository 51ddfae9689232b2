"""Moving bodies of a checker's pairs: bounds of their travel, and of their displacement by tracking errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.base.kernels import kernel
from hplan.certificate.body_travel import body_motion, body_sways
from hplan.collision.coal_scene import CoalScene
from hplan.collision.reach import joint_axis
from hplan.robot.base_shapes import GROUND, TURRET
from hplan.robot.model import Robot
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
    slides = [joint_axis(robot, joint)[1] for joint in range(robot.dof)]
    with np.errstate(over="ignore"):
        largest: FloatArray = np.fmin(tracking.deviations(speeds), np.where(slides, _FARTHEST, math.tau))
    return largest


def fastest(bezier: FloatArray, duration: FloatArray) -> FloatArray:
    """(pieces, dof) bounds of |velocity| within each cubic: it lies in the hull of its Bezier points [rad/s]."""
    with np.errstate(over="ignore", invalid="ignore"):
        fastest: FloatArray = 3.0 * np.abs(np.diff(bezier, axis=1)).max(axis=1) / duration[:, None]
    return fastest


def pair_sways(checker: CoalScene, deviations: FloatArray) -> FloatArray:
    """Tracking-error displacement bound of each pair, of (k, dof) deviations [rad] -> (pairs, k) [m]."""
    if checker.own_bodies is not None:
        return body_sways(checker, checker.own_bodies, deviations)
    mover_of, others = movers(checker)
    return sways(checker.robot, others, deviations)[mover_of]


def sways(robot: Robot, others: Sequence[tuple[int, int]], deviations: FloatArray) -> FloatArray:
    """(movers, k) tracking-error displacement bounds of the moving bodies [m]: of the links, then of the others."""
    found = [pair_sway(robot, part, other, deviations) for part, other in others]
    return np.column_stack([robot.sway(deviations), *found]).T


def off_axis(checker: CoalScene, others: Sequence[tuple[int, int]], turns: FloatArray) -> FloatArray:
    """(movers, k) how much farther than its axis a link that is no capsule moves as joints turn by (k, dof) [m].

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
    """(movers, pieces + 1) the larger displacement bound of the two pieces at each row, from those of the pieces."""
    if sway.shape[1] == 1:
        return np.repeat(sway, pieces + 1, axis=1)
    return np.maximum(np.column_stack([sway[:, :1], sway]), np.column_stack([sway, sway[:, -1:]]))


def with_obstacles(
    checker: CoalScene, mover_of: IntArray, moved: FloatArray, nearer: FloatArray, clock: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Moving bodies where obstacles move too: a body and what moves alike make another, which travels as far as both.

    Args:
        checker: The arm among obstacles that move.
        mover_of: (pairs,) the moving body of each pair.
        moved: (movers, pieces) how far each travels in each piece [m].
        nearer: (movers, k) how much nearer tracking errors may bring its pairs [m].
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
    robot: Robot, bezier: FloatArray, checker: CoalScene, deviations: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """The moving bodies of a checker's pairs along a motion, and what tracking errors do.

    Args:
        robot: The arm.
        bezier: (pieces, 4, dof) Bezier points of the motion's cubics.
        checker: The arm among the obstacles.
        deviations: (k, dof) largest deviations of the joints [rad].

    Returns:
        (pairs,) the moving body of each pair; (movers, pieces) how far each travels in each piece; (movers, k) by how
        much deviations may bring its pairs nearer [m].
    """
    if checker.own_bodies is not None:
        return body_motion(checker, checker.own_bodies, bezier, deviations)
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
