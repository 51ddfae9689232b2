"""One motion from configuration to configuration: route, smooth path, timing, certificate, tried until all hold.

Where the base turns and the straight motion is clear, that is the motion. Else a roadmap looks for a quick path by a
few configurations; unless what comes of it is close to the fastest motion that there could be, grids are tried in turn,
from coarse and near to fine and wide, and the quicker motion is taken.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TypeVar

import numpy as np

from hplan.base.arrays import FloatArray, frozen
from hplan.errors import CertificationError, HplanError, NoPathError, OptionError, TimingError
from hplan.planning.certified_motion import PlannedMotion, certificate_of, required, smooth_and_certify
from hplan.planning.enclosure import EnclosedError, enclosed_goals
from hplan.planning.grid_route import find_route
from hplan.planning.refusals import Refusals
from hplan.planning.roadmap import BRIEF, WIDE, Effort, quick_path
from hplan.planning.task import GridAttempt, PlanningTask
from hplan.robot.limits import least_duration as least_between
from hplan.smoothing.repair import repaired
from hplan.timing.retime import resting

_NoPath = TypeVar("_NoPath", bound=NoPathError)

#: Nodes are not motions: where the grid path's motions cannot be shown clear, the search is repeated with obstacles
#: grown by these [m].
GROWTH = (0.0, 2e-3, 5e-3, 0.01, 0.02, 0.04)

#: Where that does not help either, grids with these multiples of the step are tried.
STEP_FACTORS = (1.0, 0.5)

#: Grids where the base turns, tried in turn. What is closed on the grid of the finest step for all yaws is closed.
YAW_GRID_ATTEMPTS = (
    GridAttempt(2.0, 4.0, 0.0, False),
    GridAttempt(2.0, 4.0, 0.0, True),
    GridAttempt(2.0, 45.0, 0.0, False),
    GridAttempt(2.0, 45.0, 0.0, True),
    GridAttempt(2.0, 360.0, 0.0, False),
    GridAttempt(1.0, 45.0, 0.0, False),
    GridAttempt(1.0, 45.0, 0.0, True),
    GridAttempt(1.0, 360.0, 0.0, False),
    GridAttempt(1.0, 45.0, 5e-3, True),
    GridAttempt(1.0, 45.0, 0.02, False),
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

#: A path in a roadmap is reckoned with its corners, and so may take this much longer than the motion along it [s].
CORNERS_S = 0.3

#: A route is searched to a goal that promises to be reached in less than this fraction of a straight motion's time.
WORTHWHILE = 0.7


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
    for number, task in enumerate(tasks):
        if task.problem.is_empty:
            return number, _at_rest(task)
    if not tasks[0].problem.turns:
        return _first_planar(tasks)
    straight = _first(tasks, _straight)
    if straight is None:
        return _roadmap_or_grids(tasks)
    number, motion = straight
    enough = WORTHWHILE * motion.trajectory.duration
    better = next((other for other in range(number) if least_duration(tasks[other]) < enough), None)
    if better is not None:
        detour = _second_look(tasks[better : better + 1], YAW_GRID_ATTEMPTS[:1])
        if detour is not None and detour[1].trajectory.duration < motion.trajectory.duration:
            return better, detour[1]
    return straight


def without_path(tasks: Sequence[PlanningTask]) -> list[NoPathError | None]:
    """Goals to which no path exists on the finest grid, decided for all at once.

    Args:
        tasks: One for each goal, from the same start among the same obstacles.

    Returns:
        For each goal the error that says so; None where a path exists, or where that is left open.
    """
    errors: list[NoPathError | None] = [None] * len(tasks)
    todo = list(range(len(tasks)))
    while todo:
        yaw = tasks[todo[0]].problem.goal[0]
        left = [number for number in todo if abs(tasks[number].problem.goal[0] - yaw) < SAME_YAW]
        todo = [number for number in todo if number not in left]
        for yaw_range_deg in WIDTHS:
            try:
                found = _enclosed([tasks[number] for number in left], GridAttempt(yaw_range_deg=yaw_range_deg))
            except OptionError:  # no such grid
                break
            shown = {number: error for number, error in zip(left, found, strict=True) if error is not None}
            left = [number for number, error in shown.items() if error.open_ended]
            for number in shown.keys() - left:
                errors[number] = shown[number]
    return errors


def reuse_motion(task: PlanningTask, before: PlannedMotion) -> PlannedMotion | None:
    """A motion for the task of an earlier one among obstacles that have changed since.

    Returns:
        The earlier motion itself where it can still be certified, and is straight or still has to avoid something; else
        a motion along its waypoints, repaired. None where neither can be had, or start, goal or joint limits are
        others.
    """
    old, new = before.task.problem, task.problem
    if any((getattr(old, name) != getattr(new, name)).any() for name in ("start", "goal", "lower", "upper")):
        return None
    if before.path is None or (_straight_is_clear(task) and len(before.waypoints) > 2):
        return None  # it would be a detour
    certificate = certificate_of(task, before.trajectory)
    if certificate.verified:
        return replace(before, task=task, route=None, certificate=certificate, origin="kept")
    margin = task.margin()
    clear, contacts = repaired(before.waypoints, task.field, new.lower, new.upper, 0.1 * margin)
    with suppress(CertificationError, TimingError):
        return None if contacts else smooth_and_certify(task, clear, margin, "mended")
    return None


def least_duration(task: PlanningTask) -> float:
    """Duration that no motion between start and goal can undercut [s]."""
    problem, robot = task.problem, task.robot
    return least_between(problem.start, problem.goal, robot.velocity_limit, robot.acceleration_limit)


def _at_rest(task: PlanningTask) -> PlannedMotion:
    """The motion from a configuration to itself."""
    start = task.problem.start
    rest = resting(task.robot.model, start)
    certificate = required(task, certificate_of(task, rest))
    return PlannedMotion(task, None, frozen(np.array(start[None])), None, rest, certificate, "none")


def _first(
    tasks: Sequence[PlanningTask], find: Callable[[PlanningTask], PlannedMotion | None]
) -> tuple[int, PlannedMotion] | None:
    """The first goal to which a motion is found, and the motion."""
    found = ((number, find(task)) for number, task in enumerate(tasks))
    return next(((number, motion) for number, motion in found if motion is not None), None)


def _straight_is_clear(task: PlanningTask) -> bool:
    return task.field.is_clear(np.stack([task.problem.start, task.problem.goal]), task.margin())


def _straight(task: PlanningTask) -> PlannedMotion | None:
    """The straight motion, without a search; None where it is not clear or cannot be certified."""
    if _straight_is_clear(task):
        with suppress(CertificationError):  # a route may lead to a motion that can be certified
            waypoints = frozen(np.stack([task.problem.start, task.problem.goal]))
            return smooth_and_certify(task, waypoints, task.margin(), "direct")
    return None


def _by_roadmap(
    task: PlanningTask, effort: Effort = BRIEF, *, quicker_than_s: float = math.inf
) -> PlannedMotion | None:
    """The motion along a quick path, or None where there is none, or none that can be timed and certified."""
    if task.options.objective != "duration" or task.options.method != "two-level":
        return None  # a short path is wanted, not a quick one, or a certain search
    margin, velocity = task.margin(), task.robot.velocity_limit
    with task.stage("roadmap"):
        waypoints = quick_path(task.problem, task.field, velocity, 0.1 * margin, effort, quicker_than_s=quicker_than_s)
    if waypoints is not None:
        with suppress(CertificationError, TimingError):
            return smooth_and_certify(task, waypoints, margin, "roadmap")
    return None


def _on_grid(task: PlanningTask, attempt: GridAttempt) -> PlannedMotion:
    """One pass on one grid."""
    margin = task.margin(attempt.growth_m)
    route = find_route(task, attempt, 0.1 * margin)
    return smooth_and_certify(task, route.path, margin, "search", route)


def _planar(task: PlanningTask) -> PlannedMotion:
    """Try finer grids and larger obstacles in turn until a motion is certified."""
    refused: CertificationError | None = None
    for step_factor in STEP_FACTORS:
        for growth_m in sorted({task.grown(growth_m) for growth_m in GROWTH}):
            try:
                return _on_grid(task, GridAttempt(step_factor, growth_m=growth_m))
            except CertificationError as error:
                refused = refused or error.with_traceback(None)
            except NoPathError:
                if refused is None:
                    raise
                break  # grown obstacles close the passage; the motion found without them could not be certified
    raise refused or CertificationError("no motion could be certified")


def _roadmap_or_grids(tasks: Sequence[PlanningTask]) -> tuple[int, PlannedMotion] | Refusals:
    """The quicker of a motion found in a roadmap and one found on grids."""
    quick = _first(tasks[:ROADMAPS], _by_roadmap)
    if quick is None:
        found = _first_turning(tasks, YAW_GRID_ATTEMPTS)
        if isinstance(found, Refusals):
            return found
        number, motion = found
        if number >= ROADMAPS or _is_close(motion):
            return found
        other = _by_roadmap(tasks[number], WIDE, quicker_than_s=motion.trajectory.duration + CORNERS_S)
        return number, motion if other is None else _quicker(motion, other)
    if _is_close(quick[1]):
        return quick
    detour = _second_look(tasks, YAW_GRID_ATTEMPTS[:SECOND_LOOKS])
    return quick if detour is None or _quicker(quick[1], detour[1]) is quick[1] else detour


def _is_close(motion: PlannedMotion) -> bool:
    """True if there cannot be a much quicker one."""
    return motion.trajectory.duration <= CLOSE * least_duration(motion.task)


def _quicker(first: PlannedMotion, second: PlannedMotion) -> PlannedMotion:
    """The one that takes less time; the first of two that take the same."""
    return first if first.trajectory.duration <= second.trajectory.duration else second


def _second_look(tasks: Sequence[PlanningTask], attempts: Sequence[GridAttempt]) -> tuple[int, PlannedMotion] | None:
    """A motion over grids where there is another already; None where there is none, or no such grid."""
    with suppress(OptionError):
        found = _first_turning(tasks, attempts)
        return None if isinstance(found, Refusals) else found
    return None


def _first_planar(tasks: Sequence[PlanningTask]) -> tuple[int, PlannedMotion] | Refusals:
    """The first goal that grids lead to, the base locked."""
    refused: dict[int, HplanError] = {}
    for number, task in enumerate(tasks):
        if number in refused:
            continue
        try:
            return number, _planar(task)
        except (CertificationError, TimingError) as error:
            refused[number] = error.with_traceback(None)
        except NoPathError as error:
            refused[number] = _kept(error, number)
            rest = [other for other in range(number + 1, len(tasks)) if other not in refused]
            shown = without_path([tasks[other] for other in rest])
            refused |= {other: error for other, error in zip(rest, shown, strict=True) if error is not None}
    return Refusals(tuple(refused[number] for number in range(len(tasks))))


def _first_turning(
    tasks: Sequence[PlanningTask], attempts: Sequence[GridAttempt]
) -> tuple[int, PlannedMotion] | Refusals:
    """The first goal that grids lead to, coarse and near ones first, the base turning.

    What is closed on the finest grid, whatever the yaw, is closed.
    """
    refused: dict[int, HplanError] = {}
    closed: dict[tuple[int, float], tuple[float, EnclosedError]] = {}  # by goal and step: up to which range of yaws
    slow: tuple[int, PlannedMotion] | None = None

    def may_be_open(number: int, attempt: GridAttempt) -> bool:
        range_deg, error = closed.get((number, attempt.step_factor), (0.0, None))
        return error is None or (error.open_ended and attempt.yaw_range_deg > range_deg)

    for attempt in attempts:
        failed: list[FloatArray] = []  # goals tried on this grid
        for number, task in enumerate(tasks):
            if not may_be_open(number, attempt):
                continue
            goal, pocket = task.problem.goal, math.radians(2.0 * task.step_deg(attempt))
            if attempt.step_factor > 1.0 and any(np.abs(goal - other).max() < pocket for other in failed):
                continue  # most likely in the same pocket; finer grids leave none out
            failed.append(goal)
            try:
                motion = _on_grid(task, replace(attempt, growth_m=task.grown(attempt.growth_m)))
                if motion.trajectory.duration <= SLUGGISH * max(least_duration(task), SHORT):
                    return number, motion
                if slow is None or motion.trajectory.duration < slow[1].trajectory.duration:
                    slow = number, motion
            except (CertificationError, TimingError) as error:
                refused.setdefault(number, error.with_traceback(None))
            except EnclosedError as error:
                if attempt.thick or attempt.growth_m > 0.0:
                    continue
                closed[number, attempt.step_factor] = attempt.yaw_range_deg, _kept(error, number)
                # The same grid may show it of others.
                rest = [
                    other
                    for other in range(number + 1, len(tasks))
                    if abs(tasks[other].problem.goal[0] - goal[0]) < SAME_YAW and may_be_open(other, attempt)
                ]
                for other, shown in zip(rest, _enclosed([tasks[k] for k in rest], attempt), strict=True):
                    if shown is not None:
                        closed[other, attempt.step_factor] = attempt.yaw_range_deg, shown
    if slow is not None:
        return slow
    none = CertificationError("no motion could be certified")
    no_path = {
        number: error for (number, factor), (_, error) in closed.items() if factor == 1.0 and not error.open_ended
    }
    return Refusals(tuple(no_path.get(number, refused.get(number, none)) for number in range(len(tasks))))


def _enclosed(tasks: Sequence[PlanningTask], attempt: GridAttempt) -> list[EnclosedError | None]:
    """Goals that the start is not connected to on one grid."""
    return enclosed_goals(tasks, attempt, [0.1 * task.margin() for task in tasks])


def _kept(error: _NoPath, number: int) -> _NoPath:
    """An error of a goal without what keeps grids in memory: its traceback and, but for the first, its region."""
    if isinstance(error, EnclosedError) and number > 0:
        error.forget_region()
    return error.with_traceback(None)
