"""Motions along sampled paths: the quick ones of a roadmap, and those that trees find."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray
from hplan.errors import CertificationError, TimingError
from hplan.planning.certified_motion import PlannedMotion, smooth_and_certify
from hplan.planning.task import PlanningTask
from hplan.sampling.roadmap import BRIEF, Effort, quick_path
from hplan.sampling.rrt_connect import TreeEffort, path_time, tree_path
from hplan.smoothing.shortcut import shorten

#: Trees of so many seeds are tried, and the most promising path taken; what they may spend, in evaluations of the
#: clearance; and the same before goals are refused.
SEEDS, BRIEF_TREES, LONG_SEEDS, LONG_TREES = 3, 12_000, 2, 120_000

#: Of so many paths the motions are compared.
COMPARED = 2


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


def by_trees(task: PlanningTask, seeds: int = SEEDS) -> PlannedMotion | None:
    """The quickest motion along the most promising paths of some trees; None where none is found and certified."""
    if task.options.method != "two-level":
        return None  # a certain search is wanted
    margin, velocity = task.margin(), task.robot.velocity_limit
    paths: list[FloatArray] = []
    times: list[float] = []
    with task.stage("roadmap"):
        for seed in range(seeds):
            path = tree_path(task.problem, task.field, velocity, 0.1 * margin, TreeEffort(BRIEF_TREES, seed))
            if path is None and not paths:
                return None
            if path is not None:
                paths.append(path)
                times.append(path_time(shorten(path, task.field, margin=0.1 * margin), velocity))
    return _quickest_along(task, [paths[number] for number in ties.argsort(times).tolist()], margin)


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
            path = tree_path(first.problem, first.field, first.robot.velocity_limit, 0.1 * margin, effort, goals=goals)
        if path is not None:
            found.setdefault(int((goals == path[-1]).all(axis=1).argmax()), []).append(path)
    for number, paths in found.items():
        motion = _quickest_along(tasks[number], paths, margin)
        if motion is not None:
            return number, motion
    return None


def _quickest_along(task: PlanningTask, paths: Sequence[FloatArray], margin: float) -> PlannedMotion | None:
    """The quickest certified motion along `COMPARED` of some paths, the first that give one; None where none does."""
    motions: list[PlannedMotion] = []
    for path in paths:
        # The path as it was found: a shortened one touches the margin, and leaves smoothing no room.
        with suppress(CertificationError, TimingError):
            motions.append(smooth_and_certify(task, path, margin, "trees"))
        if len(motions) == COMPARED:
            break
    return min(motions, key=lambda motion: motion.trajectory.duration, default=None)
