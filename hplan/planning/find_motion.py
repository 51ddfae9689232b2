"""One motion from configuration to configuration: route, smooth path, timing, certificate, tried until all hold.

Where the base turns and the straight motion is clear, that is the motion. Else a pair of trees looks for a path; unless
what comes of it is close to the fastest motion that there could be, several pairs of trees look for others, and the
quickest motion is taken. Where trees find none, a flood of a grid over all yaws may show that there is none. Where the
base is locked, grids are searched, from the step that is asked for to finer ones. Grids have as many nodes as fit a
memory and a time, whatever the joint ranges: their step is made larger where it has to be.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TypeVar

import numpy as np

from hplan.base.arrays import frozen
from hplan.errors import CertificationError, HplanError, NoPathError, NotFoundError, TimingError
from hplan.optimization.repair import repaired
from hplan.planning.certified_motion import PlannedMotion, certificate_of, required, smooth_and_certify
from hplan.planning.grid_route import find_route
from hplan.planning.refusals import EnclosedError, Refusals, enclosed_goals
from hplan.planning.sampled_motion import (
    by_sampling,
    by_trees_to_any,
    least_duration,
    rivals,
    trees_tried,
)
from hplan.planning.task import COARSEST_DEG, GridAttempt, PlanningTask
from hplan.trajectory.retime import resting

_NoPath = TypeVar("_NoPath", bound=NoPathError)

#: Nodes are not motions: where the grid path's motions cannot be shown clear, the search is repeated with obstacles
#: grown by these [m].
GROWTH = (0.0, 2e-3, 5e-3, 0.01, 0.02, 0.04)

#: Where that does not help either, grids with these multiples of the step are tried.
STEP_FACTORS = (1.0, 0.5)

#: So far the base may turn beyond start and goal where many goals are decided at once, tried in turn [deg].
WIDTHS = (45.0, 360.0)

#: Most nodes of a grid.
MOST_CELLS = 1e8

#: A planar grid with more nodes is searched only after trees.
LARGE_PLANAR = 2e6

#: Goals at yaws that differ by less than this have the same grid.
SAME_YAW = 1e-9

#: So many goals are looked for by sampling, and so many are compared with the effort `best`.
SAMPLED, COMPARED = 2, 6

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
        NotFoundError: None was found within memory and effort, and it was not shown that there is none.
    """
    found = first_motion(tasks)
    if isinstance(found, Refusals):
        raise found.error()
    return found


def first_motion(tasks: Sequence[PlanningTask]) -> tuple[int, PlannedMotion] | Refusals:
    """As `find_motion`; where there is none, why there is none to each of the goals."""
    found = _first_motion(tasks)
    if tasks[0].options.effort != "best" or isinstance(found, Refusals):
        return found
    # More starts need not lead to all that fewer lead to.
    known = _first_motion([replace(task, options=replace(task.options, effort="default")) for task in tasks])
    if isinstance(known, Refusals) or known[1].trajectory.duration >= found[1].trajectory.duration:
        return found
    return known[0], replace(known[1], task=tasks[known[0]])


def _first_motion(tasks: Sequence[PlanningTask]) -> tuple[int, PlannedMotion] | Refusals:
    """The same with one effort."""
    for number, task in enumerate(tasks):
        if task.problem.is_empty:
            return number, _at_rest(task)
    if tasks[0].problem.turns:
        return _first_over_yaws(tasks)
    if tasks[0].cells(GridAttempt()) > LARGE_PLANAR:
        # Trees take a fraction of the time, and their paths are shorter than those that a flood of the grid finds.
        return _sampled(tasks) or by_trees_to_any(tasks) or _first_planar(tasks)
    found = _first_planar(tasks)
    return (by_trees_to_any(tasks) or found) if isinstance(found, Refusals) else found


def _first_over_yaws(tasks: Sequence[PlanningTask]) -> tuple[int, PlannedMotion] | Refusals:
    """The first goal that is reached while the base turns: straight, or the quicker of other motions."""
    direct = first_found(tasks, straight)
    if direct is None:
        return _sampled_or_grids(tasks)
    number, motion = direct
    enough = WORTHWHILE * motion.trajectory.duration
    better = next((other for other in range(number) if least_duration(tasks[other]) < enough), None)
    if better is not None:
        detour = by_sampling(tasks[better])
        if detour is not None and detour.trajectory.duration < motion.trajectory.duration:
            return better, detour
    return direct


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
            attempt = tasks[0].fitting(GridAttempt(yaw_range_deg=yaw_range_deg), MOST_CELLS)
            if attempt is None or not left:
                break
            some = [tasks[number] for number in left]
            found = enclosed_goals(some, attempt, [0.1 * task.margin() for task in some], explained=left[0] == 0)
            shown = {number: error for number, error in zip(left, found, strict=True) if error is not None}
            left = [number for number, error in shown.items() if error.open_ended]
            for number in shown.keys() - left:
                errors[number] = _with_step(shown[number], tasks[number], attempt)
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
    if before.path is None or (straight_is_clear(task) and len(before.waypoints) > 2):
        return None  # it would be a detour
    certificate = certificate_of(task, before.trajectory)
    if certificate.verified:
        return replace(before, task=task, route=None, certificate=certificate, origin="kept")
    margin = task.margin()
    clear, contacts = repaired(before.waypoints, task.field, new.lower, new.upper, 0.1 * margin)
    with suppress(CertificationError, TimingError):
        return None if contacts else smooth_and_certify(task, clear, margin, "mended")
    return None


def _at_rest(task: PlanningTask) -> PlannedMotion:
    """The motion from a configuration to itself."""
    start = task.problem.start
    rest = resting(task.robot.model, start)
    certificate = required(task, certificate_of(task, rest))
    return PlannedMotion(task, None, frozen(np.array(start[None])), None, rest, certificate, "none")


