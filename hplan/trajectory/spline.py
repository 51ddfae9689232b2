"""Smooth path: a clamped cubic B-spline in joint space.

Its second derivative is continuous, so the geometry causes no jump of acceleration. Every span is a cubic Bezier piece
that lies in the convex hull of its four control points. The whole path is therefore within the joint limits if the
control points are; the hull of a piece's derivative bounds its motion, which the collision check uses.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import BoolArray, FloatArray, Record, frozen, readonly
from hplan.base.deadline import check_deadline
from hplan.base.kernels import kernel
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.compiled_motions import piece_is_clear
from hplan.collision.compiled_obstacles import FieldArrays
from hplan.errors import InputError
from hplan.geometry.polyline import curve_length, stations
from hplan.trajectory.cubics import bezier_piece, bezier_pieces, evaluate

#: Longest step along a piece, as a fraction, of the optimizer's sampled contact check before the exact one.
STRIDE = 1.0 / 16.0

#: Number of panels of a piece, each with Gauss-Legendre quadrature, for its length: a path may have cusps.
_PANELS = 6


@dataclass(frozen=True, eq=False)
class SplinePath(Record):
    """Path from its first to its last control point.

    The parameter is approximately the joint-space arc length.

    Attributes:
        control: (n, dof) control points, n >= 4.
        knots: (n + 4,) clamped knots.
    """

    control: FloatArray
    knots: FloatArray

    @classmethod
    def from_control_points(cls, control: ArrayLike) -> SplinePath:
        """Spline with these control points and knots averaged along their polygon.

        Averaging (de Boor, A Practical Guide to Splines, XIII) makes the parameter follow the arc length.

        Raises:
            InputError: There are fewer than 4 control points, the first two or the last two are equal, or too many
                coincide in between.

        Examples:
            >>> path = SplinePath.from_control_points([[0.0], [1.0], [2.0], [3.0]])
            >>> path.evaluate(path.end).tolist(), round(path.length, 9)
            ([3.0], 3.0)
        """
        points = readonly(control)
        station = stations(points)
        if len(points) < 4:
            raise InputError(f"a spline needs at least 4 control points, got {len(points)}")
        inner = (station[1:-3] + station[2:-2] + station[3:-1]) / 3.0
        knots = np.concatenate([[0.0] * 4, inner, [station[-1]] * 4])
        if not (np.diff(knots[3:-3]) > 0.0).all() or not (np.diff(station)[[0, -1]] > 0.0).all():
            raise InputError("too many control points coincide, or one is not a number")
        return cls(points, readonly(knots))

    @cached_property
    def breaks(self) -> FloatArray:
        """(pieces + 1,) break parameters of the pieces."""
        return readonly(self.knots[3:-3])

    @cached_property
    def pieces(self) -> FloatArray:
        """(pieces, 4, dof) Bezier control points of the spans."""
        return frozen(bezier_pieces(np.array(self.control), self.knots))

    @property
    def end(self) -> float:
        """Last parameter; the first is 0."""
        return float(self.knots[-1])

    def evaluate(self, s: ArrayLike, derivative: int = 0) -> FloatArray:
        """Evaluate the path or its derivatives; returns (..., dof) values.

        Derivatives are with respect to the parameter.

        Args:
            s: (...) parameters; clipped to [0, end].
            derivative: 0, 1 or 2.
        """
        return evaluate(self.pieces, self.breaks, s, derivative)

    @cached_property
    def length(self) -> float:
        """Joint-space length, by Gauss-Legendre quadrature on `_PANELS` panels of each piece."""
        starts = np.arange(_PANELS) / _PANELS
        inner = self.breaks[:-1, None] + starts * np.diff(self.breaks)[:, None]
        panels = np.append(inner.ravel(), self.breaks[-1])
        return curve_length(lambda s: np.linalg.norm(self.evaluate(s, 1), axis=-1), panels)

    def is_clear(self, field: ClearanceField, margin: float) -> bool:
        """True if the whole path is verified collision-free.

        Args:
            field: Clearances to the obstacles.
            margin: Required clearance at each evaluated configuration [m].
        """
        return bool(np.isfinite(self.control).all()) and not blocked_pieces(self.pieces, field, margin).any()


def blocked_pieces(pieces: FloatArray, field: ClearanceField, margin: float) -> BoolArray:
    """(pieces,) True for each Bezier piece that is not verified collision-free."""
    blocked = np.empty(len(pieces), dtype=np.bool_)
    _mark_blocked(np.array(pieces), field.arrays, margin, blocked)
    check_deadline()
    return blocked


@kernel
def _mark_blocked(pieces: FloatArray, field: FieldArrays, margin: float, blocked: BoolArray) -> None:
    """Mark the pieces that `piece_is_clear` does not verify."""
    for i in range(len(pieces)):
        blocked[i] = not piece_is_clear(pieces[i], field, margin, 0.0)


class MovableSpline(NamedTuple):
    """Spline with fixed knots whose (n, dof) control points an optimizer moves.

    Its piece `i` depends on the control points `i` to `i + 3`.
    """

    control: FloatArray
    knots: FloatArray


@kernel
def pieces_are_clear(spline: MovableSpline, field: FieldArrays, margin: float) -> bool:
    """True if `piece_is_clear` verifies all pieces."""
    control, knots = spline
    piece = np.empty((4, control.shape[1]))
    for i in range(3, control.shape[0]):
        bezier_piece(control, knots, i, piece)
        if not piece_is_clear(piece, field, margin, 0.0):
            return False
    return True
