"""Timed motion of an optimizer: a clamped cubic B-spline over time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray, Record, frozen
from hplan.robot.dynamics import InverseDynamics, joints_that_slide
from hplan.trajectory.speed_profile import check_row_count
from hplan.trajectory.spline import SplinePath
from hplan.trajectory.trajectory import Trajectory

#: Number of control points at each end fixed by the boundary state; at rest they are equal.
RESTING = 3


@dataclass(frozen=True, eq=False)
class BoundaryState(Record):
    """Position, velocity and acceleration at one end of a motion.

    Attributes:
        position: (dof,) [rad].
        velocity: (dof,) [rad/s].
        acceleration: (dof,) [rad/s^2].
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray

    @classmethod
    def at_rest(cls, position: FloatArray) -> BoundaryState:
        """State of rest at a configuration."""
        still = frozen(np.zeros_like(position))
        return cls(position, still, still)

    @classmethod
    def of_row(cls, trajectory: Trajectory, row: int) -> BoundaryState:
        """State at a sample of a trajectory."""
        return cls(trajectory.position[row], trajectory.velocity[row], trajectory.acceleration[row])

    def controls(self, widths: tuple[float, float]) -> FloatArray:
        r"""(`RESTING`, dof) outer control points of a spline starting in this state.

        With the durations :math:`h_1, h_2` of the first two pieces, they are :math:`q, \; q + h_1 v / 3` and, from
        there,
        :math:`(h_1 + h_2) (v + h_1 a / 2) / 3` farther. At the end of a motion the durations are negative.

        Args:
            widths: Durations of the first pieces, the outer one first [s].
        """
        first, second = widths
        points = np.empty((RESTING, len(self.position)))
        points[0] = self.position
        points[1] = self.position + (first / 3.0) * self.velocity
        points[2] = points[1] + ((first + second) / 3.0) * (self.velocity + (0.5 * first) * self.acceleration)
        return points

    def drifts(self, widths: tuple[float, float]) -> FloatArray:
        """(`RESTING`, dof) derivatives of the outer control points at time scale 1.

        The derivatives are with respect to the time scale.

        Args:
            widths: Durations of the first pieces, the outer one first [s].
        """
        first, second = widths
        points = np.zeros((RESTING, len(self.position)))
        points[1] = (first / 3.0) * self.velocity
        points[2] = points[1] + ((first + second) / 3.0) * (self.velocity + first * self.acceleration)
        return points


