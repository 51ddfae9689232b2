r"""Wind on simulated trees: drag of limbs and fruit in gusts of a given spectrum.

The speed along the wind's direction is its mean plus a Gauss-Markov process, whose spectrum is that of Dryden's
longitudinal gusts (MIL-HDBK-1797),

.. math:: S(f) = \sigma^2 \frac{4 L / V}{1 + (2 \pi f L / V)^2}

for the mean speed :math:`V`, the length scale :math:`L` and the standard deviation :math:`\sigma`. It is the same at
all points of a tree, so that limbs sway together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.base.checked import NotNegative, Options, Positive

#: Density of air [kg/m^3], and drag coefficients of a limb with leaves and of a fruit.
AIR_DENSITY, LIMB_DRAG, FRUIT_DRAG = 1.2, 1.0, 0.47


@dataclass(frozen=True)
class Wind(Options):
    """Wind that blows on trees.

    Attributes:
        speed_m_s: Mean speed [m/s].
        intensity: Standard deviation of the speed, relative to its mean.
        length_scale_m: Length scale of the gusts [m].
        heading_deg: Direction that it blows to, from the x axis about the vertical [deg].
        leaf_width_m: Width of the leaves of a limb, in addition to its own [m].
        seed: Random seed of the gusts.

    Examples:
        >>> from hplan.apps.execution.wind import Wind
        >>> wind = Wind(speed_m_s=4.0, intensity=0.0)
        >>> wind.speeds(0.5, 0.25).tolist()
        [4.0, 4.0, 4.0]
    """

    speed_m_s: Positive = 3.0
    intensity: NotNegative = 0.25
    length_scale_m: Positive = 10.0
    heading_deg: float = 0.0
    leaf_width_m: NotNegative = 0.02
    seed: int = 0

    @property
    def direction(self) -> FloatArray:
        """(3,) direction that the wind blows to."""
        heading = math.radians(self.heading_deg)
        return np.array([math.cos(heading), math.sin(heading), 0.0])

    def speeds(self, duration_s: float, step_s: float) -> FloatArray:
        """(n,) speeds of the wind at times from 0 to at least a duration [m/s].

        Args:
            duration_s: The duration [s].
            step_s: Time between two speeds [s].
        """
        count = 1 + math.ceil(duration_s / step_s)
        noise = np.random.default_rng(self.seed).normal(size=count)
        keeps = math.exp(-step_s * self.speed_m_s / self.length_scale_m)
        gusts = np.empty(count)
        gusts[0] = noise[0]
        for number in range(1, count):
            gusts[number] = keeps * gusts[number - 1] + math.sqrt(1.0 - keeps**2) * noise[number]
        found: FloatArray = self.speed_m_s * (1.0 + self.intensity * gusts)
        return found

    def limb_drag(self, axis: FloatArray, length: FloatArray, radius: FloatArray, speed: float) -> FloatArray:
        """(n, 3) drag forces on pieces of limbs, across their axes [N].

        Args:
            axis: (n, 3) directions of the pieces.
            length: (n,) lengths [m].
            radius: (n,) radii [m].
            speed: Speed of the wind [m/s].
        """
        across = self.direction - (axis @ self.direction)[:, None] * axis
        area = length * (2.0 * radius + self.leaf_width_m)
        share = np.linalg.norm(across, axis=1)
        found: FloatArray = (0.5 * AIR_DENSITY * LIMB_DRAG * area * share * speed * abs(speed))[:, None] * across
        return found

    def fruit_drag(self, radius: FloatArray, speed: float) -> FloatArray:
        """(n, 3) drag forces on fruit of (n,) radii [N]."""
        area = math.pi * radius**2
        found: FloatArray = (0.5 * AIR_DENSITY * FRUIT_DRAG * area * speed * abs(speed))[:, None] * self.direction
        return found
