"""How far contacts displace the point of a limb that a fruit hangs from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Final

import numpy as np

from hplan.base.arrays import FloatArray, Record, readonly
from hplan.scene.limb_parts import TINY
from hplan.scene.limbs import Limbs
from hplan.scene.obstacle_kind import ContactLimit
from hplan.scene.wood import MOST_SWING

#: Number of normals for which the displacement of a limb by a pushed fruit is examined.
_SPHERE: Final = 400


@dataclass(frozen=True, eq=False)
class HangingPoint(Record):
    """Point of a limb that a fruit hangs from.

    Attributes:
        limbs: All limbs.
        segment: Number of the segment.
        along: Distance from its start [m].
        swing: (3, 3) compliance of the pendulum [m/N].
        youngs_modulus: Minimum and maximum of Young's modulus [Pa].
    """

    limbs: Limbs
    segment: int
    along: float
    swing: FloatArray
    youngs_modulus: tuple[float, float]

    def __call__(self, limit: ContactLimit) -> tuple[float, bool]:
        """Largest displacement per deflection of a part of a limb, and True if one of both carries the other."""
        if limit not in self._known:
            self._known[limit] = self._largest(limit)
        return self._known[limit]

    @cached_property
    def _known(self) -> dict[ContactLimit, tuple[float, bool]]:
        """Results by contact: the motions to a fruit push the same limbs."""
        return {}

    def _largest(self, limit: ContactLimit) -> tuple[float, bool]:
        r"""Bound of the displacement over all normals of the contact.

        A contact of the force f that deflects the part by :math:`\delta = f\, n^\top C_{xx} n` displaces this point by
        :math:`u = f C_{fx} n`. Let m be the largest generalized eigenvalue of :math:`C_{fx}^\top C_{fx}` and
        :math:`C_{xx}`. Then :math:`|u|^2 \le m f \delta`, and :math:`f \delta` is at most
        `ContactLimit.stiffness_per_pa` times the squared depth. Ends and middle of the part are examined.
        """
        if isinstance(limit.displacement, HangingPoint):
            return self._ratio_by_fruit(limit, limit.displacement), False
        limbs, numbers = self.limbs, (self.segment, limit.segment)
        path, other = limbs.path(self.segment), limbs.path(limit.segment)
        if not path or not other or path[-1] != other[-1]:
            return 0.0, False
        here, axis = limbs.start[self.segment] + self.along * limbs.axis[self.segment], limbs.axis[limit.segment]
        largest = 0.0
        for along in (limit.along[0], 0.5 * sum(limit.along), limit.along[1]):
            at = limbs.start[limit.segment] + along * axis
            moved = limbs.mutual_compliance(numbers, np.stack([here, at]), 1.0)
            own = limbs.compliance(limit.segment, along / float(limbs.length[limit.segment]), 1.0)[:3, :3]
            largest = max(largest, _generalized_eigenvalue(moved.T @ moved, own))
        return math.sqrt(largest * limit.stiffness_per_pa), limit.segment in path or self.segment in other

    def displacement_by_push(self, force: float, depth: float) -> float:
        r"""Upper bound of the displacement of the fruit itself by a push with any normal [m].

        If a push of the depth d and the force f displaces the limb by :math:`a` along the normal, and the fruit
        relative to it by :math:`b`, then (Cauchy and Schwarz) the limb moves by at most
        :math:`\sqrt{\lambda_{max}(C) f a}`, and the fruit by :math:`\sqrt{c f b}` more, where :math:`c` is the
        compliance of a pendulum at rest, the softest that it has. As :math:`a + b \le d`, the sum is at most
        :math:`\sqrt{(\lambda_{max}(C) + c) f d}`. The chord of a swing exceeds its part across the stalk.

        Args:
            force: Upper bound of the static force [N].
            depth: Upper bound of the depth in the fruit [m].
        """
        cosine = math.sqrt(1.0 - MOST_SWING**2)
        return math.sqrt(2.0 / (1.0 + cosine) * self._softest * force * depth)

    @cached_property
    def _softest(self) -> float:
        """Largest compliance of limb and pendulum at rest [m/N]."""
        limbs, cosine = self.limbs, math.sqrt(1.0 - MOST_SWING**2)
        here = limbs.start[self.segment] + self.along * limbs.axis[self.segment]
        limb = limbs.mutual_compliance((self.segment, self.segment), np.stack([here, here]), self.youngs_modulus[0])
        return float(np.linalg.eigvalsh(limb)[-1]) + float(np.linalg.eigvalsh(self.swing)[-1]) / cosine

    def _ratio_by_fruit(self, limit: ContactLimit, other: HangingPoint) -> float:
        """Largest displacement per deflection of another fruit on the same limb.

        A push of the depth d along n exerts d / (n C n) with the compliance C of limb and pendulum, and at most the
        limit's force. The softest limb is displaced most, since the pendulum does not depend on it. Many normals are
        examined.
        """
        limbs, numbers, soft = self.limbs, (self.segment, other.segment), self.youngs_modulus[0]
        points = np.stack([
            limbs.start[point.segment] + point.along * limbs.axis[point.segment] for point in (self, other)
        ])  # fmt: skip
        own = limbs.mutual_compliance((other.segment, other.segment), points[[1, 1]], soft) + other.swing
        normals = _half_sphere(_SPHERE)
        moved = np.linalg.norm(normals @ limbs.mutual_compliance(numbers, points, soft).T, axis=1)
        per_depth = 1.0 / np.maximum(np.einsum("ni,ij,nj->n", normals, own, normals), TINY)
        return float((moved * np.minimum(per_depth, limit.force / max(limit.depth, TINY))).max())


def _generalized_eigenvalue(above: FloatArray, below: FloatArray) -> float:
    """Upper bound of the largest generalized eigenvalue of two positive semidefinite matrices."""
    # Along a limb both vanish. A small fraction of the trace makes `below` invertible.
    scale, rest = float(np.trace(below)), 1e-9
    if scale <= 0.0:
        return 0.0
    root = np.linalg.cholesky(below + rest * scale * np.eye(3))
    half = np.linalg.solve(root, above)
    return float(np.linalg.eigvalsh(np.linalg.solve(root, half.T))[-1]) * (1.0 + 1e-6)


@cache
def _half_sphere(count: int) -> FloatArray:
    """(count, 3) evenly distributed directions with z > 0."""
    rank = np.arange(count) + 0.5
    height, turn = rank / count, math.pi * (1.0 + math.sqrt(5.0)) * rank
    across = np.sqrt(1.0 - height**2)
    return readonly(np.column_stack([across * np.cos(turn), across * np.sin(turn), height]))