@dataclass(frozen=True, eq=False)
class TimedSpline(Record):
    """Motion from rest to rest, or between states in motion.

    Attributes:
        control: (n, dof) control points; the boundary states fix the first and the last `RESTING` of them.
        knots: (n + 4,) clamped knots [s].
        ends: States at the start and at the end; None if both are at rest.
    """

    control: FloatArray
    knots: FloatArray
    ends: tuple[BoundaryState, BoundaryState] | None = None

    @classmethod
    def approximate(
        cls,
        positions: Callable[[FloatArray], FloatArray],
        breaks: FloatArray,
        ends: tuple[BoundaryState, BoundaryState] | None = None,
    ) -> TimedSpline:
        """Approximate a motion by a spline, with fourth-order accuracy.

        The error decreases with the fourth power of the pieces' duration.

        The control points are samples of the motion at the means of their knots, minus a sixth of their second
        differences:
        for equal pieces the quasi-interpolant of de Boor and Fix (J. Approx. Theory 8, 1973). With boundary states in
        motion, the spline interpolates the motion at the means of the knots of its control points.

        Args:
            positions: The motion, (k,) times -> (k, dof) configurations.
            breaks: (pieces + 1,) increasing break times of the pieces, from 0 [s], at least 2 * `RESTING` pieces.
            ends: Boundary states of the spline, which may differ from the motion's; None for rest at the motion's ends.
        """
        knots = np.concatenate([np.zeros(3), breaks, np.full(3, breaks[-1])])
        means = (knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3.0
        control = positions(means)
        if ends is not None:
            return cls(frozen(control), frozen(knots)).with_ends(ends)._interpolate(control[RESTING:-RESTING], means)
        control[RESTING:-RESTING] -= np.diff(control[RESTING - 1 : 1 - RESTING], n=2, axis=0) / 6.0
        control[:RESTING], control[-RESTING:] = control[0], control[-1]
        return cls(frozen(control), frozen(knots))

    def _interpolate(self, points: FloatArray, clock: FloatArray) -> TimedSpline:
        """Interpolate (inner, dof) points with the inner control points; ends stay fixed."""
        from scipy.interpolate import BSpline
        from scipy.linalg import solve_banded

        inner, count = slice(RESTING, -RESTING), len(points)
        weights = BSpline.design_matrix(clock[inner], self.knots, 3)
        control = np.array(self.control)
        control[inner] = 0.0
        # Row i has four weights, in columns i - 2 to i + 2.
        row, column = np.repeat(np.arange(count), 4), weights.indices - RESTING
        is_inner = (column >= 0) & (column < count)
        bands = np.zeros((5, count))
        bands[(2 + row - column)[is_inner], column[is_inner]] = weights.data[is_inner]
        control[inner] = solve_banded((2, 2), bands, points - weights @ control, check_finite=False)
        return TimedSpline(frozen(control), self.knots, self.ends)

    def with_ends(self, ends: tuple[BoundaryState, BoundaryState] | None) -> TimedSpline:
        """Spline with outer control points for given boundary states; unchanged for None."""
        if ends is None:
            return self
        control, (first, last) = np.array(self.control), self._widths
        control[:RESTING], control[-RESTING:] = ends[0].controls(first), ends[1].controls(last)[::-1]
        return TimedSpline(frozen(control), self.knots, ends)

    @property
    def _widths(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Durations of the two outer pieces at both ends [s].

        The outermost piece comes first; durations at the end are negative.
        """
        (a, b, c), (d, e, f) = self.knots[3:6].tolist(), self.knots[-6:-3].tolist()
        return (b - a, c - b), (e - f, d - e)

    @property
    def drift(self) -> FloatArray:
        """(n, dof) derivatives of the control points with respect to time scale.

        The states at the ends stay fixed.
        """
        drift = np.zeros_like(self.control)
        if self.ends is not None:
            first, last = self._widths
            drift[:RESTING], drift[-RESTING:] = self.ends[0].drifts(first), self.ends[1].drifts(last)[::-1]
        return drift

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return float(self.knots[-1])

    @property
    def path(self) -> SplinePath:
        """The curve as a path whose parameter is the time."""
        return SplinePath(self.control, self.knots)

    def positions(self, clock: FloatArray) -> FloatArray:
        """(k, dof) configurations at (k,) times [s]."""
        return self.path.evaluate(clock)

    def at_time_scale(self, time_scale: float) -> TimedSpline:
        """Scale all times by a factor; the boundary states stay fixed."""
        return TimedSpline(self.control, frozen(self.knots * time_scale)).with_ends(self.ends)

    def clock(self, count: int) -> FloatArray:
        """(pieces * count,) sample times: `count` in each piece, equally spaced [s].

        The first sample of a piece is its start.
        """
        breaks = self.knots[3:-3]
        return frozen((breaks[:-1, None] + np.diff(breaks)[:, None] * (np.arange(count) / count)).ravel())

    def weights(self, clock: FloatArray, order: int = 0) -> FloatArray:
        """(times, n) weights of the control points at given times.

        Args:
            clock: (times,) times [s].
            order: 0 for the position, or the order of the derivative.
        """
        from scipy.interpolate import BSpline

        return np.asarray(BSpline(self.knots, np.eye(len(self.control)), 3)(clock, nu=order))

    def trajectory(self, dynamics: InverseDynamics, rate_hz: float) -> Trajectory:
        """Sample the motion for a controller.

        If pieces meet at samples only, the samples represent the motion exactly: between two samples it is a single
        cubic, determined by their positions and velocities.

        Args:
            dynamics: Inverse dynamics of the arm, for the torques.
            rate_hz: Samples per second.

        Raises:
            OptionError: There are too many samples (`check_row_count`).
        """
        check_row_count(self.duration * rate_hz, self.duration, rate_hz)
        clock = np.arange(math.floor(self.duration * rate_hz + 1e-6) + 1, dtype=np.float64) / rate_hz
        path = self.path
        position, velocity, acceleration = (path.evaluate(clock, derivative) for derivative in range(3))
        still = np.ptp(self.control, axis=0) <= 1e-12  # up to rounding
        position[:, still], velocity[:, still], acceleration[:, still] = self.control[0, still], 0.0, 0.0
        for end, state in zip((0, -1), self.ends or (None, None), strict=True):
            position[end], velocity[end], acceleration[end] = self.control[end], 0.0, 0.0
            if state is not None:
                velocity[end], acceleration[end] = state.velocity, state.acceleration
        torque = dynamics.torques(position, velocity, acceleration)
        rows = clock, position, velocity, acceleration, torque
        return Trajectory(tuple(dynamics.model.names)[1:], *rows, joints_that_slide(dynamics.model))


@dataclass(frozen=True, eq=False)
class MotionBetween(Record):
    """Motion blended into nonzero boundary states at its ends.

    Attributes:
        positions_at_rest: The motion from rest to rest, (k,) times -> (k, dof) configurations.
        duration: Duration [s].
        ends: Boundary states, with the motion's own positions.
        within_s: (2, dof) maximum blending time of each joint at each end [s].
    """

    positions_at_rest: Callable[[FloatArray], FloatArray]
    duration: float
    ends: tuple[BoundaryState, BoundaryState]
    within_s: FloatArray

    def positions(self, clock: FloatArray) -> FloatArray:
        """(k, dof) configurations at (k,) times [s]."""
        q, spans = np.array(self.positions_at_rest(clock)), np.minimum(self.within_s, 0.5 * self.duration)
        since = clock[:, None]
        for state, sign, gone, span in zip(self.ends, (1.0, -1.0), (since, self.duration - since), spans, strict=True):
            left = np.clip(1.0 - gone / span, 0.0, 1.0)
            speed, push = sign * state.velocity, state.acceleration + 6.0 * sign * state.velocity / span
            q += gone * left**3 * (speed + 0.5 * gone * push)
        return q


def even_breaks(duration: float, pieces: int) -> FloatArray:
    """(pieces + 1,) break times of pieces of equal duration [s].

    Examples:
        >>> even_breaks(2.0, 4).tolist()
        [0.0, 0.5, 1.0, 1.5, 2.0]
    """
    return frozen(np.linspace(0.0, duration, pieces + 1))


def breaks_at_rows(intervals: int, pieces: int, rate_hz: float) -> FloatArray:
    """(pieces + 1,) break times at samples, nearly evenly spaced [s].

    Examples:
        >>> breaks_at_rows(5, 2, 10.0).tolist()
        [0.0, 0.2, 0.5]
    """
    return frozen((np.arange(pieces + 1, dtype=np.int64) * intervals // pieces) / rate_hz)
