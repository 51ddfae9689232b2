"""Certified motions along given paths: waypoints of any planner, start to goal."""

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
    """A polyline verified collision-free, near the given one.

    Attributes:
        waypoints: (m, dof) the polyline.
        moved: Numbers of the given motions that it changes, counted from 1.
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
    """Make a certified motion along a given path.

    The path consists of straight motions in joint space. It is verified collision-free; if it only violates the
    required clearance it is moved away. Then it is shortened, smoothed, timed and certified like hplan's own paths:
    nothing about its source is trusted. The motion begins at the first waypoint and ends at the last, at rest. The
    scene's start and goal do not matter, and a fruit that is its goal is an obstacle like the others.

    Args:
        robot: The arm.
        scene: Obstacles, required clearance, locked joints.
        waypoints: (n, dof) configurations, n >= 2, from start to goal; repeated ones count once.
        options: How to smooth and time the path; search options do not matter.
        keep_within_rad: Maximum distance of the motion's path from the polyline (Euclidean norm over all joints): keeps
            the shape and only rounds the corners, more tightly if obstacles leave no room. At least 1e-4. None to
            shorten and smooth the path. If the path is moved away from obstacles, the distance counts from the moved
            path.
        progress: Called with the name of each stage as it begins.
        cancel: A function or an event that reports cancellation.

    Returns:
        The motion as the result of a plan, for the scene with the path's ends as start and goal (`result.scene`).
        Section `given` of its report has the number of waypoints, the motions between them that were moved, and the
        lengths.

    Raises:
        InputError: `waypoints` are invalid, fewer than two, or all the same; a locked joint moves; or a path to be
            shortened ends where it begins.
        JointLimitError: A waypoint violates the joint limits; names it and the joint.
        PathInContactError: The path is in contact, or is too close to an obstacle and could not be moved away; names
            the waypoint or the motion between two, link, obstacle and depth.
        MovingObstacleError: The scene has a moving obstacle or a moving base.
        OptionError: `keep_within_rad` is too small or not finite.
        TimingError: The path cannot be timed.
        CertificationError: No motion along the path could be certified.
        NotInTimeError: No motion was found before the deadline.
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
        raise InputError(
            "the path ends where it begins, and shortening leaves nothing of it; keep its shape (keep_within_rad)"
        )
    with stage_clock(progress) as clock, time_limit(options.deadline_s, cancel) as limit:
        try:
            return _finished(Problem.of(robot, along, options), path, keep_within_rad)
        except TimeIsUpError:
            raise limit.error(clock.describe()) from None


def _finished(problem: Problem, path: GivenPath, keep_within_rad: float | None) -> PlanResult:
    """The result for a validated path."""
    robot, points = problem.robot, path.points
    problem.world.check_base(robot.yaw_of(points[0]))
    clear = _shown_clear(problem, path)
    problem = problem.between(points[0], points[-1])
    if keep_within_rad is not None:
        return _result(path, clear, _kept(problem, clear.waypoints, keep_within_rad))
    return _result(path, clear, _smoothed(problem, clear.waypoints))


def _shown_clear(problem: Problem, path: GivenPath) -> _ClearPath:
    """The path, moved away from bodies that it is too close to.

    Raises:
        PathInContactError: The path is in contact, or could not be moved away.
        CertificationError: The path was not verified collision-free, though no contact was found.
    """
    world, field, points = problem.world, problem.field, path.points
    # Fraction of the margin required of the path itself; smoothing uses the whole margin if possible.
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
    """The motion along the path, shortened and smoothed.

    If it cannot be certified, the motion along the path with rounded corners.
    """
    try:
        return quickest(problem, [Path(waypoints, "given")], problem.margin)
    except (CertificationError, TimingError):
        with suppress(CertificationError, TimingError):
            return _kept(problem, waypoints, ROUNDING)
        raise


#: Maximum distance from the polyline if the corners are only rounded because nothing else can be certified [rad].
ROUNDING = 0.02


def _kept(problem: Problem, waypoints: FloatArray, deviation_rad: float) -> Transit:
    """The motion along the path with its corners rounded.

    The rounding is as large as can be verified collision-free.

    Args:
        deviation_rad: Maximum distance from the polyline [rad].

    Raises:
        CertificationError: No rounding was verified collision-free, or the motion is not certified.
        TimingError: The path cannot be timed.
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
    """The result of a plan; its report describes the path."""
    result = plan_result(Plan(motion))
    given: dict[str, Any] = {
        "waypoints": path.count,
        "moved_segments": list(clear.moved),
        "length_rad": path_length(path.points),
        "length_moved_rad": path_length(clear.waypoints),
        "length_finished_rad": 0.0 if motion.path is None else motion.path.length,
    }
    return replace(result, told={"given": given})
