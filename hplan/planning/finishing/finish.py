"""Somebody else's path made into a certified motion: waypoints of any planner, from start to goal."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import number as checked_number
from hplan.base.arrays import FloatArray
from hplan.base.deadline import Cancel, TimeIsUpError, time_limit
from hplan.base.polyline import path_length
from hplan.errors import CertificationError, InputError, TimingError
from hplan.optimization.repair import pushed_clear, repaired
from hplan.optimization.smooth_path import SMALLEST_FRACTION
from hplan.planning.finishing.given_path import SAME, GivenPath, given_path, scene_along
from hplan.planning.finishing.path_contact import places_of, refuse
from hplan.planning.motion import Plan, Transit, certified_trajectory, quickest
from hplan.planning.options import PlanOptions
from hplan.planning.path_finder import Path
from hplan.planning.plan import check_task, plan_result
from hplan.planning.problem import MARGIN, Problem
from hplan.planning.result import PlanResult
from hplan.planning.stages import Progress, no_progress, stage, stage_clock
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.trajectory.corner_rounding import LEAST_DEVIATION, rounded_path
from hplan.trajectory.timing import corner_grid


class _ClearPath(NamedTuple):
    """A polyline verified collision-free, near the one that was given.

    Attributes:
        waypoints: (m, dof) the polyline.
        moved: Numbers of the motions of the one that was given, counted from 1, that are not in it as they were.
    """

    waypoints: FloatArray
    moved: tuple[int, ...]


def finish(
    robot: Robot,
    scene: Scene,
    waypoints: ArrayLike,
    options: PlanOptions | None = None,
    *,
    keep_within_rad: float | None = None,
    progress: Progress = no_progress,
    cancel: Cancel | None = None,
) -> PlanResult:
    """The certified motion along somebody else's path.

    The path is one of straight motions in joint space. It is verified collision-free; where it merely comes closer than
    the clearance to keep it is moved away; then it is shortened, smoothed, timed and certified like hplan's own paths.
    Whatever planned it: nothing is taken on trust. The motion begins at the first waypoint and ends at the last, at
    rest; start and goal of the scene do not matter, and a fruit that is its goal is an obstacle like the others.

    Args:
        robot: The arm.
        scene: Obstacles, clearance to keep, locked joints.
        waypoints: (n, dof) configurations, n >= 2, from start to goal; repeated ones count once.
        options: How to finish it; those of searches do not matter.
        keep_within_rad: Largest distance of the motion's path from the polyline (Euclidean norm over all joints), where
            its shape is to be kept and only its corners rounded; less where obstacles leave no room. At least 1e-4.
            None to shorten and smooth it. Where the path comes too close and is moved away, it is that from the moved
            one.
        progress: Called with the name of each stage as it begins.
        cancel: A function or an event that says whether the motion is cancelled.

    Returns:
        The motion as of a plan, for the scene with the path's ends as start and goal (`result.scene`). Its report has
        in `given`: how many waypoints there were, which motions between them were moved, and lengths.

    Raises:
        InputError: Waypoints that are none, fewer than two, or all the same; joints that are locked and move; a path
            that ends where it begins and is to be shortened.
        JointLimitError: A waypoint outside the joint limits; names it and the joint.
        PathInContactError: The path touches something, or comes too close and could not be moved away; names the
            waypoint or the motion between two, link, obstacle and depth.
        MovingObstacleError: Something in the scene moves.
        OptionError: A distance that cannot be kept.
        TimingError: The path cannot be timed.
        CertificationError: No motion along the path could be certified.
        NotInTimeError: None was found before the deadline.
        PlanCancelledError: It was cancelled.

    Examples:
        >>> import numpy as np
        >>> from hplan import finish, load_robot, load_scene
        >>> waypoints = np.radians([(0, 0, 0, 0), (0, 0, 90, 90), (0, 45, 60, 70)])
        >>> result = finish(load_robot(), load_scene(), waypoints)
        >>> result.certificate.verified
        True
        >>> result.report["given"]["waypoints"]
        3
    """
    check_task(robot, scene, options, progress)
    options = PlanOptions() if options is None else options
    if keep_within_rad is not None:
        expected = f"None, or a finite number of radians >= {LEAST_DEVIATION:g}"
        checked_number("keep_within_rad", keep_within_rad, expected, lambda value: value >= LEAST_DEVIATION)
    path = given_path(robot, waypoints)
    along = scene_along(robot, scene, path)
    if keep_within_rad is None and np.abs(path.points[-1] - path.points[0]).max() <= SAME:
        raise InputError("the path ends where it begins: shortened, nothing is left of it; its shape can be kept")
    with stage_clock(progress) as clock, time_limit(options.deadline_s, cancel) as limit:
        try:
            return _finished(Problem.of(robot, along, options), path, keep_within_rad)
        except TimeIsUpError:
            raise limit.error(clock.describe()) from None


def _finished(problem: Problem, path: GivenPath, keep_within_rad: float | None) -> PlanResult:
    """The motion."""
    robot, points = problem.robot, path.points
    problem.world.check_base(robot.yaw_of(points[0]))
    clear = _shown_clear(problem, path)
    problem = problem.between(points[0], points[-1])
    if keep_within_rad is not None:
        return _result(path, clear, _kept(problem, clear.waypoints, keep_within_rad))
    return _result(path, clear, _smoothed(problem, clear.waypoints))


def _shown_clear(problem: Problem, path: GivenPath) -> _ClearPath:
    """The path, moved away from what it merely comes too close to.

    Raises:
        PathInContactError: It touches something, or could not be moved away.
        CertificationError: It was not verified collision-free, though no contact was found.
    """
    world, field, points = problem.world, problem.field, path.points
    # Fraction of the margin that the path itself is to have; smoothing asks for the whole where it can be had.
    path_margin = 0.1
    with stage("postprocess"):
        spare = float(field.along(points[[0, -1]]).min())
        margin = path_margin * min(MARGIN, 0.5 * spare) if spare > 0.0 else path_margin * MARGIN
        if spare > 0.0 and field.is_clear(points, margin):
            return _ClearPath(points, ())
        places = list(places_of(world, path, margin))
        touching = [place for place in places if place.touches]
        ends = [place for place in places if place.at_waypoint and place.number in (0, len(points) - 1)]
        if touching or ends:
            raise refuse(path, touching or ends)
        locked = problem.robot.locked_mask(problem.scene.locked_joints)
        lower, upper = (np.where(locked, points[0], bound) for bound in (problem.robot.lower, problem.robot.upper))
        clear, unmoved = pushed_clear(points, field, lower, upper, margin)
        if unmoved:
            clear, unmoved = repaired(points, field, lower, upper, margin)
        if unmoved and places:
            raise refuse(path, places)
        moved = [number for number in range(len(points) - 1) if not field.is_clear(points[number : number + 2], margin)]
        segments = tuple(int(path.numbers[number + 1]) - 1 for number in moved)
    if unmoved:
        raise CertificationError(
            f"the path cannot be verified collision-free between waypoints {segments[0]} and {segments[0] + 1}, and "
            "could not be moved away",
            segments=list(segments),
        )
    return _ClearPath(clear, segments)


def _smoothed(problem: Problem, waypoints: FloatArray) -> Transit:
    """The motion along the path shortened and smoothed; where it cannot be certified, with its corners rounded."""
    try:
        return quickest(problem, [Path(waypoints, "given")], problem.margin)
    except (CertificationError, TimingError):
        with suppress(CertificationError, TimingError):
            return _kept(problem, waypoints, ROUNDING)
        raise


#: Largest distance from the polyline where corners are only rounded because nothing else can be certified [rad].
ROUNDING = 0.02


def _kept(problem: Problem, waypoints: FloatArray, deviation_rad: float) -> Transit:
    """The motion along the path with its corners rounded, as far as can be verified collision-free.

    Raises:
        CertificationError: No rounding was verified collision-free, or the motion is not certified.
        TimingError: It cannot be timed.
    """
    margin = 0.5 * SMALLEST_FRACTION * problem.margin
    allowed = deviation_rad
    with stage("postprocess"):
        path = rounded_path(waypoints, allowed)
        while not path.is_clear(problem.field, margin):
            if allowed <= LEAST_DEVIATION:
                raise CertificationError("the path's corners cannot be rounded within its clearance")
            allowed = max(0.5 * allowed, LEAST_DEVIATION)
            path = rounded_path(waypoints, allowed)
    trajectory, certificate = certified_trajectory(problem, path, grid=corner_grid(path))
    return Transit("transit", trajectory, certificate, problem, waypoints, path, "given")


def _result(path: GivenPath, clear: _ClearPath, motion: Transit) -> PlanResult:
    """The result of a plan, with what became of the path in its report."""
    result = plan_result(Plan(motion))
    given: dict[str, Any] = {
        "waypoints": path.count,
        "moved_segments": list(clear.moved),
        "length_rad": path_length(path.points),
        "length_moved_rad": path_length(clear.waypoints),
        "length_finished_rad": 0.0 if motion.path is None else motion.path.length,
    }
    return replace(result, told={"given": given})
