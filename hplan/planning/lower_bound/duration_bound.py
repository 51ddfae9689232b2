"""A duration that no motion between two configurations can fall below, shown rather than estimated.

For every problem that of the slowest joint alone. Where the base does not turn, reachability on grids of the first
three planar joints excludes longer ones: on coarse grids first, with each joint in turn as the one whose speed is
followed, at last on finer ones with the joint that excluded most. `docs/proof.md` has the proof.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from hplan.base import ties
from hplan.base.arrays import IntArray, frozen
from hplan.certificate.certificate import LIMIT_TOLERANCE
from hplan.collision.clearance_field import ClearanceField
from hplan.errors import BoundError
from hplan.planning.definition import Problem
from hplan.planning.lower_bound.joint_tubes import JointMotions
from hplan.planning.lower_bound.planar_search import PlanarSearch, Resolution, TimedGrid
from hplan.planning.world import World
from hplan.robot.limits import Limits

#: Samples of the grids on which the speed of each joint is followed in turn, and of those for the best of them. How the
#: cells lie to the obstacles matters about as much as their size: so there are two.
EACH_JOINT, ONE_JOINT = (24, 48), (66, 76)

#: The part of the duration that the search distinguishes, and the gap below which no finer grid is searched.
_STEP, ENOUGH = 0.002, 0.01


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
        method: `joints` for the slowest joint alone, `planar` where obstacles and several joints together count too.
        joint: Name of that joint; of the one whose speed was followed.
    """

    seconds: float
    joints_s: float
    duration_s: float
    method: Literal["joints", "planar"]
    joint: str

    @property
    def gap(self) -> float:
        """Fraction by which the motion may at most be longer than the shortest one; 0 for an empty motion."""
        return self.duration_s / self.seconds - 1.0 if self.seconds > 0.0 else 0.0


def duration_bound(
    world: World, problem: Problem, limits: Limits, duration_s: float, *, enough: float = ENOUGH
) -> DurationBound:
    """Bound the durations of motions from below.

    Torque limits, contacts of the arm with itself, tracking errors and links after the third are left out: motions
    that they forbid are not excluded.

    Args:
        world: The arm, and what it must keep clear of.
        problem: Start and goal, and the joints that may move.
        duration_s: Duration of a motion that solves the problem within the limits [s].
        enough: Where the bound is this part of the duration below it, it is not looked for a better one.

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
    is_planar = not problem.turns and robot.arm.link_count >= 3 and len(world.solids) > 0
    near = duration_s * (1.0 - max(enough, _STEP))
    if not is_planar or least >= near:
        return by_joints
    found, joint = _planar(world, problem, motions, (least, near, duration_s))
    if found <= least:
        return by_joints
    return DurationBound(found, least, duration_s, "planar", robot.joint_names[joint])


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


def _planar(
    world: World, problem: Problem, motions: JointMotions, durations: tuple[float, float, float]
) -> tuple[float, int]:
    """The longest duration that is excluded, and the joint whose speed was followed.

    Args:
        durations: One that is excluded already, one that would do, that of a motion [s].

    Raises:
        BoundError: The duration of the motion that is known is excluded.
    """
    found, near, duration_s = durations
    first, obstacles = world.robot.yaw_joints, _obstacles(world)
    orders = [np.array([k, *(j for j in range(3) if j != k)]) + first for k in range(3)]
    orders = [order for order in orders if motions.velocity[order[0]] > 0.0]

    def searched(order: IntArray, samples: int) -> PlanarSearch | None:
        grid = TimedGrid.of(motions.only(order), duration_s, Resolution(samples))
        # Most states of one sample and of all that a grid may have, in words of 8 bytes; finer ones are left out.
        if grid.words > 6_000_000 or grid.words * samples > 400_000_000:
            return None
        return PlanarSearch.of(world.robot, obstacles, problem.start, order, grid)

    best = orders[0]
    for samples in (*EACH_JOINT, *ONE_JOINT):
        if found >= near:
            break
        for order in orders if samples in EACH_JOINT else [best]:
            search = searched(order, samples)
            if search is None:
                continue
            if samples == EACH_JOINT[0] and not search.is_possible(duration_s):
                raise _contradiction(duration_s, world.robot.joint_names[order[0]])
            longer = _longest(search, found, duration_s)
            if longer > found:
                found, best = longer, order
    return found, int(best[0])


def _obstacles(world: World) -> ClearanceField:
    """Obstacles with the clearance to keep, without tracking errors and the arm itself; none is too large."""
    linked = world.linked
    excess = np.array([solid.excess for solid in linked.solids])
    field = replace(linked, growth=linked.growth - excess).field(world.robot, own_clearance=world.clearance)
    if world.touched:
        field = field.sparing(linked.named(world.touched))
    return field.only(np.ones(len(linked.solids), dtype=np.bool_), arm=False)


def _longest(search: PlanarSearch, excluded: float, possible: float) -> float:
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
