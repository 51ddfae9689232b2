"""First-order constraint rows on the tool's tilt along a timed spline."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.kinematics.damped_steps import Chain, leaning
from hplan.optimization.interior_point import ProgramRows
from hplan.optimization.timed_spline import RESTING, TimedSpline
from hplan.optimization.torque_rows import rows_of

#: Number of sample times in each piece.
_TIMES = 3

#: A program leaves out sample times with a tilt below this fraction of the maximum.
LEANING = 0.3


@dataclass(frozen=True, eq=False)
class Leaning:
    """Tilt of the tool at sample times of a motion.

    Attributes:
        clock: (times,) the times [s].
        cosines: (times,) cosines of the tilt angles.
        slopes: (times, dof) derivatives of the cosines with respect to the joints [1/rad].
        most_rad: Maximum permitted tilt [rad].
    """

    clock: FloatArray
    cosines: FloatArray
    slopes: FloatArray
    most_rad: float

    @classmethod
    def of(cls, spline: TimedSpline, upright: Chain) -> Leaning:
        """Tilt at `_TIMES` sample times of each piece."""
        clock = spline.clock(_TIMES)
        configurations = np.ascontiguousarray(spline.positions(clock))
        cosines, slopes = np.empty(len(clock)), np.empty(configurations.shape)
        leaning(configurations, upright, cosines, slopes)
        return cls(clock, cosines, slopes, float(upright.free_turn[1]))

    @property
    def is_upright(self) -> bool:
        """True if the tilt stays within its maximum at all sample times."""
        return bool(self.cosines.min() >= math.cos(self.most_rad))

    def rows(self, spline: TimedSpline, movable: IntArray) -> ProgramRows:
        """One constraint row for each tilted sample: stay within the maximum tilt.

        A sample that already exceeds the maximum must not tilt further.
        """
        near = np.flatnonzero(self.cosines < math.cos(LEANING * self.most_rad))
        weights = spline.weights(self.clock[near])[:, RESTING:-RESTING]
        blocks = -weights[:, :, None] * self.slopes[near][:, None, movable]
        bound = np.maximum(self.cosines[near] - math.cos(self.most_rad), 0.0)
        return rows_of(blocks, np.zeros(len(near)), bound)
