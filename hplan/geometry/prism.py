r"""Circumscribed prisms of cylinders, for kernels and sections with flat faces only.

The sides of the prism touch the cylinder, so the prism contains it. With :math:`n` sides its corners are outside by
:math:`r (1 / \cos(\pi / n) - 1)`. :math:`n` is chosen to keep that below `ERROR`, but at most `MOST_SIDES`, which gives
0.12 % of the radius.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np

from hplan.geometry.hull import HULL_VERTICES, Hull, whole_hull
from hplan.geometry.rotation import rpy_rotation

#: Maximum excess of a prism over its cylinder, if `MOST_SIDES` sides suffice for it [m].
ERROR: Final = 5e-4

#: Minimum and maximum number of sides of a prism.
FEWEST_SIDES: Final = 12
MOST_SIDES: Final = HULL_VERTICES // 2


@lru_cache(maxsize=4096)
def prism(
    center: tuple[float, float, float], rpy_deg: tuple[float, float, float], length: float, radius: float
) -> Hull:
    """Return the circumscribed prism of a cylinder as a hull.

    The vertices of the lower end come first. Recent results are cached.

    Args:
        center: Centre of the cylinder [m].
        rpy_deg: Roll, pitch and yaw about the fixed axes x, y, z [deg]; the axis is along z at zero.
        length: Length [m].
        radius: Radius [m].
    """
    n = _sides(radius)
    widest = radius / math.cos(math.pi / n)
    scale = np.array([widest, widest, 0.5 * length])
    return _unit_prism(n).transform(rpy_rotation(*map(math.radians, rpy_deg)), np.array(center), scale)


@lru_cache
def _unit_prism(sides: int) -> Hull:
    """Prism with vertices at radius 1 and heights -1 and 1."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.ones(sides)])
    return whole_hull(np.concatenate([ring * (1.0, 1.0, -1.0), ring]), "prism")


def prism_excess(radius: float) -> float:
    """Maximum distance of a point of the prism from its cylinder [m]."""
    return radius / math.cos(math.pi / _sides(radius)) - radius


def _sides(radius: float) -> int:
    """Number of sides, a multiple of 4."""
    needed = math.pi / math.acos(radius / (radius + ERROR))
    return min(MOST_SIDES, max(FEWEST_SIDES, 4 * math.ceil(0.25 * needed)))
