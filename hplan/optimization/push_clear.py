"""Pushes a spline with few control points out of the obstacles.

For each piece in collision, the control points move along the gradient of the clearance at its worst point. Pushing
checks samples only. The exact check afterwards requires half the margin, so that small violations between samples do
not reject the spline.
"""

from __future__ import annotations

import math

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, frozen
from hplan.base.deadline import check_deadline, is_up
from hplan.base.kernels import kernel
from hplan.collision.compiled_clearance import body_slopes, least_body_clearance
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.compiled_motions import piece_is_clear
from hplan.collision.compiled_obstacles import FieldArrays
from hplan.geometry.polyline import stations
from hplan.optimization.options import JointArrays, PostprocessOptions
from hplan.trajectory.cubics import bezier_piece
from hplan.trajectory.spline import STRIDE, MovableSpline, SplinePath

#: Maximum number of rounds of pushing.
_PUSH_ROUNDS = 40

#: Pushing is abandoned if a piece in collision has this multiple of the margin at all samples.
_UNSEEN = 1.5

#: Pushing is abandoned after `_STALLED` rounds in which the total clearance deficit did not fall below `_SHRUNK` times
#: its previous minimum since all pieces were checked.
_STALLED, _SHRUNK = 8, 0.9


def clear_spline(
    path: FloatArray, field: ClearanceField, options: PostprocessOptions, *, count: int, margin: float
) -> SplinePath | None:
    """Fit a spline to a collision-free polyline and push it off obstacles.

    Args:
        path: (m, dof) waypoints, collision-free.
        count: Number of control points, >= 4.
        margin: Required clearance at the samples [m]; the exact check requires half of it at each evaluated
            configuration.

    Returns:
        The spline, verified collision-free, or None if pushing did not succeed.
    """
    station = stations(path)
    even = np.linspace(0.0, station[-1], count)
    control = np.column_stack([np.interp(even, station, path[:, joint]) for joint in range(path.shape[1])])
    control[0], control[-1] = path[0], path[-1]
    moved = MovableSpline(control, SplinePath.from_control_points(control).knots)
    pushed = push_out(moved, field.arrays, options.joints, margin)
    check_deadline()
    spline = SplinePath(frozen(control), moved.knots)
    return spline if pushed and spline.is_clear(field, 0.5 * margin) else None


@kernel
def _worst_point(
    piece: FloatArray, field: FieldArrays, movable: IntArray, enough: float, gradient: FloatArray
) -> tuple[float, float]:
    """Minimum sampled clearance of a Bezier piece, and its parameter.

    The gradient of that clearance with respect to the joints is written into `gradient`, unless it is `enough` or
    more.
    """
    dof, bodies = piece.shape[1], len(field.bodies) + len(field.pairs)
    q, worst = np.empty(dof), piece[0].copy()
    clear, slopes = np.empty(bodies), np.empty((bodies, len(movable)))
    least, at = enough, 0.0
    for sample in range(17):
        t = sample / 16.0
        u = 1.0 - t
        w0, w1, w2, w3 = u * u * u, 3.0 * u * u * t, 3.0 * u * t * t, t * t * t
        for k in range(dof):
            q[k] = w0 * piece[0, k] + w1 * piece[1, k] + w2 * piece[2, k] + w3 * piece[3, k]
        here = least_body_clearance(q, field, least)
        if here < least:
            least, at = here, t
            for k in range(dof):
                worst[k] = q[k]
    if least == enough:
        return least, at
    body_slopes(worst, field, movable, least + 1e-9, clear, slopes)
    nearest = 0
    for k in range(bodies):
        if clear[k] < clear[nearest]:
            nearest = k
    for m in range(len(movable)):
        gradient[movable[m]] = slopes[nearest, m]
    return least, at


@kernel
def push_out(spline: MovableSpline, field: FieldArrays, joints: JointArrays, margin: float) -> bool:
    """Push control points along the clearance gradient until all pieces seem clear."""
    control, knots = spline
    count, dof = control.shape
    lower, upper, movable = joints.lower, joints.upper, joints.movable
    piece, gradient, weight = np.empty((4, dof)), np.empty(dof), np.empty(4)
    # Pieces in collision are pushed until they are clear, then the pieces that moved with them are checked.
    is_clear, is_blocked = np.zeros(count - 3, dtype=np.bool_), np.zeros(count - 3, dtype=np.bool_)
    lowest, since = math.inf, 0
    for _ in range(_PUSH_ROUNDS):
        pushed, missing = is_blocked.any(), 0.0
        for i in range(count - 3):
            if is_clear[i] or (pushed and not is_blocked[i]):
                continue
            bezier_piece(control, knots, i + 3, piece)
            is_blocked[i] = not piece_is_clear(piece, field, margin, STRIDE)
            if not is_blocked[i]:
                is_clear[i] = True
                continue
            if is_up(field.until):
                return False
            least, at = _worst_point(piece, field, movable, _UNSEEN * margin, gradient)
            # What the proof meets between the samples is not pushed off if all samples are far from it.
            if not least < _UNSEEN * margin:
                return False
            square = 0.0
            for j in movable:
                square += gradient[j] * gradient[j]
            if square < 1e-8:
                return False
            missing += margin - least
            # Divide the step among the four control points about in proportion to their weights on the curve there.
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
            # Control points at a joint limit move by the other joints only.
            stuck = 0.0
            for c in range(4):
                if 0 < i + c < count - 1:
                    for j in movable:
                        at_limit = control[i + c, j] >= upper[j] if gradient[j] > 0.0 else control[i + c, j] <= lower[j]
                        if at_limit:
                            stuck += weight[c] * weight[c] * gradient[j] * gradient[j]
            if stuck > (1.0 - 1e-6) * square * total:
                return False
            step = 1.2 * (max(2.0 * margin, 1e-3) - least) / square / total / (1.0 - stuck / (square * total))
            is_clear[max(0, i - 3) : i + 4] = False
            for c in range(4):
                if 0 < i + c < count - 1:
                    for j in movable:
                        moved = control[i + c, j] + step * weight[c] * gradient[j]
                        control[i + c, j] = min(upper[j], max(lower[j], moved))
        if not is_blocked.any():
            if not pushed:
                return True
            continue
        since += 1
        if missing < _SHRUNK * lowest or not pushed:
            lowest, since = missing, 0
        elif since == _STALLED:
            return False
    return False
