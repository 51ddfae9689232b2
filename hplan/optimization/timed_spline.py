"""The timed motion as an optimiser moves it: a clamped cubic B-spline over time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray, Record, frozen
from hplan.robot.dynamics import InverseDynamics
from hplan.smoothing.spline import SplinePath
from hplan.timing.trajectory import Trajectory

#: Control points at each end that are equal where the motion is at rest, without acceleration.
RESTING = 3


@dataclass(frozen=True, eq=False)
class TimedSpline(Record):
    """A motion from rest to rest.

    Attributes:
        control: (n, dof) control points; the first `RESTING` are equal, and so are the last.
        knots: (n + 4,) clamped knots [s].
    """

    control: FloatArray
    knots: FloatArray

    @classmethod
    def near(cls, positions: Callable[[FloatArray], FloatArray], breaks: FloatArray) -> TimedSpline:
        """A spline near a motion from rest to rest, off it by the fourth power of the pieces' duration.

        The control points are taken from the motion at the means of their knots, less a sixth of their second
        differences: for equal pieces the quasi-interpolant of de Boor and Fix (J. Approx. Theory 8, 1973).

        Args:
            positions: The motion, (k,) times -> (k, dof) configurations.
            breaks: (pieces + 1,) increasing times from 0 at which pieces meet [s], at least 2 * `RESTING` pieces.
        """
        knots = np.concatenate([np.zeros(3), breaks, np.full(3, breaks[-1])])
        control = positions((knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3.0)
        control[RESTING:-RESTING] -= np.diff(control[RESTING - 1 : 1 - RESTING], n=2, axis=0) / 6.0
        control[:RESTING], control[-RESTING:] = control[0], control[-1]
        return cls(frozen(control), frozen(knots))

    @property
    def duration(self) -> float:
        """How long the motion takes [s]."""
        return float(self.knots[-1])

    @property
    def path(self) -> SplinePath:
        """The same curve as a path; its parameter is the time."""
        return SplinePath(self.control, self.knots)

    def at_pace(self, pace: float) -> TimedSpline:
        """The motion with all times multiplied by a number."""
        return TimedSpline(self.control, frozen(self.knots * pace))

    def trajectory(self, dynamics: InverseDynamics, rate_hz: float) -> Trajectory:
        """Rows of the motion.

        Where pieces meet at rows alone the rows are the motion exactly: between two of them it is one cubic, which the
        rows' positions and velocities give.
        """
        clock = np.arange(math.floor(self.duration * rate_hz + 1e-6) + 1, dtype=np.float64) / rate_hz
        position, velocity, acceleration = (self.path.evaluate(clock, derivative) for derivative in range(3))
        for end in (0, -1):
            position[end], velocity[end], acceleration[end] = self.control[end], 0.0, 0.0
        torque = dynamics.torques(position, velocity, acceleration)
        return Trajectory(tuple(dynamics.model.names)[1:], clock, position, velocity, acceleration, torque)


def even_breaks(duration: float, pieces: int) -> FloatArray:
    """(pieces + 1,) times where pieces of equal duration meet [s]."""
    return frozen(np.linspace(0.0, duration, pieces + 1))


def breaks_at_rows(intervals: int, pieces: int, rate_hz: float) -> FloatArray:
    """(pieces + 1,) times where pieces meet that are as equal as whole numbers of rows allow [s]."""
    return frozen((np.arange(pieces + 1, dtype=np.int64) * intervals // pieces) / rate_hz)
