"""The fastest of the motions near several paths: estimated, then made roughly, and the best of them to the end.

An optimiser finds the fastest motion near the one that it begins with: on the other side of an obstacle there may be a
faster one. Paths that can be moved into each other lead to about the same one, so that only the quickest
of every class is looked at.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray
from hplan.optimization.coarse_profile import coarse_profile
from hplan.optimization.minimize_time import LONGEST_S, Effort, minimize_time, rough_motion
from hplan.optimization.path_classes import PARTS, class_numbers
from hplan.optimization.smooth_path import SMALLEST_FRACTION, clear_start, near_field
from hplan.optimization.time_problem import TimeProblem
from hplan.optimization.timed_spline import TimedSpline
from hplan.trajectory.speed_profile import SpeedProfile

#: Obstacles farther than this from a path are left out of the programs that move it [m].
NEAR = 0.4


#: Pairs of the arm's own bodies that do not touch near a motion whose joints turn by so much are left out of programs
#: [rad]: about as much as a step changes at most.
_TURN = 0.6


@dataclass(frozen=True)
class StartsEffort:
    """What may be spent on the motions near several paths.

    Attributes:
        optimization: Of one motion.
        rough: So many rough motions are made, of the paths with the quickest splines, one of each class.
        others: So many, if there are fewer classes, with other paths.
        finished: So many of them, the quickest, are optimised to the end.
    """

    optimization: Effort
    rough: int
    others: int
    finished: int


class OptimizationStart(NamedTuple):
    """What an optimiser begins with.

    Attributes:
        number: Of the path.
        profile: About the fastest motion along a smooth path near it.
    """

    number: int
    problem: TimeProblem
    profile: SpeedProfile


def optimization_starts(paths: Sequence[FloatArray], problem: TimeProblem) -> list[OptimizationStart]:
    """Smooth paths near some polylines, about the quickest first; without those where none is found clear at once.

    Args:
        paths: (m, dof) clear polylines between the same ends.
        problem: What is to be kept; what is near is chosen for each path.
    """
    found: list[OptimizationStart] = []
    for number, path in enumerate(paths):
        near = near_field(path, problem.field, NEAR)
        is_clear = near.is_clear(path, SMALLEST_FRACTION * problem.options.margin)
        spline = clear_start(path, near, problem.options) if is_clear else None
        if spline is not None:
            profile = coarse_profile(spline, problem.options)
            if profile.duration < LONGEST_S:
                along = profile.positions(PARTS * profile.duration)
                near = near.without_idle_pairs(along, problem.options.movable, NEAR, _TURN)
                found.append(OptimizationStart(number, replace(problem, near=near), profile))
    # Another path than the first is preferred to it only where its smooth path is quicker by more than this part.
    times = [start.profile.duration * (1.0 - 0.03 * (start.number == 0)) for start in found]
    return [found[k] for k in ties.argsort(times).tolist()]


def fastest_motions(
    starts: Sequence[OptimizationStart], effort: StartsEffort, *, quicker_than_s: float = math.inf
) -> list[tuple[int, TimedSpline]]:
    """The fastest motions that come of some starts, each with the number of its path; the fastest first.

    Args:
        starts: The starts, in the order of `optimization_starts`.
        quicker_than_s: Longest duration of a motion that is of use [s].
    """
    several = starts if len(starts) < 2 else [starts[k] for k in _promising(starts, effort).tolist()]
    chosen: list[tuple[OptimizationStart, TimedSpline | None]] = [(start, None) for start in several]
    # A rough motion comes out quicker by no more than about this part of a motion that is known, and of another one.
    left_to_gain, among_rough = 0.1, 0.05
    if len(several) > 1 or math.isfinite(quicker_than_s):
        chosen = [(start, rough_motion(start.profile, start.problem, effort.optimization)) for start in several]
        times = [math.inf if rough is None else rough.duration for _, rough in chosen]
        enough = min(quicker_than_s / (1.0 - left_to_gain), min(times, default=math.inf) / (1.0 - among_rough))
        best = ties.argsort(times)[: effort.finished]
        chosen = [chosen[k] for k in best.tolist() if times[k] <= enough]
    found = [
        (start.number, motion)
        for start, rough in chosen
        if (motion := minimize_time(start.profile, start.problem, effort.optimization, rough=rough)) is not None
    ]
    return [found[k] for k in ties.argsort([motion.duration for _, motion in found]).tolist()]


def _promising(starts: Sequence[OptimizationStart], effort: StartsEffort) -> IntArray:
    """Numbers of the starts that have rough motions: the first of each class, and others if these are few."""
    paths = np.stack([start.profile.positions(PARTS * start.profile.duration) for start in starts])
    first = class_numbers(paths, starts[0].problem.field) == np.arange(len(starts))
    count = min(max(int(first.sum()), effort.others), effort.rough)
    return np.argsort(~first, kind="stable")[:count]
