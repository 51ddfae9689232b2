"""Use of the joint limits along a motion of cubics between rows, bounded for all times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray
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
    h = duration[:, None]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        position = _largest_offset(bezier, middle) / half
        # Derivatives of the cubic: velocity (quadratic, three Bezier points), acceleration (linear, its two ends).
        velocity = 3.0 * np.diff(bezier, axis=1) / h[:, None]
        acceleration = 2.0 * np.diff(velocity, axis=1) / h[:, None]
        start, end = acceleration[:, 0], acceleration[:, 1]
        turning = start * end < 0.0
        at = np.where(turning, start / np.where(turning, start - end, 1.0), 0.0)
        inner = velocity[:, 0] + h * at * (start + 0.5 * at * (end - start))
        speeds = (velocity[:, 0], velocity[:, 2], inner, trajectory.velocity)
        pushes = (start, end, trajectory.acceleration)
        peak_velocity, peak_acceleration = (
            np.max([np.abs(values).max(axis=0) for values in parts], axis=0) for parts in (speeds, pushes)
        )
    peak_torque = np.maximum(
        largest_torques(robot.dynamics, bezier, duration, robot.torque_limit), np.abs(trajectory.torque).max(axis=0)
    )
    return LimitUse(
        position=_finite_or_inf(position),
        velocity=fraction_of(peak_velocity, robot.velocity_limit),
        acceleration=fraction_of(peak_acceleration, robot.acceleration_limit),
        torque=fraction_of(peak_torque, robot.torque_limit),
    )


def _largest_offset(bezier: FloatArray, middle: FloatArray) -> FloatArray:
    """(dof,) largest distance of cubics of (pieces, 4, dof) Bezier points from a (dof,) configuration."""
    ends = bezier[:, ::3]
    low, high = ends.min(axis=(0, 1)), ends.max(axis=(0, 1))
    largest: FloatArray = np.maximum(high - middle, middle - low)
    # Of most pieces all points lie between the extremes of the ends, and with them the cubic.
    between = ((bezier >= low) & (bezier <= high)).all(axis=(1, 2))
    if between.all():
        return largest
    inner: FloatArray = np.abs(_extremes(bezier[~between]) - middle).max(axis=(0, 1))
    return np.maximum(largest, inner)


def _extremes(bezier: FloatArray) -> FloatArray:
    """(pieces, 4, dof) values of cubics of (pieces, 4, dof) Bezier points, the extremes among them.

    At both ends, and where the derivative is zero; what is no number, or has none, stays none.
    """
    change = np.diff(bezier, axis=1)
    # Of numbers of size one no square overflows.
    change = change / np.maximum(np.abs(change).max(axis=1, keepdims=True), 1e-300)
    bent, half_turn, first = change[:, 0] - 2.0 * change[:, 1] + change[:, 2], change[:, 1] - change[:, 0], change[:, 0]
    # Of bent t^2 + 2 half_turn t + first, without a difference of numbers nearly the same.
    root = np.sqrt(np.maximum(half_turn * half_turn - bent * first, 0.0))
    sum_of_both = -(half_turn + np.copysign(root, half_turn))
    found = [bezier[:, 0], bezier[:, 3]]
    for zero in (sum_of_both / bent, first / sum_of_both):
        t = np.where((zero > 0.0) & (zero < 1.0), zero, 0.0)[:, None]
        points = bezier
        for _ in range(3):  # de Casteljau
            points = points[:, :-1] + t * (points[:, 1:] - points[:, :-1])
        found.append(points[:, 0])
    values: FloatArray = np.stack(found, axis=1)
    return np.where(np.isfinite(bezier).all(axis=1, keepdims=True), values, np.nan)


def fraction_of(peak: FloatArray, limit: FloatArray) -> float:
    """Largest fraction of a limit; a joint that does not move may have a limit of zero."""
    idle = (peak <= 1e-9) & (limit <= 0.0)
    with np.errstate(over="ignore"):
        return _finite_or_inf(np.where(idle, 0.0, peak / np.where(limit > 0.0, limit, 1e-300)))


def _finite_or_inf(values: FloatArray) -> float:
    """The largest of some values; infinite where one is not a number."""
    return float(np.where(np.isnan(values), np.inf, values).max())
