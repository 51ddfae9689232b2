r"""Duration minimised over the control points of a spline.

The shortest path is not the fastest: it turns sharply around obstacles, and where it turns the arm must slow down.
Here the control points of the spline are moved, one joint at a time (pattern search), to lower an estimate of the
duration under velocity and acceleration limits. A step is kept only if the margin is kept at samples of all pieces
that it changes, and a round of steps only if the whole path is then shown clear; the result is therefore as safe as
the start. A step into an obstacle is given a second chance: the control points around it are pushed out, so that the
path can slide along the obstacle.

The estimate is the classic two-pass time-optimal parameterisation on a coarse grid (Bobrow et al. 1985; Pham and Pham
2018): with :math:`x = \dot s^2` and :math:`u = \ddot s`, each joint demands
:math:`|q' u + q'' x| \le a` and :math:`|q'|^2 x \le v^2`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray, frozen
from hplan.base.deadline import is_up, look
from hplan.base.kernels import any_int, inlined, kernel
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.clearance_kernels import FieldArrays
from hplan.smoothing.options import JointArrays, PostprocessOptions
from hplan.smoothing.push_clear import push_out
from hplan.smoothing.spline import FIRST, STRIDE, MovableSpline, SplinePath, bezier_piece, copy_into, pieces_are_clear
from hplan.timing.speed_profile import SpeedProfile

#: Points at which a piece's speed is estimated.
_PER_PIECE = 8

#: Rounds of pushing a control point's neighbours out after a move into contact.
_SLIDES = any_int(3)


def minimize_duration(
    spline: SplinePath, field: ClearanceField, options: PostprocessOptions, *, margin: float
) -> tuple[SplinePath, float]:
    """Move the control points for a shorter duration.

    Args:
        spline: A clear spline.
        field: Arm and obstacles.
        options: Limits, movable joints and effort.
        margin: Clearance asked for at the samples [m]; half of it wherever the proof evaluates it.

    Returns:
        A spline with the same ends, clear, and the estimate of its duration [s], no longer than before.
    """
    control = np.array(spline.control)
    moved = MovableSpline(control, spline.knots)
    duration = _search(moved, field.arrays, options.joints, margin, options.trials)
    look()
    return SplinePath(frozen(control), spline.knots), float(duration)


def estimated_duration(spline: SplinePath, options: PostprocessOptions) -> float:
    """The estimate of a spline's duration that `minimize_duration` goes by [s]."""
    return _estimate(spline, options)[2]


def coarse_profile(spline: SplinePath, options: PostprocessOptions) -> SpeedProfile:
    """About the fastest motion along a spline under velocity and acceleration limits, in a tenth of a millisecond.

    Between the points of its grid the limits are passed by a little.
    """
    parameter, square, _ = _estimate(spline, options)
    with np.errstate(divide="ignore"):  # where the path has a cusp the arm stops, for ever
        return SpeedProfile.of(spline, frozen(parameter), frozen(np.sqrt(square)))


def _estimate(spline: SplinePath, options: PostprocessOptions) -> tuple[FloatArray, FloatArray, float]:
    """Path parameters, the squares of the path speed there, and the duration [s]."""
    pieces = len(spline.control) - 3
    grid = _grid_of(spline.knots, pieces)
    points = len(grid.parameter)
    demands, square = np.empty((points, 2 * len(options.movable) + 1)), np.empty(points)
    _demands(np.array(spline.control), FIRST, pieces - 1, grid, options.joints, demands)
    return grid.parameter, square, float(_duration(grid.parameter, demands, square))


class _Grid(NamedTuple):
    """Points of the path at which speeds are estimated: each inner end of a piece belongs to the piece after it.

    Attributes:
        parameter: (points,) path parameters.
        first: (points, 4) weights of the piece's control points in the first derivative.
        second: (points, 4) and in the second.
    """

    parameter: FloatArray
    first: FloatArray
    second: FloatArray


@kernel
def _grid_of(knots: FloatArray, pieces: int) -> _Grid:
    """The grid of a spline with these knots."""
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
def _demands(control: FloatArray, low: int, high: int, grid: _Grid, joints: JointArrays, demands: FloatArray) -> None:
    """Write what the limits demand at the grid points of pieces low to high.

    Written into the rows of `demands` are, with q' taken positive, push = a / q' and bend = q'' / q' for each movable
    joint, so that -push <= u + bend x <= push, and last the largest x at which some u remains.
    """
    _, first, second = grid
    _, _, velocity, acceleration, movable = joints
    points, count = demands.shape[0], len(movable)
    for row in range(low * _PER_PIECE, _rows_up_to(high, points)):
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


