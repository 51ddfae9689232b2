"""Lazy roadmap: quick paths of a few straight motions, checked for contact only where they matter.

The configurations are start, goal and points of a low-discrepancy sequence around the two; any two may be joined by a
straight motion. A path's duration is that of its motions' slowest joints, and a little more for each motion. The
quickest path is found as though all points and motions were clear, these are checked one by one, what costs least to
check first, and where one is not clear the quickest path without it comes next (lazy PRM, Bohlin and Kavraki 2000; with
deterministic points, Janson et al. 2018). So only what could be part of a quick path is checked, and nearly nothing
else.

That no path is found shows nothing: that is what grids are for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray, frozen
from hplan.base.deadline import is_up, look
from hplan.base.kernels import kernel
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.clearance_kernels import FieldArrays, keeps_margin, segment_is_clear, segment_is_refused
from hplan.problem.definition import Problem


@dataclass(frozen=True)
class Effort:
    """Size of a roadmap.

    Attributes:
        points: Configurations in addition to start and goal.
        checks: Most motions between them that are checked.
        beyond: How far beyond start and goal points reach: what a joint can do in this part of the straight motion's
            time, but no less than in `BEYOND_S` and no farther than `FARTHEST`.
    """

    points: int
    checks: int
    beyond: float


#: A quick try near start and goal, and a wider one.
BRIEF, WIDE = Effort(128, 300, 0.175), Effort(160, 400, 0.5)

#: What each motion adds to the duration of a path, as its ends are corners [s].
CORNER_S = 0.15

#: Paths that take longer than so many times the straight motion, and so much more, are no quick ones [s].
LONGEST, LONGEST_S = 2.5, 1.0

#: How far beyond start and goal points reach at least, in time [s], and at most [rad].
BEYOND_S, FARTHEST = 0.25, 1.0


def quick_path(
    problem: Problem,
    field: ClearanceField,
    velocity: FloatArray,
    margin: float,
    effort: Effort = BRIEF,
    *,
    quicker_than_s: float = math.inf,
) -> FloatArray | None:
    """A clear path of a few straight motions.

    Args:
        problem: Start, goal and joint limits.
        field: Arm and obstacles.
        velocity: (dof,) velocity limits [rad/s].
        margin: Clearance asked for wherever a motion is evaluated [m].
        effort: Size of the roadmap.
        quicker_than_s: Longest duration of a path that is of use.

    Returns:
        (m, dof) waypoints, m >= 2, or None where none was found.
    """
    straight_s = float((np.abs(problem.goal - problem.start) / velocity).max())
    beyond = np.minimum(velocity * max(effort.beyond * straight_s, BEYOND_S), FARTHEST)
    lower = np.maximum(np.minimum(problem.start, problem.goal) - beyond, problem.lower)
    upper = np.minimum(np.maximum(problem.start, problem.goal) + beyond, problem.upper)
    spread = lower + low_discrepancy(effort.points, len(lower)) * (upper - lower)
    points = np.concatenate([[problem.start, problem.goal], spread])
    longest = min(LONGEST * straight_s + LONGEST_S, quicker_than_s)
    path = _quickest(points, np.array(velocity), field.arrays, margin, longest, effort.checks)
    look()
    return frozen(points[path]) if len(path) else None


def low_discrepancy(count: int, dimensions: int) -> FloatArray:
    """(count, dimensions) evenly spread points of the unit cube: Roberts' R sequence.

    Multiples of the powers of 1 / g modulo 1, g the root of g^(d + 1) = g + 1 (Roberts 2018, "The unreasonable
    effectiveness of quasirandom sequences").
    """
    root = 2.0
    for _ in range(64):
        # Newton's method, by products alone: the last digit of a power depends on the processor.
        power = math.prod([root] * dimensions)
        root -= (power * root - root - 1.0) / ((dimensions + 1) * power - 1.0)
    steps = np.cumprod(np.full(dimensions, 1.0 / root))
    return (0.5 + np.outer(np.arange(1, count + 1), steps)) % 1.0


@kernel
def _quickest(
    points: FloatArray, velocity: FloatArray, field: FieldArrays, margin: float, longest: float, checks: int
) -> IntArray:
    """Numbers of the points of the quickest path from point 0 to point 1 that was found clear; empty without one."""
    count, dof = points.shape
    duration = np.empty((count, count))  # infinite for motions that are not clear
    for i in range(count):
        for j in range(i + 1):
            time = CORNER_S
            for k in range(dof):
                time = max(time, CORNER_S + abs(points[i, k] - points[j, k]) / velocity[k])
            duration[i, j], duration[j, i] = time, time
    least = duration[0].copy()  # of what is left from a point to the start, whatever is clear
    used = np.empty(count, dtype=np.int64)
    used[0], used[1], size = 0, 1, 2
    for i in range(2, count):
        if least[i] + duration[i, 1] <= longest:
            used[size] = i
            size += 1
    checked, likely = np.zeros((count, count), dtype=np.bool_), np.zeros((count, count), dtype=np.bool_)
    left, following, done = np.empty(count), np.empty(count, dtype=np.int64), np.empty(count, dtype=np.bool_)
    while checks > 0 and not is_up(field.until):
        if not _joined(used[:size], duration, least, longest, (left, following, done)):
            break  # no path is left that is not too long
        here, motions, refused = 0, 0, -1
        while here != 1 and refused < 0:
            here = following[here]
            motions += 1
            if here != 1 and not checked[here, here]:
                checked[here, here] = True
                if not keeps_margin(points[here], field, margin):
                    refused = here
        if refused >= 0:
            size = _without(used, size, refused)
            continue
        here, clear = 0, True
        while here != 1 and clear:  # what a few looks refuse lets all the path's proofs be spared
            after = following[here]
            if not likely[here, after]:
                likely[here, after] = likely[after, here] = True
                clear = not segment_is_refused(points[here], points[after], field, margin)
            if clear:
                here = after
            else:
                checks -= 1
        if clear:
            here = 0
        while here != 1 and clear:
            after = following[here]
            if not checked[here, after]:
                checks -= 1
                checked[here, after] = checked[after, here] = True
                clear = segment_is_clear(points[here], points[after], field, margin)
            if clear:
                here = after
        if not clear:
            duration[here, after] = duration[after, here] = math.inf
        else:
            path = np.zeros(motions + 1, dtype=np.int64)
            for a in range(motions):
                path[a + 1] = following[path[a]]
            return path
    return np.empty(0, dtype=np.int64)


@kernel
def _joined(
    used: IntArray,
    duration: FloatArray,
    least: FloatArray,
    longest: float,
    work: tuple[FloatArray, IntArray, BoolArray],
) -> bool:
    """True if a path joins start and goal; written are, from the start on, the points that follow one another.

    A* from the goal, on a graph in which nearly all are joined.

    Args:
        used: Numbers of the points.
        duration: (count, count) of the motions between points; infinite for what is not clear.
        least: (count,) at least so long from each point to the start.
        longest: Longest duration of a path.
        work: (count,) durations from each point to the goal, the points that follow, and whether these are known.
    """
    left, following, done = work
    for i in used:
        left[i], done[i] = math.inf, False
    left[1] = 0.0
    here = 1
    while here > 0:
        done[here] = True
        nearest, soonest = -1, longest
        for i in used:
            if not done[i]:
                if left[here] + duration[here, i] < left[i]:
                    left[i], following[i] = left[here] + duration[here, i], here
                through = left[i] if i == 0 else left[i] + least[i]
                if through < soonest:
                    nearest, soonest = i, through
        here = nearest
    return here == 0


@kernel
def _without(used: IntArray, size: int, point: int) -> int:
    """Take a point out of the first ones of a list; how many are left is returned."""
    kept = 0
    for a in range(size):
        if used[a] != point:
            used[kept] = used[a]
            kept += 1
    return kept
