"""Certified motions along given paths: waypoints of any planner, start to goal.

Straight motions that the compiled distances verify are clear. On each of the others the place with the minimum
clearance is searched among closely spaced configurations, and coal determines the bodies and the depth.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hplan.base import ties
from hplan.base.arguments import number as checked_number
from hplan.base.arrays import FloatArray, IntArray, Record, frozen, numbers
from hplan.base.deadline import Cancel, TimeIsUpError, time_limit
from hplan.collision.motion_coefficients import reach
from hplan.errors import (
    CertificationError,
    ConfigurationInCollisionError,
    InputError,
    MovingObstacleError,
    PathInContactError,
    TimingError,
)
from hplan.geometry.polyline import path_length
from hplan.optimization.repair import pushed_clear, repair
from hplan.optimization.smooth_path import SMALLEST_FRACTION
from hplan.planning.motion import Motion, Plan, certified_trajectory, quickest
from hplan.planning.options import PlanOptions
from hplan.planning.path_finder import Path
from hplan.planning.plan import check_task, plan_result
from hplan.planning.problem import MARGIN, Problem
from hplan.planning.result import PlanResult
from hplan.planning.stages import Progress, no_progress, stage, stage_clock
from hplan.planning.world import World
from hplan.robot.model import Robot
from hplan.robot.upright import with_fixed_axis
from hplan.scene.model import Goal, Scene, Start
from hplan.trajectory.corner_rounding import LEAST_DEVIATION, rounded_path
from hplan.trajectory.timing import corner_grid


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
            return _finish_path(Problem.from_scene(robot, along, options), path, keep_within_rad)
        except TimeIsUpError:
            raise limit.error(clock.describe()) from None


def _finish_path(problem: Problem, path: GivenPath, keep_within_rad: float | None) -> PlanResult:
    """The result for a validated path."""
    points = path.points
    problem.world.check_base()
    clear, moved = _shown_clear(problem, path)
    problem = problem.from_configurations(points[0], points[-1])
    motion = (
        _smooth_path(problem, clear)
        if keep_within_rad is None
        else _motion_with_round_corners(problem, clear, keep_within_rad)
    )
    given: dict[str, Any] = {
        "waypoints": path.count,
        "moved_segments": list(moved),
        "length_rad": path_length(points),
        "length_moved_rad": path_length(clear),
        "length_finished_rad": 0.0 if motion.path is None else motion.path.length,
    }
    return replace(plan_result(Plan(motion)), told={"given": given})


def _shown_clear(problem: Problem, path: GivenPath) -> tuple[FloatArray, tuple[int, ...]]:
    """The path, moved away from bodies that it is too close to.

    The second value has the numbers of the given motions that it changes, counted from 1.

    Raises:
        PathInContactError: The path is in contact, or could not be moved away.
        CertificationError: The path was not verified collision-free, though no contact was found.
    """
    world, field, points = problem.world, problem.field, path.points
    # Fraction of the margin required of the path itself; smoothing uses the whole margin if possible.
    path_margin = 0.1
    with stage("postprocess"):
        spare = float(field.spare_clearances(points[[0, -1]]).min())
        margin = path_margin * min(MARGIN, 0.5 * spare) if spare > 0.0 else path_margin * MARGIN
        if spare > 0.0 and field.is_clear(points, margin):
            return points, ()
        places = list(places_of(world, path, margin))
        touching = [place for place in places if place.touches]
        ends = [place for place in places if place.at_waypoint and place.number in (0, len(points) - 1)]
        if touching or ends:
            raise refuse(path, touching or ends)
        locked = problem.robot.locked_mask(problem.scene.locked_joints)
        lower, upper = (np.where(locked, points[0], bound) for bound in (problem.robot.lower, problem.robot.upper))
        clear, unmoved = pushed_clear(points, field, lower, upper, margin)
        if unmoved:
            clear, unmoved = repair(points, field, lower, upper, margin)
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
    return clear, segments


def _smooth_path(problem: Problem, waypoints: FloatArray) -> Motion:
    """The motion along the path, shortened and smoothed.

    If it cannot be certified, the motion along the path with rounded corners.
    """
    try:
        return quickest(problem, [Path(waypoints, "given")], problem.margin)
    except (CertificationError, TimingError):
        with suppress(CertificationError, TimingError):
            return _motion_with_round_corners(problem, waypoints, LARGEST_ROUNDING)
        raise


#: Maximum distance from the polyline if the corners are only rounded because nothing else can be certified [rad].
LARGEST_ROUNDING = 0.02


def _motion_with_round_corners(problem: Problem, waypoints: FloatArray, deviation_rad: float) -> Motion:
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
    return Motion("transit", trajectory, certificate, problem, waypoints, path, "given")


#: Waypoints closer to each other than this in every joint are one; the same holds for path ends and the scene's start
#: and goal [rad].
SAME = 1e-9


@dataclass(frozen=True, eq=False)
class GivenPath(Record):
    """Waypoints within the joint limits, without consecutive repetitions.

    Attributes:
        points: (m, dof) waypoints, m >= 2.
        numbers: (m,) their numbers among the given ones, counted from 1; for repeated ones the first.
        count: Number of given waypoints, repetitions included.
    """

    points: FloatArray
    numbers: IntArray
    count: int


def given_path(robot: Robot, waypoints: ArrayLike) -> GivenPath:
    """Validate waypoints and drop consecutive repetitions.

    Args:
        waypoints: (n, dof) configurations, start to goal.

    Raises:
        InputError: `waypoints` is not an (n, dof) array of finite numbers, has fewer than two, or all are the same.
        JointLimitError: A waypoint violates the joint limits; names it, counted from 1, and the joint.
    """
    points = numbers("waypoints", waypoints, (None, robot.dof))
    if len(points) < 2:
        raise InputError(f"waypoints: expected two or more, got {len(points)}", count=len(points))
    # Paths of other planners have angles of continuous joints in (-pi, pi].
    points = np.where(robot.continuous, np.unwrap(points, axis=0), points)
    robot = robot.about(points[0])
    points = np.array([robot.check_configuration(q, f"waypoint {number + 1}") for number, q in enumerate(points)])
    kept = [0]
    for number in range(1, len(points)):
        if np.abs(points[number] - points[kept[-1]]).max() > SAME:
            kept.append(number)
    if len(kept) < 2:
        raise InputError(f"waypoints: all {len(points)} are the same; there is no motion to make", count=len(points))
    return GivenPath(frozen(points[kept]), frozen(np.array(kept, dtype=np.int64) + 1), len(points))


def scene_along(robot: Robot, scene: Scene, path: GivenPath) -> Scene:
    """The scene with the ends of a path as start and goal.

    The same scene if they are its own.

    Args:
        scene: The obstacles; a fruit that is its goal is an obstacle like all others.

    Raises:
        InputError: A locked joint moves along the path, or the scene's start is in motion.
        MovingObstacleError: The scene has a moving obstacle or a moving base.
    """
    if scene.moves:
        raise MovingObstacleError(scene.first_moving)
    if scene.start.is_moving:
        raise InputError("the scene's start is in motion, but the motion along a given path begins at rest")
    for joint in np.flatnonzero(robot.locked_mask(scene.locked_joints)).tolist():
        off = np.abs(path.points[:, joint] - path.points[0, joint])
        if off.max() > SAME:
            number, name = int(path.numbers[int((off > SAME).argmax())]), robot.joint_names[joint]
            raise InputError(
                f"waypoint {number}: joint {name!r} is locked, but moves by {off.max():.6g} rad along the path",
                joint=name,
                waypoint=number,
            )
    own = robot.joints_of(scene.start, "start"), robot.joints_of(scene.goal, "goal", scene.start)
    ends = zip(own, path.points[[0, -1]], strict=True)
    if all(own is not None and own.shape == end.shape and np.abs(own - end).max() <= SAME for own, end in ends):
        return scene
    start, goal = (tuple(path.points[end].tolist()) for end in (0, -1))
    ends_of_path = {"start": Start(joints_rad=start), "goal": Goal(joints_rad=goal)}
    return with_fixed_axis(robot, scene).copy_unchecked(ends_of_path)


#: Maximum displacement of any point of the arm between two sampled configurations [m], and the maximum number of steps.
STEP_M, MOST_STEPS = 2e-3, 4000

#: Number of valleys, and of other configurations with too little clearance, that coal checks on each motion.
_VALLEYS, _SPREAD = 12, 48


class Place(NamedTuple):
    """A place on a path in contact or with too little clearance.

    Attributes:
        number: Number of the waypoint, or of the first waypoint of the motion, from 0.
        fraction: Fraction of the motion before the place; 0 at a waypoint.
        at_waypoint: True if the waypoint itself is the place.
        error: Link, obstacle, depth and required clearance.
    """

    number: int
    fraction: float
    at_waypoint: bool
    error: ConfigurationInCollisionError

    @property
    def touches(self) -> bool:
        """True if the bodies touch; False if they are only too close."""
        return self.error.depth_m >= self.error.clearance_m


def places_of(world: World, path: GivenPath, margin: float) -> Iterator[Place]:
    """The places of a path in contact or too close, in order.

    They are waypoints, and places on motions between clear waypoints.

    Args:
        margin: Clearance beyond the required one for motions to be verified collision-free [m].
    """
    points = path.points
    low = np.flatnonzero(world.field.spare_clearances(points) < margin).tolist()
    near = {number: _check_with_coal(world, points[number]) for number in low}
    for number in range(len(points)):
        error = near.get(number)
        if error is not None:
            yield Place(number, 0.0, True, error)
        ends = points[number : number + 2]
        free = error is None and near.get(number + 1) is None
        if len(ends) == 2 and free and not world.field.is_clear(ends, margin):
            place = _deepest_contact(world, ends, number)
            if place is not None:
                yield place


def refuse(path: GivenPath, places: list[Place]) -> PathInContactError:
    """The error that names one or more places of a path."""
    facts = [_contact_facts(path, place) for place in places]
    first, fact = places[0], facts[0]
    if first.at_waypoint:
        where = f"waypoint {fact['waypoint']}"
    else:
        after = int(path.numbers[first.number + 1])
        where = f"at {100.0 * first.fraction:.1f} % between waypoints {fact['segment']} and {after}, the path"
    more = f"; {len(places) - 1} more such places follow" if len(places) > 1 else ""
    words = first.error.message.removeprefix(first.error.which).lstrip()
    return PathInContactError(f"{where} {words}{more}", facts)


def _contact_facts(path: GivenPath, place: Place) -> dict[str, object]:
    number, error = int(path.numbers[place.number]), place.error
    return {
        "waypoint": number if place.at_waypoint else None,
        # With repeated waypoints the motion starts at the last of them.
        "segment": None if place.at_waypoint else int(path.numbers[place.number + 1]) - 1,
        "fraction": place.fraction,
        "link": error.link,
        "obstacle": error.obstacle,
        "depth_m": error.depth_m,
        "clearance_m": error.clearance_m,
        "touches": place.touches,
    }


def _check_with_coal(world: World, q: FloatArray) -> ConfigurationInCollisionError | None:
    """Check a configuration with coal: the error, or None if clear."""
    try:
        world.check_clear(q, "it")
    except ConfigurationInCollisionError as error:
        return error.with_traceback(None)
    return None


def _deepest_contact(world: World, ends: FloatArray, number: int) -> Place | None:
    """The deepest contact found between two clear waypoints, or None."""
    first, step = ends[0], ends[1] - ends[0]
    travel = float((reach(world.robot) @ np.abs(step)).max(initial=0.0))
    count = int(min(max(2, math.ceil(travel / STEP_M)), MOST_STEPS))
    fractions = np.linspace(0.0, 1.0, count + 1)
    clearances = world.field.spare_clearances(first + fractions[:, None] * step)
    deepest: tuple[float, ConfigurationInCollisionError] | None = None

    def look_at(fraction: float) -> None:
        nonlocal deepest
        error = _check_with_coal(world, first + fraction * step)
        if error is not None and (deepest is None or _excess_indices(error) > _excess_indices(deepest[1])):
            deepest = fraction, error

    for at in _indices_to_check(clearances).tolist():
        look_at(float(fractions[at]))
    if deepest is None:
        valley = int(ties.argmin(clearances))
        centre = float(fractions[valley])
    else:
        centre = deepest[0]
    width = 1.0 / count
    # Bisection around the nearest configuration.
    for _ in range(12):
        width *= 0.5
        tried = np.clip([centre - width, centre, centre + width], 0.0, 1.0)
        if deepest is None:
            centre = float(tried[ties.argmin(world.field.spare_clearances(first + tried[:, None] * step))])
            look_at(centre)
        else:
            for fraction in (tried[0], tried[2]):
                look_at(float(fraction))
            centre = deepest[0]
    return None if deepest is None else Place(number, deepest[0], False, deepest[1])


def _excess_indices(error: ConfigurationInCollisionError) -> float:
    return error.depth_m - error.clearance_m


def _indices_to_check(clearances: FloatArray) -> IntArray:
    """Indices of the configurations along a motion that coal checks.

    They are the lowest valleys, and evenly spread ones of those without clearance.
    """
    padded = np.concatenate([[math.inf], clearances, [math.inf]])
    valleys = np.flatnonzero((clearances <= padded[:-2]) & (clearances <= padded[2:]))
    lowest = valleys[np.argsort(clearances[valleys], kind="stable")[:_VALLEYS]]
    low = np.flatnonzero(clearances <= 0.0)
    spread = low[np.unique(np.linspace(0, len(low) - 1, min(_SPREAD, len(low))).astype(np.int64))] if len(low) else low
    return np.unique(np.concatenate([lowest, spread]))