@inlined
def _rows_up_to(piece: int, points: int) -> int:
    """Grid points of the pieces up to one; the last piece has both its ends."""
    return points if piece == (points - 1) // _PER_PIECE - 1 else (piece + 1) * _PER_PIECE


@kernel
def _copy_rows(target: FloatArray, source: FloatArray, low: int, high: int) -> None:
    """Copy the rows of pieces low to high."""
    for row in range(low * _PER_PIECE, _rows_up_to(high, len(source))):
        for k in range(source.shape[1]):
            target[row, k] = source[row, k]


@kernel
def _duration(grid: FloatArray, demands: FloatArray, square: FloatArray) -> float:
    """Duration by one pass forward and one back; `square` is left as the squared path speed."""
    points, most = demands.shape[0], demands.shape[1] - 1
    last = points - 1
    square[0] = 0.0
    for i in range(last):
        u = 1e12
        for k in range(0, most, 2):
            u = min(u, demands[i, k] - demands[i, k + 1] * square[i])
        square[i + 1] = min(demands[i + 1, most], max(0.0, square[i] + 2.0 * u * (grid[i + 1] - grid[i])))
    square[last] = 0.0
    duration, after = 0.0, 0.0
    for i in range(last, 0, -1):
        u = 1e12
        for k in range(0, most, 2):
            u = min(u, demands[i, k] + demands[i, k + 1] * square[i])
        span = grid[i] - grid[i - 1]
        square[i - 1] = min(square[i - 1], max(0.0, square[i] + 2.0 * u * span))
        before = math.sqrt(square[i - 1])
        duration += 2.0 * span / max(1e-6, before + after)
        after = before
    return duration


@kernel
def _search(spline: MovableSpline, field: FieldArrays, joints: JointArrays, margin: float, trials: int) -> float:
    """Pattern search over the inner control points, each coordinate with a step of its own."""
    control, (lower, upper, _, _, movable) = spline.control, joints
    count, dof = control.shape
    pieces = count - 3
    grid = _grid_of(spline.knots, pieces)
    points = len(grid.parameter)
    demands, square = np.empty((points, 2 * len(movable) + 1)), np.empty(points)
    saved = np.empty((count, dof))
    step = np.empty((count, dof))
    for c in range(count):
        for j in range(dof):
            step[c, j] = 0.05
    _demands(control, FIRST, pieces - 1, grid, joints, demands)
    kept = demands.copy()  # of the control points as they stand between moves
    best = _duration(grid.parameter, demands, square)
    tried = 0
    largest = 1.0
    paid = False
    proven = control.copy()
    while tried < trials and largest > 1e-4:
        largest = 0.0
        for move in range(2 * (count - 2) * len(movable)):
            # Each coordinate has two moves in turn: its step, and where that does not pay the opposite one.
            c, j = 1 + (move // 2) // len(movable), movable[(move // 2) % len(movable)]
            if move % 2 == 1 and paid:
                continue
            if is_up(field.until):
                return math.inf
            low, high = max(0, c - 3), min(pieces - 1, c)
            copy_into(saved, control)
            control[c, j] = min(upper[j], max(lower[j], control[c, j] + step[c, j]))
            tried += 1
            _demands(control, low, high, grid, joints, demands)
            value = _duration(grid.parameter, demands, square)
            paid = value < best - 1e-7
            if paid and not pieces_are_clear(spline, low, high, field, margin, STRIDE):
                # Slide along the obstacle: push the neighbours out, and see whether it still pays.
                paid = push_out(spline, low, high, field, joints, margin, _SLIDES)
                low, high = max(0, c - 6), min(pieces - 1, c + 3)
                if paid:
                    _demands(control, low, high, grid, joints, demands)
                    value = _duration(grid.parameter, demands, square)
                    paid = value < best - 1e-7 and pieces_are_clear(spline, low, high, field, margin, STRIDE)
            if paid:
                best = value
                _copy_rows(kept, demands, low, high)
                step[c, j] *= 1.6
            else:
                copy_into(control, saved)
                _copy_rows(demands, kept, low, high)
                step[c, j] *= -1.0 if move % 2 == 0 else -0.4
            largest = max(largest, abs(step[c, j]))
        if not pieces_are_clear(spline, FIRST, pieces - 1, field, 0.5 * margin, 0.0):
            copy_into(control, proven)
            _demands(control, FIRST, pieces - 1, grid, joints, demands)
            return float(_duration(grid.parameter, demands, square))
        copy_into(proven, control)
    return float(best)
