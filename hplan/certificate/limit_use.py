"""Use of the joint limits along a motion of polynomials between rows, bounded for all times."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.base.kernels import kernel
from hplan.certificate.torque_bound import largest_torques
from hplan.robot.model import Robot
from hplan.trajectory.trajectory import Trajectory

#: A hull larger than what is known by no more than this part is as large; and how often a polynomial is halved at most.
_SAME_PEAK, _MOST_HALVINGS = 1e-12, 26


@dataclass(frozen=True)
class LimitUse:
    """Upper bound of the fraction of each limit that a trajectory uses, at all times; infinite where numbers overflow.

    Attributes:
        position: Largest distance from the middle of the joint range, as a fraction of half the range: 1 at a limit.
        velocity: Largest |velocity| / limit.
        acceleration: Largest |acceleration| / limit.
        torque: Largest |torque| / limit.
    """

    position: float
    velocity: float
    acceleration: float
    torque: float


def limit_use(robot: Robot, trajectory: Trajectory, bezier: FloatArray, duration: FloatArray) -> LimitUse:
    """Bound the use of each limit over a motion's segments, and by its columns for velocity, acceleration and torque.

    Position, velocity and acceleration are bounded by Bezier points of halved segments (`_peak`), torques as in
    `hplan.certificate.torque_bound`. Along straight lines between rows velocities jump: acceleration and torque are
    infinite unless the arm stands still.

    Args:
        bezier: (pieces, 4 or 6, dof) its segments.
        duration: (pieces,) their durations [s].
    """
    middle, half = 0.5 * (robot.lower + robot.upper), 0.5 * (robot.upper - robot.lower)
    offset, speed, push = _peaks(np.ascontiguousarray(bezier), duration, middle)
    peak_velocity = np.maximum(speed, np.abs(trajectory.velocity).max(axis=0))
    peak_acceleration = np.maximum(push, np.abs(trajectory.acceleration).max(axis=0))
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        position = offset / half
    peak_torque = np.maximum(
        largest_torques(robot.dynamics, bezier, duration, robot.torque_limit), np.abs(trajectory.torque).max(axis=0)
    )
    has_jumps = trajectory.interpolation == "linear" and bool((np.diff(trajectory.position, axis=0) != 0.0).any())
    return LimitUse(
        position=_finite_or_inf(position),
        velocity=fraction_of(peak_velocity, robot.velocity_limit),
        acceleration=math.inf if has_jumps else fraction_of(peak_acceleration, robot.acceleration_limit),
        torque=math.inf if has_jumps else fraction_of(peak_torque, robot.torque_limit),
    )


@kernel
def _peaks(bezier: FloatArray, duration: FloatArray, middle: FloatArray) -> FloatArray:
    """(3, dof) largest distances of segments from a configuration, largest |velocity| and |acceleration|."""
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
    """Largest size of a polynomial, or a known larger number; infinite if a number is not finite.

    The polynomial lies in the hull of its Bezier points, and its ends are two of them. Where the hull is larger than
    what is known, the polynomial is halved, which quarters what the hull is too large by.

    Args:
        work: Its first row has the Bezier points; the others are room for halves.
        levels: Room for how often each half was halved.
        points: The number of Bezier points.
        known: The size known so far.
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
        # The second half takes the place of the whole; the first one goes on top, and is looked at first.
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
    """The larger of a number and the size of another; infinite if that is not a number."""
    return max(largest, abs(value)) if abs(value) < math.inf else math.inf


def fraction_of(peak: FloatArray, limit: FloatArray) -> float:
    """Largest fraction of a limit; a joint that does not move may have a limit of zero."""
    idle = (peak <= 1e-9) & (limit <= 0.0)
    with np.errstate(over="ignore"):
        return _finite_or_inf(np.where(idle, 0.0, peak / np.where(limit > 0.0, limit, 1e-300)))


def _finite_or_inf(values: FloatArray) -> float:
    """The largest of some values; infinite where one is not a number."""
    return float(np.where(np.isnan(values), np.inf, values).max())
