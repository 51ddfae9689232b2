"""Input of path timing: a geometric path, and motion limits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import number
from hplan.base.arrays import FloatArray, Record, readonly


def check_rate(rate_hz: float) -> None:
    """Check the sampling rate of a controller.

    Raises:
        OptionError: `rate_hz` is not between 1 and 100000.
    """
    number(
        "rate_hz", rate_hz, "a number of samples per second between 1 and 100000", lambda rate: 1.0 <= rate <= 100_000.0
    )


def check_speed(speed: float) -> None:
    """Check a fraction of full speed.

    Raises:
        OptionError: `speed` is not in (0, 1].
    """
    number("speed", speed, "a factor in (0, 1]", lambda factor: 0.0 < factor <= 1.0)


def rest_to_rest(
    distance: FloatArray, velocity: ArrayLike, acceleration: ArrayLike, jerk: ArrayLike | None = None
) -> FloatArray:
    r"""Minimum durations of independent rest-to-rest motions over given distances.

    With maximum speed v, acceleration a and jerk j, the duration over distance d is

    .. math::
        T = d / v + v / a + a / j, \quad T = a / j + \sqrt{(a / j)^2 + 4 d / a}, \quad T = \sqrt[3]{32 d / j}

    if v is reached, if only a is reached, or if neither is reached.

    Args:
        distance: (...) distances >= 0.
        velocity: (...) maximum speeds.
        acceleration: (...) maximum accelerations.
        jerk: (...) maximum jerks; None for no limit.

    Returns:
        (...) durations [s]; 0 for a distance of 0.

    Examples:
        >>> rest_to_rest(np.array([0.0, 1.0]), 1.0, 1.0).tolist()
        [0.0, 2.0]
    """
    v, a = np.asarray(velocity, dtype=np.float64), np.asarray(acceleration, dtype=np.float64)
    j = np.full(1, np.inf) if jerk is None else np.asarray(jerk, dtype=np.float64)
    a = np.minimum(a, np.sqrt(v * j))  # if the speed is reached before the acceleration
    growth = a / j  # time until the acceleration is reached [s]
    durations = np.where(
        distance >= v * (v / a + growth),
        distance / v + v / a + growth,
        np.where(
            distance >= 2.0 * a * growth**2,
            growth + np.sqrt(growth**2 + 4.0 * distance / a),
            np.cbrt(32.0 * distance / j),
        ),
    )
    return np.where(distance > 0.0, durations, 0.0)


def least_duration_between(
    turn: FloatArray, speeds: tuple[FloatArray, FloatArray], velocity: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """Minimum durations of independent motions between states in motion, without jerk limits.

    A joint accelerates as much as it can, towards a peak speed or its limit, and brakes as much as it can.

    Args:
        turn: (dof,) signed distances.
        speeds: (dof,) signed speeds at the start and at the end, each.
        velocity: (dof,) maximum speeds.
        acceleration: (dof,) maximum accelerations.

    Returns:
        (dof,) durations [s].

    Examples:
        >>> still = np.zeros(2)
        >>> least_duration_between(np.array([1.0, 4.0]), (still, still), np.ones(2), np.ones(2)).tolist()
        [2.0, 5.0]
        >>> least_duration_between(still, (np.ones(2), still), np.ones(2), np.ones(2)).round(6).tolist()
        [2.414214, 2.414214]
    """
    first, last = speeds
    # With one acceleration from the first speed to the last; beyond that distance, towards positive peaks.
    direct = 0.5 * (first + last) * np.abs(last - first) / acceleration
    sign = np.where(turn < direct, -1.0, 1.0)
    first, last, turn = sign * first, sign * last, sign * turn
    squares = 0.5 * (first**2 + last**2)
    peak = np.sqrt(np.maximum(acceleration * turn + squares, 0.0))
    reached = np.minimum(peak, np.maximum(velocity, np.maximum(np.abs(first), np.abs(last))))
    cruise = (peak**2 - reached**2) / acceleration
    cruise_s: FloatArray = cruise / np.where(cruise > 0.0, reached, 1.0)
    return (2.0 * reached - first - last) / acceleration + cruise_s


def clock_at_limits(path: FloatArray, velocity: FloatArray) -> FloatArray:
    """(m,) times at the (m, dof) waypoints of a path at the velocity limits, from its start [s]."""
    return np.concatenate([[0.0], np.cumsum((np.abs(np.diff(path, axis=0)) / velocity).max(axis=1))])


def least_duration(start: FloatArray, goal: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> float:
    """Lower bound on the rest-to-rest duration between two configurations [s].

    It is the minimum duration of the slowest joint alone.

    Args:
        start: (dof,) configuration.
        goal: (dof,) configuration.
        velocity: (dof,) maximum speeds.
        acceleration: (dof,) maximum accelerations.

    Examples:
        >>> least_duration(np.zeros(2), np.array([1.0, 4.0]), np.ones(2), np.ones(2))
        5.0
    """
    return float(rest_to_rest(np.abs(goal - start), velocity, acceleration).max())


class GeometricPath(Protocol):
    """Twice differentiable curve in joint space over [0, end]."""

    @property
    def breaks(self) -> FloatArray:
        """Increasing break parameters of the pieces, both ends included."""

    def evaluate(self, s: ArrayLike, derivative: int = 0) -> FloatArray:
        """Points or derivatives at (...) parameters, as (..., dof)."""


@dataclass(frozen=True, eq=False)
class Limits(Record):
    """Limits of a motion, one entry for each joint.

    Attributes:
        velocity: (dof,) maximum velocity [rad/s].
        acceleration: (dof,) maximum acceleration [rad/s^2].
        torque: (dof,) maximum torque [N m]; None for no limit.
        jerk: (dof,) maximum jerk [rad/s^3]; None for no limit.
    """

    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray | None = None
    jerk: FloatArray | None = None

    def scale(self, speed: float) -> Limits:
        """Scale the limits for motions at a fraction of full speed.

        Torque limits are unchanged, because gravity torques do not scale with speed.

        Raises:
            OptionError: `speed` is not in (0, 1].

        Examples:
            >>> Limits(np.ones(1), np.ones(1)).scale(0.5).acceleration.tolist()
            [0.25]
        """
        check_speed(speed)
        jerk = None if self.jerk is None else readonly(self.jerk * speed**3)
        return replace(
            self,
            velocity=readonly(self.velocity * speed),
            acceleration=readonly(self.acceleration * speed**2),
            jerk=jerk,
        )
