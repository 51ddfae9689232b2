"""Approach angles: those asked for, and configurations with the tool at a point and the angles that they have."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, Record
from hplan.errors import OptionError

#: An angle this far outside the interval asked for is in it [rad].
WINDOW_TOLERANCE = 1e-7


@dataclass(frozen=True)
class Window(Record):
    """An interval of approach angles.

    Attributes:
        low: Where it begins.
        width: How wide it is, in [0, 2 pi]; 0 for one angle.
    """

    low: float
    width: float

    def holds(self, angle: FloatArray) -> BoolArray:
        """True for angles in it, whole turns aside."""
        inside: BoolArray = above(angle, self.low - WINDOW_TOLERANCE) <= self.width + 2.0 * WINDOW_TOLERANCE
        return inside

    @classmethod
    def of(cls, approach_deg: float | tuple[float, float] | None) -> Window | None:
        """The interval that is asked for; None for all angles.

        Args:
            approach_deg: Approach angle, or an interval (low, high) of it; None for all [deg].

        Raises:
            OptionError: It is no angle or interval.
        """
        if approach_deg is None:
            return None
        expected = "an angle or an interval (low, high), low <= high, in degrees"
        try:
            ends = np.atleast_1d(np.array(approach_deg, dtype=np.float64))
        except (TypeError, ValueError) as error:
            raise OptionError("approach_deg", approach_deg, expected) from error
        if ends.shape not in ((1,), (2,)) or not np.isfinite(ends).all() or ends[0] > ends[-1]:
            raise OptionError("approach_deg", approach_deg, expected)
        low, high = np.radians(ends[[0, -1]])
        return None if high - low >= math.tau else cls(float(low), float(high - low))


@dataclass(frozen=True, eq=False)
class Candidates(Record):
    """Configurations that put the tool at a point.

    Attributes:
        configurations: (k, dof), k >= 1, within the limits; of a planar arm in the order of their joint values, of any
            other those first that are reached soonest.
        approach: (k,) approach angle in (-pi, pi]: of a planar arm the absolute angle of the last link in the arm
            plane, of any other that of the tool frame's z axis (`hplan.kinematics.tool_at_point`).
    """

    configurations: FloatArray
    approach: FloatArray


def above(angle: FloatArray, low: FloatArray | float) -> FloatArray:
    """Differences of angles from another, in [0, 2 pi)."""
    difference: FloatArray = (angle - low) % math.tau
    return difference
