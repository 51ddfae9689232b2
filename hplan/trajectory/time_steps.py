"""Clock steps of a retimed motion, one per new sample (`hplan.trajectory.time_scaling`).

A step must satisfy bounds on the first, second and third differences of the new control points and on the torques at
the sample. All are, to first order, linear in the step, so each gives an interval of steps; the step in their
intersection nearest to the requested one is taken, and the intervals are recomputed there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.base.kernels import kernel
from hplan.robot.dynamics import newton_euler
from hplan.trajectory.cubics import bezier_slope, bezier_value

#: Number of samples over which the offset at the seam is faded out.
FADED = 100

#: Changes of the step are planned ahead with this fraction of the jerk limit.
AHEAD = 0.8

#: Maximum number of corrections of a step, and differences that count as zero [rad].
LOOKS, ROUNDING = 4, 1e-13

#: If no step satisfies the limits, this many previous samples are repeated with their changes scaled by `LESS`, twice
#: as many after each further failure; at most `MOST_RETURNS` times.
BACK, LESS, MOST_RETURNS = 6, 0.7, 200


class Clocks(NamedTuple):
    """Motion and requested speed factors.

    Attributes:
        bezier: (pieces, 4, dof) cubics of the motion.
        time: (pieces + 1,) times of its samples [s].
        points: (3, dof) first control points.
        clock: (3,) their times [s].
        fade: (3, dof) offset at the seam and its fading time (`hplan.trajectory.time_scaling`).
        factors: (rows,) requested speed factors, from the second point on.
    """

    bezier: FloatArray
    time: FloatArray
    points: FloatArray
    clock: FloatArray
    fade: FloatArray
    factors: FloatArray


class Kept(NamedTuple):
    """Limits of a retimed motion.

    Attributes:
        steps: (3, dof) maximum first, second and third differences of control points [rad].
        torque: (dof,) torque limits [N m].
        bodies: The arm's bodies as for `newton_euler`; empty if torque is not limited.
        gravity: (3,) gravity [m/s^2].
    """

    steps: FloatArray
    torque: FloatArray
    bodies: FloatArray
    gravity: FloatArray


@kernel
def run_clock(clocks: Clocks, kept: Kept, period: float, final: int) -> tuple[int, int, FloatArray, FloatArray]:
    """Compute the control points of a retimed motion.

    Args:
        clocks: The motion and the requested factors.
        kept: The limits.
        period: Time between samples [s].
        final: From this sample on the motion ends once it is at rest.

    Returns:
        Status: 0 if it reaches its end, 1 if there are too few samples, 2 if no step satisfies the limits; the number
        of points; (rows,) their times on the motion's own clock [s]; (rows, dof) the points.
    """
    rows, dof = len(clocks.factors), clocks.points.shape[1]
    end = clocks.time[len(clocks.time) - 1]
    tau, points, most = np.empty(rows), np.empty((rows, dof)), np.full(rows, np.inf)
    for k in range(3):
        tau[k] = clocks.clock[k]
        for j in range(dof):
            points[k, j] = clocks.points[k, j]
    found, work = np.empty((2, dof)), np.empty((7, dof))
    returns, back, farthest = 0, BACK, 2
    i = len(clocks.clock) - 1
    while i < rows - 1:
        done = tau[i - 2] >= end or (i >= final and tau[i] == tau[i - 2])
        if done:
            return 0, i + 1, tau, points
        before = tau[i] - tau[i - 1]
        wanted = clocks.factors[i] * period
        step = before
        ok = False
        for look in range(LOOKS):
            _write_point(clocks, tau[i] + step, found)
            low, high, ahead = _interval(points, i, found, kept, period, work)
            ok = low <= high and step + high >= 0.0
            if not ok:
                break
            aim = _step_towards(before, wanted, ahead, most[i])
            new = min(max(aim, step + low), step + high)
            new = max(new, 0.0)
            if abs(new - step) <= 1e-9 * period and (look > 0 or new == step):
                break
            step = new
        if ok:
            _write_point(clocks, tau[i] + step, found)
            tau[i + 1] = tau[i] + step
            for j in range(dof):
                points[i + 1, j] = found[0, j]
            i += 1
            if i > farthest + BACK:
                back = BACK
            farthest = max(i, farthest)
            continue
        returns += 1
        if returns > MOST_RETURNS:
            return 2, i, tau, points
        first = max(2, i - back)
        for k in range(first, i):
            most[k] = LESS * min(most[k], abs(tau[k + 1] - 2.0 * tau[k] + tau[k - 1]))
        back = min(2 * back, 400)
        i = first
    return 1, rows, tau, points


@kernel
def _step_towards(before: float, wanted: float, ahead: float, most: float) -> float:
    """Next step towards a requested one, so that changes can end there.

    Args:
        before: Previous step [s].
        wanted: Requested step [s].
        ahead: Maximum change of the change from sample to sample [s].
        most: Maximum change [s].
    """
    left = abs(wanted - before)
    change = left
    if ahead < np.inf and left > ahead:
        change = min(left, 0.5 * (math.sqrt(ahead * ahead + 8.0 * ahead * left) - ahead))
    change = min(change, most)
    return before + change if wanted > before else before - change


@kernel
def _write_point(clocks: Clocks, at: float, found: FloatArray) -> None:
    """Write the point at a time of the motion, and its derivative."""
    bezier, time, fade = clocks.bezier, clocks.time, clocks.fade
    last = len(time) - 1
    inside = 0.0 <= at < time[last]
    at = min(max(at, 0.0), time[last])
    piece = min(int(np.searchsorted(time, at, side="right")) - 1, last - 1)
    h = time[piece + 1] - time[piece]
    t = (at - time[piece]) / h
    span = fade[2, 0]
    since = at - clocks.clock[2]
    x = since / span if span > 0.0 else 1.0
    for j in range(bezier.shape[2]):
        p0, p1, p2, p3 = bezier[piece, 0, j], bezier[piece, 1, j], bezier[piece, 2, j], bezier[piece, 3, j]
        found[0, j] = bezier_value(p0, p1, p2, p3, t)
        found[1, j] = bezier_slope(p0, p1, p2, p3, t) / h if inside else 0.0
        if x < 1.0:
            y = max(x, 0.0)
            value = 1.0 + y * y * y * (-10.0 + y * (15.0 - 6.0 * y))
            rate = y + y * y * y * (-6.0 + y * (8.0 - 3.0 * y))
            found[0, j] += value * fade[0, j] + span * rate * fade[1, j]
            found[1, j] += -30.0 * y * y * (1.0 - y) * (1.0 - y) / span * fade[0, j]
            found[1, j] += (1.0 + y * y * (-18.0 + y * (32.0 - 15.0 * y))) * fade[1, j]


@kernel
def _interval(
    points: FloatArray, i: int, found: FloatArray, kept: Kept, period: float, work: FloatArray
) -> tuple[float, float, float]:
    """Interval of feasible step corrections, and the maximum change of their change.

    The second value is per sample. The interval is empty if no correction satisfies the limits.
    """
    dof = points.shape[1]
    low, high, ahead = -np.inf, np.inf, np.inf
    for j in range(dof):
        now, one, two = points[i, j], points[i - 1, j], points[i - 2, j]
        least = max(now - kept.steps[0, j], 2.0 * now - one - kept.steps[1, j])
        least = max(least, 3.0 * (now - one) + two - kept.steps[2, j]) - ROUNDING
        largest = min(now + kept.steps[0, j], 2.0 * now - one + kept.steps[1, j])
        largest = min(largest, 3.0 * (now - one) + two + kept.steps[2, j]) + ROUNDING
        rate = found[1, j]
        if abs(rate) > 1e-12:
            a, b = (least - found[0, j]) / rate, (largest - found[0, j]) / rate
            low, high = max(low, min(a, b)), min(high, max(a, b))
            ahead = min(ahead, AHEAD * kept.steps[2, j] / abs(rate))
        elif not least <= found[0, j] <= largest:
            return 1.0, 0.0, ahead
    if kept.bodies.shape[0] == 0:
        return low, high, ahead
    more = 0.05 * period
    _torque(points, i, found, 0.0, kept, period, work)
    for j in range(dof):
        work[3, j] = work[2, j]
    _torque(points, i, found, more, kept, period, work)
    for j in range(dof):
        rate = (work[2, j] - work[3, j]) / more
        if abs(rate) * period > 1e-9 * kept.torque[j]:
            a, b = (-kept.torque[j] - work[3, j]) / rate, (kept.torque[j] - work[3, j]) / rate
            low, high = max(low, min(a, b)), min(high, max(a, b))
        elif abs(work[3, j]) > kept.torque[j]:
            return 1.0, 0.0, ahead
    return low, high, ahead


@kernel
def _torque(
    points: FloatArray, i: int, found: FloatArray, more: float, kept: Kept, period: float, work: FloatArray
) -> None:
    """Write the torques at a sample into the third row of `work`; the last three rows are a buffer.

    The next point is moved on by `more`, a part of a step.
    """
    dof = points.shape[1]
    for j in range(dof):
        after = found[0, j] + more * found[1, j]
        work[4, j] = (points[i - 1, j] + 4.0 * points[i, j] + after) / 6.0
        work[5, j] = (after - points[i - 1, j]) / (2.0 * period)
        work[6, j] = (after - 2.0 * points[i, j] + points[i - 1, j]) / (period * period)
    newton_euler(work[4:5], work[5:6], work[6:7], kept.bodies, kept.gravity, work[2:3])
