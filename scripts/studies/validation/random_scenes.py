"""What scenes drawn at random share."""

from __future__ import annotations

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.scene.limits import Vector


def direction(random: np.random.Generator) -> FloatArray:
    """(3,) unit vector, all directions equally likely."""
    drawn = random.normal(size=3)
    unit: FloatArray = drawn / np.linalg.norm(drawn)
    return unit


def vector(array: FloatArray) -> Vector:
    """A (3,) array as scenes hold it."""
    x, y, z = array.tolist()
    return x, y, z
