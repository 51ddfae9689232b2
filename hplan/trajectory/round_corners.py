"""Corners rounded: a spline near a clear polyline, shown clear itself.

Around each corner the control points stand at a distance `d` on both sides of it. Where four neighbours are in line
the spline is straight; at a corner it stays in the hull of the corner's control points and their neighbours. A piece
that cannot be shown clear has the distance of its corner halved: in the limit the spline is the polyline.
"""

from __future__ import annotations

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.collision.clearance_field import ClearanceField
from hplan.errors import CertificationError
from hplan.trajectory.spline import SplinePath, first_contact

#: Smallest distance of a control point from its corner [rad].
_SMALLEST = 1e-6


def smooth(path: FloatArray, field: ClearanceField, *, margin: float) -> SplinePath:
    """A spline with the ends of a clear polyline, near it, shown clear.

    Args:
        path: (m, dof) waypoints, m >= 2, clear at `margin`, no two neighbours equal.
        field: Arm and obstacles.
        margin: Clearance the polyline has wherever it was evaluated [m]; half of it is asked of the spline.

    Raises:
        CertificationError: No rounding of some corner can be shown clear.
    """
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    cuts = np.minimum(lengths[:-1], lengths[1:]) / 3.0
    while True:
        control, corner_of = _control_points(path, lengths, cuts)
        spline = SplinePath.through(control)
        bad = first_contact(spline.pieces, field, 0.5 * margin)
        if not bad.any():
            return spline
        # Piece i depends on control points i to i + 3.
        corners = {int(c) for i in np.flatnonzero(bad) for c in corner_of[i : i + 4] if c >= 0}
        if not corners or min(cuts[c] for c in corners) < _SMALLEST:
            raise CertificationError(
                "the path's corners cannot be rounded within its clearance", pieces=np.flatnonzero(bad).tolist()
            )
        cuts[list(corners)] *= 0.5


def _control_points(path: FloatArray, lengths: FloatArray, cuts: FloatArray) -> tuple[FloatArray, list[int]]:
    """Control points, `cuts` from the corners, and for each the corner it belongs to (-1: none)."""
    points, corner_of = [path[0]], [-1]
    for i, length in enumerate(lengths):
        direction = (path[i + 1] - path[i]) / length
        if i > 0:
            points.append(path[i] + cuts[i - 1] * direction)
            corner_of.append(i - 1)
        # Between its corners a segment is straight; a point in its middle keeps it so.
        points.append(0.5 * (path[i] + path[i + 1]))
        corner_of.append(-1)
        if i < len(lengths) - 1:
            points.append(path[i + 1] - cuts[i] * direction)
            points.append(path[i + 1])
            corner_of.extend([i, i])
    points.append(path[-1])
    corner_of.append(-1)
    if len(points) < 4:
        thirds = [path[0] + (path[-1] - path[0]) * f for f in (0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)]
        return np.array(thirds), [-1] * 4
    return np.array(points), corner_of
