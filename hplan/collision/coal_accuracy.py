r"""Upper bounds of the excess of coal's distances over the true ones.

Measured on coal 3.0 against long double arithmetic; a proof subtracts these bounds from every distance.

- For pairs on which coal iterates (GJK, shapes with corners), 60,000 pairs of hulls of an arm's size exceeded the true
distance by at most 1.2e-6 m: `ITERATION`.
- Next to boxes of 1e5 m the excess was 36e-6 m, of 1e8 m 0.8e-3 m: `SIZE` for each metre of the larger shape.
- For cylinders coal stops at 1.2e-6 of the distance, plus the same number in metres, above the true distance (170,000
pairs, sizes of 5 mm to 1 km, 1 mm to 500 m apart): `CURVED`, valid up to 10 m, farther than an arm reaches.
- Capsule axes of lengths :math:`l_1, l_2` with :math:`l_1 l_2 \sin \theta \le 1.5 \cdot 10^{-7}` m² are treated as
  parallel, and any pair of their points as the nearest. The distance then exceeds the true one by at most
  :math:`\min(l_1, l_2) \sin \theta \le 1.5 \cdot 10^{-7} / \max(l_1, l_2)` m², and at most by the shorter length: 30e-6
  m
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

#: Error of coal's iteration [m].
ITERATION = 2e-6

#: Error of coal's iteration on curved shapes [m].
CURVED = 1.5e-5

#: Error per size of the larger shape [m/m].
SIZE = 1e-9

#: Axes of capsules: square root of 100 machine epsilons, below which coal treats axes as parallel [m^2].
PARALLEL = 1.5e-7


def distance_errors(movers: FloatArray, solids: Sequence[Solid], pairs: FloatArray) -> FloatArray:
    """Upper bounds of the excess of coal's distances [m].

    Args:
        movers: (bodies, 3) `extents` of the moving bodies.
        solids: The obstacles.
        pairs: (pairs, 2, 3) `extents` of both shapes of each self-collision pair.

    Returns:
        (bodies * solids + pairs,) bounds: each moving body with each obstacle, body by body, then the pairs.
    """
    curved = np.array([type(solid) is Cylinder for solid in solids], dtype=np.bool_)
    second = np.array([_solid_extent(solid) for solid in solids]).reshape(-1, 2)
    among = _errors(movers[:, None], second[None])
    among += np.where((movers[:, 2:] > 0.0) | curved, CURVED - ITERATION, 0.0)
    round_pairs = pairs[:, :, 2].any(axis=1)
    return np.append(among, _errors(pairs[:, 0], pairs[:, 1]) + np.where(round_pairs, CURVED - ITERATION, 0.0))


def extents(shapes: Iterable[pin.GeometryObject]) -> FloatArray:
    """(n, 3) size, axis length and cylinder flag of shapes.

    The size [m]; the length of a capsule's axis [m], infinity for other shapes; 1 for cylinders, 0 for others.
    """
    found = [(*_extent(shape), isinstance(shape.geometry, coal.Cylinder)) for shape in shapes]
    return frozen(np.array(found, dtype=np.float64).reshape(-1, 3))


def _errors(first: FloatArray, second: FloatArray) -> FloatArray:
    """Errors of pairs from (..., 2+) sizes and axis lengths [m]."""
    longer = np.maximum(first[..., 1], second[..., 1])
    shorter = np.minimum(first[..., 1], second[..., 1])
    with np.errstate(divide="ignore"):
        parallel = np.minimum(np.where(longer > 0.0, PARALLEL / longer, 0.0), shorter)
    errors: FloatArray = ITERATION + SIZE * np.maximum(first[..., 0], second[..., 0]) + parallel
    return errors


def _extent(shape: pin.GeometryObject) -> tuple[float, float]:
    """Size and axis length of a shape [m].

    The length is infinite for all but capsules.
    """
    geometry = shape.geometry
    if isinstance(geometry, coal.Capsule):
        return 2.0 * float(geometry.halfLength + geometry.radius), 2.0 * float(geometry.halfLength)
    geometry.computeLocalAABB()
    return 2.0 * float(geometry.aabb_radius), math.inf


def _solid_extent(solid: Solid) -> tuple[float, float]:
    """Size and axis length of an obstacle [m].

    The length is infinite for all but capsules.
    """
    if type(solid) is Sphere:  # Scenes have hundreds of these, and `isinstance` takes ten times as long.
        return 2.0 * solid.radius, math.inf
    if type(solid) is Box:
        return math.hypot(*solid.size), math.inf
    if type(solid) is Cylinder:
        return math.hypot(2.0 * solid.radius, solid.length), math.inf
    if type(solid) is Capsule:
        length = math.dist(solid.start, solid.end)
        return length + 2.0 * solid.radius, length
    sides = (float(np.ptp(along)) for along in solid.core.T)  # One side at a time: a tenth of the time for many points.
    return math.hypot(*sides) + 2.0 * solid.rounding, math.inf
