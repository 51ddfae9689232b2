"""Kernels that verify motions as collision-free by conservative advancement.

The clearance at a configuration verifies a segment of the motion before and after it
(`hplan.collision.compiled_cover`). A query in the middle often verifies the whole motion. Otherwise the queries advance
from the start: the next one lies far enough ahead that the segment verified backward from it should meet the verified
part; if it does not, a nearer query follows. Each query asks only for a segment a little longer than the previous one,
because many cheap queries prove a motion faster than few expensive ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.base.deadline import is_up
from hplan.base.kernels import any_int, kernel
from hplan.collision.compiled_cover import Moving, Part, moving_arm, part_shown_clear
from hplan.collision.compiled_obstacles import FieldArrays
from hplan.collision.compiled_twists import motion_bends

#: Maximum number of distance queries along one motion.
_MOST_LOOKS = any_int(1_000_000)

#: Spacing of the queries before the proof, as travel of the motion's fastest point [m].
_APART = 0.8

#: First requested segment, and a later one as a multiple of the one before.
_FIRST_STEP, _LONGER = 1.0, 2.0

#: Distance of the next query beyond the verified part as a fraction of the last verified segment; and the factor by
#: which that distance shrinks after a query that was too far.
_NEXT, _NEARER = 0.8, 0.5


class Run(NamedTuple):
    """A motion along a Bezier segment, with its buffers.

    Attributes:
        piece: (4, dof) control points.
        moving: The arm in motion, with its bounds on speed and acceleration.
        q: (dof,) buffer for a configuration.
        rates: (dof,) buffer for the joint rates there.
        until: Deadline, as in `hplan.collision.compiled_obstacles.FieldArrays`.
    """

    piece: FloatArray
    moving: Moving
    q: FloatArray
    rates: FloatArray
    until: FloatArray


@kernel
def _prepare_motion(piece: FloatArray, field: FieldArrays, margin: float) -> Run:
    """Prepare a motion: bounds on the speed and acceleration of its points."""
    dof = piece.shape[1]
    bends, fastest, changes = np.empty((len(field.bodies) + len(field.pairs), 2)), np.empty(dof), np.empty(dof)
    for j in range(dof):
        first, second, third = piece[1, j] - piece[0, j], piece[2, j] - piece[1, j], piece[3, j] - piece[2, j]
        fastest[j] = 3.0 * max(abs(first), max(abs(second), abs(third)))
        changes[j] = 6.0 * max(abs(second - first), abs(third - second))
    motion_bends(fastest, changes, field, bends)
    return Run(piece, moving_arm(field, dof, bends, margin), fastest, changes, field.until)


@kernel
def _verify_segment(run: Run, t: float, back: float, forward: float) -> Part:
    """Segment verified collision-free around parameter t, at most the requested one."""
    piece, u = run.piece, 1.0 - t
    w0, w1, w2, w3 = u * u * u, 3.0 * u * u * t, 3.0 * u * t * t, t * t * t
    for i in range(len(run.q)):
        run.q[i] = w0 * piece[0, i] + w1 * piece[1, i] + w2 * piece[2, i] + w3 * piece[3, i]
        first, second, third = piece[1, i] - piece[0, i], piece[2, i] - piece[1, i], piece[3, i] - piece[2, i]
        run.rates[i] = 3.0 * (u * u * first + 2.0 * u * t * second + t * t * third)
    return part_shown_clear(run.q, run.rates, run.moving, back, forward)


@kernel
def _march(run: Run, middle: Part, looks: int, stride: float, least: float) -> tuple[float, int]:
    """Verify a motion as collision-free from its start.

    Args:
        middle: Segment that is verified around the middle of the motion.
        looks: Maximum number of distance queries.
        stride: Minimum step between queries.
        least: The march stops if less than this is verified ahead.

    Returns:
        The end of the verified segment as the motion's parameter, 0 if nothing is verified; and the number of queries.
    """
    shown, covered, at, last, ask = 0.0, 0.0, 0.0, -1.0, _FIRST_STEP
    for used in range(looks):
        asked = at - covered
        part = _verify_segment(run, at, asked, min(1.0 - at, ask))
        if part.forward < 0.0:
            return shown, used + 1
        if part.back >= asked or at <= last + stride:
            shown, last, covered = at, at, at + part.forward
            if covered >= 0.5 - middle.back:
                covered = max(covered, 0.5 + middle.forward)
            if covered >= 1.0:
                return 1.0, used + 1
            if part.forward < least:
                return shown, used + 1
            step = max(part.forward, stride)
            ask, at = _LONGER * step, min(1.0, covered + _NEXT * step)
        else:
            at = max(covered + _NEARER * asked, last + stride)
            ask = _LONGER * (at - covered)
        if at == last or is_up(run.until):
            return shown, used + 1  # A clearance of almost zero makes no progress.
    return shown, looks


@kernel
def shown_part(piece: FloatArray, field: FieldArrays, margin: float, least: float, looks: int) -> tuple[float, int]:
    """Segment verified to keep a margin from the start, by conservative advancement.

    Args:
        piece: (4, dof) Bezier points of the motion.
        margin: Clearance required at every query; half of it is kept along the whole segment [m].
        least: The march stops if less than this is verified ahead.
        looks: Maximum number of distance queries.

    Returns:
        The end of the verified segment as the motion's parameter in [0, 1], 0 if nothing is verified; and the number of
        queries.
    """
    run = _prepare_motion(piece, field, margin)
    shown, used = _march(run, Part(-1.0, -1.0), looks, 0.0, least)
    return shown, used


@kernel
def piece_is_clear(piece: FloatArray, field: FieldArrays, margin: float, stride: float) -> bool:
    """True if a motion along a Bezier segment verifiably keeps a margin.

    The proof is the same as in `shown_part`. A query in the middle often verifies the whole motion; and most motions
    that are checked are in collision, which a few widely spaced queries detect quickly.

    Args:
        stride: Minimum step between queries. A positive value rules out proofs near contact but is cheap, for
            optimizers.
    """
    run = _prepare_motion(piece, field, margin)
    middle = _verify_segment(run, 0.5, 0.5, 0.5)
    if middle.forward < 0.0 or (middle.back >= 0.5 and middle.forward >= 0.5):
        return middle.forward >= 0.0
    farthest = 0.0
    for b in range(len(field.bodies)):
        farthest = max(farthest, run.moving.bends[b, 0])
    parts = 2
    while farthest > parts * _APART and not is_up(field.until):
        parts *= 2
        for part in range(1, parts, 2):
            if _verify_segment(run, part / parts, 0.0, 0.0).forward < 0.0:
                return False
    shown, _ = _march(run, middle, _MOST_LOOKS, stride, 0.0)
    return shown == 1.0


@kernel
def straight_piece(start: FloatArray, end: FloatArray) -> FloatArray:
    """(4, dof) Bezier points of a straight motion at constant rate."""
    piece = np.empty((4, len(start)))
    for i in range(len(start)):
        third = (end[i] - start[i]) / 3.0
        piece[0, i], piece[1, i], piece[2, i], piece[3, i] = start[i], start[i] + third, end[i] - third, end[i]
    return piece


@kernel
def segment_is_clear(start: FloatArray, end: FloatArray, field: FieldArrays, margin: float) -> bool:
    """True if the straight joint-space motion verifiably keeps a margin (`shown_part`)."""
    return piece_is_clear(straight_piece(start, end), field, margin, 0.0)


@kernel
def path_is_clear(path: FloatArray, field: FieldArrays, margin: float) -> bool:
    """True if every segment of a polyline verifiably keeps a margin (`shown_part`)."""
    clear, i = True, 0
    while clear and i < path.shape[0] - 1:
        clear = segment_is_clear(path[i], path[i + 1], field, margin)
        i += 1
    return clear
