"""Kernels for arms of any kind: how far bodies move, motions shown clear, and what is near to them.

No more is looked for at a configuration than lets the motion go on by a part of it that is a little longer than the
last one: looks that are nearer to each other but cheaper are the quicker proof.
"""

from __future__ import annotations

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray
from hplan.base.deadline import is_up
from hplan.base.kernels import any_int, kernel
from hplan.bodies import flat_bodies as flat
from hplan.bodies.placed_bodies import ALONG, PLACED, START, place_bodies
from hplan.collision import obstacle_rows as row
from hplan.collision.body_kernels import body_advance
from hplan.collision.distances import point_segment
from hplan.collision.obstacle_rows import FieldArrays

#: Most looks at the clearance along one motion.
_MOST_LOOKS = any_int(1_000_000)

#: Places of a motion that are looked at before it is proved are about so far apart, as its farthest point goes [m].
_APART = 0.4

#: The first part of a motion that is asked for, and a later one in multiples of the one before.
_FIRST_STEP, _LONGER = 0.25, 2.0


@kernel
def body_bounds(turns: FloatArray, movers: FloatArray, numbers: FloatArray, result: FloatArray) -> None:
    """Largest displacement of any point of each mover while joints move in proportion, by `turns` in all."""
    dof = len(turns)
    at = int(numbers[flat.REACHES])
    for k in range(movers.shape[0]):
        bound = 0.0
        for j in range(dof):
            bound += numbers[at + dof * k + j] * abs(turns[j])
        result[k] = bound


@kernel
def body_shown_part(
    start: FloatArray, turns: FloatArray, field: FieldArrays, margin: float, looks: int
) -> tuple[float, int]:
    """The part of a straight joint-space motion that a few looks at the clearance show clear, and how many it took."""
    dof = len(start)
    bounds, q = np.empty(field.chain.shape[0]), np.empty(dof)
    body_bounds(turns, field.chain, field.base, bounds)
    shown, at, most = 0.0, 0.0, _FIRST_STEP
    for used in range(looks):
        for i in range(dof):
            q[i] = start[i] + at * turns[i]
        advance = body_advance(q, field, bounds, margin, min(1.0 - at, most))
        if advance < 0.0:
            return shown, used + 1
        shown = at
        if at >= 1.0 or is_up(field.until):
            return shown, used + 1
        at = min(1.0, at + advance)
        most = _LONGER * advance
    return shown, looks


@kernel
def body_segment_is_refused(start: FloatArray, end: FloatArray, field: FieldArrays, margin: float) -> bool:
    """True if a straight joint-space motion does not keep a margin at one of some places, which are looked at first.

    Most motions that are looked at fail, and places far apart tell so at once.
    """
    dof = len(start)
    turns, q, bounds = np.empty(dof), np.empty(dof), np.empty(field.chain.shape[0])
    for i in range(dof):
        turns[i] = end[i] - start[i]
    body_bounds(turns, field.chain, field.base, bounds)
    farthest = 0.0
    for bound in bounds:
        farthest = max(farthest, bound)
    bounds[:] = 0.0
    parts = 2
    while True:
        for part in range(1, parts, 2):
            for i in range(dof):
                q[i] = start[i] + part / parts * turns[i]
            if body_advance(q, field, bounds, margin, 0.0) < 0.0:
                return True
        if farthest <= parts * _APART or is_up(field.until):
            return False
        parts *= 2


@kernel
def body_segment_is_clear(start: FloatArray, end: FloatArray, field: FieldArrays, margin: float) -> bool:
    """As `hplan.collision.clearance_kernels.segment_is_clear`."""
    if body_segment_is_refused(start, end, field, margin):
        return False
    turns = np.empty(len(start))
    for i in range(len(start)):
        turns[i] = end[i] - start[i]
    shown, _ = body_shown_part(start, turns, field, margin, _MOST_LOOKS)
    return shown == 1.0


@kernel
def body_piece_is_clear(piece: FloatArray, field: FieldArrays, margin: float, stride: float) -> bool:
    """As `hplan.smoothing.spline.piece_is_clear`."""
    dof = piece.shape[1]
    bounds, q, fastest = np.empty(field.chain.shape[0]), np.empty(dof), np.zeros(dof)
    for j in range(dof):
        for c in range(3):
            fastest[j] = max(fastest[j], 3.0 * abs(piece[c + 1, j] - piece[c, j]))
    body_bounds(fastest, field.chain, field.base, bounds)
    t, most = 0.0, _FIRST_STEP
    while True:
        u = 1.0 - t
        w0, w1, w2, w3 = u * u * u, 3.0 * u * u * t, 3.0 * u * t * t, t * t * t
        for i in range(dof):
            q[i] = w0 * piece[0, i] + w1 * piece[1, i] + w2 * piece[2, i] + w3 * piece[3, i]
        advance = body_advance(q, field, bounds, margin, min(1.0 - t, most))
        if advance < 0.0:
            return False
        if t >= 1.0:
            return True
        if is_up(field.until):
            return False
        t = min(1.0, t + max(stride, advance))
        most = _LONGER * max(stride, advance)


@kernel
def mark_near_bodies(path: FloatArray, arrays: FieldArrays, distance: float, near: BoolArray) -> None:
    """Mark the rows whose bounding ball comes within a distance of a body at some configuration."""
    movers, numbers, solids = arrays.chain, arrays.base, arrays.solids
    placed, frames = np.empty((int(numbers[flat.BODIES]), PLACED)), np.empty((path.shape[1] + 1, 12))
    for i in range(path.shape[0]):
        if is_up(arrays.until):
            break
        place_bodies(path[i], movers, numbers, frames, placed)
        for b in range(placed.shape[0]):
            if movers[b, flat.JOINT] >= numbers[flat.DOF]:
                continue
            start = (placed[b, START], placed[b, START + 1], placed[b, START + 2])
            along = (placed[b, ALONG], placed[b, ALONG + 1], placed[b, ALONG + 2])
            for s in range(solids.shape[0]):
                if not near[s]:
                    centre = (solids[s, row.CENTRE], solids[s, row.CENTRE + 1], solids[s, row.CENTRE + 2])
                    beyond = distance + solids[s, row.BOUND] + movers[b, flat.AXIS_RADIUS]
                    near[s] = point_segment(centre, start, along) <= beyond
