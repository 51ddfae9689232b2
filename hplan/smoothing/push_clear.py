"""A spline of few control points, pushed out of the obstacles and pulled taut around them.

Pushing moves the control points of a piece that is not clear along the gradient of the clearance at its worst point.
It looks at samples; the proof follows, with half the margin, so that what samples missed does not refuse it.

Pulling taut is Laplacian smoothing of the control polygon, with a push after every round.
"""

from __future__ import annotations

import math

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, frozen
from hplan.base.kernels import any_int, kernel
from hplan.base.polyline import stations
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.clearance_kernels import link_clearances, smallest
from hplan.smoothing.options import PostprocessOptions
from hplan.smoothing.spline import FIRST, STRIDE, SplinePath, bezier_piece, copy_into, piece_is_clear

#: Rounds of pushing, and after a round of smoothing.
_ROUNDS, _PUSHES = any_int(40), any_int(6)

#: Pushing is given up after so many rounds in which what is missing in clearance, over all pieces, did not shrink to
#: this share of the least before.
_STALLED, _SHRUNK = 8, 0.9


def clear_spline(
    path: FloatArray, field: ClearanceField, options: PostprocessOptions, *, count: int, margin: float
) -> SplinePath | None:
    """A spline of few control points along a clear polyline, pushed out of the obstacles that its corners cut.

    Args:
        path: (m, dof) waypoints, clear.
        field: Arm and obstacles.
        options: Joint limits and movable joints.
        count: Number of control points, >= 4.
        margin: Clearance asked for at the samples [m]; half of it wherever the proof evaluates it.

    Returns:
        The spline, shown clear, or None where pushing did not succeed.
    """
    station = stations(path)
    even = np.linspace(0.0, station[-1], count)
    control = np.column_stack([np.interp(even, station, path[:, joint]) for joint in range(path.shape[1])])
    control[0], control[-1] = path[0], path[-1]
    knots = SplinePath.through(control).knots
    pushed = push_out(
        control, knots, field.chain, field.base, field.solids, field.data, options.lower, options.upper,
        options.movable, margin, 0, count - 4, _ROUNDS,
    )  # fmt: skip
    spline = SplinePath(frozen(control), knots)
    return spline if pushed and spline.is_clear(field, 0.5 * margin) else None


def tighten(
    spline: SplinePath, field: ClearanceField, options: PostprocessOptions, *, margin: float, rounds: int
) -> SplinePath:
    """Pull a clear spline taut around the obstacles.

    Args:
        spline: A clear spline.
        field: Arm and obstacles.
        options: Joint limits and movable joints.
        margin: Clearance asked for wherever it is evaluated [m].
        rounds: Rounds of smoothing and pushing.

    Returns:
        The clear spline with the shortest control polygon found, with the same ends and knots.
    """
    control = np.array(spline.control)
    _tighten(
        control, spline.knots, field.chain, field.base, field.solids, field.data, options.lower, options.upper,
        options.movable, margin, rounds,
    )  # fmt: skip
    taut = SplinePath(frozen(control), spline.knots)
    return taut if taut.is_clear(field, 0.5 * margin) else spline


@kernel
def push_out(
    control: FloatArray,
    knots: FloatArray,
    chain: FloatArray,
    base: FloatArray,
    solids: FloatArray,
    data: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    movable: IntArray,
    margin: float,
    first_piece: int,
    last_piece: int,
    rounds: int,
) -> bool:
    """Move control points along the gradient of the clearance until the pieces named seem clear."""
    count, dof = control.shape
    links = chain.shape[0]
    piece, q, clear = np.empty((4, dof)), np.empty(dof), np.empty(links)
    worst, gradient = np.empty(dof), np.empty(dof)
    weight = np.empty(4)
    lowest, since = math.inf, 0
    for _ in range(rounds):
        contact, missing = False, 0.0
        for i in range(first_piece, last_piece + 1):
            bezier_piece(control, knots, i + 3, piece)
            if piece_is_clear(piece, chain, base, solids, data, margin, STRIDE):
                continue
            contact = True
            # First samples of the piece for its worst point, then central differences there for the gradient.
            least, at, square, ahead = math.inf, 0.0, 0.0, 0.0
            for probe in range(17 + 2 * len(movable)):
                t = probe / 16.0
                u = 1.0 - t
                w0, w1, w2, w3 = u * u * u, 3.0 * u * u * t, 3.0 * u * t * t, t * t * t
                j = movable[(probe - 17) // 2] if probe >= 17 else -1
                for k in range(dof):
                    if probe < 17:
                        q[k] = w0 * piece[0, k] + w1 * piece[1, k] + w2 * piece[2, k] + w3 * piece[3, k]
                    else:
                        q[k] = worst[k]
                if j >= 0:
                    q[j] += 1e-4 if probe % 2 == 1 else -1e-4
                link_clearances(q, chain, base, solids, data, clear)
                here = smallest(clear)
                if j >= 0:
                    if probe % 2 == 1:
                        ahead = here
                    else:
                        gradient[j] = (ahead - here) / 2e-4
                        square += gradient[j] * gradient[j]
                elif here < least:
                    least, at = here, t
                    for k in range(dof):
                        worst[k] = q[k]
            if square < 1e-8:
                return False
            missing += margin - least
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
        since += 1
        if missing < _SHRUNK * lowest:
            lowest, since = missing, 0
        elif since == _STALLED:
            return False
    return False


@kernel
def _tighten(
    control: FloatArray,
    knots: FloatArray,
    chain: FloatArray,
    base: FloatArray,
    solids: FloatArray,
    data: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    movable: IntArray,
    margin: float,
    rounds: int,
) -> None:
    """Smooth and push in turn; `control` is left as the shortest that kept the margin at its samples."""
    count = control.shape[0]
    best, before = control.copy(), control.copy()
    shortest = _polygon_length(control)
    for _ in range(rounds):
        copy_into(before, control)
        for i in range(1, count - 1):
            for j in movable:
                control[i, j] = 0.5 * (before[i - 1, j] + before[i + 1, j])
        clear = push_out(
            control, knots, chain, base, solids, data, lower, upper, movable, margin, FIRST, count - 4, _PUSHES
        )  # fmt: skip
        if clear:
            length = _polygon_length(control)
            if length < shortest:
                shortest = length
                copy_into(best, control)
    copy_into(control, best)


@kernel
def _polygon_length(control: FloatArray) -> float:
    total = 0.0
    for i in range(control.shape[0] - 1):
        square = 0.0
        for j in range(control.shape[1]):
            square += (control[i + 1, j] - control[i, j]) ** 2
        total += math.sqrt(square)
    return total
