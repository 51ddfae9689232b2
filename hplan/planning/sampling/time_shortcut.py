"""Shortcuts that save time: what a path found by sampling may come to, told before it is smoothed.

`hplan.optimization.shortcut` pulls a path taut, in joint-space length, and takes a tenth of all planning. To choose
among several paths far less will do: time at the velocity limits is looked at before the clearance is, and few tries
suffice.
"""

from __future__ import annotations

import numpy as np

from hplan.base.arrays import FloatArray, frozen
from hplan.base.deadline import check_deadline, is_up
from hplan.base.kernels import kernel
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.clearance_kernels import FieldArrays, segment_is_clear

#: What a corner adds to the time of a path [s].
CORNER_S = 0.02

#: Shortcuts tried.
ROUNDS = 100

#: Ends of shortcuts within this fraction of a segment from a waypoint are put there.
NEAR = 0.1


def path_time(path: FloatArray, velocity: FloatArray) -> float:
    """About how long a motion along waypoints takes: at the velocity limits, and a little for each corner [s]."""
    return float((np.abs(np.diff(path, axis=0)) / velocity).max(axis=1).sum() + CORNER_S * (len(path) - 2))


def quicken(
    path: FloatArray, field: ClearanceField, velocity: FloatArray, *, margin: float, rounds: int = ROUNDS
) -> FloatArray:
    """Make a clear path quicker.

    Args:
        path: (m, dof) waypoints, shown clear.
        field: Arm and obstacles.
        velocity: (dof,) velocity limits [rad/s].
        margin: Clearance asked of shortcuts wherever they are evaluated [m]; what stays of the path keeps its own.
        rounds: Number of shortcuts tried.

    Returns:
        (k, dof) waypoints from the same start to the same goal, shown clear, its `path_time` never longer.
    """
    quicker = _quicken(np.array(path), 1.0 / velocity, field.arrays, margin, rounds)
    check_deadline()
    return frozen(quicker)


@kernel
def _quicken(path: FloatArray, slowness: FloatArray, field: FieldArrays, margin: float, rounds: int) -> FloatArray:
    """Try shortcuts between pairs of points of a low-discrepancy sequence, as `hplan.optimization.shortcut` does."""
    dof = path.shape[1]
    ends = np.empty((2, dof))
    for attempt in range(rounds):
        count = path.shape[0]
        if count < 3 or is_up(field.until):
            break
        clock = np.zeros(count)
        for m in range(1, count):
            clock[m] = clock[m - 1] + motion_time(path[m - 1], path[m], slowness)
        first = (0.5 + (attempt + 1) * 0.7548776662466927) % 1.0
        reach = ((0.5 + (attempt + 1) * 0.5698402909980532) % 1.0) / (1 << (attempt % 4))
        i, leave = _place(clock, first * clock[count - 1])
        j, arrive = _place(clock, min(1.0, first + reach) * clock[count - 1])
        if i >= j:
            continue
        for k in range(dof):
            ends[0, k] = path[i, k] + leave * (path[i + 1, k] - path[i, k])
            ends[1, k] = path[j, k] + arrive * (path[j + 1, k] - path[j, k])
        head = i + 2 if leave == 1.0 else i + 1  # waypoints before the shortcut
        tail = j if arrive == 0.0 else j + 1  # the first after it
        corners = (1 if 0.0 < leave < 1.0 else 0) + (1 if 0.0 < arrive < 1.0 else 0)
        before = clock[j] + arrive * (clock[j + 1] - clock[j]) - clock[i] - leave * (clock[i + 1] - clock[i])
        saved = before - motion_time(ends[0], ends[1], slowness) + CORNER_S * (tail - head - corners)
        if saved > 1e-6 and segment_is_clear(ends[0], ends[1], field, margin):
            joined = np.empty((head + corners + count - tail, dof))
            for k in range(dof):
                for m in range(head):
                    joined[m, k] = path[m, k]
                if 0.0 < leave < 1.0:
                    joined[head, k] = ends[0, k]
                if 0.0 < arrive < 1.0:
                    joined[head + corners - 1, k] = ends[1, k]
                for m in range(tail, count):
                    joined[head + corners + m - tail, k] = path[m, k]
            path = joined
    return path


@kernel
def motion_time(start: FloatArray, end: FloatArray, slowness: FloatArray) -> float:
    """Least time of the straight motion at the velocity limits [s]."""
    time = 0.0
    for k in range(len(start)):
        time = max(time, abs(end[k] - start[k]) * slowness[k])
    return time


@kernel
def _place(clock: FloatArray, at: float) -> tuple[int, float]:
    """The segment that a time falls into, and the fraction of it there; 0 or 1 near its ends."""
    m = 0
    while m + 2 < len(clock) and clock[m + 1] < at:
        m += 1
    span = clock[m + 1] - clock[m]
    fraction = (at - clock[m]) / span if span > 0.0 else 0.0
    if fraction < NEAR:
        fraction = 0.0
    elif fraction > 1.0 - NEAR:
        fraction = 1.0
    return m, fraction
