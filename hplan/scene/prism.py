r"""Prisms about cylinders: what kernels and sections, which know flat faces only, take for a cylinder.

The prism's sides touch the cylinder, so that it holds the whole; its corners stand out by
:math:`r (1 / \cos(\pi / n) - 1)` with :math:`n` sides. There are as many as keep that below `ERROR`, but
`MOST_SIDES` at most, with which it is 0.12 % of the radius.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np

from hplan.base.arrays import frozen, readonly
from hplan.scene.solids import HULL_VERTICES, Hull, rpy_rotation

#: A prism stands out of its cylinder by no more than this, as far as its sides allow [m].
ERROR: Final = 5e-4

#: Fewest and most sides of a prism.
FEWEST_SIDES: Final = 12
MOST_SIDES: Final = HULL_VERTICES // 2


@lru_cache(maxsize=4096)
def prism(
    center: tuple[float, float, float], rpy_deg: tuple[float, float, float], length: float, radius: float
) -> Hull:
    """The prism about a cylinder as a hull, corners of the lower end first; the last ones are kept.

    Args:
        center: Middle of the cylinder [m].
        rpy_deg: Its roll, pitch and yaw (fixed axes x, y, z) [deg]; at zero it stands on z.
        length: Its length [m].
        radius: Its radius [m].
    """
    n = _sides(radius)
    rotation, middle = rpy_rotation(*map(math.radians, rpy_deg)), np.array(center)
    angles = 2.0 * np.pi * np.arange(n) / n
    widest = radius / math.cos(math.pi / n)
    ring = widest * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n)])
    half = np.array([0.0, 0.0, 0.5 * length])
    ends = np.stack([ring - half, ring + half]) @ rotation.T + middle
    between = angles + np.pi / n
    normals = np.zeros((n + 2, 3))
    normals[:n, 0], normals[:n, 1], normals[n:, 2] = np.cos(between), np.sin(between), (-1.0, 1.0)
    normals = normals @ rotation.T
    corners = ends.reshape(-1, 3)
    # Every corner is on or below: rounding errors shift a plane outward, never into the prism.
    planes = np.column_stack([normals, (normals @ corners.T).max(axis=1)])
    starts = np.concatenate([ends[0], ends[1], ends[0]])
    stops = np.concatenate([np.roll(ends[0], -1, axis=0), np.roll(ends[1], -1, axis=0), ends[1]])
    edges = np.column_stack([starts, stops - starts])
    at = np.arange(n)
    following = np.roll(at, -1)
    fan = at[1:-1]
    faces = np.concatenate(
        [
            np.column_stack([np.zeros_like(fan), fan + 1, fan]),
            np.column_stack([np.full_like(fan, n), fan + n, fan + n + 1]),
            np.column_stack([at, following, following + n]),
            np.column_stack([at, following + n, at + n]),
        ]
    )
    hull = Hull("prism", frozen(corners), readonly(faces, np.int64))
    vars(hull)["_facets"] = frozen(planes), frozen(edges)
    return hull


def prism_excess(radius: float) -> float:
    """How far the prism about a cylinder stands out of it [m]."""
    return radius / math.cos(math.pi / _sides(radius)) - radius


def _sides(radius: float) -> int:
    """Number of sides, a multiple of 4."""
    needed = math.pi / math.acos(radius / (radius + ERROR))
    return min(MOST_SIDES, max(FEWEST_SIDES, 4 * math.ceil(0.25 * needed)))
