r"""Piecewise polynomials: Bezier points, values and derivatives, B-spline samples.

A motion given by samples of position and velocity is a cubic between each two of them. A motion defined by control
points a period h apart is a uniform cubic B-spline whose knots are its samples,

.. math::
    x_k = \tfrac16 (q_{k-1} + 4 q_k + q_{k+1}), \quad
    \dot x_k = \frac{q_{k+1} - q_{k-1}}{2 h}, \quad
    \ddot x_k = \frac{q_{k+1} - 2 q_k + q_{k-1}}{h^2},

so that between its samples it is the same cubics, with a continuous acceleration.

A controller may follow other polynomials between the same samples (`Interpolation`): quintics, which match the samples'
accelerations too, or straight lines, which are cubics as well. All functions that read segments take Bezier points of
degree 3 or 5 (`cubic_at`), so one implementation covers all three.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import FloatArray, frozen
from hplan.base.kernels import inline, kernel

#: Curve between two samples: a cubic by positions and velocities, a quintic by accelerations too, or a straight line.
Interpolation: TypeAlias = Literal["cubic", "quintic", "linear"]


#: Maximum speed and acceleration of a motion at rest [rad/s, rad/s^2].
RESTING = 1e-6


class Rows(NamedTuple):
    """Samples of a motion.

    Attributes:
        time: (n,) strictly increasing from 0 [s].
        position: (n, dof) [rad].
        velocity: (n, dof) [rad/s].
        acceleration: (n, dof) [rad/s^2].
        torque: (n, dof) [N m].
    """

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.time[-1])

    @property
    def pieces(self) -> tuple[FloatArray, FloatArray]:
        """The cubics between the samples (`hermite_pieces`)."""
        return hermite_pieces(self.time, self.position, self.velocity)

    def cut_before(self, row: int) -> Rows:
        """The motion from a sample on; its time starts at 0.

        Examples:
            >>> zero = np.zeros((2, 1))
            >>> Rows(np.array([0.0, 2.0]), zero, zero, zero, zero).cut_before(1).time.tolist()
            [0.0]
        """
        return Rows(self.time[row:] - self.time[row], *(values[row:] for values in self[1:]))

    def cut_after(self, row: int) -> Rows:
        """The motion up to a sample."""
        return Rows(*(values[: row + 1] for values in self))

    def is_at_rest(self, row: int) -> bool:
        """True if the motion is at rest at a sample."""
        return float(max(np.abs(self.velocity[row]).max(), np.abs(self.acceleration[row]).max())) <= RESTING

    def positions(self, clock: FloatArray) -> FloatArray:
        """(k, dof) configurations at (k,) times; clamped to the motion's ends."""
        if len(self.time) == 1:
            return np.repeat(self.position, len(clock), axis=0)
        return evaluate(self.pieces[0], self.time, clock)


def joined_rows(parts: Sequence[Rows]) -> Rows:
    """Concatenate motions; each must start in the final state of its predecessor."""
    begins = np.cumsum([0.0, *(part.duration for part in parts[:-1])])
    times = [parts[0].time, *(part.time[1:] + begin for part, begin in zip(parts[1:], begins[1:], strict=True))]
    others = zip(*(part[1:] for part in parts), strict=True)
    return Rows(np.concatenate(times), *(np.concatenate([own[0], *(more[1:] for more in own[1:])]) for own in others))


