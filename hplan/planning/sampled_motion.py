"""Motions along paths that trees find."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.errors import NoPathError
from hplan.planning.certified_motion import PlannedMotion, Polyline, quickest_certified
from hplan.planning.effort import effort_of
from hplan.planning.grid_route import find_route
from hplan.planning.sampling.rrt_connect import TreeEffort, tree_path
from hplan.planning.sampling.several_trees import PromisingPath, TreesEffort, promising_paths
from hplan.planning.task import GridAttempt, PlanningTask
from hplan.robot.limits import least_duration as least_between

#: Coarse grids with more nodes than this are left out.
MOST_COARSE = 5e6

#: Effort of trees of which the first path is taken, and before goals are refused, with so many seeds.
ONE_PAIR = TreesEffort(1, 12_000)
LONG_TREES, LONG_SEEDS = 120_000, 2


def by_trees(task: PlanningTask, effort: TreesEffort) -> PlannedMotion | None:
    """The quickest motion along paths of some trees; None where none is found and certified."""
    return quickest_certified(task, _polylines(_of_trees(task, effort)), task.margin())


def by_sampling(task: PlanningTask) -> PlannedMotion | None:
    """The motion along the path of one pair of trees, or the quickest along many paths; None where there is none."""
    effort, margin = effort_of(task), task.margin()
    first = _of_trees(task, replace(effort.trees, pairs=1))
    known = quickest_certified(task, _polylines(first), margin)
    if known is not None and known.trajectory.duration <= effort.close * least_duration(task):
        return known
    found = _of_trees(task, effort.trees, first, 1)
    if known is not None:  # along the first
        found = [path for path in found if path is not first[0]]
    polylines = [*_of_grids(task, effort.grids), *_polylines(found)]
    if known is None:
        return quickest_certified(task, polylines, margin)
    other = quickest_certified(task, polylines, margin, quicker_than_s=known.trajectory.duration)
    return known if other is None or known.trajectory.duration <= other.trajectory.duration else other


def rivals(task: PlanningTask) -> list[Polyline]:
    """Other paths, to be compared with one that was found on a planar grid."""
    effort = effort_of(task)
    return [] if effort.planar is None else _polylines(_of_trees(task, effort.planar))


def _may_sample(task: PlanningTask) -> bool:
    """False where the options ask for a certain search: `dense`, of the planar grid."""
    return task.problem.turns or task.options.method == "two-level"


def trees_tried(task: PlanningTask) -> str:
    """The trees, where it is told what was tried."""
    effort = effort_of(task).trees
    return f"trees with {effort.pairs * effort.each} evaluations of the clearance"


def least_duration(task: PlanningTask) -> float:
    """Duration that no motion between start and goal can undercut [s]."""
    problem, robot = task.problem, task.robot
    return least_between(problem.start, problem.goal, robot.velocity_limit, robot.acceleration_limit)


def _of_grids(task: PlanningTask, attempts: Sequence[GridAttempt]) -> list[Polyline]:
    """The shortest path on each of some planar grids that has one."""
    if task.problem.turns or task.options.method != "two-level":
        return []
    found: list[Polyline] = []
    for attempt in attempts:
        if task.cells(attempt) > MOST_COARSE:
            continue
        with suppress(NoPathError):
            route = find_route(task, replace(attempt, growth_m=task.grown(attempt.growth_m)), 0.1 * task.margin())
            found.append(Polyline(route.path, "search"))
    return found


def _of_trees(
    task: PlanningTask, effort: TreesEffort, known: Sequence[PromisingPath] = (), grown: int = 0
) -> list[PromisingPath]:
    """The paths of several pairs of trees, with those that so many of them have found already, the best first."""
    if not _may_sample(task):
        return []
    margin, velocity = 0.1 * task.margin(), task.robot.velocity_limit
    with task.stage("trees"):
        return promising_paths(task.problem, task.field, velocity, margin, effort, known, grown)


def _polylines(paths: Sequence[PromisingPath]) -> list[Polyline]:
    """The paths of trees as they were found: shortened ones touch the margin, and leave smoothing no room."""
    return [Polyline(path.waypoints, "trees") for path in paths]


def by_trees_to_any(tasks: Sequence[PlanningTask]) -> tuple[int, PlannedMotion] | None:
    """A motion to whichever goal trees with more effort reach; None where they reach none."""
    if not _may_sample(tasks[0]):
        return None
    margin = min(task.margin() for task in tasks)
    found: dict[int, list[FloatArray]] = {}
    at_once = tasks[0].robot.planar is None  # another path takes as long again
    for seed in range(LONG_SEEDS + at_once):
        reached = tree_path_to_any(tasks, TreeEffort(LONG_TREES, seed))
        if reached is None:
            continue
        number, path = reached
        found.setdefault(number, []).append(path)
        motion = quickest_certified(tasks[number], [Polyline(path, "trees")], margin) if at_once else None
        if motion is not None:
            return number, motion
    for number, paths in found.items():
        motion = quickest_certified(tasks[number], [Polyline(path, "trees") for path in paths], margin)
        if motion is not None:
            return number, motion
    return None


def tree_path_to_any(tasks: Sequence[PlanningTask], effort: TreeEffort) -> tuple[int, FloatArray] | None:
    """The number of whichever goal a pair of trees reaches, and the path as found; None where they reach none."""
    goals, first = np.array([task.problem.goal for task in tasks]), tasks[0]
    margin = 0.1 * min(task.margin() for task in tasks)
    with first.stage("trees"):
        path, _ = tree_path(first.problem, first.field, first.robot.velocity_limit, margin, effort, goals=goals)
    return None if path is None else (int((goals == path[-1]).all(axis=1).argmax()), path)
