"""Optimizes motions near several paths and returns the fastest ones.

An optimizer finds the fastest motion near its initial guess; on the other side of an obstacle there may be a faster
one. Durations are first estimated, then optimized coarsely, and only the best motions are optimized fully. Paths that
deform into each other lead to about the same motion, so only the fastest path of each homotopy class is optimized.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray
from hplan.collision.compiled_field import ClearanceField
from hplan.optimization.coarse_profile import coarse_profile
from hplan.optimization.minimize_time import LONGEST_MOTION_S, OptimizerEffort, minimize_time, rough_motion
from hplan.optimization.options import PostprocessOptions
from hplan.optimization.path_classes import PARTS, class_numbers
from hplan.optimization.smooth_path import SMALLEST_FRACTION, clear_start, rounded_start
from hplan.optimization.time_problem import TimeProblem
from hplan.optimization.timed_spline import TimedSpline
from hplan.trajectory.speed_profile import SpeedProfile
from hplan.trajectory.spline import SplinePath

#: The first path is preferred unless another path's smooth motion, and coarsely optimized motion, are faster by more
#: than these fractions.
_PREFERRED_SMOOTH, _PREFERRED_ROUGH = 0.03, 0.007

#: Pairs of the arm's own bodies are left out of programs if they are this far apart along the motion [m], or do not
#: touch within this joint displacement of it [rad]: about the maximum change in one step.
_FARTHEST_M, _FARTHEST_TURN = 0.4, 0.6


class OptimizationStart(NamedTuple):
    """Initial guess of an optimizer.

    Attributes:
        number: Index of the path.
        problem: The time problem, without pairs that stay apart along this path.
        profile: Approximate time-optimal motion along a smooth path near it.
    """

    number: int
    problem: TimeProblem
    profile: SpeedProfile


def optimization_starts(paths: Sequence[FloatArray], problem: TimeProblem) -> list[OptimizationStart]:
    """Smooth paths near given polylines, sorted by estimated duration, fastest first.

    A path is left out if no collision-free spline is found near it, or if its estimated duration is too long to
    optimize. If none is left, they start along the polylines themselves, with rounded corners.

    Args:
        paths: (m, dof) collision-free polylines that share their start and goal.
        problem: Limits and clearance constraints; pairs that stay apart are left out for each path.
    """
    found: list[OptimizationStart] = []
    for find_spline in (clear_start, rounded_start):
        near_paths = (_start_near(path, number, problem, find_spline) for number, path in enumerate(paths))
        found = found or [start for start in near_paths if start is not None]
    times = [start.profile.duration * (1.0 - _PREFERRED_SMOOTH * (start.number == 0)) for start in found]
    return [found[k] for k in ties.argsort(times).tolist()]


def _start_near(
    path: FloatArray,
    number: int,
    problem: TimeProblem,
    find_spline: Callable[[FloatArray, ClearanceField, PostprocessOptions], SplinePath | None],
) -> OptimizationStart | None:
    """The smooth path near one polyline; None if there is none or it takes too long."""
    field = problem.field
    is_clear = field.is_clear(path, SMALLEST_FRACTION * problem.options.margin)
    spline = find_spline(path, field, problem.options) if is_clear else None
    if spline is None:
        return None
    profile = coarse_profile(spline, problem.options)
    if not profile.duration < LONGEST_MOTION_S:
        return None
    along = profile.positions(PARTS * profile.duration)
    near = field.without_idle_pairs(along, problem.options.movable, _FARTHEST_M, _FARTHEST_TURN)
    return OptimizationStart(number, replace(problem, near=near), profile)


def fastest_motions(
    starts: Sequence[OptimizationStart], effort: OptimizerEffort, *, quicker_than_s: float = math.inf
) -> list[tuple[int, TimedSpline]]:
    """Optimized motions with the index of their path, fastest first.

    Args:
        starts: Initial guesses, in the order of `optimization_starts`.
        quicker_than_s: Maximum useful duration of a motion [s].
    """
    several = starts if len(starts) < 2 else [starts[k] for k in _select_starts(starts, effort).tolist()]
    chosen: list[tuple[OptimizationStart, TimedSpline | None]] = [(start, None) for start in several]
    # Full optimization shortens a coarsely optimized motion by at most about the first fraction relative to a known
    # motion, and by the second relative to other coarse motions.
    left_to_gain, among_rough = 0.1, 0.05
    if len(several) > 1 or math.isfinite(quicker_than_s):
        chosen = [(start, rough_motion(start.profile, start.problem, effort)) for start in several]
        times = [
            math.inf if rough is None else rough.duration * (1.0 - _PREFERRED_ROUGH * (start.number == 0))
            for start, rough in chosen
        ]
        enough = min(quicker_than_s / (1.0 - left_to_gain), min(times, default=math.inf) / (1.0 - among_rough))
        best = ties.argsort(times)[: effort.finished]
        chosen = [chosen[k] for k in best.tolist() if times[k] <= enough]
    found = [
        (start.number, motion)
        for start, rough in chosen
        if (motion := minimize_time(start.profile, start.problem, effort, rough=rough)) is not None
    ]
    return [found[k] for k in ties.argsort([motion.duration for _, motion in found]).tolist()]


def _select_starts(starts: Sequence[OptimizationStart], effort: OptimizerEffort) -> IntArray:
    """Indices of the starts to optimize coarsely: class representatives, then others."""
    paths = np.stack([start.profile.positions(PARTS * start.profile.duration) for start in starts])
    first = class_numbers(paths, starts[0].problem.field) == np.arange(len(starts))
    count = min(max(int(first.sum()), effort.others), effort.rough)
    return np.argsort(~first, kind="stable")[:count]
