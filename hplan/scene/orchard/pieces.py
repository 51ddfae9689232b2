"""Capsules and points as orchards write them: every length a whole number of tenths of a millimetre.

Files stay short so, and the same seed gives the same text wherever the last bit of a sine falls.
"""

from __future__ import annotations

from collections.abc import Iterable

from hplan.scene.limits import Vector
from hplan.scene.obstacles import Capsule

#: Decimals of a length in metres.
DECIMALS = 4


def rounded(point: Iterable[float]) -> Vector:
    """A point on the grid of tenths of a millimetre [m]."""
    # Adding 0.0 turns -0.0, which a file would show, into 0.0.
    x, y, z = (round(float(value), DECIMALS) + 0.0 for value in point)
    return x, y, z


def capsule(name: str, start: Vector, end: Vector, radius: float) -> Capsule:
    """A capsule from its ends, as given [m]."""
    return Capsule.model_validate({"name": name, "from": start, "to": end, "radius": radius})
