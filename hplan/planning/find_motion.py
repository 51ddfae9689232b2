"""One motion from configuration to configuration: route, smooth path, timing, certificate, tried until all hold.

Where the base turns and the straight motion is clear, that is the motion. Else a roadmap looks for a quick way by a few
configurations; unless what comes of it is close to the fastest motion that there could be, grids are tried in turn,
from coarse and near to fine and wide, and the quicker motion is taken.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from hplan.base.arrays import FloatArray, Record, frozen
from hplan.errors import CertificationError, HplanError, NoPathError, OptionError, TimingError
from hplan.planning.enclosed_goals import Component, enclosed_goals
from hplan.planning.enclosure import EnclosedError
from hplan.planning.grid_route import GridAttempt, PlanningTask, Route, find_route
from hplan.planning.refusals import Refusals
from hplan.planning.roadmap import BRIEF, WIDE, Effort, quick_path
from hplan.robot.limits import GeometricPath, Limits
from hplan.robot.limits import least_duration as least_between
from hplan.robot.tracking import TrackingModel
from hplan.smoothing.options import PostprocessOptions
from hplan.smoothing.repair import repaired
from hplan.smoothing.smooth_path import fast_path
from hplan.smoothing.spline import SplinePath
from hplan.timing.retime import resting, time_path
from hplan.timing.speed_ceiling import SpeedCeiling, averaging_s
from hplan.timing.trajectory import Trajectory
from hplan.verification.certificate import Certificate, Stretch, certify_among

#: Clearance asked for wherever a motion is evaluated, beyond the scene's own [m]; less where start or goal have less.
MARGIN = 2e-3

#: Nodes are not motions: where the grid path's motions cannot be shown clear, the search is repeated with obstacles
#: grown by these [m].
GROWTH = (0.0, 2e-3, 5e-3, 0.01, 0.02, 0.04)

#: Where that does not help either, grids this many times as fine are tried.
FINER = (1.0, 2.0)

#: Where the base turns: steps of the grid as multiples of the option, how far the base may turn beyond start and goal
#: [deg], growth of obstacles [m], whether layers are thick. What is closed on the grid of the finest step for all yaws
#: is closed.
YAW_GRID_ATTEMPTS = (
    (2.0, 4.0, 0.0, False),
    (2.0, 4.0, 0.0, True),
    (2.0, 45.0, 0.0, False),
    (2.0, 45.0, 0.0, True),
    (2.0, 360.0, 0.0, False),
    (1.0, 45.0, 0.0, False),
    (1.0, 45.0, 0.0, True),
    (1.0, 360.0, 0.0, False),
    (1.0, 45.0, 5e-3, True),
    (1.0, 45.0, 0.02, False),
)

#: So far the base may turn beyond start and goal where many goals are decided at once, tried in turn [deg].
WIDTHS = (45.0, 360.0)

#: Goals at yaws that differ by less than this have the same grid.
SAME_YAW = 1e-9

#: A motion that takes more than this many times the least duration has corners that could only just be rounded. It is
#: taken if no other try gives a faster one.
SLUGGISH = 8.0

#: Where the least duration is shorter, this counts [s].
SHORT = 0.25

#: So many goals are looked for in roadmaps. With a motion that takes no more than this many times the least duration
#: nothing else is looked for; with a slower one only so many grids.
ROADMAPS, CLOSE, SECOND_LOOKS = 2, 1.15, 2

#: A way in a roadmap is reckoned with its corners, and so may take this much longer than the motion along it [s].
CORNERS_S = 0.3

#: A route is searched to a goal that promises to be reached in less than this share of the time of a straight motion.
WORTHWHILE = 0.7


#: Shares of the clearance that sway may take which comes with speed, tried in turn until a motion is certified.
CEILINGS = (0.75, 0.5, 0.2)

#: A motion is empty, straight, along a way found in a roadmap or on a grid, along that of an earlier motion, or an
#: earlier motion.
Origin: TypeAlias = Literal["none", "direct", "roadmap", "search", "mended", "kept"]


@dataclass(frozen=True, eq=False)
class PlannedMotion(Record):
    """A certified motion from configuration to configuration.

    Attributes:
        task: What was asked.
        route: The way over the grid; None where none was needed.
        way: (m, dof) waypoints before post-processing.
        path: The smooth path; None for an empty motion.
        trajectory: The timed motion.
        certificate: What was shown of it.
        origin: Where the way comes from.
    """

    task: PlanningTask
    route: Route | None
    way: FloatArray
    path: SplinePath | None
    trajectory: Trajectory
    certificate: Certificate
    origin: Origin


def find_motion(tasks: Sequence[PlanningTask]) -> tuple[int, PlannedMotion]:
    """A motion to one of several goals.

    Args:
        tasks: One for each goal, from the same start; those that promise the shortest motions first.

    Returns:
        Which of them, and the motion.

    Raises:
        NoPathError: No path exists on the grid to any of them.
        TimingError: The path cannot be timed.
        CertificationError: No motion could be certified.
    """
    found = first_motion(tasks)
    if isinstance(found, Refusals):
        raise found.error()
    return found


def first_motion(tasks: Sequence[PlanningTask]) -> tuple[int, PlannedMotion] | Refusals:
    """As `find_motion`; where there is none, why there is none to each of the goals."""
    attempts = [_Attempts(task) for task in tasks]
    for number, attempt in enumerate(attempts):
        if attempt.task.problem.is_empty:
            return number, attempt.empty()
    if not tasks[0].problem.turns:
        return _first_planar(attempts)
    straight = _straight(attempts)
    if straight is None:
        return _worlds(attempts)
    number, motion = straight
    enough = WORTHWHILE * motion.trajectory.duration
    better = [other for other in range(number) if least_duration(attempts[other].task) < enough]
    if better:
        detour = _second_look(attempts[better[0] : better[0] + 1], YAW_GRID_ATTEMPTS[:1])
        if detour is not None and detour[1].trajectory.duration < motion.trajectory.duration:
            return better[0], detour[1]
    return straight


def without_path(tasks: Sequence[PlanningTask]) -> list[NoPathError | None]:
    """To which of several goals no path exists on the finest grid, decided for all at once.

    Args:
        tasks: One for each goal, from the same start among the same obstacles.

    Returns:
        For each goal the error that says so; None where a path exists, or where that is left open.
    """
    attempts = [_Attempts(task) for task in tasks]
    errors: list[NoPathError | None] = [None] * len(tasks)
    todo = list(range(len(tasks)))
    while todo:
        yaw = tasks[todo[0]].problem.goal[0]
        left = [number for number in todo if abs(tasks[number].problem.goal[0] - yaw) < SAME_YAW]
        todo = [number for number in todo if number not in left]
        for beyond_deg in WIDTHS:
            grid_attempt = GridAttempt(tasks[0].options.step_deg, beyond=math.radians(beyond_deg))
            try:
                shown = dict(zip(left, _enclosed([attempts[number] for number in left], grid_attempt), strict=True))
            except OptionError:  # no such grid
                break
            for number, component in shown.items():
                if component is not None and not component.open_ended:
                    errors[number] = _no_path(component)
            left = [number for number, component in shown.items() if component is not None and component.open_ended]
    return errors


def reuse_motion(task: PlanningTask, before: PlannedMotion) -> PlannedMotion:
    """A motion for the task of an earlier one among obstacles that have changed since.

    The earlier motion itself where it can still be certified, and is straight or still has to go around something;
    else a motion along its way, mended.

    Raises:
        CertificationError: Neither can be had, or start, goal or joint limits are others.
        TimingError: The mended path cannot be timed.
    """
    old, new = before.task.problem, task.problem
    if any((getattr(old, name) != getattr(new, name)).any() for name in ("start", "goal", "lower", "upper")):
        raise CertificationError("the earlier motion was made for another task")
    straight = task.field.is_clear(np.stack([task.problem.start, task.problem.goal]), _Attempts(task).margin(0.0))
    if before.path is None or (straight and len(before.way) > 2):
        raise CertificationError("the earlier motion would be a detour")
    certificate = certified_as_required(task, before.trajectory)
    if certificate.verified:
        return replace(before, task=task, route=None, certificate=certificate, origin="kept")
    return _Attempts(task).along(before.way)


def least_duration(task: PlanningTask) -> float:
    """What no motion between start and goal can undercut [s]."""
    problem, robot = task.problem, task.robot
    return least_between(problem.start, problem.goal, robot.velocity_limit, robot.acceleration_limit)


def timed(task: PlanningTask, path: GeometricPath, share: float = 0.0) -> Trajectory:
    """The fastest motion along a path under the robot's limits.

    Args:
        task: What is asked.
        path: The path.
        share: Share of the clearance that the sway may take which comes with speed; 0 where speed is not to care.

    Raises:
        TimingError: There is none.
    """
    robot, options, delay_s = task.robot, task.options, task.options.tracking.delay_s
    with task.stage("timing"):
        limits = Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit)
        limits = limits.scaled(options.speed)
        if share > 0.0:
            averaged_s = averaging_s(limits, options.rate_hz)
            limits = replace(limits, path_speed=SpeedCeiling(robot, path, task.field, delay_s, share, averaged_s))
        return time_path(path, robot.dynamics, limits, rate_hz=options.rate_hz)


def executable(
    task: PlanningTask, path: GeometricPath, among: Callable[[Trajectory], Sequence[Stretch]] | None = None
) -> tuple[Trajectory, Certificate]:
    """The fastest certified motion along a path.

    Where tracking errors grow with speed, tight places are run slowly, and where that is not enough, more slowly.

    Args:
        task: What was asked.
        path: The path.
        among: What the arm is judged among in a motion along it; the task's surroundings where this is None.

    Raises:
        TimingError: There is none within the limits.
        CertificationError: It is asked for, and something was not shown.
    """
    shares = CEILINGS if task.options.tracking.delay_s > 0.0 else (0.0,)
    for share in shares[:-1]:
        trajectory = timed(task, path, share)
        certificate = certified_as_required(task, trajectory, None if among is None else among(trajectory))
        if certificate.verified:
            return trajectory, certificate
    trajectory = timed(task, path, shares[-1])
    return trajectory, certified(task, trajectory, None if among is None else among(trajectory))


def certified(task: PlanningTask, trajectory: Trajectory, among: Sequence[Stretch] | None = None) -> Certificate:
    """The certificate of a motion.

    Args:
        task: What was asked.
        trajectory: The motion.
        among: What the arm is judged among, stretch by stretch; the task's surroundings where this is None.

    Raises:
        CertificationError: It is asked for, and something was not shown.
    """
    certificate = certified_as_required(task, trajectory, among)
    if task.options.certify and not certificate.verified:
        raise CertificationError(
            f"the motion is not certified: {'; '.join(certificate.violations)}",
            violations=list(certificate.violations),
        )
    return certificate


def certified_as_required(
    task: PlanningTask, trajectory: Trajectory, among: Sequence[Stretch] | None = None
) -> Certificate:
    """The certificate of a motion, whatever it says; arguments as of `certified`."""
    options = task.options
    with task.stage("certificate"):
        return certify_among(
            task.robot,
            trajectory,
            [(slice(0, max(1, trajectory.samples - 1)), task.world.checker)] if among is None else among,
            clearance=task.scene.clearance,
            tracking=TrackingModel(options.tracking_error, options.tracking_delay_s),
        )


def smooth_and_certify(
    task: PlanningTask, route: Route | None, way: FloatArray, margin: float, origin: Origin
) -> PlannedMotion:
    """The certified motion along a polyline.

    Args:
        task: What is asked.
        route: Where the polyline comes from, if from a grid.
        way: (m, dof) the polyline, clear.
        margin: Clearance asked for beyond the one to keep [m].
        origin: Where the polyline comes from.

    Raises:
        CertificationError: There is none, or none can be certified.
        TimingError: It cannot be timed.
    """
    robot, problem, options = task.robot, task.problem, task.options
    with task.stage("postprocess"):
        path = fast_path(
            way,
            task.field,
            PostprocessOptions(
                lower=problem.lower,
                upper=problem.upper,
                velocity=robot.velocity_limit,
                acceleration=robot.acceleration_limit,
                movable=problem.movable,
                margin=margin,
                objective=options.objective,
            ),
        )
    trajectory, certificate = executable(task, path)
    return PlannedMotion(task, route, way, path, trajectory, certificate, origin)


def _straight(attempts: Sequence[_Attempts]) -> tuple[int, PlannedMotion] | None:
    """The first goal with a clear straight motion that can be certified."""
    for number, attempt in enumerate(attempts):
        problem = attempt.task.problem
        if attempt.task.field.is_clear(np.stack([problem.start, problem.goal]), attempt.margin(0.0)):
            try:
                return number, attempt.straight()
            except CertificationError:
                continue  # a route may lead to a motion that can be certified
    return None


def _worlds(attempts: Sequence[_Attempts]) -> tuple[int, PlannedMotion] | Refusals:
    """The quicker of a motion found in a roadmap and one found on grids."""
    quick = _by_roadmap(attempts[:ROADMAPS])
    if quick is None:
        found = _first_turning(attempts, YAW_GRID_ATTEMPTS)
        if isinstance(found, Refusals):
            return found
        number, motion = found
        if number >= ROADMAPS or attempts[number].is_close(motion):
            return number, motion
        other = attempts[number].by_roadmap(WIDE, quicker_than_s=motion.trajectory.duration + CORNERS_S)
        return number, motion if other is None else _quicker(motion, other)
    number, motion = quick
    if attempts[number].is_close(motion):
        return quick
    detour = _second_look(attempts, YAW_GRID_ATTEMPTS[:SECOND_LOOKS])
    return quick if detour is None or _quicker(motion, detour[1]) is motion else detour


def _second_look(
    attempts: Sequence[_Attempts], grid_attempts: Sequence[tuple[float, float, float, bool]]
) -> tuple[int, PlannedMotion] | None:
    """A motion over grids where there is another already; None where there is none, or no such grid."""
    try:
        found = _first_turning(attempts, grid_attempts)
    except OptionError:
        return None
    return None if isinstance(found, Refusals) else found


def _quicker(first: PlannedMotion, second: PlannedMotion) -> PlannedMotion:
    """The one that takes less time; the first of two that take the same."""
    return first if first.trajectory.duration <= second.trajectory.duration else second


def _by_roadmap(attempts: Sequence[_Attempts]) -> tuple[int, PlannedMotion] | None:
    """The first goal with a certified motion along a quick way."""
    for number, attempt in enumerate(attempts):
        motion = attempt.by_roadmap()
        if motion is not None:
            return number, motion
    return None


def _first_planar(attempts: Sequence[_Attempts]) -> tuple[int, PlannedMotion] | Refusals:
    """The first goal that grids lead to, the base locked."""
    refused: dict[int, HplanError] = {}
    for number, attempt in enumerate(attempts):
        if number in refused:
            continue
        try:
            return number, attempt.planar()
        except (CertificationError, TimingError) as error:
            refused[number] = error.with_traceback(None)
        except NoPathError as error:
            refused[number] = _kept(error, number)
            rest = [other for other in range(number + 1, len(attempts)) if other not in refused]
            shown = without_path([attempts[other].task for other in rest])
            refused |= {other: error for other, error in zip(rest, shown, strict=True) if error is not None}
    return Refusals(tuple(refused[number] for number in range(len(attempts))))


def _first_turning(
    attempts: Sequence[_Attempts], grid_attempts: Sequence[tuple[float, float, float, bool]]
) -> tuple[int, PlannedMotion] | Refusals:
    """The first goal that grids lead to, coarse and near ones first, the base turning.

    What is closed on the finest grid, whatever the yaw, is closed.
    """
    refused: dict[int, HplanError] = {}
    closed: dict[tuple[int, float], _Closed] = {}
    slow: tuple[int, PlannedMotion] | None = None
    for coarser, beyond_deg, growth, thick in grid_attempts:
        failed: list[FloatArray] = []  # goals tried on this grid
        for number, attempt in enumerate(attempts):
            if (number, coarser) in closed and not closed[number, coarser].may_open(beyond_deg):
                continue
            goal, near = attempt.task.problem.goal, math.radians(2.0 * coarser * attempt.task.options.step_deg)
            if coarser > 1.0 and any(np.abs(goal - other).max() < near for other in failed):
                continue  # most likely in the same pocket; finer grids leave none out
            failed.append(goal)
            grid_attempt = GridAttempt(
                coarser * attempt.task.options.step_deg, attempt.grown(growth), math.radians(beyond_deg), thick
            )
            try:
                motion = attempt.on_grid(grid_attempt)
                if motion.trajectory.duration <= SLUGGISH * max(least_duration(attempt.task), SHORT):
                    return number, motion
                if slow is None or motion.trajectory.duration < slow[1].trajectory.duration:
                    slow = number, motion
            except (CertificationError, TimingError) as error:
                refused.setdefault(number, error.with_traceback(None))
            except EnclosedError as error:
                if thick or growth > 0.0:
                    continue
                closed[number, coarser] = _Closed(beyond_deg, error.open_ended, _kept(error, number))
                # The same grid may show it of others.
                rest = [
                    other
                    for other in range(number + 1, len(attempts))
                    if abs(attempts[other].task.problem.goal[0] - goal[0]) < SAME_YAW
                    and not ((other, coarser) in closed and not closed[other, coarser].may_open(beyond_deg))
                ]
                for other, component in zip(rest, _enclosed([attempts[k] for k in rest], grid_attempt), strict=True):
                    if component is not None:
                        closed[other, coarser] = _Closed(beyond_deg, component.open_ended, _no_path(component))
    if slow is not None:
        return slow
    shown = {number: one.error for (number, coarser), one in closed.items() if coarser == 1.0 and not one.open_ended}
    none = CertificationError("no motion could be certified")
    return Refusals(tuple(shown.get(number, refused.get(number, none)) for number in range(len(attempts))))


@dataclass(frozen=True, eq=False)
class _Closed:
    """A goal to which no path exists on the grids of one step, up to a range of yaws.

    Attributes:
        beyond_deg: How far the base turned beyond start and goal [deg].
        open_ended: Whether more yaws might open it.
        error: What says so.
    """

    beyond_deg: float
    open_ended: bool
    error: NoPathError

    def may_open(self, beyond_deg: float) -> bool:
        """Whether a path may exist over more yaws."""
        return self.open_ended and beyond_deg > self.beyond_deg


def _enclosed(attempts: Sequence[_Attempts], grid_attempt: GridAttempt) -> list[Component | None]:
    """Which goals the start is not connected to on one grid."""
    if not attempts:
        return []
    return enclosed_goals(
        [attempt.task for attempt in attempts], grid_attempt, [0.1 * each.margin(0.0) for each in attempts]
    )


def _no_path(component: Component) -> NoPathError:
    return NoPathError("no path exists on the grid", reached_cells=component.cells)


def _kept(error: NoPathError, number: int) -> NoPathError:
    """An error of a goal without what keeps grids in memory: its traceback and, but for the first, its explanation."""
    error = error.bare if isinstance(error, EnclosedError) and number > 0 else error
    return error.with_traceback(None)


@dataclass(frozen=True, eq=False)
class _Attempts:
    """All tries at one motion."""

    task: PlanningTask

    def margin(self, growth: float) -> float:
        """Clearance asked for beyond the one to keep [m]: less where start or goal have less."""
        return min(MARGIN + growth, 0.5 * self.task.problem.spare_clearance)

    def grown(self, growth: float) -> float:
        """Growth of obstacles at which start and goal stay free [m]."""
        return min(growth, 0.8 * self.task.problem.spare_clearance)

    def planar(self) -> PlannedMotion:
        """Try finer grids and larger obstacles in turn until a motion is certified."""
        refused: CertificationError | None = None
        for finer in FINER:
            for growth in sorted({self.grown(growth) for growth in GROWTH}):
                try:
                    return self.on_grid(GridAttempt(self.task.options.step_deg / finer, growth))
                except CertificationError as error:
                    refused = refused or error.with_traceback(None)
                except NoPathError:
                    if refused is None:
                        raise
                    break  # grown obstacles close the way; what was found without them could not be certified
        raise refused or CertificationError("no motion could be certified")

    def on_grid(self, grid_attempt: GridAttempt) -> PlannedMotion:
        """One pass on one grid."""
        margin = self.margin(grid_attempt.growth)
        route = find_route(self.task, grid_attempt, 0.1 * margin)
        return smooth_and_certify(self.task, route, route.path, margin, "search")

    def straight(self) -> PlannedMotion:
        """The straight motion, without a search."""
        problem = self.task.problem
        return smooth_and_certify(
            self.task, None, frozen(np.stack([problem.start, problem.goal])), self.margin(0.0), "direct"
        )

    def empty(self) -> PlannedMotion:
        """The motion from a configuration to itself."""
        start = self.task.problem.start
        rest = resting(self.task.robot.model, start)
        return PlannedMotion(
            self.task, None, frozen(np.array(start[None])), None, rest, certified(self.task, rest), "none"
        )

    def is_close(self, motion: PlannedMotion) -> bool:
        """Whether there cannot be a much quicker one."""
        return motion.trajectory.duration <= CLOSE * least_duration(self.task)

    def by_roadmap(self, effort: Effort = BRIEF, *, quicker_than_s: float = math.inf) -> PlannedMotion | None:
        """The motion along a quick way, or None where there is none, or none that can be timed and certified."""
        if self.task.options.objective != "duration" or self.task.options.method != "two-level":
            return None  # a short path is wanted, not a quick one, or a certain search
        margin = self.margin(0.0)
        with self.task.stage("roadmap"):
            way = quick_path(
                self.task.problem, self.task.field, self.task.robot.velocity_limit, 0.1 * margin, effort,
                quicker_than_s=quicker_than_s,
            )  # fmt: skip
        if way is None:
            return None
        try:
            return smooth_and_certify(self.task, None, way, margin, "roadmap")
        except (CertificationError, TimingError):
            return None

    def along(self, way: FloatArray) -> PlannedMotion:
        """The motion along a way that was clear before, mended where it is no longer."""
        margin = self.margin(0.0)
        problem = self.task.problem
        clear, contacts = repaired(way, self.task.field, problem.lower, problem.upper, 0.1 * margin)
        if contacts:
            raise CertificationError("the earlier way cannot be mended")
        return smooth_and_certify(self.task, None, clear, margin, "mended")
