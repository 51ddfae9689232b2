"""A duration that no motion between two configurations can fall below, shown rather than estimated.

For every problem that of the slowest joint alone. Where something is in the way, reachability on ever finer grids of
three joints excludes longer ones. `docs/proof.md` has the proof.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pinocchio as pin

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray, frozen
from hplan.certificate.certificate import LIMIT_TOLERANCE
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.reach import joint_axis
from hplan.errors import BoundError
from hplan.planning.lower_bound.grid_search import GridSearch, TimedGrid
from hplan.planning.lower_bound.joint_tubes import JointMotions
from hplan.planning.lower_bound.occupied_cells import AXES
from hplan.planning.problem import Problem
from hplan.planning.world import World
from hplan.robot.limits import Limits
from hplan.robot.model import Robot

#: Samples of motions, and above which part that is left of the duration of the one that is known so many are looked at.
SAMPLES = ((64, 0.01), (128, 0.015), (256, 0.02))

#: The part of the duration that the search distinguishes.
_STEP = 0.002

#: Motions are looked at next that are so many times as long as what is excluded already.
_LONGER = 1.3

#: Most words of 8 bytes that a grid may have; finer ones are left out.
_MOST_WORDS = 6_000_000


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
        joint: Name of the slowest joint.
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
    world: World, problem: Problem, limits: Limits, duration_s: float, *, thorough: bool = False
) -> DurationBound:
    """Bound the durations of motions from below.

    Torque limits, contacts of the arm with itself and tracking errors are left out: motions that they forbid are not
    excluded. Of joints without an axis of the grids only the range counts.

    Args:
        world: The arm, and what it must keep clear of.
        problem: Start and goal, and the joints that may move.
        duration_s: Duration of a motion that solves the problem within the limits [s].
        thorough: Whether all grids are searched, however near the bound is already.

    Raises:
        BoundError: It is shown that there is no motion so short: the duration given, or the proof, is wrong.
    """
    robot = world.robot
    motions = _joint_motions(world, problem, limits)
    alone = motions.least_durations
    slowest = int(ties.argmax(alone))
    least = min(float(alone[slowest]), duration_s)
    if alone[slowest] > duration_s * (1.0 + 1e-9):
        raise _contradiction(duration_s, [robot.joint_names[slowest]])
    by_joints = DurationBound(least, least, duration_s, "joints", robot.joint_names[slowest])
    samples = [(count, _STEP if thorough else gap) for count, gap in SAMPLES]
    if not len(world.solids) or duration_s <= least * (1.0 + samples[0][1]):
        return by_joints
    found = _on_grids(world, motions, samples, least, duration_s)
    if found <= least:
        return by_joints
    method: Literal["planar", "spatial"] = "planar" if _moves_in_a_plane(robot, problem) else "spatial"
    return DurationBound(found, least, duration_s, method, robot.joint_names[slowest])


def _moves_in_a_plane(robot: Robot, problem: Problem) -> bool:
    """True if all joints that may move turn about parallel axes."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, problem.start)
    axes = []
    for joint in problem.movable.tolist():
        axis, slides = joint_axis(robot, joint)
        if slides:
            return False
        axes.append(data.oMi[joint + 1].rotation @ axis)
    return all(np.linalg.norm(np.cross(axes[0], axis)) <= 1e-9 for axis in axes)


def _contradiction(duration_s: float, joints: Sequence[str]) -> BoundError:
    """The error that names the joints of a bound; the last of them moves bodies fastest."""
    named = f"joint{'s' if len(joints) > 1 else ''} {', '.join(map(repr, joints))}"
    return BoundError(
        f"a motion of {duration_s:.6g} s was found, and shown to be impossible by the bound of {named}",
        duration_s=duration_s,
        joint=joints[-1],
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
    world: World, motions: JointMotions, samples: Sequence[tuple[int, float]], excluded: float, duration_s: float
) -> float:
    """The longest duration that is excluded.

    Args:
        samples: As `SAMPLES`.
        excluded: A duration that is excluded already [s].
        duration_s: That of a motion [s].

    Raises:
        BoundError: The duration of the motion that is known is excluded.
    """
    obstacles = _obstacles(world)
    excess = _excess(world.robot, obstacles)
    for count, gap in samples:
        while duration_s > excluded * (1.0 + gap):
            # In less time joints are in fewer places, and cells are smaller; nothing is excluded where start is goal.
            longest = min(duration_s, _LONGER * excluded) or duration_s
            axes = _axes(obstacles, motions, longest)
            grid = TimedGrid.of(motions.only(axes), longest, count)
            if not len(axes) or grid.words > _MOST_WORDS:
                break
            search = GridSearch.of(obstacles, excess, motions, axes, grid)
            if search.is_possible(longest):
                excluded = _longest(search, excluded, longest)
                break
            if longest == duration_s:
                raise _contradiction(duration_s, [world.robot.joint_names[axis] for axis in axes.tolist()])
            excluded = longest
    return excluded


def _axes(obstacles: ClearanceField, motions: JointMotions, duration_s: float) -> IntArray:
    """The joints that can move some body farthest in a time, `AXES` at most; the one that does so least is first."""
    lower, upper = motions.ranges(duration_s, 16)
    reaches = obstacles.reaches.max(axis=0)
    farthest = np.where(motions.velocity > 0.0, (upper - lower) * reaches, 0.0)
    axes = ties.argsort(-farthest)[:AXES]
    axes = axes[farthest[axes] > 0.0]
    return axes[ties.argsort((reaches * motions.velocity)[axes])]


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
