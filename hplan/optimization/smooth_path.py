"""Post-processing: smooth paths near a polyline."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.collision.compiled_field import ClearanceField
from hplan.errors import CertificationError, InputError
from hplan.optimization.options import PostprocessOptions
from hplan.optimization.push_clear import clear_spline
from hplan.optimization.shortcut import SHORTCUTS, shorten
from hplan.robot.limits import least_duration, rest_to_rest
from hplan.trajectory.corner_rounding import clear_rounding
from hplan.trajectory.spline import SplinePath

#: Numbers of control points of the optimizer's initial spline, tried in order: about as few as suffice. Where none of
#: them keeps the margin, the last one may keep a part of it.
_FAST_CONTROL_POINTS = (6, 8, 10, 14, 20, 30, 44)

#: Numbers of control points of the first smooth path, tried in order. Any collision-free spline suffices there: a
#: failed attempt costs milliseconds, and more control points succeed more often. The second are for a first motion at
#: once.
CONTROL_POINTS, FIRST_CONTROL_POINTS = (6, 10, 14, 20, 30, 44, 8, 12), (10, 20, 44)

#: Number of shortcuts tried before an optimization: a less taut path has more clearance. And before a first motion at
#: once, which an optimization follows.
START_SHORTCUTS, FIRST_SHORTCUTS = 25, 8

#: A start and goal closer to each other than this coincide [rad].
_NO_MOTION = 1e-9

#: Fraction of the margin that is still required if the full margin is infeasible.
SMALLEST_FRACTION = 0.05


def clear_path(
    path: FloatArray,
    field: ClearanceField,
    options: PostprocessOptions,
    counts: Sequence[int] = CONTROL_POINTS,
    rounds: int = SHORTCUTS,
) -> SplinePath:
    """First smooth path near a collision-free polyline, verified collision-free.

    The straight motion is returned if it is as fast.

    Args:
        path: (m, dof) waypoints, m >= 2.
        counts: Numbers of control points, tried in order.
        rounds: Number of shortcuts tried: `START_SHORTCUTS` of them before a spline is fitted, all of them before
            corners are rounded where no spline succeeds.

    Raises:
        InputError: Start and goal of the path coincide.
        CertificationError: The motions of the path cannot be verified, or its corners cannot be rounded.
    """
    smallest = _smallest_margin(path, field, options)
    if is_straight(path, field, options):
        return SplinePath.from_control_points(np.linspace(path[0], path[-1], 4))
    found = clear_start(path, field, options, counts, counts, rounds=min(rounds, START_SHORTCUTS))
    if found is not None:
        return found
    return clear_rounding(shorten(path, field, margin=smallest, rounds=rounds), field, margin=smallest)


def short_path(path: FloatArray, field: ClearanceField, options: PostprocessOptions) -> SplinePath:
    """Short smooth path: a spline along the shortened polyline.

    Args:
        path: (m, dof) waypoints, m >= 2.

    Raises:
        InputError: Start and goal of the path coincide.
        CertificationError: The motions of the path cannot be verified, or its corners cannot be rounded.
    """
    smallest = _smallest_margin(path, field, options)
    taut = shorten(path, field, margin=smallest)
    # A short path needs many control points, so that the spline can follow the obstacles closely.
    for count in (44, 64):
        spline = clear_spline(taut, field, options, count=count, margin=smallest)
        if spline is not None:
            return spline
    return clear_rounding(taut, field, margin=smallest)


def _smallest_margin(path: FloatArray, field: ClearanceField, options: PostprocessOptions) -> float:
    """Minimum required clearance of a path [m]."""
    if np.linalg.norm(path[-1] - path[0]) < _NO_MOTION:
        raise InputError("the path ends where it begins; there is no motion to make")
    smallest = SMALLEST_FRACTION * options.margin
    if not field.is_clear(path, smallest):
        raise CertificationError("the motions between the nodes of the path cannot be verified collision-free")
    return smallest


def is_straight(path: FloatArray, field: ClearanceField, options: PostprocessOptions) -> bool:
    """True if the straight motion is collision-free and about time-optimal."""
    least = least_duration(path[0], path[-1], options.velocity, options.acceleration)
    straight = straight_duration(path[0], path[-1], options)
    # A motion within this factor of the lower bound on the duration counts as time-optimal.
    return straight <= 1.005 * least and field.is_clear(path[[0, -1]], options.margin)


def clear_start(
    path: FloatArray,
    field: ClearanceField,
    options: PostprocessOptions,
    counts: Sequence[int] = _FAST_CONTROL_POINTS,
    reduced: Sequence[int] = _FAST_CONTROL_POINTS[-1:],
    *,
    rounds: int = START_SHORTCUTS,
) -> SplinePath | None:
    """Collision-free spline along a path, as an optimizer's initial guess.

    None if no number of control points succeeds.

    Args:
        path: (m, dof) waypoints, collision-free, m >= 2. The resulting spline is verified, the path is not.
        counts: Numbers of control points, tried in order.
        reduced: The same for a quarter of the margin.
        rounds: Number of shortcuts tried.
    """
    if np.linalg.norm(path[-1] - path[0]) < _NO_MOTION:
        return None
    taut = path
    for margin, numbers in ((options.margin, counts), (0.25 * options.margin, reduced)):
        taut = shorten(taut, field, margin=margin, rounds=rounds)
        for count in numbers:
            spline = clear_spline(taut, field, options, count=count, margin=margin)
            if spline is not None:
                return spline
    return None


def rounded_start(path: FloatArray, field: ClearanceField, options: PostprocessOptions) -> SplinePath | None:
    """A shortened polyline with rounded corners, as an optimizer's initial guess.

    None if its corners cannot be rounded.

    Args:
        path: (m, dof) waypoints, verified to keep the smallest margin, m >= 2.
    """
    smallest = SMALLEST_FRACTION * options.margin
    try:
        return clear_rounding(shorten(path, field, margin=smallest, rounds=START_SHORTCUTS), field, margin=smallest)
    except CertificationError:
        return None


def straight_duration(start: FloatArray, goal: FloatArray, options: PostprocessOptions) -> float:
    """Duration of the straight motion under velocity and acceleration limits [s].

    All joints move in proportion.
    """
    turn = np.abs(goal - start)
    moves = turn > 0.0
    speed = (options.velocity[moves] / turn[moves]).min()
    acceleration = (options.acceleration[moves] / turn[moves]).min()
    return float(rest_to_rest(np.ones(1), speed, acceleration)[0])
