"""Capsules and points of orchards, rounded to multiples of 0.1 mm.

Rounding keeps files short, and the same seed gives the same text on machines with different last bits of a sine.
"""

from __future__ import annotations

from collections.abc import Iterable

from hplan.scene.limits import Vector
from hplan.scene.obstacles import Capsule

#: Number of decimals of a length in metres.
DECIMALS = 4


def rounded(point: Iterable[float]) -> Vector:
    """Round a point to the 0.1 mm grid [m]."""
    # Adding 0.0 turns -0.0, which would appear in files, into 0.0.
    x, y, z = (round(float(value), DECIMALS) + 0.0 for value in point)
    return x, y, z


def capsule(name: str, start: Vector, end: Vector, radius: float) -> Capsule:
    """Return a capsule with the given ends [m]."""
    return Capsule.model_validate({"name": name, "from": start, "to": end, "radius": radius})
