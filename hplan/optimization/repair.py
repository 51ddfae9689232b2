"""Repair of motions between free nodes that cannot be verified collision-free themselves: replaced by motions that can.

First the joints move one after the other, in any order that will do. Then the middle of the motion is pushed out of
the obstacles, along the gradient of the clearance, and the two halves are repaired likewise.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, frozen
from hplan.collision.clearance_field import ClearanceField

#: How often a motion is halved.
_HALVINGS = 3

#: Largest push [rad], and the difference that the gradient is taken with.
_LARGEST_PUSH, _DIFFERENCE = 0.1, 1e-4

#: What a push aims at beyond the margin [m].
_BEYOND = 2e-3


def repaired(
    path: FloatArray,
    field: ClearanceField,
    lower: FloatArray,
    upper: FloatArray,
    margin: float,
) -> tuple[FloatArray, list[int]]:
    """A polyline whose motions are verified collision-free, as far as they can be repaired.

    Args:
        path: (m, dof) configurations.
        lower: (dof,) joint limits.
        upper: (dof,) joint limits; equal to `lower` for a joint that may not move.
        margin: Clearance asked for wherever a motion is evaluated [m].

    Returns:
        The polyline, and the motions of the one given, by number, that could not be repaired.
    """
    pieces, contacts = [path[:1]], []
    for i in range(len(path) - 1):
        inner = _between(path[i], path[i + 1], field, lower, upper, margin)
        if inner is None:
            contacts.append(i)
        else:
            pieces.append(inner)
        pieces.append(path[i + 1 : i + 2])
    return frozen(np.concatenate(pieces)), contacts


def pushed_clear(
    path: FloatArray, field: ClearanceField, lower: FloatArray, upper: FloatArray, margin: float
) -> tuple[FloatArray, list[int]]:
    """A polyline near one that comes too near to something: waypoints and middles of motions are pushed away from it.

    Args:
        path: (m, dof) configurations; the first and the last stay.
        lower: (dof,) joint limits.
        upper: (dof,) joint limits; equal to `lower` for a joint that may not move.
        margin: Clearance asked for wherever a motion is evaluated [m].

    Returns:
        The polyline, and the motions of the one given, by number, that it could not be found for.
    """
    points = path.copy()
    for number in (np.flatnonzero(field.along(path[1:-1]).min(axis=1) < margin) + 1).tolist():
        for wanted in (margin + _BEYOND, margin):
            there = _out(path[number], field, lower, upper, wanted)
            if there is not None:
                points[number] = there
                break
    pieces, contacts = [points[:1]], []
    for i, (first, last) in enumerate(itertools.pairwise(points)):
        if not field.is_clear(np.stack([first, last]), margin):
            inner = _pushed(first, last, field, lower, upper, margin, _HALVINGS)
            if inner is None:
                contacts.append(i)
            else:
                pieces.append(inner)
        pieces.append(last[None])
    return frozen(np.concatenate(pieces)), contacts


def leave_contact(
    q: FloatArray, field: ClearanceField, lower: FloatArray, upper: FloatArray, margin: float
) -> Iterator[FloatArray]:
    """Paths out of a tight place along the gradient of the clearance, each longer than the one before.

    Args:
        q: (dof,) configuration.
        lower: (dof,) joint limits.
        upper: (dof,) joint limits; equal to `lower` for a joint that may not move.
        margin: Clearance asked for wherever a motion is evaluated [m].

    Yields:
        (k, dof) configurations from `q` on, the motions between them verified collision-free.
    """
    path = q[None]
    # Clearances aimed at in turn when leaving a tight place [m].
    for wanted in (5e-3, 0.01, 0.02, 0.04, 0.08):
        if field.clearance(path[-1]) >= wanted:
            continue
        there = _out(path[-1], field, lower, upper, wanted)
        if there is None or not field.is_clear(np.stack([path[-1], there]), margin):
            return
        path = np.vstack([path, there])
        yield path


def _between(
    first: FloatArray, last: FloatArray, field: ClearanceField, lower: FloatArray, upper: FloatArray, margin: float
) -> FloatArray | None:
    """Configurations between two by which the motion is verified collision-free; none where it is as it stands."""
    if field.is_clear(np.stack([first, last]), margin):
        return np.empty((0, len(first)))
    inner = _in_turn(first, last, field, margin)
    return _pushed(first, last, field, lower, upper, margin, _HALVINGS) if inner is None else inner


def _in_turn(first: FloatArray, last: FloatArray, field: ClearanceField, margin: float) -> FloatArray | None:
    """Configurations between two at which one joint stops and another sets out."""
    for order in itertools.permutations(np.flatnonzero(first != last)):
        inner = np.repeat(first[None], max(0, len(order) - 1), axis=0)
        for k, joint in enumerate(order[:-1]):
            inner[k:, joint] = last[joint]
        if field.is_clear(np.vstack([first, inner, last]), margin):
            return inner
    return None


def _pushed(
    first: FloatArray,
    last: FloatArray,
    field: ClearanceField,
    lower: FloatArray,
    upper: FloatArray,
    margin: float,
    halvings: int,
) -> FloatArray | None:
    """Configurations between two, each the middle of its neighbours pushed out of the obstacles."""
    middle = _out(0.5 * (first + last), field, lower, upper, margin + _BEYOND)
    if middle is None:
        return None
    parts = []
    for a, b in ((first, middle), (middle, last)):
        if field.is_clear(np.stack([a, b]), margin):
            parts.append(np.empty((0, len(first))))
            continue
        if halvings == 0:
            return None
        inner = _pushed(a, b, field, lower, upper, margin, halvings - 1)
        if inner is None:
            return None
        parts.append(inner)
    return np.vstack([parts[0], middle, parts[1]])


def _out(
    q: FloatArray, field: ClearanceField, lower: FloatArray, upper: FloatArray, wanted: float
) -> FloatArray | None:
    """A configuration nearby that has the clearance wanted.

    All links that are too near are pushed at once, by the least step that would put them right if clearances were
    linear: where two are held from different sides, going after the nearer one alone leads to and fro.
    """
    movable = np.flatnonzero(upper > lower)
    probe = _DIFFERENCE * np.eye(len(q))[movable]
    # Steps along the gradient for one middle.
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
        push[movable] = np.linalg.pinv(gradients, rcond=1e-2) @ (wanted + 0.5 * _BEYOND - clearances[near])
        # Heuristic, so it need not have all its digits, and the last ones are not the same on every processor.
        push = ties.on_raster(push * min(1.0, _LARGEST_PUSH / max(float(np.abs(push).max()), 1e-12)))
        q = np.clip(q + push, lower, upper)
    return q if field.clearance(q) >= wanted else None
