r"""The spline moved to where the motion along it is fastest.

The shortest path is not the fastest: it turns sharply around obstacles, and where it turns the arm must slow down.
Here the control points of the spline are moved, one joint at a time (pattern search), to lower an estimate of the
duration under velocity and acceleration limits. A step is kept only if all pieces that it changes are shown clear and
within the joint limits; the result is therefore as safe as the start.

The estimate is the classic two-pass time-optimal parameterisation on a coarse grid (Bobrow et al. 1985; Pham and Pham
2018): with :math:`x = \dot s^2` and :math:`u = \ddot s`, each joint demands
:math:`|q' u + q'' x| \le a` and :math:`|q'|^2 x \le v^2`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba as nb
import numpy as np

from hplan.arrays import FloatArray, IntArray, frozen
from hplan.clearance import ClearanceField, _link_clearances
from hplan.errors import CertificationError
from hplan.postprocess.shorten import shorten
from hplan.postprocess.smooth import smooth
from hplan.postprocess.spline import SplinePath, bezier_piece, piece_is_clear

#: Numbers of control points tried in turn.
CONTROL_POINTS = (6, 7, 8, 9, 10, 12, 14, 17, 20, 25, 30, 44)

#: Share of the margin that is still asked for where the full one cannot be kept.
SMALLEST_SHARE = 0.05

#: Points at which a piece's speed is estimated.
_PER_PIECE = 8


@dataclass(frozen=True, eq=False)
class PostprocessOptions:
    """What post-processing has to respect, and how long it may try.

    Attributes:
        lower: (dof,) joint limits.
        upper: (dof,) joint limits.
        velocity: (dof,) velocity limits [rad/s].
        acceleration: (dof,) acceleration limits [rad/s^2].
        movable: Joints that may move.
        margin: Clearance asked for wherever a motion is evaluated [m].
        shortcuts: Shortcuts tried on the polyline.
        trials: Steps tried on the spline.
        length_weight: Seconds that a radian of path length is worth.
    """

    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    movable: IntArray
    margin: float
    shortcuts: int = 200
    trials: int = 500
    length_weight: float = 0.0


def fast_path(path: FloatArray, field: ClearanceField, options: PostprocessOptions) -> SplinePath:
    """A smooth path worth executing, near a grid path: shortened, splined, and moved to where it is fast.

    Args:
        path: (m, dof) waypoints of the grid path, m >= 2.
        field: Arm and obstacles.
        options: Limits, margin and effort.

    Raises:
        CertificationError: The grid path's own motions cannot be shown clear, or its corners cannot be rounded.
    """
    smallest = SMALLEST_SHARE * options.margin
    if not field.is_clear(path, smallest):
        raise CertificationError("the motions between the nodes of the grid path cannot be shown clear")
    for margin in (options.margin, 0.25 * options.margin, smallest):
        taut = shorten(path, field, margin=margin, rounds=options.shortcuts)
        for count in CONTROL_POINTS:
            spline = clear_spline(taut, field, options, count=count, margin=margin)
            if spline is not None:
                return hasten(spline, field, options, margin=margin)
    taut = shorten(path, field, margin=smallest, rounds=options.shortcuts)
    return hasten(smooth(taut, field, margin=smallest), field, options, margin=0.5 * smallest)


def clear_spline(
    path: FloatArray, field: ClearanceField, options: PostprocessOptions, *, count: int, margin: float
) -> SplinePath | None:
    """A spline of few control points along a clear polyline, pushed out of the obstacles that its corners cut.

    Args:
        path: (m, dof) waypoints, clear.
        field: Arm and obstacles.
        options: Joint limits and movable joints.
        count: Number of control points, >= 4.
        margin: Clearance asked for wherever it is evaluated [m].

    Returns:
        The spline, shown clear, or None where pushing did not succeed.
    """
    station = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    even = np.linspace(0.0, station[-1], count)
    control = np.column_stack([np.interp(even, station, path[:, joint]) for joint in range(path.shape[1])])
    control[0], control[-1] = path[0], path[-1]
    knots = SplinePath.through(control).knots
    pushed = _push_out(
        control, knots, field.chain, field.base, field.solids, options.lower, options.upper, options.movable, margin,
        0, count - 4, 40,
    )  # fmt: skip
    return SplinePath(frozen(control), knots) if pushed else None


def hasten(spline: SplinePath, field: ClearanceField, options: PostprocessOptions, *, margin: float) -> SplinePath:
    """Move the control points for a shorter duration.

    Args:
        spline: A clear spline.
        field: Arm and obstacles.
        options: Limits, movable joints and effort.
        margin: Clearance asked for wherever it is evaluated [m].

    Returns:
        A spline with the same ends, clear, with an estimate no longer than before.
    """
    control = np.array(spline.control)
    _search(
        control, spline.knots, field.chain, field.base, field.solids, options.lower, options.upper, options.velocity,
        options.acceleration, options.movable, margin, options.length_weight, options.trials,
    )  # fmt: skip
    return SplinePath(frozen(control), spline.knots)


@nb.njit(cache=True)
def _push_out(
    control: FloatArray,
    knots: FloatArray,
    chain: FloatArray,
    base: FloatArray,
    solids: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    movable: IntArray,
    margin: float,
    first_piece: int,
    last_piece: int,
    rounds: int,
) -> bool:
    """Move control points along the gradient of the clearance until the pieces named are shown clear."""
    count, dof = control.shape
    links = chain.shape[0]
    piece, q, clear = np.empty((4, dof)), np.empty(dof), np.empty(links)
    worst, gradient = np.empty(dof), np.empty(dof)
    weight = np.empty(4)
    for _ in range(rounds):
        contact = False
        for i in range(first_piece, last_piece + 1):
            bezier_piece(control, knots, i + 3, piece)
            if piece_is_clear(piece, chain, base, solids, margin):
                continue
            contact = True
            least, at = math.inf, 0.0
            for sample in range(17):
                t = sample / 16.0
                u = 1.0 - t
                for j in range(dof):
                    q[j] = (
                        u * u * u * piece[0, j] + 3.0 * u * u * t * piece[1, j] + 3.0 * u * t * t * piece[2, j]
                        + t * t * t * piece[3, j]
                    )  # fmt: skip
                _link_clearances(q, chain, base, solids, clear)
                if clear.min() < least:
                    least, at = clear.min(), t
                    worst[:] = q
            square = 0.0
            for j in range(dof):
                gradient[j] = 0.0
            for j in movable:
                q[:] = worst
                q[j] = worst[j] + 1e-4
                _link_clearances(q, chain, base, solids, clear)
                ahead = clear.min()
                q[j] = worst[j] - 1e-4
                _link_clearances(q, chain, base, solids, clear)
                gradient[j] = (ahead - clear.min()) / 2e-4
                square += gradient[j] * gradient[j]
            if square < 1e-8:
                return False
            # Share the step among the four control points about as they weigh on the curve there.
            u = 1.0 - at
            weight[0] = u * u * u / 6.0
            weight[3] = at * at * at / 6.0
            weight[1] = (3.0 * at * at * at - 6.0 * at * at + 4.0) / 6.0
            weight[2] = 1.0 - weight[0] - weight[1] - weight[3]
            total = 0.0
            for c in range(4):
                if 0 < i + c < count - 1:
                    total += weight[c] * weight[c]
            if total < 1e-6:
                return False
            step = 1.2 * (max(2.0 * margin, 1e-3) - least) / square / total
            for c in range(4):
                if 0 < i + c < count - 1:
                    for j in movable:
                        moved = control[i + c, j] + step * weight[c] * gradient[j]
                        control[i + c, j] = min(upper[j], max(lower[j], moved))
        if not contact:
            return True
    return False


@nb.njit(cache=True)
def _differentiate(control: FloatArray, knots: FloatArray, i: int, first: FloatArray, second: FloatArray) -> None:
    """First and second derivative at the `_PER_PIECE` points of piece i (its end excluded)."""
    dof = control.shape[1]
    piece = np.empty((4, dof))
    bezier_piece(control, knots, i + 3, piece)
    width = knots[i + 4] - knots[i + 3]
    for sample in range(_PER_PIECE + 1):
        t = sample / _PER_PIECE
        u = 1.0 - t
        row = i * _PER_PIECE + sample
        if row >= first.shape[0]:
            break
        for j in range(dof):
            a, b, c = piece[1, j] - piece[0, j], piece[2, j] - piece[1, j], piece[3, j] - piece[2, j]
            first[row, j] = 3.0 * (u * u * a + 2.0 * u * t * b + t * t * c) / width
            second[row, j] = 6.0 * (u * (b - a) + t * (c - b)) / (width * width)


@nb.njit(cache=True)
def estimate_duration(
    first: FloatArray, second: FloatArray, grid: FloatArray, velocity: FloatArray, acceleration: FloatArray,
    speed: FloatArray,
) -> float:  # fmt: skip
    """Duration of the motion along a path given by its derivatives on a grid; `speed` is left as the squared speed."""
    points, dof = first.shape
    for i in range(points):
        most = 1e12
        for j in range(dof):
            p = abs(first[i, j])
            c = second[i, j] if first[i, j] >= 0.0 else -second[i, j]
            if p > 1e-9:
                most = min(most, (velocity[j] / p) ** 2)
            if p < 1e-6:
                if abs(c) > 1e-9:
                    most = min(most, acceleration[j] / abs(c))
                continue
            for k in range(dof):
                pk = abs(first[i, k])
                if pk < 1e-6:
                    continue
                ck = second[i, k] if first[i, k] >= 0.0 else -second[i, k]
                gap = c / p - ck / pk
                if gap > 1e-12:
                    most = min(most, (acceleration[j] / p + acceleration[k] / pk) / gap)
        speed[i] = most
    speed[0], speed[points - 1] = 0.0, 0.0
    for i in range(points - 1):
        u = 1e12
        for j in range(dof):
            p = abs(first[i, j])
            if p > 1e-6:
                c = second[i, j] if first[i, j] >= 0.0 else -second[i, j]
                u = min(u, (acceleration[j] - c * speed[i]) / p)
        reach = max(0.0, speed[i] + 2.0 * u * (grid[i + 1] - grid[i]))
        speed[i + 1] = min(speed[i + 1], reach)
    for i in range(points - 1, 0, -1):
        u = 1e12
        for j in range(dof):
            p = abs(first[i, j])
            if p > 1e-6:
                c = second[i, j] if first[i, j] >= 0.0 else -second[i, j]
                u = min(u, (acceleration[j] + c * speed[i]) / p)
        reach = max(0.0, speed[i] + 2.0 * u * (grid[i] - grid[i - 1]))
        speed[i - 1] = min(speed[i - 1], reach)
    duration = 0.0
    for i in range(points - 1):
        duration += 2.0 * (grid[i + 1] - grid[i]) / max(1e-6, math.sqrt(speed[i]) + math.sqrt(speed[i + 1]))
    return duration


@nb.njit(cache=True)
def _length(first: FloatArray, grid: FloatArray) -> float:
    """Path length by the trapezoidal rule."""
    total = 0.0
    before = math.sqrt((first[0] ** 2).sum())
    for i in range(1, first.shape[0]):
        here = math.sqrt((first[i] ** 2).sum())
        total += 0.5 * (before + here) * (grid[i] - grid[i - 1])
        before = here
    return total


@nb.njit(cache=True)
def _search(
    control: FloatArray,
    knots: FloatArray,
    chain: FloatArray,
    base: FloatArray,
    solids: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    movable: IntArray,
    margin: float,
    length_weight: float,
    trials: int,
) -> None:
    """Pattern search over the inner control points, each coordinate with a step of its own."""
    count, dof = control.shape
    pieces = count - 3
    points = pieces * _PER_PIECE + 1
    grid = np.empty(points)
    for i in range(pieces):
        for sample in range(_PER_PIECE):
            grid[i * _PER_PIECE + sample] = knots[i + 3] + sample / _PER_PIECE * (knots[i + 4] - knots[i + 3])
    grid[points - 1] = knots[count]
    first, second, speed = np.empty((points, dof)), np.empty((points, dof)), np.empty(points)
    for i in range(pieces):
        _differentiate(control, knots, i, first, second)
    best = estimate_duration(first, second, grid, velocity, acceleration, speed)
    best += length_weight * _length(first, grid)
    step = np.full((count, dof), 0.05)
    piece, saved = np.empty((4, dof)), np.empty((count, dof))
    tried = 0
    while tried < trials:
        largest = 0.0
        for c in range(1, count - 1):
            low_piece, high_piece = max(0, c - 3), min(pieces - 1, c)
            for j in movable:
                for turn in range(2):
                    old = control[c, j]
                    new = min(upper[j], max(lower[j], old + step[c, j]))
                    if new == old:
                        step[c, j] = -step[c, j]
                        continue
                    tried += 1
                    control[c, j] = new
                    for i in range(low_piece, high_piece + 1):
                        _differentiate(control, knots, i, first, second)
                    value = estimate_duration(first, second, grid, velocity, acceleration, speed)
                    value += length_weight * _length(first, grid)
                    good = value < best - 1e-7
                    repaired = False
                    if good:
                        for i in range(low_piece, high_piece + 1):
                            bezier_piece(control, knots, i + 3, piece)
                            if not piece_is_clear(piece, chain, base, solids, margin):
                                good = False
                                break
                        if not good:
                            # Slide along the obstacle: push the neighbours out, and see whether it still pays.
                            saved[:] = control
                            saved[c, j] = old
                            repaired = True
                            wide_low, wide_high = max(0, c - 6), min(pieces - 1, c + 3)
                            good = _push_out(
                                control, knots, chain, base, solids, lower, upper, movable, margin,
                                low_piece, high_piece, 3,
                            )  # fmt: skip
                            if good:
                                for i in range(wide_low, wide_high + 1):
                                    _differentiate(control, knots, i, first, second)
                                value = estimate_duration(first, second, grid, velocity, acceleration, speed)
                                value += length_weight * _length(first, grid)
                                good = value < best - 1e-7
                            if good:
                                for i in range(wide_low, wide_high + 1):
                                    bezier_piece(control, knots, i + 3, piece)
                                    if not piece_is_clear(piece, chain, base, solids, margin):
                                        good = False
                                        break
                            if not good:
                                control[:] = saved
                                for i in range(wide_low, wide_high + 1):
                                    _differentiate(control, knots, i, first, second)
                    if good:
                        best = value
                        step[c, j] *= 1.6
                        break
                    if not repaired:
                        control[c, j] = old
                        for i in range(low_piece, high_piece + 1):
                            _differentiate(control, knots, i, first, second)
                    step[c, j] = -step[c, j]
                    if turn == 1:
                        step[c, j] *= 0.4
                largest = max(largest, abs(step[c, j]))
        if largest < 1e-4:
            break
