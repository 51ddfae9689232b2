"""Compliance between two points of limbs, as a reference for bounds."""

from __future__ import annotations

import math

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.scene.limbs import TWIST_RATIO, Limbs


def mutual_compliance(limbs: Limbs, numbers: tuple[int, int], points: FloatArray, youngs_modulus: float) -> FloatArray:
    """(3, 3) displacement at one point of a limb by a force at another one [m/N].

    Args:
        limbs: All limbs.
        numbers: Segments of the displaced point and of the force.
        points: (2, 3) the points, on these segments' axes [m].
        youngs_modulus: Young's modulus [Pa].
    """
    paths = [limbs.path(number)[::-1] for number in numbers]
    shared = [row for row, other in zip(*paths, strict=False) if row == other]
    found, rigidity = np.zeros((3, 3)), limbs.flexural_rigidity(youngs_modulus)
    for rank, row in enumerate(shared):
        ends = [
            float(np.dot((limbs.joint[path[rank + 1]] if rank + 1 < len(path) else point) - limbs.start[row],
                         limbs.axis[row]))
            for path, point in zip(paths, points, strict=True)
        ]  # fmt: skip
        part = min(max(min(ends), 0.0), float(limbs.length[row]))
        twist = (1.0 / TWIST_RATIO - 1.0) * part / rigidity[row]
        arms = [np.cross(limbs.axis[row], point - limbs.start[row]) for point in points]
        found += twist * np.outer(*arms)
        # The integrand is quadratic in s: two Gauss points are exact.
        for s in (0.5 - 0.5 / math.sqrt(3.0), 0.5 + 0.5 / math.sqrt(3.0)):
            first, second = points - (limbs.start[row] + s * part * limbs.axis[row])
            weight = 0.5 * part / rigidity[row]
            found += weight * (float(first @ second) * np.eye(3) - np.outer(second, first))
    return found
