"""Post-processing: from a polyline to smooth paths near it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.collision.clearance_field import ClearanceField
from hplan.errors import CertificationError, InputError
from hplan.optimization.options import PostprocessOptions
from hplan.optimization.push_clear import clear_spline
from hplan.optimization.shortcut import shorten
from hplan.robot.limits import least_duration, rest_to_rest
from hplan.trajectory.corner_rounding import clear_rounding
from hplan.trajectory.spline import SplinePath

#: Numbers of control points of a spline for an optimiser to begin with, tried in turn: as few as will do.
_FAST_CONTROL_POINTS = (6, 8, 7, 9, 10, 12, 14, 17, 20, 25, 30, 44)

#: Shortcuts tried before an optimiser begins: what is less taut has more room.
START_SHORTCUTS = 25

#: Ends nearer to each other than this are one [rad].
_NO_MOTION = 1e-9

#: Obstacles farther than this from the grid path are left out while the spline is moved [m].
NEAR = 0.3

#: With no more rows in the field than this none are left out.
FEW = 20

#: Fraction of the margin that is still asked for where the full one cannot be kept.
SMALLEST_FRACTION = 0.05


def clear_path(path: FloatArray, field: ClearanceField, options: PostprocessOptions) -> SplinePath:
    """The first smooth path near a clear polyline that is verified collision-free; straight where that is as fast.

    Args:
        path: (m, dof) waypoints, m >= 2.

    Raises:
        InputError: The path ends where it begins.
        CertificationError: Its motions cannot be verified, or its corners cannot be rounded.
    """
    smallest = _smallest_margin(path, field, options)
    if is_straight(path, field, options):
        return SplinePath.through(np.linspace(path[0], path[-1], 4))
    near = near_field(path, field, NEAR)
    # Where any clear spline will do: a number that fails takes milliseconds, and more points succeed more often.
    found = clear_start(path, near, options, (6, 10, 14, 20, 30, 44, 8, 12))
    if found is not None and (near is field or found.is_clear(field, 0.5 * smallest)):
        return found
    return clear_rounding(shorten(path, field, margin=smallest), field, margin=smallest)


def short_path(path: FloatArray, field: ClearanceField, options: PostprocessOptions) -> SplinePath:
    """A short smooth path: pulled taut, a spline along it. Arguments and errors are those of `clear_path`."""
    smallest = _smallest_margin(path, field, options)
    taut = shorten(path, field, margin=smallest)
    # For a short path many, so that the spline can follow the obstacles closely.
    for count in (44, 64):
        spline = clear_spline(taut, field, options, count=count, margin=smallest)
        if spline is not None:
            return spline
    return clear_rounding(taut, field, margin=smallest)


def _smallest_margin(path: FloatArray, field: ClearanceField, options: PostprocessOptions) -> float:
    """The least clearance that a path may have, if its ends differ and it has that."""
    if np.linalg.norm(path[-1] - path[0]) < _NO_MOTION:
        raise InputError("the path ends where it begins; there is no motion to make")
    smallest = SMALLEST_FRACTION * options.margin
    if not field.is_clear(path, smallest):
        raise CertificationError("the motions between the nodes of the path cannot be verified collision-free")
    return smallest


def is_straight(path: FloatArray, field: ClearanceField, options: PostprocessOptions) -> bool:
    """True if the fastest motion between the ends of a path is the straight one, which is verified collision-free."""
    least = least_duration(path[0], path[-1], options.velocity, options.acceleration)
    straight = straight_duration(path[0], path[-1], options)
    # A motion that takes no longer than so many times the least duration of its ends is as good as the fastest.
    return straight <= 1.005 * least and field.is_clear(path[[0, -1]], options.margin)


def near_field(path: FloatArray, field: ClearanceField, distance: float) -> ClearanceField:
    """The field without what is far from a path, which does not matter to optimisers; proofs do not leave it out."""
    return field.near(path, distance) if len(field.solids) > FEW else field


def clear_start(
    path: FloatArray,
    field: ClearanceField,
    options: PostprocessOptions,
    counts: Sequence[int] = _FAST_CONTROL_POINTS,
) -> SplinePath | None:
    """A spline along a clear path for an optimiser to begin with, verified collision-free; None where none is found.

    Args:
        path: (m, dof) waypoints, clear, m >= 2; what is made of it is verified, not the path.
        counts: Numbers of control points tried in turn.
    """
    if np.linalg.norm(path[-1] - path[0]) < _NO_MOTION:
        return None
    for margin in (options.margin, 0.25 * options.margin):
        taut = shorten(path, field, margin=margin, rounds=START_SHORTCUTS)
        for count in counts:
            spline = clear_spline(taut, field, options, count=count, margin=margin)
            if spline is not None:
                return spline
    return None


def straight_duration(start: FloatArray, goal: FloatArray, options: PostprocessOptions) -> float:
    """Duration of the straight motion, all joints in proportion, under velocity and acceleration limits [s]."""
    turn = np.abs(goal - start)
    moves = turn > 0.0
    speed = (options.velocity[moves] / turn[moves]).min()
    acceleration = (options.acceleration[moves] / turn[moves]).min()
    return float(rest_to_rest(np.ones(1), speed, acceleration)[0])
