"""Planes that bodies are ahead of."""

from __future__ import annotations

import math
from typing import Final, TypeAlias

from hplan.base.kernels import inline
from hplan.geometry.vectors import Vector, dot

#: Unit normal of a plane, and its height along it [m].
Plane: TypeAlias = tuple[Vector, float]

#: A plane with nothing behind it.
NO_PLANE: Final[Plane] = ((0.0, 0.0, 0.0), -math.inf)


@inline
def is_behind(plane: Plane, centre: Vector, radius: float) -> bool:
    """True if a ball is behind a plane."""
    behind: bool = dot(plane[0], centre) + radius <= plane[1]
    return behind
