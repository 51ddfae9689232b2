"""Specialists: additions to planning for one family of robots.

A specialist may have budgets, inverse kinematics, path finders, proofs and pages of its own. What it leaves out follows
the rules of all robots. Planning does not know any specialist; `hplan.base.lazy_import` describes how they are loaded.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from hplan.base.arrays import FloatArray
from hplan.base.lazy_import import load_extensions
from hplan.collision.coal_scene import CoalScene
from hplan.errors import NoPathError, OptionError
from hplan.kinematics.tool_at_point import tool_at_point
from hplan.planning.effort import EFFORTS, Effort
from hplan.planning.joint_ranges import LEAST_MARGIN, RANGE_MARGIN, JointRanges
from hplan.planning.options import EffortName, PlanOptions
from hplan.robot.model import Robot

#: `hplan.planning.problem.Problem`, and `hplan.planning.path_finder.PathFinder`; both rest on this module.
ProblemT = TypeVar("ProblemT")
FinderT = TypeVar("FinderT", covariant=True)


@dataclass(frozen=True)
class GoalSampler:
    """Inverse kinematics that returns configurations with the tool at a point, or at one of several.

    Attributes:
        at_point: The function; its arguments are those of `hplan.kinematics.tool_at_point.tool_at_point`.
        more: Number of directions or samples that are tried if all of a smaller number collide.
        enough: With this number of approaches, shorter ones are not searched; None to search all lengths.
        is_sorted: True if the quickest configurations come first, so that the others can be left out.
    """

    at_point: Callable[..., FloatArray] = tool_at_point
    more: int = 256
    enough: int | None = 8
    is_sorted: bool = True


@dataclass(frozen=True)
class Specialist(Generic[ProblemT, FinderT]):
    """Additions to planning for a family of robots.

    Attributes:
        recognizes: True for the robots of the family.
        presets: Budgets of the effort presets.
        goal_sampler: Inverse kinematics for a fruit or point.
        joint_ranges: Intervals in which the joints can move, from a scene, a (dof,) configuration and a margin [m].
        path_finders: The finders for a problem, in order of preference; None for the finders of all robots.
        prove_infeasible: For each goal of a problem the error that proves that no path leads there, or None.
        describe_proof: The kind of proof that was attempted, for the error if it did not succeed.
        searches_first: True if a problem is searched on a grid before a straight motion is tried.
        check_cspace: Refuses a robot without a C-space picture, or a yaw that it cannot have [rad]; None is the goal's.
        draw_cspace: For a `hplan.planning.result.PlanResult`, options and a yaw: the page of the C-space as HTML, and a
            function that draws its figure.
    """

    recognizes: Callable[[Robot], bool]
    presets: Mapping[EffortName, Effort]
    goal_sampler: GoalSampler
    joint_ranges: Callable[[CoalScene, FloatArray, float], JointRanges]
    path_finders: Callable[[ProblemT], Sequence[FinderT] | None]
    prove_infeasible: Callable[[ProblemT], list[NoPathError | None]]
    describe_proof: Callable[[ProblemT], str]
    searches_first: Callable[[ProblemT], bool]
    check_cspace: Callable[[Robot, float | None], None]
    draw_cspace: Callable[[Any, PlanOptions, float | None], tuple[str, Callable[[], Any]]]


_SPECIALISTS: list[Specialist[Any, Any]] = []


def register_specialist(specialist: Specialist[Any, Any]) -> None:
    """Add a specialist; the first one that recognizes a robot is used."""
    _SPECIALISTS.append(specialist)


def specialist_of(robot: Robot) -> Specialist[Any, Any] | None:
    """Return the specialist that recognizes a robot, or None."""
    load_extensions()
    return next((specialist for specialist in _SPECIALISTS if specialist.recognizes(robot)), None)


def presets_of(robot: Robot) -> Mapping[EffortName, Effort]:
    """Return the budgets of a robot's effort presets."""
    specialist = specialist_of(robot)
    return EFFORTS if specialist is None else specialist.presets


def goal_sampler_of(robot: Robot) -> GoalSampler:
    """Return a robot's inverse kinematics for a fruit or point."""
    specialist = specialist_of(robot)
    return GoalSampler() if specialist is None else specialist.goal_sampler


def joint_ranges(scene: CoalScene, q: FloatArray, margin: float = RANGE_MARGIN) -> JointRanges:
    """Return the intervals in which the joints can move from a configuration.

    Args:
        scene: The arm among obstacles, built with the tracking error and the required clearance.
        q: (dof,) configuration with more clearance than `margin` beyond the required one.
        margin: Clearance of the intervals beyond the required one [m].
    """
    specialist = specialist_of(scene.robot)
    if specialist is None:
        return JointRanges(scene.robot.lower, scene.robot.upper)
    return specialist.joint_ranges(scene, q, margin)


def narrow_ranges(scene: CoalScene, start: FloatArray, goal: FloatArray, clearance: float) -> JointRanges:
    """Return the free intervals around a start, with its goal inside.

    Args:
        scene: The arm among obstacles, built with the tracking error and the required clearance.
        start: (dof,) configuration.
        goal: (dof,) configuration.
        clearance: Clearance of both beyond the required one [m].

    Raises:
        NoPathError: A blocked joint separates the goal from the start; names the obstacle and the blocked angles.
    """
    ranges = joint_ranges(scene, start, min(RANGE_MARGIN, 0.5 * clearance))
    if ranges.wall_before(goal) is None:
        return ranges
    least = min(LEAST_MARGIN, 0.5 * clearance)
    ranges = joint_ranges(scene, start, least)
    wall = ranges.wall_before(goal)
    if wall is None:
        return ranges
    beyond = joint_ranges(scene, goal, least)
    other = beyond.lower if wall.is_upper else beyond.upper
    raise wall.no_path(scene.robot, float(other[wall.joint]))


def check_method(robot: Robot, options: PlanOptions) -> None:
    """Refuse a dense search for a robot without a grid.

    Raises:
        OptionError: The robot has no specialist.
    """
    if options.method == "dense" and specialist_of(robot) is None:
        expected = f"'two-level' for {robot.name!r}, which has no grid that can be searched"
        raise OptionError("method", options.method, expected)
