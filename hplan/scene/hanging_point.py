"""How far a fruit on its stalk and limb can be displaced."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hplan.base.arrays import FloatArray, Record
from hplan.scene.limbs import Limbs
from hplan.scene.wood import MOST_SWING


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

    def displacement_by_work(self, of_wood: float, others: float) -> float:
        r"""Upper bound of the displacement of the fruit by work on its limb and on the fruit itself [m].

        With the energy :math:`U` the limb moves by at most :math:`\sqrt{2 \lambda_{max}(C) U}` at this point, and with
        the energy :math:`V` the fruit by :math:`\sqrt{2 c V}` more, where :math:`c` is the compliance of a pendulum at
        rest. If both have the work W together, the sum is at most :math:`\sqrt{2 (\lambda_{max}(C) + c) W}`. Stiffer
        wood takes more work and moves less: for work in proportion to Young's modulus :math:`\lambda_{max}(C) W` is the
        same for all wood.

        Args:
            of_wood: Work in proportion to Young's modulus, for the stiffest wood [J].
            others: Other work [J].
        """
        limb, pendulum = self._compliances
        stiff = limb * self.youngs_modulus[0] / self.youngs_modulus[1]
        return math.sqrt(2.0 * ((stiff + pendulum) * of_wood + (limb + pendulum) * others))

    @cached_property
    def _compliances(self) -> tuple[float, float]:
        """Largest compliance of the softest limb, and of the pendulum at rest [m/N]."""
        limb = self.limbs.compliance_along(np.array([self.segment]), np.array([self.along]))[0][0]
        at_rest = float(np.linalg.eigvalsh(self.swing)[-1]) / math.sqrt(1.0 - MOST_SWING**2)
        return float(np.linalg.eigvalsh(limb)[-1]) / self.youngs_modulus[0], at_rest
