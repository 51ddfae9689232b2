r"""Rounds the corners of a polyline within a deviation, and measures deviations.

Let P be the polyline through the waypoints, s its arc length, and :math:`\Delta_k` the change of its unit direction at
corner k, at :math:`s_k`. The path is the cubic spline

.. math::
    V(s) = \sum_i N_i(s)\, P(\xi_i), \qquad \xi_i = \tfrac13 (t_{i+1} + t_{i+2} + t_{i+3}),

with simple knots :math:`s_k - h_k,\ s_k,\ s_k + h_k` at each corner (Schoenberg's operator; its control points are
points of the polyline). V reproduces straight lines, parameter included, and P is a straight line plus the terms
:math:`\Delta_k (s - s_k)_+`. As :math:`s_k` is the middle of its knots, the first differences of such a term's
control values step from 0 to 1 there; hence its second derivative is the tent of area 1 over
:math:`[s_k - h_k, s_k + h_k]`, and it differs from the term itself by a function that is zero outside and reaches its
maximum, :math:`h_k / 6`, at the corner. The intervals do not overlap, so

.. math::
    |V(s) - P(s)| \le \tfrac16 h_k |\Delta_k| \quad \text{(Euclidean norm, at equal s)},

and :math:`h_k` is chosen so that this is at most the permitted deviation. The path is thus near the polyline
everywhere, and passes near every waypoint in turn. Its second derivative is continuous, it has unit speed outside the
corners, and it lies in the convex hull of the waypoints: it satisfies joint limits that the waypoints satisfy.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import number
from hplan.base.arrays import FloatArray, numbers, readonly
from hplan.collision.compiled_field import ClearanceField
from hplan.errors import CertificationError, InputError
from hplan.geometry.polyline import stations
from hplan.trajectory.spline import SplinePath, blocked_pieces

#: Minimum deviation that can be requested [rad]: sharper corners exceed toppra's tolerances.
LEAST_DEVIATION = 1e-4

#: Waypoints closer to each other than this coincide [rad].
COINCIDENT = 1e-9

#: Fraction of the deviation used for leaving out waypoints.
THINNING = 0.25


def rounded_path(waypoints: ArrayLike, deviation_rad: float) -> SplinePath:
    """Polyline through waypoints with its corners rounded (formula: see the module).

    At equal arc length, path and polyline are at most `deviation_rad` apart in the Euclidean norm of joint space: the
    path follows the polyline, and passes every waypoint in turn within the deviation. It starts and ends at the first
    and the last waypoint (up to rounding), and stays in the convex hull of all waypoints.

    A quarter of the deviation is used to leave out waypoints (duplicates, collinear ones, noise): a chord replaces the
    waypoints between its ends if points of it, in the same order, are within that distance of them; by convexity the
    segments between them are, too. The corners of the chords are rounded by the remaining deviation.

    Args:
        waypoints: (n, dof), n >= 1.
        deviation_rad: Maximum distance from the polyline; at least 1e-4.

    Returns:
        The path; constant if all waypoints are equal.

    Raises:
        InputError: `waypoints` is empty, its rows differ in length, or a value is not finite.
        OptionError: The deviation is too small, too large or not finite.

    Examples:
        >>> path = rounded_path([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], 0.01)
        >>> path.evaluate([0.0, path.end]).tolist()
        [[0.0, 0.0], [1.0, 1.0]]
    """
    points = as_waypoints(waypoints)
    # Maximum deviation: farther than any joint moves [rad].
    most_deviation = 1e6
    expected = f"a number of radians >= {LEAST_DEVIATION:g} and <= {most_deviation:g}"
    number("deviation_rad", deviation_rad, expected, lambda given: LEAST_DEVIATION <= given <= most_deviation)
    points = _thin_points(points, THINNING * deviation_rad - COINCIDENT)
    if len(points) < 2:
        return SplinePath(readonly(np.repeat(points, 4, axis=0)), readonly([0.0] * 4 + [1.0] * 4))
    length = np.linalg.norm(np.diff(points, axis=0), axis=1)
    bend = np.linalg.norm(np.diff(np.diff(points, axis=0) / length[:, None], axis=0), axis=1)
    return _round_corners(
        points, np.minimum(_widest(length), 6.0 * (1.0 - THINNING) * deviation_rad / np.maximum(bend, 1e-12))
    )


def clear_rounding(path: FloatArray, field: ClearanceField, *, margin: float) -> SplinePath:
    """Round a polyline's corners as widely as is verified collision-free.

    A corner that cannot be verified is rounded half as widely: in the limit the spline is the polyline.

    Args:
        path: (m, dof) waypoints, m >= 2, collision-free at `margin`, no two neighbours equal.
        field: Clearances to the obstacles.
        margin: Clearance of the polyline at each evaluated configuration [m]; the spline must have half of it.

    Raises:
        CertificationError: No rounding of some corner can be verified.
    """
    half = _widest(np.linalg.norm(np.diff(path, axis=0), axis=1))
    while True:
        spline = _round_corners(path, half)
        bad = np.flatnonzero(blocked_pieces(spline.pieces, field, 0.5 * margin))
        if not len(bad):
            return spline
        # Pieces come in threes: straight, into the corner, out of it.
        corners = np.unique(bad[bad % 3 > 0] // 3)
        if not len(corners) or half[corners].min() < 1e-6:
            reason = "the path's corners cannot be rounded within its clearance"
            raise CertificationError(reason, pieces=bad.tolist())
        half[corners] *= 0.5


def _widest(length: FloatArray) -> FloatArray:
    """(m - 2,) maximum half-widths of corners.

    A corner uses at most 0.4 of the shorter adjacent segment.
    """
    widest: FloatArray = 0.4 * np.minimum(length[:-1], length[1:])
    return widest


def _round_corners(points: FloatArray, half: FloatArray) -> SplinePath:
    """Spline of the polyline with given corner half-widths (see the module)."""
    station = stations(points)
    inner = (station[1:-1, None] + half[:, None] * np.array([-1.0, 0.0, 1.0])).ravel()
    knots = np.concatenate([[0.0] * 4, inner, [station[-1]] * 4])
    greville = (knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3.0
    control = np.stack([np.interp(greville, station, joint) for joint in points.T], axis=1)
    control[[0, -1]] = points[[0, -1]]
    # Rounding errors must not move a control point out of joint limits that the waypoints satisfy.
    control = np.clip(control, points.min(axis=0), points.max(axis=0))
    return SplinePath(readonly(control), readonly(knots))


def as_waypoints(waypoints: ArrayLike) -> FloatArray:
    """Convert waypoints to a new (n, dof) array, n >= 1.

    Raises:
        InputError: `waypoints` is empty, its rows differ in length, or a value is not finite.
    """
    points = numbers("waypoints", waypoints, (None, None))
    if 0 in points.shape:
        raise InputError(f"waypoints: expected an array (waypoints, joints), got shape {points.shape}")
    return points


def _thin_points(points: FloatArray, radius: float) -> FloatArray:
    """Subset of the points, ends included, connected by the longest permitted chords."""
    taken, low = [points[0]], 0
    while low < len(points) - 1:
        high = low + 1
        while high < len(points) - 1 and _stands_for(points[low : high + 2], radius):
            high += 1
        if np.linalg.norm(points[high] - taken[-1]) > COINCIDENT:
            taken.append(points[high])
        low = high
    if len(taken) > 1:
        taken[-1] = points[-1]
    return np.array(taken)


def _stands_for(points: FloatArray, radius: float) -> bool:
    """True if the chord may replace the points between its ends.

    It may if it has points, in order, within the radius of each point between.
    """
    start, step = points[0], points[-1] - points[0]
    away = points[1:-1] - start
    squared = float(step @ step)
    if squared <= COINCIDENT**2:
        return bool((np.linalg.norm(away, axis=1) <= radius).all())
    middle = away @ step / squared
    offset = np.linalg.norm(away - middle[:, None] * step, axis=1)
    if (offset > radius).any():
        return False
    # Interval of the chord within the radius of each point; traverse them in order, each as early as possible.
    reach = np.sqrt((radius**2 - offset**2) / squared)
    earliest = np.maximum.accumulate(np.maximum(middle - reach, 0.0))
    return bool((earliest <= np.minimum(middle + reach, 1.0)).all())


def largest_path_deviation(positions: ArrayLike, waypoints: ArrayLike) -> float:
    """Maximum distance of configurations from the polyline through waypoints [rad].

    The distance is the Euclidean norm in joint space.

    Args:
        positions: (k, dof) configurations, k >= 1.
        waypoints: (n, dof).

    Raises:
        InputError: `positions` or `waypoints` is empty, has another number of joints, or a value is not finite.

    Examples:
        >>> largest_path_deviation([[0.5, 0.1]], [[0.0, 0.0], [1.0, 0.0]])
        0.1
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
