"""Several pairs of trees, of which each may find another path: first anywhere, then only where a path would be quicker.

A path that takes no longer than `t` at the velocity limits leaves no joint farther beyond start and goal than half of
what it can do in the time that is left: once there is a path, samples come from that box (after Gammell et al. 2014,
"Informed RRT*", who sample the set of whole configurations that can be on a shorter path).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, frozen
from hplan.collision.clearance_field import ClearanceField
from hplan.problem.definition import Problem
from hplan.sampling.rrt_connect import TreeEffort, tree_path
from hplan.sampling.time_shortcut import path_time, quicken


@dataclass(frozen=True)
class TreesEffort:
    """Effort of several pairs of trees.

    Attributes:
        evaluations: Evaluations of the clearance in all.
        anywhere: Pairs of trees that grow anywhere within the joint limits, and evaluations of each at most.
        quicker: Pairs that grow only where a path would be quicker, and evaluations of each at most.
    """

    evaluations: int
    anywhere: tuple[int, int]
    quicker: tuple[int, int]


def promising_paths(
    problem: Problem, field: ClearanceField, velocity: FloatArray, margin: float, effort: TreesEffort
) -> list[tuple[float, FloatArray]]:
    """Clear paths of straight motions from start to goal, and what they may come to.

    Args:
        problem: Start, goal and joint limits.
        field: Arm and obstacles.
        velocity: (dof,) velocity limits [rad/s].
        margin: Clearance asked for wherever a motion is evaluated [m].
        effort: How far to go.

    Returns:
        For each path its time after shortcuts [s], and its (m, dof) waypoints as they were found; the quickest first.
    """
    found: list[FloatArray] = []
    times: list[float] = []
    left = effort.evaluations
    for seed in range(effort.anywhere[0] + effort.quicker[0]):
        each = effort.anywhere[1] if seed < effort.anywhere[0] else effort.quicker[1]
        if left <= 0 or (seed >= effort.anywhere[0] and not found):
            break
        inside = problem if seed < effort.anywhere[0] else quicker_only(problem, velocity, min(times))
        path, spent = tree_path(inside, field, velocity, margin, TreeEffort(min(each, left), seed))
        left -= spent
        if path is not None:
            found.append(path)
            times.append(path_time(quicken(path, field, velocity, margin=margin), velocity))
    return [(times[number], found[number]) for number in ties.argsort(times).tolist()]


def quicker_only(problem: Problem, velocity: FloatArray, time_s: float) -> Problem:
    """The problem with joint limits that hold all paths which take no longer than a time at the velocity limits."""
    spare = 0.5 * np.maximum(0.0, time_s * velocity - np.abs(problem.goal - problem.start))
    low, high = np.minimum(problem.start, problem.goal), np.maximum(problem.start, problem.goal)
    return replace(
        problem,
        lower=frozen(np.maximum(problem.lower, low - spare)),
        upper=frozen(np.minimum(problem.upper, high + spare)),
    )
