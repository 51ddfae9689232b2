"""Quick ways by a few configurations: a roadmap whose motions are looked at only when they matter.

The configurations are start, goal and points of a low-discrepancy sequence around the two; any two may be joined by a
straight motion. A way lasts as long as its motions' slowest joints take, and a little for each motion. The quickest way
is found as though all motions were clear, its motions are looked at one by one, and where one is not clear the quickest
way without it comes next (lazy PRM, Bohlin and Kavraki 2000; with deterministic points, Janson et al. 2018). So what is
looked at is what could be part of a quick way, and nearly nothing else.

Where nothing is found nothing is shown: that is what grids are for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, frozen
from hplan.base.kernels import kernel
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.clearance_kernels import link_clearances, segment_is_clear, smallest
from hplan.problem.definition import Problem


@dataclass(frozen=True)
class Effort:
    """How far a roadmap goes.

    Attributes:
        points: Configurations beside start and goal.
        looks: How many motions between them are looked at.
        aside: How far beyond start and goal points reach: what a joint can do in this share of the straight motion's
            time, but no less than in `ASIDE_S` and no farther than `FARTHEST`.
    """

    points: int
    looks: int
    aside: float


#: A look close by, for ways that are quick; and one farther around.
BRIEF, WIDE = Effort(128, 300, 0.175), Effort(160, 400, 0.5)

#: What a motion adds to the time of a way, as it has to be reached and left by way of a corner [s].
CORNER_S = 0.15

#: Ways that take longer than this many times the straight motion, and so much beside, are no quick ones [s].
LONGEST, LONGEST_S = 2.5, 1.0

#: How far beyond start and goal points reach at least, in time [s], and at most [rad].
ASIDE_S, FARTHEST = 0.25, 1.0


def quick_path(
    problem: Problem,
    field: ClearanceField,
    velocity: FloatArray,
    margin: float,
    effort: Effort = BRIEF,
    *,
    quicker_than_s: float = math.inf,
) -> FloatArray | None:
    """A clear way of a few straight motions.

    Args:
        problem: Start, goal and joint limits.
        field: Arm and obstacles.
        velocity: (dof,) velocity limits [rad/s].
        margin: Clearance asked for wherever a motion is evaluated [m].
        effort: How far to go.
        quicker_than_s: Ways that take longer are of no use.

    Returns:
        (m, dof) waypoints, m >= 2, or None where none was found.
    """
    straight_s = float((np.abs(problem.goal - problem.start) / velocity).max())
    aside = np.minimum(velocity * max(effort.aside * straight_s, ASIDE_S), FARTHEST)
    lower = np.maximum(np.minimum(problem.start, problem.goal) - aside, problem.lower)
    upper = np.minimum(np.maximum(problem.start, problem.goal) + aside, problem.upper)
    spread = lower + low_discrepancy(effort.points, len(lower)) * (upper - lower)
    points = np.concatenate([[problem.start, problem.goal], spread])
    way = _quickest(
        points, np.array(velocity), field.chain, field.base, field.solids, field.data, margin,
        min(LONGEST * straight_s + LONGEST_S, quicker_than_s), CORNER_S, effort.looks,
    )  # fmt: skip
    return frozen(points[way]) if len(way) else None


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
    points: FloatArray,
    velocity: FloatArray,
    chain: FloatArray,
    base: FloatArray,
    solids: FloatArray,
    data: FloatArray,
    margin: float,
    longest: float,
    corner: float,
    looks: int,
) -> IntArray:
    """Numbers of the points of the quickest way from point 0 to point 1 that was found clear; empty without one."""
    count, dof = points.shape
    lasting = np.empty((count, count))  # infinite for motions that are not clear
    for i in range(count):
        for j in range(i + 1):
            time = corner
            for k in range(dof):
                time = max(time, corner + abs(points[i, k] - points[j, k]) / velocity[k])
            lasting[i, j], lasting[j, i] = time, time
    clear = np.empty(chain.shape[0])
    used = np.empty(count, dtype=np.int64)
    used[0], used[1], size = 0, 1, 2
    for i in range(2, count):
        if lasting[0, i] + lasting[i, 1] <= longest:
            link_clearances(points[i], chain, base, solids, data, clear)
            if smallest(clear) >= margin:
                used[size] = i
                size += 1
    seen = np.zeros((count, count), dtype=np.bool_)
    left, following, done = np.empty(count), np.empty(count, dtype=np.int64), np.empty(count, dtype=np.bool_)
    while looks > 0:
        # Dijkstra's algorithm from the goal, on a graph in which nearly all are joined.
        for a in range(size):
            left[used[a]], done[used[a]] = math.inf, False
        left[1] = 0.0
        here = 1
        while here > 0:
            done[here] = True
            nearest, least = -1, longest
            for a in range(size):
                i = used[a]
                if not done[i]:
                    if left[here] + lasting[here, i] < left[i]:
                        left[i], following[i] = left[here] + lasting[here, i], here
                    if left[i] < least:
                        nearest, least = i, left[i]
            here = nearest
        if here < 0:
            break  # no way is left that does not take too long
        motions = 0
        while here != 1:
            after = following[here]
            if not seen[here, after]:
                looks -= 1
                seen[here, after] = seen[after, here] = True
                if not segment_is_clear(points[here], points[after], chain, base, solids, data, margin):
                    lasting[here, after] = lasting[after, here] = math.inf
                    break
            here = after
            motions += 1
        if here == 1:
            way = np.zeros(motions + 1, dtype=np.int64)
            for a in range(motions):
                way[a + 1] = following[way[a]]
            return way
    return np.empty(0, dtype=np.int64)
