"""Shortens paths by shortcuts; every segment is verified collision-free.

Pairs of points on the path come from a low-discrepancy sequence, not from a random generator: the same path always
gives the same result. Between two points either all joints or only one of them moves in a straight line (the others
keep their motion), which also removes the detour of one joint while the others must avoid an obstacle.
"""

from __future__ import annotations

import math

import numpy as np

from hplan.base.arrays import FloatArray, frozen
from hplan.base.deadline import check_deadline, is_up
from hplan.base.kernels import kernel
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.compiled_motions import segment_is_clear
from hplan.collision.compiled_obstacles import FieldArrays

#: Number of shortcuts tried by default.
SHORTCUTS = 300

#: Waypoints closer to each other than this are merged [rad].
_MERGE = 1e-9


def without_twins(path: FloatArray) -> FloatArray:
    """Remove waypoints that equal their predecessor; the last waypoint always stays."""
    if (np.linalg.norm(np.diff(path, axis=0), axis=1) > _MERGE).all():
        return np.array(path)
    kept = [path[0]]
    kept.extend(point for point in path[1:] if np.linalg.norm(point - kept[-1]) > _MERGE)
    if len(kept) > 1:
        kept[-1] = path[-1]
    return np.array(kept)


def shorten(path: FloatArray, field: ClearanceField, *, margin: float, rounds: int = SHORTCUTS) -> FloatArray:
    """Shorten a collision-free path.

    Args:
        path: (m, dof) waypoints, verified collision-free.
        margin: Required clearance of shortcuts at each evaluated configuration [m]; the remaining parts of the path
            keep their own clearance.

    Returns:
        (k, dof) waypoints from the same start to the same goal, verified collision-free, never longer.
    """
    path = without_twins(path)
    if len(path) < 3:
        return frozen(np.array(path))
    shorter = _shortcut(_skip_visible(path, field.arrays, margin), field.arrays, margin, rounds)
    check_deadline()
    return frozen(shorter)


@kernel
def _skip_visible(path: FloatArray, field: FieldArrays, margin: float) -> FloatArray:
    """Skip waypoints: connect each to the farthest visible one.

    The search gallops and then bisects.
    """
    kept = [0]
    last = path.shape[0] - 1
    here = 0
    while here < last:
        clear_to, stride = here + 1, 2
        blocked = last + 1
        while here + stride <= last:
            if segment_is_clear(path[here], path[here + stride], field, margin):
                clear_to = here + stride
                stride *= 2
            else:
                blocked = here + stride
                break
        if blocked > last and clear_to < last:
            if segment_is_clear(path[here], path[last], field, margin):
                clear_to = last
            else:
                blocked = last
        while blocked - clear_to > 1 and clear_to < last:
            middle = (clear_to + blocked) // 2
            if segment_is_clear(path[here], path[middle], field, margin):
                clear_to = middle
            else:
                blocked = middle
        here = clear_to
        kept.append(here)
    result = np.empty((len(kept), path.shape[1]))
    for i in range(len(kept)):
        for joint in range(path.shape[1]):
            result[i, joint] = path[kept[i], joint]
    return result


@kernel
def _distance(first: FloatArray, i: int, second: FloatArray, j: int) -> float:
    """Distance between row i of one array and row j of another."""
    square = 0.0
    for joint in range(first.shape[1]):
        square += (first[i, joint] - second[j, joint]) ** 2
    return math.sqrt(square)


@kernel
def _write_station(path: FloatArray, station: FloatArray, at: float, point: FloatArray) -> int:
    """Write the point at a station of a path; return its segment."""
    i = 0
    while i < path.shape[0] - 2 and station[i + 1] <= at:
        i += 1
    fraction = (at - station[i]) / (station[i + 1] - station[i])
    for joint in range(path.shape[1]):
        point[joint] = path[i, joint] + fraction * (path[i + 1, joint] - path[i, joint])
    return i


@kernel
def _join_bypass(path: FloatArray, i: int, bypass: FloatArray, inner: int, j: int) -> FloatArray:
    """Replace segments i to j of a path by a bypass.

    The result is the path up to segment i, the first `inner` + 2 points of the bypass, and the path after segment j,
    without duplicate points.
    """
    count, dof = path.shape
    joined = np.empty((i + 1 + inner + 2 + count - 1 - j, dof))
    size = 0
    for part in range(3):
        source = bypass if part == 1 else path
        first, last = (0, i + 1) if part == 0 else ((0, inner + 2) if part == 1 else (j + 1, count))
        for m in range(first, last):
            if size > 0 and _distance(source, m, joined, size - 1) <= _MERGE:
                if part < 2 or m < count - 1:
                    continue
                size -= 1  # the goal itself stays
            for joint in range(dof):
                joined[size, joint] = source[m, joint]
            size += 1
    return joined[:size].copy()


@kernel
def _shortcut(path: FloatArray, field: FieldArrays, margin: float, rounds: int) -> FloatArray:
    """Try shortcuts between pairs of points from a low-discrepancy sequence."""
    dof = path.shape[1]
    for attempt in range(rounds):
        count = path.shape[0]
        if count < 3 or is_up(field.until):
            break
        station = np.zeros(count)
        for m in range(1, count):
            station[m] = station[m - 1] + _distance(path, m, path, m - 1)
        whole = station[count - 1]
        # The R2 sequence (generalized golden ratio); the maximum length of a shortcut cycles from the whole path to 1/8
        # of it.
        first = (0.5 + (attempt + 1) * 0.7548776662466927) % 1.0
        reach = ((0.5 + (attempt + 1) * 0.5698402909980532) % 1.0) / (1 << (attempt % 4))
        low, high = first * whole, min(whole, (first + reach) * whole)
        if high - low < 1e-6 * whole:
            continue
        bypass = np.empty((count + 2, dof))
        i = _write_station(path, station, low, bypass[0])
        j = _write_station(path, station, high, bypass[1])
        if i == j:
            continue
        joint = attempt % (dof + 1) - 1  # -1: all joints move in a straight line
        inner = j - i if joint >= 0 else 0
        for k in range(dof):
            bypass[inner + 1, k] = bypass[1, k]
        for m in range(inner):
            # The other joints keep their motion; this joint moves linearly with the stations.
            fraction = (station[i + 1 + m] - low) / (high - low)
            for k in range(dof):
                bypass[1 + m, k] = path[i + 1 + m, k]
            bypass[1 + m, joint] = bypass[0, joint] + fraction * (bypass[inner + 1, joint] - bypass[0, joint])
        length = 0.0
        for m in range(inner + 1):
            length += _distance(bypass, m + 1, bypass, m)
        if length > high - low - 1e-9 * whole:
            continue
        clear = True
        for m in range(inner + 1):
            if not segment_is_clear(bypass[m], bypass[m + 1], field, margin):
                clear = False
                break
        if clear:
            path = _join_bypass(path, i, bypass, inner, j)
    return path
