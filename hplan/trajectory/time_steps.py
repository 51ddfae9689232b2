"""Clock steps of a retimed motion, one per new sample (`hplan.trajectory.time_scaling`).

A step must satisfy bounds on the first, second and third differences of the new control points and on the torques at
the sample. All are, to first order, linear in the step, so each gives an interval of steps; the step in their
intersection nearest to the requested one is taken, and the intervals are recomputed there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray, frozen
from hplan.base.kernels import kernel
from hplan.robot.dynamics import newton_euler
from hplan.trajectory.cubics import RESTING, Rows, bezier_slope, bezier_value

#: Number of samples over which the offset at the seam is faded out.
FADED = 100

#: Changes of the step are planned ahead with this fraction of the jerk limit.
AHEAD = 0.8

#: Maximum number of corrections of a step, and differences that count as zero [rad].
LOOKS, ROUNDING = 16, 1e-13

#: If no step satisfies the limits, this many previous samples are repeated with their changes scaled by `LESS`, twice
#: as many after each further failure; at most `MOST_RETURNS` times.
BACK, LESS, MOST_RETURNS = 6, 0.7, 200

#: A joint that reaches its limit may exceed it by this distance [rad].
LIMIT_TOLERANCE = 2e-7

#: Tolerances, as fractions: samples may exceed limits of velocity, acceleration and torque by the first, or by up to
#: the second if the motion itself exceeds them; jerk limits by the third. A larger excess of the motion itself is
#: permitted, but not increased.
SPARE, MOST_SPARE, SPARE_JERK = 7e-4, 9.5e-4, 0.03

#: Smaller jumps of the acceleration are ignored [rad/s^2].
SMOOTH = 1e-4


class Course(NamedTuple):
    """A motion prepared for new timings, which may start at any sample.

    Attributes:
        bezier: (pieces, 4, dof) cubics of the motion.
        time: (n,) times of its samples [s].
        states: (3, n, dof) position, velocity and acceleration of the samples.
        largest: (7, n, dof) maximum magnitudes from each sample on: velocity, acceleration (of the samples, and of the
            cubics too), torque, jump of the acceleration from one cubic to the next, jerk, acceleration of the cubics
            alone; and the maximum position.
        least: (n, dof) minimum position from each sample on.
    """

    bezier: FloatArray
    time: FloatArray
    states: FloatArray
    largest: FloatArray
    least: FloatArray

    @classmethod
    def build(cls, rows: Rows) -> Course:
        """Prepare a motion of at least two samples."""
        bezier, states, largest, least = _prepare(*rows)
        return cls(frozen(bezier), rows.time, frozen(states), frozen(largest), frozen(least))


class TimingLimits(NamedTuple):
    """Limits of an arm for new timings.

    Attributes:
        joints: (6, dof) minimum and maximum position, velocity, acceleration, torque and jerk; infinite for no limit.
        bodies: The arm's bodies as for `newton_euler`; empty if torque is not limited.
        gravity: (3,) gravity [m/s^2].
    """

    joints: FloatArray
    bodies: FloatArray
    gravity: FloatArray


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
def _prepare(
    time: FloatArray, position: FloatArray, velocity: FloatArray, acceleration: FloatArray, torque: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """`bezier`, `states`, `largest` and `least` of a `Course`, from its samples."""
    n, dof = position.shape
    bezier, states = np.empty((n - 1, 4, dof)), np.empty((3, n, dof))
    largest, least, bent = np.zeros((7, n, dof)), np.empty((n, dof)), np.zeros((2, n, dof))
    for row in range(n - 1, -1, -1):
        above = min(row + 1, n - 1)
        for j in range(dof):
            q = position[row, j]
            states[0, row, j], states[1, row, j], states[2, row, j] = q, velocity[row, j], acceleration[row, j]
            jump, jerk = 0.0, 0.0
            if row < n - 1:
                h = time[row + 1] - time[row]
                third = h / 3.0
                one, two = q + third * velocity[row, j], position[row + 1, j] - third * velocity[row + 1, j]
                bezier[row, 0, j], bezier[row, 1, j], bezier[row, 2, j] = q, one, two
                bezier[row, 3, j] = position[row + 1, j]
                bent[0, row, j] = 6.0 * ((two - one) - (one - q)) / (h * h)
                bent[1, row, j] = 6.0 * ((position[row + 1, j] - two) - (two - one)) / (h * h)
                jerk = abs(bent[1, row, j] - bent[0, row, j]) / h
                if row < n - 2:
                    jump = abs(bent[0, row + 1, j] - bent[1, row, j])
            highest = max(abs(bent[0, row, j]), abs(bent[1, row, j]))
            largest[0, row, j] = max(largest[0, above, j], abs(velocity[row, j]))
            largest[1, row, j] = max(largest[1, above, j], highest, abs(acceleration[row, j]))
            largest[2, row, j] = max(largest[2, above, j], abs(torque[row, j]))
            largest[3, row, j] = max(largest[3, above, j], jump)
            largest[4, row, j] = max(largest[4, above, j], jerk)
            largest[5, row, j] = max(largest[5, above, j], highest)
            largest[6, row, j] = q if row == n - 1 else max(largest[6, above, j], q)
            least[row, j] = q if row == n - 1 else min(least[above, j], q)
    return bezier, states, largest, least


@kernel
def retime(
    course: Course, row: int, limits: TimingLimits, factors: FloatArray, period: float, final: int
) -> tuple[int, bool, FloatArray, FloatArray, FloatArray]:
    """Compute a motion retimed from a sample on, at a fixed sampling period.

    The limits are the arm's, or the motion's own from that sample on if those are higher.

    Args:
        course: The motion.
        row: Index of the first sample of the new timing, not the last.
        limits: Limits of the arm.
        factors: (rows,) requested speed factors, from that sample on.
        period: Time between samples [s].
        final: From this sample on the motion ends once it is at rest.

    Returns:
        Status as of `run_clock`, or 3 if the motion would end at another speed than before; whether the positions keep
        the position limits; (n,) times of the samples in the original motion, from `row` on [s]; (3, n, dof) positions,
        velocities and accelerations; (dof,) upper bounds of the displacement off the path [rad].
    """
    n, dof = len(course.time), course.bezier.shape[2]
    bezier, time, begin_s = course.bezier[row:], np.empty(n - row), course.time[row]
    for k in range(n - row):
        time[k] = course.time[row + k] - begin_s
    duration = time[n - row - 1]
    rests = _is_at_rest(course.states, row)
    points, clock, fade = _begin(course, row, duration, period, factors[0] if rests else 1.0)
    kept = _keep_or_repair(course, row, limits, period)
    nothing, off = np.empty((3, 0, dof)), np.zeros(dof)
    outcome, count, clock, points = run_clock(Clocks(bezier, time, points, clock, fade, factors), kept, period, final)
    if outcome != 0:
        return outcome, False, clock, nothing, off
    if clock[count - 1] > duration and not _is_at_rest(course.states, n - 1):
        return 3, False, clock, nothing, off
    states, taken, is_within, fastest, piece = np.empty((3, count - 2, dof)), np.empty(count - 2), True, 0.0, 0
    for k in range(count):
        at = min(max(clock[k], 0.0), duration)
        while piece < n - row - 2 and at >= time[piece + 1]:
            piece += 1
        while piece > 0 and at < time[piece]:
            piece -= 1
        t = (at - time[piece]) / (time[piece + 1] - time[piece])
        if k > 0:
            fastest = max(fastest, clock[k] - clock[k - 1])
        if 0 < k < count - 1:
            taken[k - 1] = at
        for j in range(dof):
            here = points[k, j]
            if k > 0:
                on_path = bezier_value(
                    bezier[piece, 0, j], bezier[piece, 1, j], bezier[piece, 2, j], bezier[piece, 3, j], t
                )
                # Before the seam the path is extended backwards.
                on_path += min(clock[k], 0.0) * course.states[1, row, j]
                off[j] = max(off[j], abs(here - on_path))
            if not 0 < k < count - 1:
                continue
            before, after = points[k - 1, j], points[k + 1, j]
            states[0, k - 1, j] = (before + 4.0 * here + after) / 6.0
            states[1, k - 1, j] = 0.5 * ((after - here) + (here - before)) / period
            states[2, k - 1, j] = ((after - here) - (here - before)) / (period * period)
    last = count - 3
    for j in range(dof):
        states[0, last, j], states[1, last, j], states[2, last, j] = points[count - 1, j], 0.0, 0.0
        for order in range(3):
            states[order, 0, j] = course.states[order, row, j]
        # From the path itself: the samples' accelerations need not agree with it.
        off[j] += fastest * fastest / 6.0 * course.largest[5, row, j]
        low = min(limits.joints[0, j], course.least[row, j]) - LIMIT_TOLERANCE
        high = max(limits.joints[1, j], course.largest[6, row, j]) + LIMIT_TOLERANCE
        for k in range(count - 2):
            is_within &= low <= states[0, k, j] <= high
    return 0, is_within, taken, states, off


@kernel
def _is_at_rest(states: FloatArray, row: int) -> bool:
    """True if a motion is at rest at a sample, as `Rows.is_at_rest`."""
    rests = True
    for j in range(states.shape[2]):
        rests &= abs(states[1, row, j]) <= RESTING and abs(states[2, row, j]) <= RESTING
    return rests


@kernel
def _begin(
    course: Course, row: int, duration: float, period: float, factor: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """First control points of a new timing, their times, and the offset that is faded out.

    Args:
        course: The motion.
        row: Index of the first sample of the new timing.
        duration: Duration of the motion from that sample on [s].
        period: Time between samples [s].
        factor: Initial speed factor; 1 if the motion is not at rest there.

    Returns:
        (3, dof) control points; (3,) their times on the motion's own clock [s]; (3, dof) the offset from the path at
        the last of them, its derivative with respect to time [rad/s], and, in the first column of the last row, the
        fading time [s].
    """
    dof, moves = course.bezier.shape[2], False
    points, clock, fade = np.empty((3, dof)), np.empty(3), np.zeros((3, dof))
    for j in range(dof):
        moves |= course.states[1, row, j] != 0.0 or course.states[2, row, j] != 0.0
    moves &= factor > 0.0
    for k in range(3):
        clock[k] = (k - 1.0) * (period * factor)
        if not moves:
            clock[k] = min(clock[k], 0.0)
    # The piece of the path at the last of these times, and the time within it.
    last, piece, at = len(course.bezier) - 1, row, min(clock[2], duration) + course.time[row]
    while piece < last and at >= course.time[piece + 1]:
        piece += 1
    t = min((at - course.time[piece]) / (course.time[piece + 1] - course.time[piece]), 1.0)
    for j in range(dof):
        q, v, a = course.states[0, row, j], course.states[1, row, j], course.states[2, row, j]
        if not moves:
            points[0, j], points[1, j], points[2, j] = q, q, q
            continue
        middle, aside = q - period * period / 6.0 * a, 0.5 * period * period * a
        points[0, j], points[1, j] = middle - period * v + aside, middle
        points[2, j] = middle + period * v + aside
        bezier = course.bezier
        fade[0, j] = points[2, j] - bezier_value(
            bezier[piece, 0, j], bezier[piece, 1, j], bezier[piece, 2, j], bezier[piece, 3, j], t
        )
        fade[1, j] = (fade[0, j] - (points[1, j] - q)) / period
    fade[2, 0] = min(FADED * period, duration - clock[2])
    return points, clock, fade


@kernel
def _keep_or_repair(course: Course, row: int, limits: TimingLimits, period: float) -> Kept:
    """Limits of a new timing: the arm's, or the motion's if higher."""
    dof = course.bezier.shape[2]
    steps, torque = np.empty((3, dof)), np.empty(dof)
    for j in range(dof):
        steps[0, j] = period * _usable_limit(limits.joints[2, j], course.largest[0, row, j])
        steps[1, j] = period * period * _usable_limit(limits.joints[3, j], course.largest[1, row, j])
        torque[j] = _usable_limit(limits.joints[4, j], course.largest[2, row, j])
        # A jump of the acceleration from one cubic to the next takes one period.
        jump = course.largest[3, row, j] if course.largest[3, row, j] > SMOOTH else 0.0
        own = course.largest[4, row, j] + jump / period
        steps[2, j] = period * period * period * max(limits.joints[5, j], own) * (1.0 + SPARE_JERK)
    return Kept(steps, torque, limits.bodies, limits.gravity)


@kernel
def _usable_limit(limit: float, own: float) -> float:
    """Usable limit: slightly above the motion's own use, within `MOST_SPARE`.

    A stop of a motion that is already a stop therefore satisfies its limits, too.
    """
    most = max(own, limit * (1.0 + MOST_SPARE))
    return max(limit * (1.0 + SPARE), min(own * (1.0 + SPARE), most))


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
    found, work = np.empty((2, dof)), np.empty((8, dof))
    returns, back, farthest = 0, BACK, 2
    i = len(clocks.clock) - 1
    while i < rows - 1:
        done = tau[i - 2] >= end or (i >= final and tau[i] == tau[i - 2])
        if done:
            return 0, i + 1, tau, points
        before = tau[i] - tau[i - 1]
        wanted = clocks.factors[i] * period
        step, ok = before, False
        # Torques are most of the cost: a step without regard to them is tried first, and kept if it satisfies them.
        for regards_torque in range(2):
            step = before
            for look in range(LOOKS):
                _write_point(clocks, tau[i] + step, found)
                low, high, ahead = _interval(points, i, found, kept, period, work, regards_torque == 1)
                ok = low <= high and step + high >= 0.0
                if not ok:
                    break
                aim = _step_towards(before, wanted, ahead, most[i])
                new = min(max(aim, step + low), step + high)
                new = max(new, 0.0)
                if abs(new - step) <= 1e-9 * period and (look > 0 or new == step):
                    break
                step = new
            if not ok:
                break
            _write_point(clocks, tau[i] + step, found)
            if regards_torque == 1 or _keeps_torque(points, i, found, kept, period, work):
                break
        if ok:
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
    points: FloatArray,
    i: int,
    found: FloatArray,
    kept: Kept,
    period: float,
    work: FloatArray,
    regards_torque: bool,
) -> tuple[float, float, float]:
    """Interval of feasible step corrections, and the maximum change of their change.

    The maximum is per sample. The interval is empty if no correction satisfies the limits; torque limits count only
    with `regards_torque`.
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
    if not regards_torque or kept.bodies.shape[0] == 0:
        return low, high, ahead
    more = 0.05 * period
    _torques(points, i, found, more, kept, period, work, 2)
    for j in range(dof):
        torque = work[0, j]
        rate = (work[1, j] - torque) / more
        if abs(rate) * period > 1e-9 * kept.torque[j]:
            a, b = (-kept.torque[j] - torque) / rate, (kept.torque[j] - torque) / rate
            low, high = max(low, min(a, b)), min(high, max(a, b))
        elif abs(torque) > kept.torque[j]:
            return 1.0, 0.0, ahead
    return low, high, ahead


