"""Lengths of polylines and curves in any space."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hplan.base.arrays import FloatArray

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


def stations(points: FloatArray) -> FloatArray:
    """(m,) arc lengths of the polyline at its (m, d) points."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def curve_length(speed: Callable[[FloatArray], FloatArray], panels: FloatArray) -> float:
    """Length of a curve, by 8-point Gauss-Legendre quadrature on each panel.

    Args:
        speed: Maps (k, 8) parameters to (k, 8) speeds.
        panels: (k + 1,) increasing parameters; the curve is smooth between them.
    """
    width = np.diff(panels)[:, None]
    return float((0.5 * width * _WEIGHTS * speed(panels[:-1, None] + 0.5 * (_NODES + 1.0) * width)).sum())


def path_length(points: FloatArray) -> float:
    """Length of a polyline of (m, d) points."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
