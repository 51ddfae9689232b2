"""Bounds, at all times, of a polynomial motion's use of the limits."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.base.kernels import kernel
from hplan.certificate.torque_bound import largest_torques
from hplan.robot.model import Robot
from hplan.trajectory.time_scaling import timing_limits
from hplan.trajectory.trajectory import Trajectory

#: A hull that exceeds the known maximum by at most this fraction counts as equal; and the maximum number of halvings.
_SAME_PEAK, _MOST_HALVINGS = 1e-12, 26


@dataclass(frozen=True)
class LimitUse:
    """Upper bound of the used fraction of each limit.

    It holds at all times. Infinite if numbers overflow.

    Attributes:
        position: Maximum distance from the middle of the joint range, as a fraction of half the range: 1 at a limit.
        velocity: Maximum |velocity| / limit.
        acceleration: Maximum |acceleration| / limit.
        torque: Maximum |torque| / limit.
    """

    position: float
    velocity: float
    acceleration: float
    torque: float

    @classmethod
    def largest(cls, parts: Iterable[LimitUse]) -> LimitUse:
        """The largest use of each limit by several motions.

        Examples:
            >>> LimitUse.largest([LimitUse(0.1, 0.9, 0.2, 0.3), LimitUse(0.2, 0.8, 0.1, 0.4)])
            LimitUse(position=0.2, velocity=0.9, acceleration=0.2, torque=0.4)
        """
        uses = ((part.position, part.velocity, part.acceleration, part.torque) for part in parts)
        return cls(*map(max, zip(*uses, strict=True)))


def limit_use(robot: Robot, trajectory: Trajectory, bezier: FloatArray, duration: FloatArray) -> LimitUse:
    """Bound the use of each limit over a motion's segments.

    The columns of the trajectory for velocity, acceleration and torque count as well. Position, velocity and
    acceleration are bounded by the Bezier points of halved segments (`_peak`), torques as in
    `hplan.certificate.torque_bound`. Along straight lines between samples velocities jump: acceleration and torque are
    infinite unless the arm rests.

    Args:
        bezier: (pieces, 4 or 6, dof) Bezier points of the trajectory's segments.
        duration: (pieces,) their durations [s].
    """
    _, at, fast, pushed, turned = trajectory.rows
    bounds = largest_torques(robot.dynamics, bezier, duration, robot.torque_limit)
    joints = timing_limits(robot).joints
    uses = _fractions(np.ascontiguousarray(bezier), duration, fast, pushed, turned, bounds, joints)
    position, velocity, acceleration, torque = uses.tolist()
    if trajectory.interpolation == "linear" and (np.diff(at, axis=0) != 0.0).any():
        acceleration = torque = math.inf
    return LimitUse(position, velocity, acceleration, torque)


@kernel
def _fractions(
    bezier: FloatArray,
    duration: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    torque: FloatArray,
    bounds: FloatArray,
    joints: FloatArray,
) -> FloatArray:
    """(4,) uses of position, velocity, acceleration and torque limits.

    Args:
        bezier: (pieces, 4 or 6, dof) Bezier points.
        duration: (pieces,) durations [s].
        velocity: (n, dof) velocities of the samples.
        acceleration: (n, dof) accelerations of the samples.
        torque: (n, dof) torques of the samples.
        bounds: (dof,) bounds of |torque| at all times.
        joints: The limits, as of `TimingLimits`.
    """
    dof = bezier.shape[2]
    middle, half, turned, found = np.empty(dof), np.empty(dof), np.empty(dof), np.empty(4)
    for j in range(dof):
        middle[j], half[j] = 0.5 * (joints[0, j] + joints[1, j]), 0.5 * (joints[1, j] - joints[0, j])
        turned[j] = bounds[j]
    peaks = _peaks(bezier, duration, middle)
    for j in range(dof):
        for k in range(len(velocity)):
            peaks[1, j] = _larger(peaks[1, j], velocity[k, j])
            peaks[2, j] = _larger(peaks[2, j], acceleration[k, j])
            turned[j] = _larger(turned[j], torque[k, j])
    found[0] = 0.0
    for j in range(dof):
        found[0] = _larger(found[0], peaks[0, j] / half[j])
    found[1] = fraction_of(peaks[1], joints[2])
    found[2] = fraction_of(peaks[2], joints[3])
    found[3] = fraction_of(turned, joints[4])
    return found


@kernel
def _peaks(bezier: FloatArray, duration: FloatArray, middle: FloatArray) -> FloatArray:
    """(3, dof) maximum distance from a configuration, |velocity| and |acceleration|."""
    segments, points, dof = bezier.shape
    degree, peaks = points - 1.0, np.zeros((3, dof))
    work, levels = np.empty((_MOST_HALVINGS + 1, points)), np.zeros(_MOST_HALVINGS + 1, dtype=np.int64)
    for j in range(dof):
        for segment in range(segments):
            h = duration[segment]
            for n in range(points):
                work[0, n] = bezier[segment, n, j] - middle[j]
            peaks[0, j] = _peak(work, levels, points, peaks[0, j])
            for n in range(points - 1):
                work[0, n] = degree * (bezier[segment, n + 1, j] - bezier[segment, n, j]) / h
            peaks[1, j] = _peak(work, levels, points - 1, peaks[1, j])
            for n in range(points - 2):
                first = bezier[segment, n + 1, j] - bezier[segment, n, j]
                bent = bezier[segment, n + 2, j] - bezier[segment, n + 1, j] - first
                work[0, n] = degree * (degree - 1.0) * bent / (h * h)
            peaks[2, j] = _peak(work, levels, points - 2, peaks[2, j])
    return peaks


@kernel
def _peak(work: FloatArray, levels: IntArray, points: int, known: float) -> float:
    """Maximum absolute value of a polynomial; infinite if it overflows.

    The result is at least `known`. The polynomial lies in the hull of its Bezier points, and its ends are two of them.
    If the hull exceeds the known maximum, the polynomial is halved, which quarters the excess of the hull.

    Args:
        work: The first row holds the Bezier points; the others are buffers for halves.
        levels: Buffer for the number of halvings of each half.
        points: Number of Bezier points.
        known: Maximum known before the call.
    """
    top, levels[0] = 0, 0
    while top >= 0:
        hull = 0.0
        for n in range(points):
            hull = _larger(hull, work[top, n])
        if hull == math.inf:
            return math.inf
        known = max(known, abs(work[top, 0]), abs(work[top, points - 1]))
        if hull <= known * (1.0 + _SAME_PEAK) or levels[top] == _MOST_HALVINGS:
            known = max(known, hull)
            top -= 1
            continue
        # The second half replaces the whole; the first half goes on top of the stack and is processed next.
        level = levels[top] + 1
        for n in range(points):
            work[top + 1, n] = work[top, 0]
            for m in range(points - 1 - n):
                work[top, m] = 0.5 * (work[top, m] + work[top, m + 1])
        levels[top], levels[top + 1] = level, level
        top += 1
    return known


@kernel
def _larger(largest: float, value: float) -> float:
    """max(a, |b|), with NaN treated as infinity."""
    return max(largest, abs(value)) if abs(value) < math.inf else math.inf


@kernel
def fraction_of(peak: FloatArray, limit: FloatArray) -> float:
    """Maximum fraction of (dof,) limits; a resting joint may have limit zero."""
    largest = 0.0
    for j in range(len(peak)):
        if peak[j] > 1e-9 or limit[j] > 0.0:
            largest = _larger(largest, peak[j] / (limit[j] if limit[j] > 0.0 else 1e-300))
    return largest
