"""A duration that no motion between two configurations can fall below, shown rather than estimated.

For every problem that of the slowest joint alone. Where something is in the way, reachability on grids of up to four
joints excludes longer ones. Of up to three, coarse grids come first, with each joint in turn as the one whose speed is
followed, at last finer ones with the joint that excluded most. Four are searched with the joint that moves bodies
fastest, for short lengths first, as joints can be in fewer places then. `docs/proof.md` has the proof.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray, frozen
from hplan.certificate.certificate import LIMIT_TOLERANCE
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.collision_bodies import collision_bodies
from hplan.errors import BoundError
from hplan.planning.definition import Problem
from hplan.planning.lower_bound.grid_search import GridSearch, Resolution, TimedGrid
from hplan.planning.lower_bound.joint_tubes import JointMotions
from hplan.planning.lower_bound.occupied_cells import AXES
from hplan.planning.world import World
from hplan.robot.limits import Limits
from hplan.robot.model import Robot

#: Samples of the grids on which the speed of each joint is followed in turn, and of those for the best of them. How the
#: cells lie to the obstacles matters about as much as their size: so there are two.
EACH_JOINT, ONE_JOINT = (24, 48), (66, 76)

#: Of grids with four joints: samples, and the parts of what is not excluded yet up to which lengths are searched.
FOUR_JOINTS, PARTS = (48, 72), (0.15, 0.3, 0.6, 1.0)

#: The part of the duration that the search distinguishes, the gap below which no finer grid is searched, and below
#: which none with four joints is, whose samples are a fiftieth of the motion apart.
_STEP, ENOUGH, ENOUGH_OF_FOUR = 0.002, 0.01, 0.025


@dataclass(frozen=True)
class DurationBound:
    """A lower bound of the durations of all motions from one configuration to another, at rest at both.

    It holds for every motion that `hplan.certify` verifies and that keeps the jerk limits, where there are any, from
    the rest before to the rest after it: with acceleration 0 at both ends. Limits are taken with the certificate's
    tolerance.

    Attributes:
        seconds: No motion is shorter [s].
        joints_s: The shortest duration of the slowest joint alone [s].
        duration_s: Duration of the motion that it was asked for [s].
        method: `joints` for the slowest joint alone; where obstacles and several joints together count too, `planar`
            if the arm moves in a plane and `spatial` for all others.
        joint: Name of that joint; of the one whose speed was followed.
    """

    seconds: float
    joints_s: float
    duration_s: float
    method: Literal["joints", "planar", "spatial"]
    joint: str

    @property
    def gap(self) -> float:
        """Fraction by which the motion may at most be longer than the shortest one; 0 for an empty motion."""
        return self.duration_s / self.seconds - 1.0 if self.seconds > 0.0 else 0.0


def duration_bound(
    world: World, problem: Problem, limits: Limits, duration_s: float, *, enough: float = ENOUGH
) -> DurationBound:
    """Bound the durations of motions from below.

    Torque limits, contacts of the arm with itself and tracking errors are left out: motions that they forbid are not
    excluded. Of joints without an axis of the grids only the range counts.

    Args:
        world: The arm, and what it must keep clear of.
        problem: Start and goal, and the joints that may move.
        duration_s: Duration of a motion that solves the problem within the limits [s].
        enough: Where the bound is this part of the duration below it, it is not looked for a better one; with four
            joints or more nor where it is `ENOUGH_OF_FOUR` below it.

    Raises:
        BoundError: It is shown that there is no motion so short: the duration given, or the proof, is wrong.
    """
    robot = world.robot
    motions = _joint_motions(world, problem, limits)
    alone = motions.least_durations
    slowest = int(ties.argmax(alone))
    least = min(float(alone[slowest]), duration_s)
    if alone[slowest] > duration_s * (1.0 + 1e-9):
        raise _contradiction(duration_s, robot.joint_names[slowest])
    by_joints = DurationBound(least, least, duration_s, "joints", robot.joint_names[slowest])
    near = duration_s * (1.0 - max(enough, _STEP))
    if not len(world.solids) or least >= near:
        return by_joints
    found, joint = _on_grids(world, motions, AXES if problem.turns else 3, (least, near, duration_s))
    if found <= least:
        return by_joints
    method: Literal["planar", "spatial"] = "spatial" if problem.turns else "planar"
    return DurationBound(found, least, duration_s, method, robot.joint_names[joint])


def _contradiction(duration_s: float, joint: str) -> BoundError:
    return BoundError(
        f"a motion of {duration_s:.6g} s was found, and shown to be impossible by the bound of joint {joint!r}",
        duration_s=duration_s,
        joint=joint,
    )


def _joint_motions(world: World, problem: Problem, limits: Limits) -> JointMotions:
    """The motions of all joints within the limits, as the certificate takes them."""
    robot, count = world.robot, world.robot.dof
    moves = np.zeros(count, dtype=np.bool_)
    moves[problem.movable] = True
    jerk = np.full(count, np.inf) if limits.jerk is None else limits.jerk * LIMIT_TOLERANCE
    able = moves & (limits.velocity > 0.0) & (limits.acceleration > 0.0) & (jerk > 0.0)
    return JointMotions(
        start=problem.start,
        goal=problem.goal,
        lower=robot.lower,
        upper=robot.upper,
        velocity=frozen(np.where(able, limits.velocity * LIMIT_TOLERANCE, 0.0)),
        acceleration=frozen(np.where(able, limits.acceleration * LIMIT_TOLERANCE, 1.0)),
        jerk=frozen(np.where(able, jerk, np.inf)),
    )


def _on_grids(
    world: World, motions: JointMotions, most: int, durations: tuple[float, float, float]
) -> tuple[float, int]:
    """The longest duration that is excluded, and the joint whose speed was followed.

    Args:
        most: Most axes of a grid.
        durations: One that is excluded already, one that would do, that of a motion [s].

    Raises:
        BoundError: The duration of the motion that is known is excluded.
    """
    found, near, duration_s = durations
    obstacles = _obstacles(world)
    excess = _excess(world.robot, obstacles)
    axes = _axes(obstacles, motions, duration_s, most)
    orders = [np.array([first, *(joint for joint in axes if joint != first)]) for first in axes]

    def excluded(order: IntArray, resolution: Resolution, longest: float) -> float:
        """The longest duration up to some length that is known to be excluded now."""
        grid = TimedGrid.of(motions.only(order), longest, resolution)
        # Most states of one sample and of all that a grid may have, in words of 8 bytes; finer ones are left out.
        if grid.words > 6_000_000 or grid.words * resolution.samples > 400_000_000:
            return found
        search = GridSearch.of(obstacles, excess, motions, order, grid)
        if longest == duration_s and not search.is_possible(duration_s):
            raise _contradiction(duration_s, world.robot.joint_names[order[0]])
        return _longest(search, found, longest)

    if len(axes) == AXES:
        order = orders[ties.argmax((obstacles.reaches.max(axis=0) * motions.velocity)[axes])]
        near, useless = min(near, duration_s * (1.0 - ENOUGH_OF_FOUR)), 0
        for samples, part in product(FOUR_JOINTS, PARTS):
            if found >= near:
                break
            if samples == useless:
                continue
            longest = duration_s if part == 1.0 else found + part * (duration_s - found)
            longer = excluded(order, Resolution(samples, speed_cells=1), longest)
            if longer == found:
                useless = samples  # on its grids for longer motions, which are coarser
            found = longer
        return found, int(order[0])
    best = orders[0] if orders else np.zeros(1, dtype=np.int64)
    for samples in (*EACH_JOINT, *ONE_JOINT):
        for order in orders if samples in EACH_JOINT else [best]:
            if found >= near:
                break
            longer = excluded(order, Resolution(samples), duration_s)
            if longer > found:
                found, best = longer, order
    return found, int(best[0])


def _axes(obstacles: ClearanceField, motions: JointMotions, duration_s: float, most: int) -> list[int]:
    """The joints that can move some body farthest in a time, in the order of their numbers; so many at most."""
    lower, upper = motions.ranges(duration_s, 16)
    farthest = np.where(motions.velocity > 0.0, (upper - lower) * obstacles.reaches.max(axis=0), 0.0)
    return sorted(joint for joint in ties.argsort(-farthest)[:most].tolist() if farthest[joint] > 0.0)


def _excess(robot: Robot, obstacles: ClearanceField) -> FloatArray:
    """(bodies,) by how much bodies are larger than the shapes that the certificate judges by, at most [m]."""
    excess = np.zeros(len(obstacles.movers))
    if robot.planar is None:  # of planar arms both see the same capsules
        growth = [body.growth for body in collision_bodies(robot)]
        excess[: len(growth)] = growth
    return excess


def _obstacles(world: World) -> ClearanceField:
    """Obstacles with the clearance to keep, without tracking errors and the arm itself; none is too large."""
    linked = world.linked
    excess = np.array([solid.excess for solid in linked.solids])
    field = replace(linked, growth=linked.growth - excess).field(world.robot, own_clearance=world.clearance)
    if world.touched:
        field = field.sparing(linked.named(world.touched))
    return field.only(np.ones(len(linked.solids), dtype=np.bool_), arm=False)


def _longest(search: GridSearch, excluded: float, possible: float) -> float:
    """The longest duration excluded, by bisection from one that is and one that is not.

    The first that is tried is a step longer than what is excluded already: often no grid excludes more.
    """
    step = _STEP * possible
    middle = excluded + step
    while possible - excluded > step:
        if search.is_possible(middle):
            possible = middle
        else:
            excluded = middle
        middle = 0.5 * (excluded + possible)
    return excluded