def hermite_pieces(time: FloatArray, position: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Cubics between samples, with the samples' positions and velocities.

    Args:
        time: (n,) times [s].
        position: (n, dof) [rad].
        velocity: (n, dof) [rad/s].

    Returns:
        (pieces, 4, dof) Bezier points [rad] and (pieces,) durations [s]; one constant piece of 1 s for a single sample.
        Points are not finite if numbers overflow.

    Examples:
        >>> bezier, _ = hermite_pieces(np.array([0.0, 3.0]), np.array([[0.0], [1.0]]), np.array([[1.0], [0.0]]))
        >>> bezier[0, :, 0].tolist()
        [0.0, 1.0, 1.0, 1.0]
    """
    if len(position) == 1:
        return np.repeat(position[:, None, :], 4, axis=1), np.ones(1)
    duration = time[1:] - time[:-1]
    bezier = np.empty((len(duration), 4, position.shape[1]))
    bezier[:, 0], bezier[:, 3] = position[:-1], position[1:]
    with np.errstate(over="ignore", invalid="ignore"):
        third = duration[:, None] / 3.0
        bezier[:, 1] = position[:-1] + third * velocity[:-1]
        bezier[:, 2] = position[1:] - third * velocity[1:]
    return bezier, duration


def segments_between(rows: Rows, interpolation: Interpolation) -> tuple[FloatArray, FloatArray]:
    """Polynomials between samples, as Bezier points and durations.

    Returns (segments, 4 or 6, dof) Bezier points [rad] and (segments,) durations [s]. Points are not finite if numbers
    overflow. A single sample is one constant segment of 1 s.
    """
    if interpolation == "cubic" or len(rows.time) == 1:
        return rows.pieces
    if interpolation == "quintic":
        return _quintics(rows)
    # A line is the cubic whose inner points are a third and two thirds along it.
    pieces, duration = hermite_pieces(rows.time, rows.position, np.zeros_like(rows.position))
    third = (rows.position[1:] - rows.position[:-1]) / 3.0
    pieces[:, 1], pieces[:, 2] = rows.position[:-1] + third, rows.position[1:] - third
    return pieces, duration


def _quintics(rows: Rows) -> tuple[FloatArray, FloatArray]:
    """Bezier points and durations of the quintics through the samples' states.

    A state is a position, a velocity and an acceleration.
    """
    time, position, velocity, acceleration = rows[:4]
    duration = np.diff(time)
    fifth = duration[:, None] / 5.0
    with np.errstate(over="ignore", invalid="ignore"):
        # The second difference of Bezier points at an end is h^2 / 20 of the acceleration there.
        leaving, arriving = fifth * velocity[:-1], fifth * velocity[1:]
        bend = 1.25 * fifth**2
        points = (
            position[:-1],
            position[:-1] + leaving,
            position[:-1] + 2.0 * leaving + bend * acceleration[:-1],
            position[1:] - 2.0 * arriving + bend * acceleration[1:],
            position[1:] - arriving,
            position[1:],
        )
        return np.stack(points, axis=1), duration


def accelerations(pieces: FloatArray, duration: FloatArray) -> FloatArray:
    """(pieces, 2, dof) second derivatives of cubics at both ends.

    They are linear in between.
    """
    bent: FloatArray = 6.0 * np.diff(pieces, n=2, axis=1) / duration[:, None, None] ** 2
    return bent


def sample_spline(points: FloatArray, period: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sample a uniform cubic B-spline at its knots.

    Args:
        points: (n, dof) control points, a period apart.
        period: Time between control points [s].

    Returns:
        (n - 2, dof) positions [rad], velocities [rad/s] and accelerations [rad/s^2].
    """
    change = np.diff(points, axis=0)
    position = (points[:-2] + 4.0 * points[1:-1] + points[2:]) / 6.0
    return position, 0.5 * (change[1:] + change[:-1]) / period, np.diff(change, axis=0) / period**2


def points_of(position: FloatArray, velocity: FloatArray, acceleration: FloatArray, period: float) -> FloatArray:
    """(3, dof) control points that define the state at a sample.

    Examples:
        >>> points = points_of(np.array([1.0]), np.array([2.0]), np.array([3.0]), 0.1)
        >>> [round(float(values[0, 0]), 9) for values in sample_spline(points, 0.1)]
        [1.0, 2.0, 3.0]
    """
    middle = position - period**2 / 6.0 * acceleration
    aside = 0.5 * period**2 * acceleration
    return np.stack([middle - period * velocity + aside, middle, middle + period * velocity + aside])


def evaluate(pieces: FloatArray, breaks: FloatArray, parameters: ArrayLike, derivative: int = 0) -> FloatArray:
    """Evaluate Bezier pieces or their derivatives; returns (..., dof) values.

    Args:
        pieces: (pieces, 4 or 6, dof) Bezier points.
        breaks: (pieces + 1,) parameters where they meet.
        parameters: (...) parameters; clipped to the range of `breaks`.
        derivative: 0, 1 or 2.
    """
    wanted = np.array(parameters, dtype=np.float64)
    values = np.empty((wanted.size, pieces.shape[2]))
    _evaluate(frozen(pieces), frozen(breaks), wanted.ravel(), derivative, values)
    return values.reshape(*wanted.shape, -1)


@inline
def bezier_value(b0: float, b1: float, b2: float, b3: float, t: float) -> float:
    """Value of a cubic at t in [0, 1]."""
    u = 1.0 - t
    return u * u * (u * b0 + 3.0 * t * b1) + t * t * (3.0 * u * b2 + t * b3)


@inline
def bezier_slope(b0: float, b1: float, b2: float, b3: float, t: float) -> float:
    """Derivative of a cubic at t in [0, 1]."""
    u = 1.0 - t
    return 3.0 * (u * u * (b1 - b0) + 2.0 * u * t * (b2 - b1) + t * t * (b3 - b2))


@inline
def cubic_at(bezier: FloatArray, piece: int, joint: int, t: float) -> tuple[float, float, float, float]:
    """Bezier points of a cubic with a segment's value at t.

    `t` is in [0, 1]. A cubic is returned unchanged. For a quintic, these are the points after two rounds of de
    Casteljau's algorithm at t. The cubic's first derivative times degree / 3, and its second times degree (degree - 1)
    / 6, are the segment's.
    """
    b0, b1, b2, b3 = bezier[piece, 0, joint], bezier[piece, 1, joint], bezier[piece, 2, joint], bezier[piece, 3, joint]
    if bezier.shape[1] == 6:
        u, b4, b5 = 1.0 - t, bezier[piece, 4, joint], bezier[piece, 5, joint]
        b0, b1, b2, b3, b4 = u * b0 + t * b1, u * b1 + t * b2, u * b2 + t * b3, u * b3 + t * b4, u * b4 + t * b5
        b0, b1, b2, b3 = u * b0 + t * b1, u * b1 + t * b2, u * b2 + t * b3, u * b3 + t * b4
    return b0, b1, b2, b3


@kernel
def _evaluate(
    pieces: FloatArray, breaks: FloatArray, parameters: FloatArray, derivative: int, values: FloatArray
) -> None:
    """Evaluate Bezier pieces or their derivatives into `values` (see `evaluate`)."""
    last, degree = len(pieces) - 1, pieces.shape[1] - 1
    i = 0
    for row in range(len(parameters)):
        s = min(breaks[last + 1], max(breaks[0], parameters[row]))
        # The piece of the previous parameter most often contains this one, too, or is adjacent.
        while i > 0 and s < breaks[i]:
            i -= 1
        while i < last and s >= breaks[i + 1]:
            i += 1
        width = breaks[i + 1] - breaks[i]
        t = (s - breaks[i]) / width
        for joint in range(values.shape[1]):
            b0, b1, b2, b3 = cubic_at(pieces, i, joint, t)
            if derivative == 0:
                value = bezier_value(b0, b1, b2, b3, t)
            elif derivative == 1:
                value = degree / 3.0 * bezier_slope(b0, b1, b2, b3, t) / width
            else:
                bent = (1.0 - t) * (b2 - 2.0 * b1 + b0) + t * (b3 - 2.0 * b2 + b1)
                value = degree * (degree - 1.0) * bent / (width * width)
            values[row, joint] = value


@kernel
def bezier_piece(control: FloatArray, knots: FloatArray, span: int, result: FloatArray) -> None:
    """Write the Bezier control points of one B-spline span, by blossoming.

    The span lies between knots[span] and knots[span + 1]. The blossom of a span is de Boor's recursion with another
    argument on each level; its values at the span's ends taken 3, 2, 1, 0 times are the Bezier points.
    """
    dof = control.shape[1]
    low, high = knots[span], knots[span + 1]
    for which in range(4):
        for joint in range(dof):
            d0, d1 = control[span - 3, joint], control[span - 2, joint]
            d2, d3 = control[span - 1, joint], control[span, joint]
            x = high if which > 0 else low
            a = (x - knots[span - 2]) / (knots[span + 1] - knots[span - 2])
            b = (x - knots[span - 1]) / (knots[span + 2] - knots[span - 1])
            c = (x - knots[span]) / (knots[span + 3] - knots[span])
            d0, d1, d2 = d0 + a * (d1 - d0), d1 + b * (d2 - d1), d2 + c * (d3 - d2)
            x = high if which > 1 else low
            a = (x - knots[span - 1]) / (knots[span + 1] - knots[span - 1])
            b = (x - knots[span]) / (knots[span + 2] - knots[span])
            d0, d1 = d0 + a * (d1 - d0), d1 + b * (d2 - d1)
            x = high if which > 2 else low
            a = (x - low) / (high - low)
            result[which, joint] = d0 + a * (d1 - d0)


@kernel
def bezier_pieces(control: FloatArray, knots: FloatArray) -> FloatArray:
    """Bezier control points of all spans, (spans, 4, dof)."""
    spans = control.shape[0] - 3
    pieces = np.empty((spans, 4, control.shape[1]))
    for i in range(spans):
        bezier_piece(control, knots, i + 3, pieces[i])
    return pieces
