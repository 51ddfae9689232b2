r"""Upper bounds of the error by which coal's distances exceed the true ones.

Measured on coal 3.0 against long double arithmetic; a proof takes these off every distance.

- Where coal iterates (GJK, shapes with corners), 60,000 pairs of hulls of the size of an arm were over by 1.2e-6 m at
  most: `ITERATION`.
- Next to boxes of 1e5 m by 36e-6 m, of 1e8 m by 0.8e-3 m: `SIZE` for each metre of the larger shape.
- From cylinders coal stops at 1.2e-6 of the distance, and as many metres, above it (170,000 pairs, sizes of 5 mm to
  1 km, 1 mm to 500 m apart): `CURVED`, up to 10 m, which is farther than an arm comes.
- Axes of capsules of lengths :math:`l_1, l_2` with :math:`l_1 l_2 \sin \theta \le 1.5 \cdot 10^{-7}` m² are taken for
  parallel, and any pair of their points for the nearest. So the distance is over by at most
  :math:`\min(l_1, l_2) \sin \theta \le 1.5 \cdot 10^{-7} / \max(l_1, l_2)` m², and by the shorter length: 30e-6 m
  between capsules of 5 mm.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, frozen
from hplan.scene.obstacles import Box, Capsule, Cylinder, Solid, Sphere

#: Where coal iterates [m].
ITERATION = 2e-6

#: Where coal iterates on what is curved [m].
CURVED = 1.5e-5

#: By size of the larger shape [m/m].
SIZE = 1e-9

#: Axes of capsules: square root of 100 machine epsilons, below which coal takes axes for parallel [m^2].
PARALLEL = 1.5e-7


def distance_errors(movers: FloatArray, solids: Sequence[Solid], pairs: FloatArray) -> FloatArray:
    """Upper bounds of the error by which distances are too large [m].

    Args:
        movers: (bodies, 3) `extents` of moving bodies.
        pairs: (pairs, 2, 3) of both of each pair.

    Returns:
        (bodies * solids + pairs,) of each moving body with each obstacle, body by body, then of the pairs.
    """
    curved = np.array([type(solid) is Cylinder for solid in solids], dtype=np.bool_)
    second = np.array([_solid_extent(solid) for solid in solids]).reshape(-1, 2)
    among = _errors(movers[:, None], second[None])
    among += np.where((movers[:, 2:] > 0.0) | curved, CURVED - ITERATION, 0.0)
    round_pairs = pairs[:, :, 2].any(axis=1)
    return np.append(among, _errors(pairs[:, 0], pairs[:, 1]) + np.where(round_pairs, CURVED - ITERATION, 0.0))


def extents(shapes: Iterable[pin.GeometryObject]) -> FloatArray:
    """(n, 3) size, length of the axis, infinite where it is no capsule [m], and 1 for cylinders, of some shapes."""
    found = [(*_extent(shape), isinstance(shape.geometry, coal.Cylinder)) for shape in shapes]
    return frozen(np.array(found, dtype=np.float64).reshape(-1, 3))


def _errors(first: FloatArray, second: FloatArray) -> FloatArray:
    """Errors of pairs, from (..., 2 or more) size and length of axis of both."""
    longer = np.maximum(first[..., 1], second[..., 1])
    shorter = np.minimum(first[..., 1], second[..., 1])
    with np.errstate(divide="ignore"):
        parallel = np.minimum(np.where(longer > 0.0, PARALLEL / longer, 0.0), shorter)
    errors: FloatArray = ITERATION + SIZE * np.maximum(first[..., 0], second[..., 0]) + parallel
    return errors


def _extent(shape: pin.GeometryObject) -> tuple[float, float]:
    """Size of a shape, and the length of its axis if it is a capsule, else infinity [m]."""
    geometry = shape.geometry
    if isinstance(geometry, coal.Capsule):
        return 2.0 * float(geometry.halfLength + geometry.radius), 2.0 * float(geometry.halfLength)
    geometry.computeLocalAABB()
    return 2.0 * float(geometry.aabb_radius), math.inf


def _solid_extent(solid: Solid) -> tuple[float, float]:
    """As `_extent`, of an obstacle."""
    if type(solid) is Sphere:  # there are hundreds, and `isinstance` takes ten times as long
        return 2.0 * solid.radius, math.inf
    if type(solid) is Box:
        return math.hypot(*solid.size), math.inf
    if type(solid) is Cylinder:
        return math.hypot(2.0 * solid.radius, solid.length), math.inf
    if type(solid) is Capsule:
        length = math.dist(solid.start, solid.end)
        return length + 2.0 * solid.radius, length
    sides = (float(np.ptp(along)) for along in solid.core.T)  # one by one: a tenth of the time, of many points
    return math.hypot(*sides) + 2.0 * solid.rounding, math.inf
