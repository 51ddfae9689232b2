r"""The polyline through waypoints with its corners rounded within a deviation, and how far a motion is from it.

Let P be the polyline through the waypoints, s its length so far, and :math:`\Delta_k` the change of its unit direction
at corner k, at :math:`s_k`. The path is the cubic spline

.. math::
    V(s) = \sum_i N_i(s)\, P(\xi_i), \qquad \xi_i = \tfrac13 (t_{i+1} + t_{i+2} + t_{i+3}),

with simple knots :math:`s_k - h_k,\ s_k,\ s_k + h_k` at each corner (Schoenberg's operator; its control points are
points of the polyline). V reproduces straight lines, parameter and all, and P is a straight line plus the terms
:math:`\Delta_k (s - s_k)_+`. As :math:`s_k` is the middle of its knots, the first differences of such a term's
control values step from 0 to 1 there; hence its second derivative is the tent of area 1 over
:math:`[s_k - h_k, s_k + h_k]`, and it differs from the term itself by a function that is zero outside and reaches its
largest value, :math:`h_k / 6`, at the corner. The intervals are kept apart, so

.. math::
    |V(s) - P(s)| \le \tfrac16 h_k |\Delta_k| \quad \text{(Euclidean norm, at equal s)},

which the choice of :math:`h_k` makes no more than the deviation allowed. The path is thus near the polyline
everywhere, and passes near every waypoint in turn. Its second derivative is continuous, it runs at unit speed outside
the corners, and it lies in the hull of the waypoints: joint limits that they keep, it keeps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import number
from hplan.base.arrays import FloatArray, numbers, readonly
from hplan.base.polyline import stations
from hplan.collision.clearance_field import ClearanceField
from hplan.errors import CertificationError, InputError
from hplan.trajectory.spline import SplinePath, first_contact

#: Smallest deviation that can be asked for [rad]: sharper corners are too much for toppra's tolerances.
LEAST_DEVIATION = 1e-4

#: Distance up to which waypoints are the same [rad].
SAME = 1e-9

#: Fraction of the deviation that leaving out waypoints may take.
THINNING = 0.25


def rounded_path(waypoints: ArrayLike, deviation_rad: float) -> SplinePath:
    r"""The polyline through waypoints with its corners rounded (see the module's text).

    Both run along each other, so that at no point they are further apart than `deviation_rad` in the Euclidean norm of
    joint space: the path keeps to the polyline, and passes every waypoint in turn within the deviation. It begins and
    ends at the first and the last of them (up to the rounding of the last digit), and stays in the hull of all.

    A quarter of the deviation goes into leaving out waypoints (equal ones, those in line, noise): a chord stands for
    those between its ends if points of it, in the same order, are within that distance of them, and then by convexity
    the segments between are too. The corners of the chords are rounded by what remains.

    Args:
        waypoints: (n, dof), n >= 1.
        deviation_rad: Largest distance from the polyline; at least 1e-4.

    Returns:
        The path; constant where all waypoints are the same.

    Raises:
        InputError: No waypoint, no list of equally many numbers each, or a value that is not finite.
        OptionError: The deviation is too small or not finite.
    """
    points = as_waypoints(waypoints)
    # Largest deviation: farther than any joint is asked to move [rad].
    most_deviation = 1e6
    expected = f"a number of radians >= {LEAST_DEVIATION:g} and <= {most_deviation:g}"
    number("deviation_rad", deviation_rad, expected, lambda given: LEAST_DEVIATION <= given <= most_deviation)
    points = _thinned(points, THINNING * deviation_rad - SAME)
    if len(points) < 2:
        return SplinePath(readonly(np.repeat(points, 4, axis=0)), readonly([0.0] * 4 + [1.0] * 4))
    length = np.linalg.norm(np.diff(points, axis=0), axis=1)
    bend = np.linalg.norm(np.diff(np.diff(points, axis=0) / length[:, None], axis=0), axis=1)
    return _rounded(
        points, np.minimum(_widest(length), 6.0 * (1.0 - THINNING) * deviation_rad / np.maximum(bend, 1e-12))
    )


def clear_rounding(path: FloatArray, field: ClearanceField, *, margin: float) -> SplinePath:
    """The polyline with its corners rounded as widely as is verified collision-free.

    A corner that cannot be verified is rounded half as widely: in the limit the spline is the polyline.

    Args:
        path: (m, dof) waypoints, m >= 2, clear at `margin`, no two neighbours equal.
        margin: Clearance the polyline has wherever it was evaluated [m]; half of it is asked of the spline.

    Raises:
        CertificationError: No rounding of some corner can be verified.
    """
    half = _widest(np.linalg.norm(np.diff(path, axis=0), axis=1))
    while True:
        spline = _rounded(path, half)
        bad = np.flatnonzero(first_contact(spline.pieces, field, 0.5 * margin))
        if not len(bad):
            return spline
        # Pieces come in threes: straight, into the corner, out of it.
        corners = np.unique(bad[bad % 3 > 0] // 3)
        if not len(corners) or half[corners].min() < 1e-6:
            reason = "the path's corners cannot be rounded within its clearance"
            raise CertificationError(reason, pieces=bad.tolist())
        half[corners] *= 0.5


def _widest(length: FloatArray) -> FloatArray:
    """(m - 2,) largest half-widths of corners: none takes more than this part of a segment at one of its ends."""
    widest: FloatArray = 0.4 * np.minimum(length[:-1], length[1:])
    return widest


def _rounded(points: FloatArray, half: FloatArray) -> SplinePath:
    """The polyline's spline with corners of some half-widths (see the module's text)."""
    station = stations(points)
    inner = (station[1:-1, None] + half[:, None] * np.array([-1.0, 0.0, 1.0])).ravel()
    knots = np.concatenate([[0.0] * 4, inner, [station[-1]] * 4])
    greville = (knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3.0
    control = np.stack([np.interp(greville, station, joint) for joint in points.T], axis=1)
    control[[0, -1]] = points[[0, -1]]
    # Rounding must not take a control point out of the joint limits that the waypoints keep.
    control = np.clip(control, points.min(axis=0), points.max(axis=0))
    return SplinePath(readonly(control), readonly(knots))


def as_waypoints(waypoints: ArrayLike) -> FloatArray:
    """Waypoints as a new (n, dof) array, n >= 1.

    Raises:
        InputError: No waypoint, no list of equally many numbers each, or a value that is not finite.
    """
    points = numbers("waypoints", waypoints, (None, None))
    if 0 in points.shape:
        raise InputError(f"waypoints: expected an array (waypoints, joints), got shape {points.shape}")
    return points


def _thinned(points: FloatArray, radius: float) -> FloatArray:
    """Some of the points, the ends among them, each as far on as the chord from the one before may reach."""
    taken, low = [points[0]], 0
    while low < len(points) - 1:
        high = low + 1
        while high < len(points) - 1 and _stands_for(points[low : high + 2], radius):
            high += 1
        if np.linalg.norm(points[high] - taken[-1]) > SAME:
            taken.append(points[high])
        low = high
    if len(taken) > 1:
        taken[-1] = points[-1]
    return np.array(taken)


def _stands_for(points: FloatArray, radius: float) -> bool:
    """True if the chord from first to last point has points in order within the radius of each in between."""
    start, step = points[0], points[-1] - points[0]
    away = points[1:-1] - start
    squared = float(step @ step)
    if squared <= SAME**2:
        return bool((np.linalg.norm(away, axis=1) <= radius).all())
    middle = away @ step / squared
    offset = np.linalg.norm(away - middle[:, None] * step, axis=1)
    if (offset > radius).any():
        return False
    # The part of the chord within the radius of each; going through them in order, each as early as it may be.
    reach = np.sqrt((radius**2 - offset**2) / squared)
    earliest = np.maximum.accumulate(np.maximum(middle - reach, 0.0))
    return bool((earliest <= np.minimum(middle + reach, 1.0)).all())


def largest_deviation(positions: ArrayLike, waypoints: ArrayLike) -> float:
    """Largest distance of configurations from the polyline through waypoints, Euclidean norm [rad].

    Args:
        positions: (k, dof) configurations, k >= 1.
        waypoints: (n, dof).

    Raises:
        InputError: One of them is no such array of finite numbers.
    """
    points = as_waypoints(waypoints)
    q = numbers("positions", positions, (None, points.shape[1]))
    if not len(q):
        raise InputError("positions: expected at least one configuration")
    nearest = np.linalg.norm(q - points[0], axis=1)
    for start, step in zip(points[:-1], np.diff(points, axis=0), strict=True):
        squared = float(step @ step)
        along = np.clip((q - start) @ step / squared, 0.0, 1.0) if squared > 0.0 else np.zeros(len(q))
        nearest = np.minimum(nearest, np.linalg.norm(q - start - along[:, None] * step, axis=1))
    return float(nearest.max())
