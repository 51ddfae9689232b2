"""Repairs motions between collision-free nodes that cannot be verified themselves.

First the joints move one after the other, in any order that works. Otherwise the midpoint of the motion is pushed out
of the obstacles along the gradient of the clearance, and the two halves are repaired recursively.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, frozen
from hplan.collision.compiled_field import ClearanceField

#: Maximum recursion depth of halving a motion.
_HALVINGS = 3

#: Maximum step of one push [rad], and the step of the finite differences for the gradient.
_LARGEST_PUSH, _DIFFERENCE = 0.1, 1e-4

#: Target clearance of a push in excess of the margin [m].
_EXTRA_CLEARANCE = 2e-3


def repair(
    path: FloatArray,
    field: ClearanceField,
    lower: FloatArray,
    upper: FloatArray,
    margin: float,
) -> tuple[FloatArray, list[int]]:
    """Replace unverified motions of a polyline by verified ones, if possible.

    Args:
        path: (m, dof) configurations.
        lower: (dof,) joint limits.
        upper: (dof,) joint limits; equal to `lower` for a joint that may not move.
        margin: Required clearance at each evaluated configuration [m].

    Returns:
        The polyline, and the indices of the given motions that could not be repaired.
    """
    pieces, contacts = [path[:1]], []
    for i in range(len(path) - 1):
        inner = _find_bypass(path[i], path[i + 1], field, lower, upper, margin)
        if inner is None:
            contacts.append(i)
        else:
            pieces.append(inner)
        pieces.append(path[i + 1 : i + 2])
    return frozen(np.concatenate(pieces)), contacts


def pushed_clear(
    path: FloatArray, field: ClearanceField, lower: FloatArray, upper: FloatArray, margin: float
) -> tuple[FloatArray, list[int]]:
    """Push waypoints and midpoints of a polyline away from nearby obstacles.

    Args:
        path: (m, dof) configurations; the first and the last stay.
        lower: (dof,) joint limits.
        upper: (dof,) joint limits; equal to `lower` for a joint that may not move.
        margin: Required clearance at each evaluated configuration [m].

    Returns:
        The polyline, and the indices of the given motions that could not be repaired.
    """
    points = path.copy()
    for number in (np.flatnonzero(field.spare_clearances(path[1:-1]) < margin) + 1).tolist():
        for wanted in (margin + _EXTRA_CLEARANCE, margin):
            there = _push_out(path[number], field, lower, upper, wanted)
            if there is not None:
                points[number] = there
                break
    pieces, contacts = [points[:1]], []
    for i, (first, last) in enumerate(itertools.pairwise(points)):
        if not field.is_clear(np.stack([first, last]), margin):
            inner = _push_midpoints(first, last, field, lower, upper, margin, _HALVINGS)
            if inner is None:
                contacts.append(i)
            else:
                pieces.append(inner)
        pieces.append(last[None])
    return frozen(np.concatenate(pieces)), contacts


def leave_contact(
    q: FloatArray, field: ClearanceField, lower: FloatArray, upper: FloatArray, margin: float
) -> Iterator[FloatArray]:
    """Yield successively longer paths out of a narrow place.

    Each step follows the gradient of the clearance.

    Args:
        q: (dof,) configuration.
        lower: (dof,) joint limits.
        upper: (dof,) joint limits; equal to `lower` for a joint that may not move.
        margin: Required clearance at each evaluated configuration [m].

    Yields:
        (k, dof) configurations starting at `q`; the motions between them are verified collision-free.
    """
    path = q[None]
    # Target clearances, in order, when leaving a narrow place [m].
    for wanted in (5e-3, 0.01, 0.02, 0.04, 0.08):
        if field.spare_clearance(path[-1]) >= wanted:
            continue
        there = _push_out(path[-1], field, lower, upper, wanted)
        if there is None or not field.is_clear(np.stack([path[-1], there]), margin):
            return
        path = np.vstack([path, there])
        yield path


def _find_bypass(
    first: FloatArray, last: FloatArray, field: ClearanceField, lower: FloatArray, upper: FloatArray, margin: float
) -> FloatArray | None:
    """Intermediate configurations that make the motion verifiably collision-free.

    Empty if the direct motion is already collision-free; None if no repair is found.
    """
    if field.is_clear(np.stack([first, last]), margin):
        return np.empty((0, len(first)))
    inner = _in_turn(first, last, field, margin)
    return _push_midpoints(first, last, field, lower, upper, margin, _HALVINGS) if inner is None else inner


def _in_turn(first: FloatArray, last: FloatArray, field: ClearanceField, margin: float) -> FloatArray | None:
    """Intermediate configurations of a motion that moves one joint at a time.

    None if no order of the joints is verified collision-free.
    """
    for order in itertools.permutations(np.flatnonzero(first != last)):
        inner = np.repeat(first[None], max(0, len(order) - 1), axis=0)
        for k, joint in enumerate(order[:-1]):
            inner[k:, joint] = last[joint]
        if field.is_clear(np.vstack([first, inner, last]), margin):
            return inner
    return None


def _push_midpoints(
    first: FloatArray,
    last: FloatArray,
    field: ClearanceField,
    lower: FloatArray,
    upper: FloatArray,
    margin: float,
    halvings: int,
) -> FloatArray | None:
    """Intermediate configurations, each a midpoint pushed out of the obstacles.

    None if the motion cannot be repaired with `halvings` further subdivisions.
    """
    middle = _push_out(0.5 * (first + last), field, lower, upper, margin + _EXTRA_CLEARANCE)
    if middle is None:
        return None
    parts = []
    for a, b in ((first, middle), (middle, last)):
        if field.is_clear(np.stack([a, b]), margin):
            parts.append(np.empty((0, len(first))))
            continue
        if halvings == 0:
            return None
        inner = _push_midpoints(a, b, field, lower, upper, margin, halvings - 1)
        if inner is None:
            return None
        parts.append(inner)
    return np.vstack([parts[0], middle, parts[1]])


def _push_out(
    q: FloatArray, field: ClearanceField, lower: FloatArray, upper: FloatArray, wanted: float
) -> FloatArray | None:
    """Find a nearby configuration with the required clearance; None if not found.

    All links that are too near are corrected together, by the minimum-norm step that would restore their clearance if
    clearances were linear. Correcting only the nearest link oscillates if two links are constrained from opposite
    sides.
    """
    movable = np.flatnonzero(upper > lower)
    probe = _DIFFERENCE * np.eye(len(q))[movable]
    # Maximum number of gradient steps for one midpoint.
    for _ in range(8):
        clearances = field.link_clearances(q)
        near = np.flatnonzero(clearances < wanted)
        if not len(near):
            return q
        slopes = [field.link_clearances(q + step)[near] - field.link_clearances(q - step)[near] for step in probe]
        gradients = np.array(slopes).T / (2.0 * _DIFFERENCE)
        if (gradients**2).sum() < 1e-6:
            return None
        push = np.zeros(len(q))
        push[movable] = np.linalg.pinv(gradients, rcond=1e-2) @ (wanted + 0.5 * _EXTRA_CLEARANCE - clearances[near])
        # The step is heuristic and does not need full precision; rounding it removes last digits that differ between
        # processors.
        push = ties.on_raster(push * min(1.0, _LARGEST_PUSH / max(float(np.abs(push).max()), 1e-12)))
        q = np.clip(q + push, lower, upper)
    return q if field.spare_clearance(q) >= wanted else None
