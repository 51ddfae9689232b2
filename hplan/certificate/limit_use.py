"""Use of the joint limits along a motion of cubics between rows, bounded for all times."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.base.kernels import kernel
from hplan.certificate.torque_bound import largest_torques
from hplan.robot.model import Robot
from hplan.trajectory.trajectory import Trajectory


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
    """Bound the use of each limit over a motion's cubics, and by its columns for velocity, acceleration and torque.

    The acceleration is linear within a piece, velocity and position have their extremes at rows or where acceleration
    and velocity are zero; torques as in `hplan.certificate.torque_bound`.

    Args:
        bezier: (pieces, 4, dof) its cubics.
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
    return LimitUse(
        position=_finite_or_inf(position),
        velocity=fraction_of(peak_velocity, robot.velocity_limit),
        acceleration=fraction_of(peak_acceleration, robot.acceleration_limit),
        torque=fraction_of(peak_torque, robot.torque_limit),
    )


@kernel
def _peaks(bezier: FloatArray, duration: FloatArray, middle: FloatArray) -> FloatArray:
    """(3, dof) largest distances of cubics from a (dof,) configuration, largest |velocity| and |acceleration|."""
    peaks = np.zeros((3, len(middle)))
    for j in range(len(middle)):
        low, high, offset, speed, push = bezier[0, 0, j], bezier[0, 0, j], 0.0, 0.0, 0.0
        for piece in range(len(bezier)):
            low, high = (
                min(low, bezier[piece, 0, j], bezier[piece, 3, j]),
                max(high, bezier[piece, 0, j], bezier[piece, 3, j]),
            )
        for piece in range(len(bezier)):
            h = duration[piece]
            p0, p1, p2, p3 = bezier[piece, 0, j], bezier[piece, 1, j], bezier[piece, 2, j], bezier[piece, 3, j]
            d0, d1, d2 = p1 - p0, p2 - p1, p3 - p2
            offset = _larger(_larger(offset, p0 - middle[j]), p3 - middle[j])
            # Of most pieces all points lie between the extremes of the ends, and with them the cubic.
            if not (low <= p1 <= high and low <= p2 <= high):
                for at in _turning_points(d0, d1, d2):
                    u = 1.0 - at
                    value = u * u * u * p0 + 3.0 * u * u * at * p1 + 3.0 * u * at * at * p2 + at * at * at * p3
                    offset = _larger(offset, value - middle[j])
            first, last = 6.0 * (d1 - d0) / (h * h), 6.0 * (d2 - d1) / (h * h)
            push = _larger(_larger(push, first), last)
            speed = _larger(_larger(speed, 3.0 * d0 / h), 3.0 * d2 / h)
            if first * last < 0.0:
                at = first / (first - last)
                speed = _larger(speed, 3.0 * d0 / h + h * at * (first + 0.5 * at * (last - first)))
        peaks[0, j], peaks[1, j], peaks[2, j] = offset, speed, push
    return peaks


@kernel
def _larger(largest: float, value: float) -> float:
    """The larger one of a number and the size of another; infinite where that is none."""
    return max(largest, abs(value)) if abs(value) < math.inf else math.inf


@kernel
def _turning_points(d0: float, d1: float, d2: float) -> tuple[float, float]:
    """Where a cubic turns around in its piece, 0 for nowhere, from the differences of its Bezier points."""
    # Of numbers of size one no square overflows.
    size = max(abs(d0), abs(d1), abs(d2), 1e-300)
    d0, d1, d2 = d0 / size, d1 / size, d2 / size
    # Of bent t^2 + 2 half_turn t + d0, without a difference of numbers nearly the same.
    bent, half_turn = d0 - 2.0 * d1 + d2, d1 - d0
    root = math.sqrt(max(half_turn * half_turn - bent * d0, 0.0))
    sum_of_both = -(half_turn + math.copysign(root, half_turn))
    one, other = sum_of_both / bent, d0 / sum_of_both
    return one if 0.0 < one < 1.0 else 0.0, other if 0.0 < other < 1.0 else 0.0


def fraction_of(peak: FloatArray, limit: FloatArray) -> float:
    """Largest fraction of a limit; a joint that does not move may have a limit of zero."""
    idle = (peak <= 1e-9) & (limit <= 0.0)
    with np.errstate(over="ignore"):
        return _finite_or_inf(np.where(idle, 0.0, peak / np.where(limit > 0.0, limit, 1e-300)))


def _finite_or_inf(values: FloatArray) -> float:
    """The largest of some values; infinite where one is not a number."""
    return float(np.where(np.isnan(values), np.inf, values).max())
