"""Ever quicker certified motions from configuration to configuration, or to one of several.

Where the base turns and the straight motion is clear, that is the motion. Else a pair of trees looks for a path; unless
what comes of it is close to the fastest motion that there could be, several pairs of trees look for others, and the
quickest motion is taken. Where trees find none, a flood of a grid over all yaws may show that there is none. Where the
base is locked, grids are searched, from the step that is asked for to finer ones. Grids have as many nodes as fit a
memory and a time, whatever the joint ranges: their step is made larger where it has to be.

A goal to which a grid has no path is not searched for again: that proof is the error.

Callers take the first motion, the last, or the last before a deadline.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Final, TypeAlias

import numpy as np

from hplan.base.arrays import FloatArray, frozen
from hplan.errors import CertificationError, HplanError, NoPathError, NotFoundError, TimingError
from hplan.optimization.repair import repaired
from hplan.planning.effort import FAR, GridAttempt
from hplan.planning.failures import WIDTHS, EnclosedError, FailuresError, enclosed_goals, without_path
from hplan.planning.grid_route import find_route
from hplan.planning.motion import Polyline, Transit, along, certificate_of, improving, last, quickest, required
from hplan.planning.sampling.rrt_connect import Pairs, TreeEffort, tree_path
from hplan.planning.sampling.several_trees import PromisingPath, TreesEffort, promising_paths
from hplan.planning.task import COARSEST_DEG, MOST_CELLS, PlanningTask
from hplan.trajectory.retime import resting

#: Nodes are not motions: where the grid path's motions cannot be verified, the search is repeated with obstacles
#: grown by these [m], and where that does not help either, on grids with these multiples of the step.
_GROWTH: Final = (0.0, 2e-3, 5e-3, 0.01, 0.02, 0.04)
_STEP_FACTORS: Final = (1.0, 0.5)

#: A planar grid with more nodes is searched only after trees; a coarse one with more than the other is left out.
_LARGE_PLANAR: Final = 2e6
_MOST_COARSE: Final = 5e6

#: A second pair of trees may take so many evaluations, however few the first one took.
_SHORT: Final = 8_000

#: To so many goals trees look for a path one by one, before they do to all at once.
_ONE_BY_ONE: Final = 2

#: The number of a goal, and a motion there.
Found: TypeAlias = tuple[int, Transit]
_Stage: TypeAlias = Callable[[Sequence[PlanningTask]], Iterator[Found]]


def transits(tasks: Sequence[PlanningTask]) -> Iterator[Found]:
    """Ever quicker certified motions to one of several goals, as far as the effort goes.

    Args:
        tasks: One for each goal, from the same start; those that promise the shortest motions first.

    Yields:
        Which of them, and the motion.

    Raises:
        FailuresError: None was found; why not to each of the goals.
        TimingError: A straight motion cannot be timed.
    """
    best_s, failures, left = math.inf, dict[int, HplanError](), list(range(len(tasks)))
    for stage in _stages(tasks):
        try:
            for place, motion in stage([tasks[number] for number in left]):
                if motion.trajectory.duration < best_s:
                    best_s = motion.trajectory.duration
                    yield left[place], motion
        except FailuresError as error:
            failures |= zip(left, error.errors, strict=True)
            left = [number for number in left if not isinstance(failures[number], NoPathError)]
        if math.isfinite(best_s):
            return
        if not left:  # no path leads to any goal: no later stage could find one
            break
    raise FailuresError(tuple(failures[number] for number in sorted(failures)) or tuple(_why_none(tasks)))


def one_transit(tasks: Sequence[PlanningTask]) -> Found:
    """The last of `transits`.

    Raises:
        NoPathError: No path exists on the grid to any of the goals.
        TimingError: The path cannot be timed.
        CertificationError: No motion could be certified.
        NotFoundError: None was found within memory and effort, and it was not shown that there is none.
    """
    try:
        return last(transits(tasks))
    except FailuresError as failures:
        raise failures.as_one() from None


def reused(tasks: Sequence[PlanningTask], before: Transit) -> Transit | None:
    """An earlier motion for one of some tasks, among obstacles that have changed since.

    Returns:
        The earlier motion itself where it can still be certified, and is straight or still has to avoid something; else
        a motion along its waypoints, repaired. None where neither can be had, or start, goal or joint limits are
        others.
    """
    same = ("start", "goal", "lower", "upper")
    old = before.task.problem
    for task in tasks:
        new = task.problem
        if any((getattr(old, name) != getattr(new, name)).any() for name in same):
            continue
        if before.path is None or (straight_is_clear(task) and len(before.waypoints) > 2):
            continue  # it would be a detour
        certificate = certificate_of(task, before.trajectory)
        if certificate.verified:
            return replace(before, task=task, route=None, certificate=certificate, origin="kept")
        margin = task.margin()
        clear, contacts = repaired(before.waypoints, task.field, new.lower, new.upper, 0.1 * margin)
        with suppress(CertificationError, TimingError):
            if not contacts:
                return quickest(task, [Polyline(clear, "mended")], margin)
    return None


def straight_is_clear(task: PlanningTask) -> bool:
    """True if the straight motion is verified collision-free."""
    return task.field.is_clear(_straight(task).waypoints, task.margin())


def _stages(tasks: Sequence[PlanningTask]) -> Sequence[_Stage]:
    """What is tried in turn until a motion is found."""
    first, pairs = tasks[0], Pairs()
    if any(task.problem.is_empty for task in tasks):
        return (_at_rest,)
    if first.effort.at_once:
        return (_at_once,)
    by_trees, by_long_trees = partial(_by_trees, pairs=pairs), partial(_by_long_trees, pairs=pairs)
    if first.problem.turns:
        stages: Sequence[_Stage] = (_along_straight, by_trees, by_long_trees)
    elif first.cells(GridAttempt()) > _LARGE_PLANAR:
        # Trees take a fraction of the time, and their paths are shorter than those that a flood of the grid finds.
        stages = (by_trees, by_long_trees, _on_grids)
    else:
        stages = (_on_grids, by_long_trees)
    return stages if first.effort.long.pairs else [stage for stage in stages if stage is not by_long_trees]


def _at_rest(tasks: Sequence[PlanningTask]) -> Iterator[Found]:
    """The motion from a configuration to itself."""
    number, task = next((number, task) for number, task in enumerate(tasks) if task.problem.is_empty)
    start = task.problem.start
    rest = resting(task.robot.model, start)
    certificate = required(task, certificate_of(task, rest))
    yield number, Transit("transit", rest, certificate, task, frozen(np.array(start[None])), None, "none")


def _at_once(tasks: Sequence[PlanningTask]) -> Iterator[Found]:
    """Motions near the first path that leads to any: straight, or of trees to whichever goal."""
    for number, polyline in _first_paths(tasks):
        with suppress(CertificationError, TimingError):
            first = along(tasks[number], polyline, tasks[number].margin())
            yield from ((number, motion) for motion in improving(first))
            return


def _first_paths(tasks: Sequence[PlanningTask]) -> Iterator[tuple[int, Polyline]]:
    """Straight paths, then paths of trees.

    Raises:
        FailuresError: A planar grid has no path to any goal; its flood takes less time than the trees.
    """
    yield from enumerate(map(_straight, tasks))
    trees, left = tasks[0].effort.trees, list(range(len(tasks)))
    if not tasks[0].problem.turns:
        trees = replace(trees, pairs=2, each=1_500)  # narrow passages are found on grids
        left = _not_enclosed(tasks)
    for seed in range(trees.seed, trees.seed + trees.pairs):
        reached, _ = _tree_to_any([tasks[number] for number in left], TreeEffort(trees.each, seed))
        if reached is not None:
            place, polyline = reached
            yield left[place], polyline


def _not_enclosed(tasks: Sequence[PlanningTask]) -> list[int]:
    """Numbers of the goals to which a path on the planar grid may exist.

    Raises:
        FailuresError: The grid has no path to any goal.
    """
    attempt = GridAttempt()
    if tasks[0].cells(attempt) > _LARGE_PLANAR:
        return list(range(len(tasks)))
    errors = enclosed_goals(tasks, attempt, [0.1 * task.margin() for task in tasks], explained=True)
    proved = tuple(error for error in errors if error is not None)
    if len(proved) == len(tasks):
        raise FailuresError(proved)
    return [number for number, error in enumerate(errors) if error is None]


def _straight(task: PlanningTask) -> Polyline:
    return Polyline(frozen(np.stack([task.problem.start, task.problem.goal])), "direct")


def _along_straight(tasks: Sequence[PlanningTask]) -> Iterator[Found]:
    """The straight motion to the first goal that has a clear one, and those to one that may be reached much sooner."""
    # A route is searched to a goal that promises to be reached in less than this fraction of a straight motion's time.
    worthwhile = 0.7
    for number, task in enumerate(tasks):
        if not straight_is_clear(task):
            continue
        try:
            direct = quickest(task, [_straight(task)], task.margin())
        except CertificationError:
            continue  # a route may lead to a motion that can be certified
        yield number, direct
        enough = worthwhile * direct.trajectory.duration
        better = next((other for other in range(number) if tasks[other].least_duration < enough), None)
        if better is not None:
            yield from ((better, motion) for motion in _near_trees(tasks[better]))
        return


def _by_trees(tasks: Sequence[PlanningTask], pairs: Pairs) -> Iterator[Found]:
    """Motions along sampled paths to the first goal that has any, or to several that may be reached sooner."""
    compared, best_s = tasks[0].effort.compared, math.inf
    for number, task in enumerate(tasks[: max(_ONE_BY_ONE, compared)]):
        if math.isfinite(best_s) and (compared == 1 or task.least_duration >= best_s):
            continue
        for motion in _near_trees(task, pairs):
            best_s = min(best_s, motion.trajectory.duration)
            yield number, motion


def _near_trees(task: PlanningTask, pairs: Pairs | None = None) -> Iterator[Transit]:
    """The motion along the path of one pair of trees, then the quickest along many paths."""
    effort = task.effort
    first = first_paths(task, pairs)
    known = near_paths(task, first)
    if known is not None:
        yield known
        if known.trajectory.duration <= effort.close * task.least_duration:
            return
    found = _tree_paths(task, effort.trees, first, 1, pairs)
    if known is not None:  # along the first
        found = [path for path in found if path is not first[0]]
    known_s = math.inf if known is None else known.trajectory.duration
    other = _quickest(task, [*_coarse_grids(task), *_polylines(found)], known_s)
    if other is not None:
        yield other


def first_paths(task: PlanningTask, pairs: Pairs | None = None) -> list[PromisingPath]:
    """The path that one pair of trees finds, if it finds one; `pairs` as `tree_path` takes them."""
    return _tree_paths(task, replace(task.effort.trees, pairs=1), pairs=pairs)


def near_paths(task: PlanningTask, paths: Sequence[PromisingPath]) -> Transit | None:
    """The quickest certified motion near some paths of trees, if there are any; None where there is none."""
    return _quickest(task, _polylines(paths))


def _quickest(task: PlanningTask, polylines: Sequence[Polyline], quicker_than_s: float = math.inf) -> Transit | None:
    """The quickest motion near some polylines, if there are any; None where there is none."""
    with suppress(CertificationError, TimingError):
        return quickest(task, polylines, task.margin(), quicker_than_s=quicker_than_s) if polylines else None
    return None


def _tree_paths(
    task: PlanningTask,
    effort: TreesEffort,
    known: Sequence[PromisingPath] = (),
    grown: int = 0,
    pairs: Pairs | None = None,
) -> list[PromisingPath]:
    """The paths of several pairs of trees, with those that so many of them have found already, the best first."""
    if not _may_sample(task):
        return []
    margin, velocity = 0.1 * task.margin(), task.robot.velocity_limit
    with task.stage("trees"):
        return promising_paths(task.problem, task.field, velocity, margin, effort, known, grown, pairs)


def _polylines(paths: Sequence[PromisingPath]) -> list[Polyline]:
    """The paths of trees as they were found: shortened ones touch the margin, and leave smoothing no room."""
    return [Polyline(path.waypoints, "trees") for path in paths]


def _coarse_grids(task: PlanningTask) -> list[Polyline]:
    """The shortest path on each of some planar grids that has one."""
    found: list[Polyline] = []
    for attempt in task.effort.grids if _may_sample(task) and not task.problem.turns else ():
        if task.cells(attempt) <= _MOST_COARSE:
            with suppress(NoPathError):
                grown = replace(attempt, growth_m=task.grown(attempt.growth_m))
                found.append(Polyline(find_route(task, grown, 0.1 * task.margin()).path, "search"))
    return found


def _may_sample(task: PlanningTask) -> bool:
    """False where the options ask for a certain search: `dense`, of the planar grid."""
    return task.problem.turns or task.options.method == "two-level"


def _by_long_trees(tasks: Sequence[PlanningTask], pairs: Pairs) -> Iterator[Found]:
    """A motion to whichever goal trees with more effort reach."""
    if not _may_sample(tasks[0]):
        return
    found: dict[int, list[FloatArray]] = {}
    at_once = tasks[0].robot.planar is None  # another path takes as long again
    long = _long_trees(tasks[0])
    each, known_s = long.each, math.inf
    for seed in range(long.seed, long.seed + long.pairs):
        reached, evaluations = _tree_to_any(tasks, TreeEffort(each, seed), pairs)
        if reached is None:
            continue
        number, polyline = reached
        found.setdefault(number, []).append(polyline.waypoints)
        motion = _quickest(tasks[number], [polyline], known_s) if at_once else None
        if motion is not None:
            yield number, motion
            known_s = motion.trajectory.duration
            if known_s <= FAR * tasks[number].least_duration:
                return
            # A second pair that takes about as long as this one did.
            each = min(each, max(_SHORT, 3 * evaluations // 2))
    if math.isfinite(known_s):
        return
    for number, paths in found.items():
        motion = _quickest(tasks[number], [Polyline(path, "trees") for path in paths])
        if motion is not None:
            yield number, motion
            return


def _long_trees(task: PlanningTask) -> TreesEffort:
    """The trees before goals are refused; half of them among clouds, which take up to four times as long."""
    long = task.effort.long
    return replace(long, each=long.each // 2) if any(solid.is_point_set for solid in task.world.solids) else long


def _tree_to_any(
    tasks: Sequence[PlanningTask], effort: TreeEffort, pairs: Pairs | None = None
) -> tuple[tuple[int, Polyline] | None, int]:
    """Which goal a pair of trees reaches and the path as found, None where they reach none; and its evaluations."""
    goals, first = np.array([task.problem.goal for task in tasks]), tasks[0]
    margin = 0.1 * min(task.margin() for task in tasks)
    with first.stage("trees"):
        velocity = first.robot.velocity_limit
        path, evaluations = tree_path(first.problem, first.field, velocity, margin, effort, goals=goals, pairs=pairs)
    if path is None:
        return None, evaluations
    return (int((goals == path[-1]).all(axis=1).argmax()), Polyline(path, "trees")), evaluations


def _on_grids(tasks: Sequence[PlanningTask]) -> Iterator[Found]:
    """The motion to the first goal that planar grids lead to, the base locked.

    Raises:
        FailuresError: They lead to none.
    """
    failures: dict[int, HplanError] = {}
    for number, task in enumerate(tasks):
        if number in failures:
            continue
        try:
            motion = _on_a_grid(task)
        except NoPathError as error:
            failures[number] = error.plain if isinstance(error, EnclosedError) and number else error
            error.with_traceback(None)  # which keeps grids in memory
            rest = [other for other in range(number + 1, len(tasks)) if other not in failures]
            shown = without_path([tasks[other] for other in rest])
            failures |= {other: error for other, error in zip(rest, shown, strict=True) if error is not None}
        except (CertificationError, NotFoundError, TimingError) as error:
            failures[number] = error.with_traceback(None)
        else:
            yield number, motion
            return
    raise FailuresError(tuple(failures[number] for number in range(len(tasks))))


def _on_a_grid(task: PlanningTask) -> Transit:
    """The motion on the first grid that leads to one, finer ones and larger obstacles in turn."""
    fitting = [task.fitting(GridAttempt(factor)) for factor in _STEP_FACTORS]
    failure: CertificationError | None = None
    for step_factor in dict.fromkeys(attempt.step_factor for attempt in fitting if attempt is not None):
        for growth_m in sorted({task.grown(growth_m) for growth_m in _GROWTH}):
            attempt = GridAttempt(step_factor, growth_m=growth_m)
            margin = task.margin(growth_m)
            try:
                route = find_route(task, attempt, 0.1 * margin)
                return quickest(task, [Polyline(route.path, "search", route), *_other_paths(task)], margin)
            except CertificationError as error:
                failure = failure or error.with_traceback(None)
            except NoPathError:
                if failure is None:
                    raise
                break  # grown obstacles close the passage; the motion found without them could not be certified
    step_deg = max(task.options.step_deg, COARSEST_DEG)
    tried = [] if any(fitting) else [f"no grid of {step_deg:g} deg or less has fewer than {MOST_CELLS:.3g} nodes"]
    raise failure or NotFoundError([*tried, _trees_tried(task)] if _may_sample(task) else tried)


def _other_paths(task: PlanningTask) -> list[Polyline]:
    """Paths to be compared with one that was found on a planar grid: of other homotopy classes, if there are any."""
    effort = task.effort.planar
    return [] if effort is None or straight_is_clear(task) else _polylines(_tree_paths(task, effort))


def _why_none(tasks: Sequence[PlanningTask]) -> Iterator[HplanError]:
    """For each goal the error that says that no path leads there, or what was tried."""
    first = tasks[0]
    if not first.effort.floods:
        yield from (NotFoundError([_trees_tried(task)]) for task in tasks)
        return
    coarse = first.to_flood(WIDTHS[-1])
    grid = "no grid over all yaws fits" if coarse is None else f"grids down to {first.step_deg(coarse):g} deg"
    for error, task in zip(without_path(tasks), tasks, strict=True):
        yield error or NotFoundError(["straight motion", _trees_tried(task), grid])


def _trees_tried(task: PlanningTask) -> str:
    each: dict[int, int] = {}  # by their seeds: some of the long ones have grown before
    for trees in (task.effort.trees, _long_trees(task)):
        each |= dict.fromkeys(range(trees.seed, trees.seed + trees.pairs), trees.each)
    return f"trees with {sum(each.values())} evaluations of the clearance"