@kernel
def _keeps_torque(points: FloatArray, i: int, found: FloatArray, kept: Kept, period: float, work: FloatArray) -> bool:
    """True if the torques at a sample are within their limits."""
    if kept.bodies.shape[0] == 0:
        return True
    _torques(points, i, found, 0.0, kept, period, work, 1)
    keeps = True
    for j in range(points.shape[1]):
        keeps &= abs(work[0, j]) <= kept.torque[j]
    return keeps


@kernel
def _torques(
    points: FloatArray, i: int, found: FloatArray, more: float, kept: Kept, period: float, work: FloatArray, count: int
) -> None:
    """Write the torques at a sample into the first `count` rows of `work`; the last six are a buffer.

    In the second row the next point is moved on by `more`, a part of a step.
    """
    for j in range(points.shape[1]):
        for row in range(count):
            after = found[0, j] + row * more * found[1, j]
            work[2 + row, j] = (points[i - 1, j] + 4.0 * points[i, j] + after) / 6.0
            work[4 + row, j] = (after - points[i - 1, j]) / (2.0 * period)
            work[6 + row, j] = (after - 2.0 * points[i, j] + points[i - 1, j]) / (period * period)
    newton_euler(work[2 : 2 + count], work[4 : 4 + count], work[6 : 6 + count], kept.bodies, kept.gravity, work)
