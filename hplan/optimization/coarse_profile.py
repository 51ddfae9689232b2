r"""Approximate time-optimal motion along a spline, used as an optimizer's initial guess.

The estimate is the classic two-pass time-optimal parameterization on a coarse grid (Bobrow et al. 1985; Pham and Pham
2018): with :math:`x = \dot s^2` and :math:`u = \ddot s`, each joint demands
:math:`|q' u + q'' x| \le a` and :math:`|q'|^2 x \le v^2`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray, frozen
from hplan.base.kernels import kernel
from hplan.optimization.options import JointArrays, PostprocessOptions
from hplan.trajectory.cubics import bezier_piece
from hplan.trajectory.speed_profile import SpeedProfile
from hplan.trajectory.spline import SplinePath

#: Number of intervals of each spline piece on which speeds are estimated.
_PER_PIECE = 8


def coarse_profile(spline: SplinePath, options: PostprocessOptions) -> SpeedProfile:
    """Approximate time-optimal motion along a spline under velocity and acceleration limits.

    Takes about 0.1 ms. The limits hold at the grid points and may be exceeded slightly between them.
    """
    pieces = len(spline.control) - 3
    grid = _grid_of(spline.knots, pieces)
    points = len(grid.parameter)
    demands, square = np.empty((points, 2 * len(options.movable) + 1)), np.empty(points)
    _demands(np.array(spline.control), grid, options.joints, demands)
    _fastest(grid.parameter, demands, square)
    with np.errstate(divide="ignore"):  # at a cusp of the path the arm stops, which takes infinite time
        return SpeedProfile.from_speed(spline, frozen(grid.parameter), frozen(np.sqrt(square)))


class _Grid(NamedTuple):
    """Path grid for the speed estimate.

    An inner break point belongs to the piece that starts there.

    Attributes:
        parameter: (points,) path parameters.
        first: (points, 4) weights of the piece's control points in the first derivative.
        second: (points, 4) weights of the piece's control points in the second derivative.
    """

    parameter: FloatArray
    first: FloatArray
    second: FloatArray


@kernel
def _grid_of(knots: FloatArray, pieces: int) -> _Grid:
    """Compute the grid of a spline with these knots."""
    points = pieces * _PER_PIECE + 1
    grid, first, second = np.empty(points), np.empty((points, 4)), np.empty((points, 4))
    unit, piece = np.zeros((pieces + 3, 1)), np.empty((4, 1))
    for i in range(pieces):
        width = knots[i + 4] - knots[i + 3]
        for c in range(4):
            unit[i + c, 0] = 1.0
            bezier_piece(unit, knots, i + 3, piece)
            unit[i + c, 0] = 0.0
            a, b, d = piece[1, 0] - piece[0, 0], piece[2, 0] - piece[1, 0], piece[3, 0] - piece[2, 0]
            for sample in range(_PER_PIECE + 1):
                row = i * _PER_PIECE + sample
                t = sample / _PER_PIECE
                u = 1.0 - t
                grid[row] = knots[i + 3] + t * width
                first[row, c] = 3.0 * (u * u * a + 2.0 * u * t * b + t * t * d) / width
                second[row, c] = 6.0 * (u * (b - a) + t * (d - b)) / (width * width)
    return _Grid(grid, first, second)


@kernel
def _demands(control: FloatArray, grid: _Grid, joints: JointArrays, demands: FloatArray) -> None:
    """Write the velocity and acceleration constraints at the grid points.

    With q' taken positive, each row of `demands` holds push = a / q' and bend = q'' / q' for each movable joint, so
    that -push <= u + bend x <= push; its last entry is the maximum x within the velocity limits that has a feasible u.
    """
    _, first, second = grid
    _, _, velocity, acceleration, movable = joints
    points, count = demands.shape[0], len(movable)
    for row in range(points):
        demand = demands[row]
        i = min(row // _PER_PIECE, (points - 1) // _PER_PIECE - 1)
        cap = 1e12
        for m in range(count):
            j = movable[m]
            p, c = 0.0, 0.0
            for k in range(4):
                p += first[row, k] * control[i + k, j]
                c += second[row, k] * control[i + k, j]
            if p < 0.0:
                p, c = -p, -c
            if p < 1e-6:
                demand[2 * m], demand[2 * m + 1] = 1e12, 0.0
                if abs(c) > 1e-9:
                    cap = min(cap, acceleration[j] / abs(c))
                continue
            inverse = 1.0 / p
            demand[2 * m], demand[2 * m + 1] = acceleration[j] * inverse, c * inverse
            cap = min(cap, (velocity[j] * inverse) ** 2)
        for m in range(count):
            for n in range(m):
                gap = abs(demand[2 * m + 1] - demand[2 * n + 1])
                both = demand[2 * m] + demand[2 * n]
                if gap * cap > both:
                    cap = both / gap
        demand[2 * count] = cap


@kernel
def _fastest(grid: FloatArray, demands: FloatArray, square: FloatArray) -> None:
    """Write the maximum squared path speeds: one forward, one backward pass."""
    points, most = demands.shape[0], demands.shape[1] - 1
    last = points - 1
    square[0] = 0.0
    for i in range(last):
        u = 1e12
        for k in range(0, most, 2):
            u = min(u, demands[i, k] - demands[i, k + 1] * square[i])
        square[i + 1] = min(demands[i + 1, most], max(0.0, square[i] + 2.0 * u * (grid[i + 1] - grid[i])))
    square[last] = 0.0
    for i in range(last, 0, -1):
        u = 1e12
        for k in range(0, most, 2):
            u = min(u, demands[i, k] + demands[i, k + 1] * square[i])
        square[i - 1] = min(square[i - 1], max(0.0, square[i] + 2.0 * u * (grid[i] - grid[i - 1])))
