"""How far a tool leans along a timed spline, to first order as rows of a linear program."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.kinematics.damped_steps import Chain, leaning
from hplan.optimization.interior_point import ProgramRows
from hplan.optimization.timed_spline import RESTING, TimedSpline
from hplan.optimization.torque_rows import rows_of

#: Times looked at in each piece.
_TIMES = 3

#: Times at which the tool leans by less than this part of what it may are left out of a program.
LEANING = 0.3


@dataclass(frozen=True, eq=False)
class Leaning:
    """How far the tool leans at some times of a motion.

    Attributes:
        clock: (times,) the times [s].
        cosines: (times,) of the angles.
        slopes: (times, dof) how the cosines change with the joints.
        most_rad: How far it may lean.
    """

    clock: FloatArray
    cosines: FloatArray
    slopes: FloatArray
    most_rad: float

    @classmethod
    def of(cls, spline: TimedSpline, upright: Chain) -> Leaning:
        """At `_TIMES` of each piece."""
        clock = spline.clock(_TIMES)
        configurations = np.ascontiguousarray(spline.positions(clock))
        cosines, slopes = np.empty(len(clock)), np.empty(configurations.shape)
        leaning(configurations, upright, cosines, slopes)
        return cls(clock, cosines, slopes, float(upright.free_turn[1]))

    @property
    def is_upright(self) -> bool:
        """Whether it leans by no more than it may."""
        return bool(self.cosines.min() >= math.cos(self.most_rad))

    def rows(self, spline: TimedSpline, movable: IntArray) -> ProgramRows:
        """A row for each time at which it leans: by no more than it may, or than it does."""
        near = np.flatnonzero(self.cosines < math.cos(LEANING * self.most_rad))
        weights = spline.weights(self.clock[near])[:, RESTING:-RESTING]
        blocks = -weights[:, :, None] * self.slopes[near][:, None, movable]
        bound = np.maximum(self.cosines[near] - math.cos(self.most_rad), 0.0)
        return rows_of(blocks, np.zeros(len(near)), bound)
