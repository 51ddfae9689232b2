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

from hplan.scene.solids import HULL_VERTICES, Hull, rpy_rotation, whole_hull

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
    widest = radius / math.cos(math.pi / n)
    scale = np.array([widest, widest, 0.5 * length])
    return _unit_prism(n).placed(rpy_rotation(*map(math.radians, rpy_deg)), np.array(center), scale)


@lru_cache
def _unit_prism(sides: int) -> Hull:
    """The prism with its corners 1 from the z axis, and 1 below and above."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.ones(sides)])
    return whole_hull(np.concatenate([ring * (1.0, 1.0, -1.0), ring]), "prism")


def prism_excess(radius: float) -> float:
    """How far the prism about a cylinder stands out of it [m]."""
    return radius / math.cos(math.pi / _sides(radius)) - radius


def _sides(radius: float) -> int:
    """Number of sides, a multiple of 4."""
    needed = math.pi / math.acos(radius / (radius + ERROR))
    return min(MOST_SIDES, max(FEWEST_SIDES, 4 * math.ceil(0.25 * needed)))