def first_found(
    tasks: Sequence[PlanningTask], find: Callable[[PlanningTask], PlannedMotion | None]
) -> tuple[int, PlannedMotion] | None:
    """The first goal to which a motion is found, and the motion."""
    found = ((number, find(task)) for number, task in enumerate(tasks))
    return next(((number, motion) for number, motion in found if motion is not None), None)


def _sampled(tasks: Sequence[PlanningTask]) -> tuple[int, PlannedMotion] | None:
    """The motion by sampling to the first goal that has one; with the effort `best`, to that which is reached first."""
    if tasks[0].options.effort != "best":
        return first_found(tasks[:SAMPLED], by_sampling)
    best: tuple[int, PlannedMotion] | None = None
    for number, task in enumerate(tasks[:COMPARED]):
        if best is None or least_duration(task) < best[1].trajectory.duration:
            motion = by_sampling(task)
            if motion is not None and (best is None or motion.trajectory.duration < best[1].trajectory.duration):
                best = number, motion
    return best


def straight_is_clear(task: PlanningTask) -> bool:
    """True if the straight motion is verified collision-free."""
    return task.field.is_clear(np.stack([task.problem.start, task.problem.goal]), task.margin())


def straight(task: PlanningTask) -> PlannedMotion | None:
    """The straight motion, without a search; None where it is not clear or cannot be certified."""
    if straight_is_clear(task):
        with suppress(CertificationError):  # a route may lead to a motion that can be certified
            waypoints = frozen(np.stack([task.problem.start, task.problem.goal]))
            return smooth_and_certify(task, waypoints, task.margin(), "direct")
    return None


def _on_grid(task: PlanningTask, attempt: GridAttempt) -> PlannedMotion:
    """One pass on one planar grid; other paths are compared with the one that it has."""
    margin = task.margin(attempt.growth_m)
    route = find_route(task, attempt, 0.1 * margin)
    others = [] if straight_is_clear(task) else rivals(task)
    return smooth_and_certify(task, route.path, margin, "search", route, others)


def _planar(task: PlanningTask) -> PlannedMotion:
    """Try finer grids and larger obstacles in turn until a motion is certified."""
    refused: HplanError | None = None
    tried: list[str] = []
    seen: set[GridAttempt] = set()
    for step_factor in STEP_FACTORS:
        for growth_m in sorted({task.grown(growth_m) for growth_m in GROWTH}):
            attempt = task.fitting(GridAttempt(step_factor, growth_m=growth_m), MOST_CELLS)
            if attempt is None:
                step_deg = max(task.options.step_deg, COARSEST_DEG)
                tried = [f"no grid of {step_deg:g} deg or less has fewer than {MOST_CELLS:.3g} nodes"]
                continue
            if attempt in seen:
                continue  # both steps were too fine, and gave way to the same
            seen.add(attempt)
            try:
                return _on_grid(task, attempt)
            except CertificationError as error:
                refused = refused or error.with_traceback(None)
            except NoPathError as error:
                if refused is None:
                    _with_step(error, task, attempt)
                    raise
                break  # grown obstacles close the passage; the motion found without them could not be certified
    if refused is None and task.options.method == "two-level":
        tried.append(trees_tried(task))
    raise refused or NotFoundError(tried)


def _sampled_or_grids(tasks: Sequence[PlanningTask]) -> tuple[int, PlannedMotion] | Refusals:
    """A motion along a sampled path and, where none is found, one found on grids."""
    found = _sampled(tasks) or by_trees_to_any(tasks)
    if found is None and tasks[0].robot.planar is None:  # no grids
        return Refusals(tuple(NotFoundError([trees_tried(task)]) for task in tasks))
    if found is not None:
        return found
    closed = without_path(tasks)
    return Refusals(tuple(error or _not_found(task) for error, task in zip(closed, tasks, strict=True)))


def _first_planar(tasks: Sequence[PlanningTask]) -> tuple[int, PlannedMotion] | Refusals:
    """The first goal that grids lead to, the base locked."""
    refused: dict[int, HplanError] = {}
    for number, task in enumerate(tasks):
        if number in refused:
            continue
        try:
            return number, _planar(task)
        except (CertificationError, NotFoundError, TimingError) as error:
            refused[number] = error.with_traceback(None)
        except NoPathError as error:
            refused[number] = _kept(error, number)
            rest = [other for other in range(number + 1, len(tasks)) if other not in refused]
            shown = without_path([tasks[other] for other in rest])
            refused |= {other: error for other, error in zip(rest, shown, strict=True) if error is not None}
    return Refusals(tuple(refused[number] for number in range(len(tasks))))


def _not_found(task: PlanningTask) -> NotFoundError:
    """The error that says what was tried for a goal that the base turns to."""
    coarse = task.fitting(GridAttempt(yaw_range_deg=WIDTHS[-1]), MOST_CELLS)
    grid = "no grid over all yaws fits" if coarse is None else f"grids down to {task.step_deg(coarse):g} deg"
    return NotFoundError(["straight motion", trees_tried(task), grid])


def _with_step(error: _NoPath, task: PlanningTask, attempt: GridAttempt) -> _NoPath:
    """An error that names the step of its grid where that is larger than the one asked for."""
    if isinstance(error, EnclosedError) and attempt.step_factor > 1.0:
        error.coarse_step_deg = task.step_deg(attempt)
    return error


def _kept(error: _NoPath, number: int) -> _NoPath:
    """An error of a goal without what keeps grids in memory: its traceback and, but for the first, its region."""
    if isinstance(error, EnclosedError) and number > 0:
        error.forget_region()
    return error.with_traceback(None)
