"""Shortcuts: the path pulled taut among the obstacles, every piece of it shown clear.

Pairs of points on the path come from a low-discrepancy sequence, not from chance: the same path always gives the same
result. Between two points either all joints or only one of them goes straight (the others keep their motion), which
also shortens where a joint turns back and forth while others must move around something.
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from hplan.arrays import FloatArray, frozen
from hplan.clearance import ClearanceField, segment_is_clear

#: Waypoints nearer than this to each other are one [rad].
_MERGE = 1e-9


def path_length(path: FloatArray) -> float:
    """Joint-space length of a polyline of (m, dof) waypoints."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def shorten(path: FloatArray, field: ClearanceField, *, margin: float, rounds: int = 300) -> FloatArray:
    """Shorten a path that is clear.

    Args:
        path: (m, dof) waypoints; every segment clear at `margin`.
        field: Arm and obstacles.
        margin: Clearance asked for wherever a motion is evaluated [m].
        rounds: Number of shortcuts tried.

    Returns:
        (k, dof) waypoints from the same start to the same goal, clear at `margin`, never longer.
    """
    if len(path) < 3:
        return frozen(np.array(path))
    taut = _skip_visible(np.ascontiguousarray(path), field.chain, field.base, field.solids, margin)
    return frozen(_shortcut(taut, field.chain, field.base, field.solids, margin, rounds))


@nb.njit(cache=True)
def _skip_visible(
    path: FloatArray, chain: FloatArray, base: FloatArray, solids: FloatArray, margin: float
) -> FloatArray:
    """Keep only waypoints that are needed: from each, go to the farthest that galloping and bisection find clear."""
    kept = [0]
    last = path.shape[0] - 1
    here = 0
    while here < last:
        clear_to, stride = here + 1, 2
        blocked = last + 1
        while here + stride <= last:
            if segment_is_clear(path[here], path[here + stride], chain, base, solids, margin):
                clear_to = here + stride
                stride *= 2
            else:
                blocked = here + stride
                break
        if blocked > last and clear_to < last:
            if segment_is_clear(path[here], path[last], chain, base, solids, margin):
                clear_to = last
            else:
                blocked = last
        while blocked - clear_to > 1 and clear_to < last:
            middle = (clear_to + blocked) // 2
            if segment_is_clear(path[here], path[middle], chain, base, solids, margin):
                clear_to = middle
            else:
                blocked = middle
        here = clear_to
        kept.append(here)
    result = np.empty((len(kept), path.shape[1]))
    for i in range(len(kept)):
        result[i] = path[kept[i]]
    return result


@nb.njit(cache=True)
def _shortcut(
    path: FloatArray, chain: FloatArray, base: FloatArray, solids: FloatArray, margin: float, rounds: int
) -> FloatArray:
    dof = path.shape[1]
    for attempt in range(rounds):
        count = path.shape[0]
        if count < 3:
            break
        station = np.zeros(count)
        for i in range(1, count):
            station[i] = station[i - 1] + math.sqrt(((path[i] - path[i - 1]) ** 2).sum())
        whole = station[count - 1]
        # The R2 sequence (generalised golden ratio); the reach of a shortcut shrinks in turn from all to 1/8.
        first = (0.5 + (attempt + 1) * 0.7548776662466927) % 1.0
        reach = ((0.5 + (attempt + 1) * 0.5698402909980532) % 1.0) / (1 << (attempt % 4))
        low, high = first * whole, min(whole, (first + reach) * whole)
        if high - low < 1e-6 * whole:
            continue
        i, j = 0, 0
        while i < count - 2 and station[i + 1] <= low:
            i += 1
        while j < count - 2 and station[j + 1] < high:
            j += 1
        if i == j:
            continue
        a = path[i] + (path[i + 1] - path[i]) * ((low - station[i]) / (station[i + 1] - station[i]))
        b = path[j] + (path[j + 1] - path[j]) * ((high - station[j]) / (station[j + 1] - station[j]))
        joint = attempt % (dof + 1) - 1  # -1: all joints go straight
        middle = np.empty((j - i, dof)) if joint >= 0 else np.empty((0, dof))
        if joint >= 0:
            for m in range(j - i):
                middle[m] = path[i + 1 + m]
                share = (station[i + 1 + m] - low) / (high - low)
                middle[m, joint] = a[joint] + share * (b[joint] - a[joint])
        old = high - low
        new = 0.0
        before = a
        for m in range(len(middle)):
            new += math.sqrt(((middle[m] - before) ** 2).sum())
            before = middle[m]
        new += math.sqrt(((b - before) ** 2).sum())
        if new > old - 1e-9 * whole:
            continue
        clear = True
        before = a
        for m in range(len(middle)):
            if not segment_is_clear(before, middle[m], chain, base, solids, margin):
                clear = False
                break
            before = middle[m]
        if not clear or not segment_is_clear(before, b, chain, base, solids, margin):
            continue
        joined = np.empty((i + 1 + 1 + len(middle) + 1 + count - 1 - j, dof))
        size = 0
        for m in range(i + 1):
            joined[size] = path[m]
            size += 1
        for point in (a, b):
            if point is b:
                for m in range(len(middle)):
                    joined[size] = middle[m]
                    size += 1
            if math.sqrt(((point - joined[size - 1]) ** 2).sum()) > 1e-9:
                joined[size] = point
                size += 1
        for m in range(j + 1, count):
            if m == count - 1 and math.sqrt(((path[m] - joined[size - 1]) ** 2).sum()) <= 1e-9:
                size -= 1
            joined[size] = path[m]
            size += 1
        path = joined[:size].copy()
    return path
