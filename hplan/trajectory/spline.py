"""The smooth path: a clamped cubic B-spline in joint space.

Its second derivative is continuous, so no jump of acceleration comes from geometry. Every span is a cubic Bezier
piece that lies in the hull of its four control points, and so the whole path is within the joint limits as soon as
the control points are; the hull of a piece's derivative bounds its motion, which is what shows it clear.
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
from hplan.base.polyline import curve_length, stations
from hplan.collision.body_motions import piece_is_clear
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.obstacle_rows import FieldArrays
from hplan.errors import InputError
from hplan.trajectory.cubics import bezier_piece, bezier_pieces, evaluate

#: Longest step along a piece with which an optimiser looks for contact before the proof.
STRIDE = 1.0 / 16.0

#: Panels of a piece, each with Gauss-Legendre quadrature, for its length: a path may have cusps.
_PANELS = 6


@dataclass(frozen=True, eq=False)
class SplinePath(Record):
    """A path from its first control point to its last; the parameter runs about as the joint-space length.

    Attributes:
        control: (n, dof) control points, n >= 4.
        knots: (n + 4,) clamped knots.
    """

    control: FloatArray
    knots: FloatArray

    @classmethod
    def through(cls, control: ArrayLike) -> SplinePath:
        """The spline with these control points, its knots averaged from the control polygon's length.

        Averaging (de Boor, A Practical Guide to Splines, XIII) makes the parameter follow the length.

        Raises:
            InputError: Fewer than 4 control points, the first two or the last two equal, or too many in between.
        """
        points = readonly(control)
        station = stations(points)
        if len(points) < 4:
            raise InputError(f"a spline needs at least 4 control points, got {len(points)}")
        inner = (station[1:-3] + station[2:-2] + station[3:-1]) / 3.0
        knots = np.concatenate([[0.0] * 4, inner, [station[-1]] * 4])
        if not (np.diff(knots[3:-3]) > 0.0).all() or not (np.diff(station)[[0, -1]] > 0.0).all():
            raise InputError("too many control points coincide, or one is no number")
        return cls(points, readonly(knots))

    @cached_property
    def breaks(self) -> FloatArray:
        """(pieces + 1,) parameters where pieces meet."""
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
        """Points or derivatives with respect to the parameter; returns (..., dof) values.

        Args:
            s: (...) parameters in [0, end]; clipped to it.
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
        """True if the whole path is verified collision-free; `margin` [m] is asked for wherever it is evaluated."""
        return bool(np.isfinite(self.control).all()) and not first_contact(self.pieces, field, margin).any()


def first_contact(pieces: FloatArray, field: ClearanceField, margin: float) -> BoolArray:
    """(pieces,) True for each Bezier piece that is not verified collision-free."""
    contact = np.array([not piece_is_clear(piece, field.arrays, margin, 0.0) for piece in np.array(pieces)])
    check_deadline()
    return contact


class MovableSpline(NamedTuple):
    """A spline whose control points, (n, dof), an optimiser moves; its knots stay.

    Its piece `i` depends on the control points `i` to `i + 3`.
    """

    control: FloatArray
    knots: FloatArray


@kernel
def pieces_are_clear(spline: MovableSpline, field: FieldArrays, margin: float) -> bool:
    """True if all pieces are clear in the sense of `piece_is_clear`."""
    control, knots = spline
    piece = np.empty((4, control.shape[1]))
    for i in range(3, control.shape[0]):
        bezier_piece(control, knots, i, piece)
        if not piece_is_clear(piece, field, margin, 0.0):
            return False
    return True
