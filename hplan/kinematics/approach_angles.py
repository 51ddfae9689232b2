"""Intervals of approach angles."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, Record
from hplan.errors import OptionError

#: Tolerance at the ends of an interval [rad].
WINDOW_TOLERANCE = 1e-7


@dataclass(frozen=True)
class Window(Record):
    """An interval of approach angles.

    Attributes:
        low: Lower end [rad].
        width: Width in [0, 2 pi]; 0 for a single angle [rad].
    """

    low: float
    width: float

    def holds(self, angle: FloatArray) -> BoolArray:
        """True for angles inside the interval, modulo 2 pi."""
        inside: BoolArray = angle_above(angle, self.low - WINDOW_TOLERANCE) <= self.width + 2.0 * WINDOW_TOLERANCE
        return inside

    def describe(self) -> str:
        """The interval as text, such as `10 to 20 deg`."""
        low, high = math.degrees(self.low), math.degrees(self.low + self.width)
        return f"{low:.4g} deg" if self.width == 0.0 else f"{low:.4g} to {high:.4g} deg"

    @classmethod
    def from_degrees(cls, approach_deg: float | tuple[float, float] | None) -> Window | None:
        """Return the interval for an `approach_deg` argument; None for all angles.

        Args:
            approach_deg: Approach angle, or an interval (low, high) [deg]; None for all.

        Raises:
            OptionError: `approach_deg` is not an angle or an interval.
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


def angle_above(angle: FloatArray, low: FloatArray | float) -> FloatArray:
    """Angle minus low, wrapped to [0, 2 pi)."""
    difference: FloatArray = (angle - low) % math.tau
    return difference
