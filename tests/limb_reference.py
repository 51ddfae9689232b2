"""Compliance between two points of limbs, as a reference for bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

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


@dataclass(frozen=True)
class Touch:
    """A contact of two points, each on a limb segment or a fruit; a push is one of a rigid body with a negative gap.

    Attributes:
        bodies: Numbers of limb segments, names of fruit, or None for rigid bodies.
        points: (2, 3) the points on their axes [m].
        normal: (3,) direction from the first to the second one.
        gap: Gap between them [m].
    """

    bodies: tuple[int | str | None, int | str | None]
    points: FloatArray
    normal: FloatArray
    gap: float


def compliance_of_touches(
    ones: Sequence[Touch], others: Sequence[Touch], limbs: Limbs, fruits: Mapping[str, FloatArray],
    youngs_modulus: float,
) -> FloatArray:  # fmt: skip
    """(k, n) distance by which each of some contacts opens per force of each of others [m/N].

    Args:
        ones: The k contacts.
        others: The n contacts.
        limbs: All limbs.
        fruits: (3, 3) compliance of fruit that hang from wood that does not bend, by name [m/N].
        youngs_modulus: Young's modulus [Pa].
    """
    found = np.zeros((len(ones), len(others)))
    for row, one in enumerate(ones):
        for column, other in enumerate(others):
            for side, body in enumerate(one.bodies):
                for far, pressed in enumerate(other.bodies):
                    if isinstance(body, int) and isinstance(pressed, int):
                        points = np.stack([one.points[side], other.points[far]])
                        compliance = mutual_compliance(limbs, (body, pressed), points, youngs_modulus)
                    elif isinstance(body, str) and body == pressed:
                        compliance = fruits[body]
                    else:
                        continue
                    sign = 1.0 if side == far else -1.0
                    found[row, column] += sign * float(one.normal @ compliance @ other.normal)
    return found


def forces_in_equilibrium(compliance: FloatArray, gaps: FloatArray) -> FloatArray:
    """(k,) forces of contacts without friction, by their (k, k) compliance and gaps: they minimize its energy [N]."""
    matrix = compliance + 1e-7 * np.eye(len(gaps))  # contacts yield by 0.1 micrometres per newton
    root = np.linalg.cholesky(matrix)
    found: FloatArray = lsq_linear(root.T, np.linalg.solve(root, -gaps), (0.0, np.inf), "bvls", tol=1e-15).x
    left = matrix @ found + gaps
    assert left.min() > -1e-7
    assert np.abs(left * found).max() < 1e-7
    return found
