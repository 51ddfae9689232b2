"""Lengths along a polyline, in joint space or any other."""

from __future__ import annotations

import numpy as np

from hplan.arrays import FloatArray


def stations(points: FloatArray) -> FloatArray:
    """Length of the polyline up to each of its (m, d) points, (m,)."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def path_length(points: FloatArray) -> float:
    """Length of a polyline of (m, d) points."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
