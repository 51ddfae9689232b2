"""Input of timing: a geometric path, and the limits of a motion along it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import number
from hplan.base.arrays import FloatArray, Record, readonly


def check_rate(rate_hz: float) -> None:
    """Refuse a rate of rows that no controller has.

    Raises:
        OptionError: It is not between 1 and 100000.
    """
    number(
        "rate_hz", rate_hz, "a number of rows per second between 1 and 100000", lambda rate: 1.0 <= rate <= 100_000.0
    )


def check_speed(speed: float) -> None:
    """Refuse a fraction of full speed that is none.

    Raises:
        OptionError: It is not in (0, 1].
    """
    number("speed", speed, "a factor in (0, 1]", lambda factor: 0.0 < factor <= 1.0)


def rest_to_rest(
    distance: FloatArray, velocity: ArrayLike, acceleration: ArrayLike, jerk: ArrayLike | None = None
) -> FloatArray:
    r"""Durations of the fastest motions over distances, each from rest to rest on its own.

    With a jerk limit j the acceleration takes time to grow: over distance d, at most at speed v and acceleration a,

    .. math::
        T = d / v + v / a + a / j, \quad T = a / j + \sqrt{(a / j)^2 + 4 d / a}, \quad T = \sqrt[3]{32 d / j}

    where v is reached, where only a is, where neither is.

    Args:
        distance: (...) distances >= 0.
        jerk: Largest jerks; None where there is no limit.

    Returns:
        (...) durations [s]; 0 for a distance of 0.
    """
    v, a = np.asarray(velocity, dtype=np.float64), np.asarray(acceleration, dtype=np.float64)
    j = np.full(1, np.inf) if jerk is None else np.asarray(jerk, dtype=np.float64)
    a = np.minimum(a, np.sqrt(v * j))  # where the speed is reached before the acceleration
    growth = a / j  # until the acceleration is reached [s]
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


def least_duration(start: FloatArray, goal: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> float:
    """Lower bound of the duration between two configurations, from rest to rest [s]: that of the slowest joint alone.

    Args:
        start: (dof,) configuration.
        goal: (dof,) configuration.
        velocity: (dof,) largest speeds.
        acceleration: (dof,) largest accelerations.
    """
    return float(rest_to_rest(np.abs(goal - start), velocity, acceleration).max())


class GeometricPath(Protocol):
    """A twice differentiable curve in joint space over [0, end]."""

    @property
    def breaks(self) -> FloatArray:
        """Increasing parameters where pieces meet, the ends among them."""

    def evaluate(self, s: ArrayLike, derivative: int = 0) -> FloatArray:
        """Points or derivatives at (...) parameters, as (..., dof)."""


@dataclass(frozen=True, eq=False)
class Limits(Record):
    """Limits of a motion, one entry for each joint.

    Attributes:
        velocity: (dof,) [rad/s].
        acceleration: (dof,) [rad/s^2].
        torque: (dof,) [N m], or None where torque is not limited.
        jerk: (dof,) [rad/s^3], or None where jerk is not limited.
    """

    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray | None = None
    jerk: FloatArray | None = None

    def scaled(self, speed: float) -> Limits:
        """The limits for motions run `speed` times as fast.

        Torque stays, as gravity does not slow down.

        Raises:
            OptionError: The speed is not in (0, 1].
        """
        check_speed(speed)
        jerk = None if self.jerk is None else readonly(self.jerk * speed**3)
        return replace(
            self,
            velocity=readonly(self.velocity * speed),
            acceleration=readonly(self.acceleration * speed**2),
            jerk=jerk,
        )
