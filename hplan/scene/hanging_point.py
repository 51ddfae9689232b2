"""How far contacts displace the point of a limb that a fruit hangs from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from hplan.base.arrays import FloatArray, Record
from hplan.scene.limb_parts import TINY
from hplan.scene.limbs import Limbs
from hplan.scene.obstacle_kind import ContactLimit
from hplan.scene.wood import MOST_SWING

#: Steps of the deflection per force, and slopes per ratio of the largest values, in `largest_ratio`.
_STEP: Final = 1.02
_SLOPES: Final = np.concatenate([[0.0], np.geomspace(1e-4, 1e4, 193), -np.geomspace(1e-4, 1e4, 193)])

#: Bound of relative rounding errors there.
_ROUNDING: Final = 1e-12


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
        r"""Bound of the displacement over all normals of the contact, and all its places on the part.

        A contact of the force f along n at x deflects the part by :math:`\delta = f\, n^\top C_{xx} n`, and this point
        by :math:`u = f C_{fx} n`. The bending moments that do so share the wood on the paths of both. Of the compliance
        of this point, let S be the share of that wood. Then (Cauchy and Schwarz) :math:`|u|^2 \le \lambda_{max}(S) f
        \delta`, and S grows towards the outer end of the part. :math:`f \delta` is at most
        `ContactLimit.stiffness_per_pa` times the squared depth, for wood of 1 Pa.
        """
        if isinstance(limit.displacement, HangingPoint):
            return self._ratio_by_fruit(limit, limit.displacement), False
        limbs = self.limbs
        path, other = limbs.path(self.segment), limbs.path(limit.segment)
        if not path or not other or path[-1] != other[-1]:
            return 0.0, False
        points = np.stack([self._place, limbs.start[limit.segment] + limit.along[1] * limbs.axis[limit.segment]])
        shared = limbs.shared_compliance((self.segment, limit.segment), points, 1.0)
        squared = float(np.linalg.eigvalsh(shared)[-1]) * limit.stiffness_per_pa
        return math.sqrt(max(0.0, squared)), limit.segment in path or self.segment in other

    @cached_property
    def _place(self) -> FloatArray:
        """(3,) the point [m]."""
        place: FloatArray = self.limbs.start[self.segment] + self.along * self.limbs.axis[self.segment]
        return place

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
        cosine, points = math.sqrt(1.0 - MOST_SWING**2), np.stack([self._place, self._place])
        limb = self.limbs.mutual_compliance((self.segment, self.segment), points, self.youngs_modulus[0])
        return float(np.linalg.eigvalsh(limb)[-1]) + float(np.linalg.eigvalsh(self.swing)[-1]) / cosine

    def _ratio_by_fruit(self, limit: ContactLimit, other: HangingPoint) -> float:
        """Largest displacement per deflection of another fruit on the same limb.

        A push of the depth d along n exerts d / (n C n) with the compliance C of limb and pendulum, and at most the
        limit's force. The softest limb is displaced most, since the pendulum does not depend on it.
        """
        limbs, soft, points = self.limbs, self.youngs_modulus[0], np.stack([self._place, other._place])
        own = limbs.mutual_compliance((other.segment, other.segment), points[[1, 1]], soft) + other.swing
        moved = limbs.mutual_compliance((self.segment, other.segment), points, soft)
        return largest_ratio(moved, own, limit.force / max(limit.depth, TINY))


def largest_ratio(moved: FloatArray, own: FloatArray, stiffest: float) -> float:
    r"""Upper bound of a displacement per deflection over all normals of a push.

    Let :math:`c = n^\top C n` and :math:`q = |M n|^2`. For every number m, :math:`q \le \lambda_{max}(M^\top M - m C) +
    m c`. Over an interval of c the right side is largest at one end; the least over many m bounds q there. The pairs
    (c, q) fill a convex set (Brickman 1961, On the field of values of a matrix), so this is tight up to the steps of c
    and m.

    Args:
        moved: (3, 3) displacement of a point per force elsewhere, M [m/N].
        own: (3, 3) compliance where the force acts, C [m/N].
        stiffest: Largest force per deflection there, whatever C says [N/m].

    Returns:
        Bound of :math:`|M n| \min(1 / (n^\top C n), k)` over all unit vectors n, for the largest stiffness k.

    Examples:
        >>> import numpy as np
        >>> from hplan.scene.hanging_point import largest_ratio
        >>> round(largest_ratio(np.eye(3), np.diag([0.5, 1.0, 2.0]), 10.0), 2)
        2.0
    """
    squared = moved.T @ moved
    size, (least, _, softest) = float(np.linalg.eigvalsh(squared)[-1]), np.linalg.eigvalsh(own).tolist()
    if size <= 0.0 or softest <= 0.0:
        return math.sqrt(max(0.0, size)) * stiffest
    least, softest = max(0.0, least - _ROUNDING * softest), softest * (1.0 + _ROUNDING)
    bent = min(max(least, 1.0 / stiffest), softest)
    count = 2 + math.ceil(math.log(softest / bent) / math.log(_STEP))
    ends = np.concatenate([[least], np.geomspace(bent, softest, count)])
    slopes = _SLOPES * size / softest
    top = np.linalg.eigvalsh(squared - slopes[:, None, None] * own)[:, -1]
    above = (top + _ROUNDING * size * (1.0 + np.abs(_SLOPES)))[:, None] + slopes[:, None] * ends
    squares = np.maximum(above[:, :-1], above[:, 1:]).min(axis=0)
    with np.errstate(divide="ignore"):
        per_force = np.minimum(1.0 / ends[:-1], stiffest)
    return float((np.sqrt(np.maximum(squares, 0.0)) * per_force).max())
