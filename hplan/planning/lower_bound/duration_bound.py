"""Certified lower bound of the duration of a motion between two configurations.

For every problem it is at least the bound of the slowest joint alone. If obstacles block the way, reachability on
increasingly fine grids of three joints excludes longer durations. `docs/proof.md` has the proof.
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
from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.motion_coefficients import joint_axis
from hplan.errors import BoundError
from hplan.planning.lower_bound.cells import AXES
from hplan.planning.lower_bound.grid_search import GridSearch, TimedGrid
from hplan.planning.lower_bound.joint_tubes import JointMotions
from hplan.planning.problem import Problem
from hplan.planning.world import World
from hplan.robot.limits import Limits
from hplan.robot.model import Robot

#: Numbers of samples of a motion, each with its minimum relative gap between bound and known duration.
SAMPLES = ((64, 0.01), (128, 0.015), (256, 0.02))

#: Resolution of the search, as a fraction of the duration.
_STEP = 0.002

#: Ratio of the next duration to try to the longest excluded one.
_LONGER = 1.3

#: Maximum size of a grid, in words of 8 bytes; finer grids are skipped.
_MOST_WORDS = 6_000_000


@dataclass(frozen=True)
class DurationBound:
    """A lower bound of the duration of rest-to-rest motions.

    It holds for every motion between two configurations that `hplan.certify` verifies and that satisfies the jerk
    limits, if any, from rest to rest: with zero acceleration at both ends. The limits include the certificate's
    tolerance.

    Attributes:
        seconds: The lower bound [s].
        joints_s: Minimum duration of the slowest joint alone [s].
        duration_s: Duration of the motion to compare with [s].
        method: `joints` for the slowest joint alone; with obstacles and several joints together, `planar` if the arm
            moves in a plane and `spatial` otherwise.
        joint: Name of the slowest joint.
    """

    seconds: float
    joints_s: float
    duration_s: float
    method: Literal["joints", "planar", "spatial"]
    joint: str

    @property
    def gap(self) -> float:
        """Maximum relative excess of the duration over the shortest motion's."""
        return self.duration_s / self.seconds - 1.0 if self.seconds > 0.0 else 0.0


def duration_bound(
    world: World, problem: Problem, limits: Limits, duration_s: float, *, thorough: bool = False
) -> DurationBound:
    """Compute a lower bound of the duration of motions.

    Torque limits, self-contacts and tracking errors are neglected, so that motions they forbid are not excluded. For
    joints without a grid axis only the range counts.

    Args:
        world: The arm and its obstacles.
        problem: Start, goal and movable joints.
        limits: Limits of the motions.
        duration_s: Duration of a motion that solves the problem within the limits [s].
        thorough: True to search all grids even if the bound is already tight.

    Raises:
        BoundError: The given duration is proved impossible: it, or the proof, is wrong.
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
    """True if all movable joints rotate about parallel axes."""
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
    """The error that names the joints of a bound.

    The last joint moves bodies fastest.
    """
    named = f"joint{'s' if len(joints) > 1 else ''} {', '.join(map(repr, joints))}"
    return BoundError(
        f"a motion of {duration_s:.6g} s was found, which the bound of {named} excludes",
        duration_s=duration_s,
        joint=joints[-1],
    )


def _joint_motions(world: World, problem: Problem, limits: Limits) -> JointMotions:
    """The motions of all joints within the limits and the certificate's tolerance."""
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
    """The longest duration that the grids exclude.

    Args:
        samples: Numbers of samples with their gaps, as in `SAMPLES`.
        excluded: A duration that is excluded already [s].
        duration_s: Duration of a known motion [s].

    Raises:
        BoundError: The duration of the known motion is excluded.
    """
    obstacles = _obstacles(world)
    excess = _excess(world.robot, obstacles)
    for count, gap in samples:
        while duration_s > excluded * (1.0 + gap):
            # A shorter duration confines the joints and makes cells smaller; nothing is excluded if start and goal are
            # the same.
            longest = min(duration_s, _LONGER * excluded) or duration_s
            axes = _axes(obstacles, motions, longest)
            grid = TimedGrid.build(motions.select(axes), longest, count)
            if not len(axes) or grid.words > _MOST_WORDS:
                break
            search = GridSearch.build(obstacles, excess, motions, axes, grid)
            if search.is_possible(longest):
                excluded = _longest(search, excluded, longest)
                break
            if longest == duration_s:
                raise _contradiction(duration_s, [world.robot.joint_names[axis] for axis in axes.tolist()])
            excluded = longest
    return excluded


def _axes(obstacles: ClearanceField, motions: JointMotions, duration_s: float) -> IntArray:
    """The joints that can move a body farthest, at most `AXES`.

    The first one moves bodies most slowly.
    """
    lower, upper = motions.ranges(duration_s, 16)
    reaches = obstacles.reaches.max(axis=0)
    farthest = np.where(motions.velocity > 0.0, (upper - lower) * reaches, 0.0)
    axes = ties.argsort(-farthest)[:AXES]
    axes = axes[farthest[axes] > 0.0]
    return axes[ties.argsort((reaches * motions.velocity)[axes])]


def _excess(robot: Robot, obstacles: ClearanceField) -> FloatArray:
    """(bodies,) maximum excess of bodies over the certificate's shapes [m]."""
    excess = np.zeros(obstacles.count)
    growth = [body.growth for body in collision_bodies(robot)]
    excess[: len(growth)] = growth
    return excess


def _obstacles(world: World) -> ClearanceField:
    """Obstacles with the required clearance, without tracking errors and self-pairs.

    None is larger than the certificate's.
    """
    linked = world.linked
    excess = np.array([solid.excess for solid in linked.solids])
    field = replace(linked, growth=linked.growth - excess).field(world.robot, own_clearance=world.clearance)
    if world.touched:
        field = field.ignoring_last_link(linked.name_mask(world.touched))
    return field.select(np.ones(len(linked.solids), dtype=np.bool_), arm=False)


def _longest(search: GridSearch, excluded: float, possible: float) -> float:
    """The longest excluded duration, by bisection.

    The first duration to try is one step longer than the excluded one: often no grid excludes more.

    Args:
        excluded: A duration that is excluded [s].
        possible: A duration that is not excluded [s].
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
