"""Motions along sampled paths: the quick ones of a roadmap, and those that trees find."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.errors import CertificationError, TimingError
from hplan.planning.certified_motion import PlannedMotion, quickest_certified, smooth_and_certify
from hplan.planning.task import PlanningTask
from hplan.sampling.roadmap import BRIEF, Effort, quick_path
from hplan.sampling.rrt_connect import TreeEffort, tree_path
from hplan.sampling.several_trees import TreesEffort, promising_paths

#: Effort of the trees: of a quick try, of one that takes what it finds first, and before goals are refused, with so
#: many seeds.
BRIEF_TREES, ONE_PAIR = TreesEffort(30_000, (3, 12_000), (9, 3_000)), TreesEffort(12_000, (1, 12_000), (0, 0))
LONG_TREES, LONG_SEEDS = 120_000, 2

#: Of so many paths the motions are compared, of those that promise to take no longer than so many times the least.
COMPARED, PROMISING = 3, 1.2


def by_roadmap(task: PlanningTask, effort: Effort = BRIEF, *, quicker_than_s: float = math.inf) -> PlannedMotion | None:
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


def by_trees(
    task: PlanningTask, effort: TreesEffort = BRIEF_TREES, *, quicker_than_s: float = math.inf
) -> PlannedMotion | None:
    """The quickest motion along the most promising paths of some trees; None where none is found and certified."""
    if task.options.method != "two-level":
        return None  # a certain search is wanted
    margin, velocity = task.margin(), task.robot.velocity_limit
    with task.stage("roadmap"):
        paths = promising_paths(task.problem, task.field, velocity, 0.1 * margin, effort)
    useful = min([quicker_than_s, *(PROMISING * seconds for seconds, _ in paths)])
    return _quickest_along(task, [path for seconds, path in paths if seconds <= useful], margin)


def by_trees_to_any(tasks: Sequence[PlanningTask]) -> tuple[int, PlannedMotion] | None:
    """A motion to whichever goal trees with more effort reach; None where they reach none."""
    if tasks[0].options.method != "two-level":
        return None  # a certain search is wanted
    goals = np.array([task.problem.goal for task in tasks])
    margin, first = min(task.margin() for task in tasks), tasks[0]
    found: dict[int, list[FloatArray]] = {}
    for seed in range(LONG_SEEDS):
        effort = TreeEffort(LONG_TREES, seed)
        with first.stage("roadmap"):
            path, _ = tree_path(
                first.problem, first.field, first.robot.velocity_limit, 0.1 * margin, effort, goals=goals
            )
        if path is not None:
            found.setdefault(int((goals == path[-1]).all(axis=1).argmax()), []).append(path)
    for number, reached in found.items():
        motion = _quickest_along(tasks[number], reached, margin)
        if motion is not None:
            return number, motion
    return None


def _quickest_along(task: PlanningTask, paths: Sequence[FloatArray], margin: float) -> PlannedMotion | None:
    """The quickest certified motion along `COMPARED` of some paths, the first that give one; None where none does."""
    # The paths as they were found: shortened ones touch the margin, and leave smoothing no room.
    batches = (paths[first : first + COMPARED] for first in range(0, len(paths), COMPARED))
    motions = (quickest_certified(task, batch, margin, "trees") for batch in batches)
    return next((motion for motion in motions if motion is not None), None)
