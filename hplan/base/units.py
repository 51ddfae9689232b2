"""The units of a joint: radians where it turns, metres where it slides. What is told of one asks here."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

#: No joint is farther from 0 [rad, m].
FARTHEST_JOINT: Final = 1e6


def at_least_mm(distance_m: float, digits: int = 2) -> str:
    """A lower bound of a distance in millimetres, rounded down, so that what is shown is one too."""
    scale = 10**digits
    return f"{math.floor(1e3 * distance_m * scale + 1e-6) / scale:.{digits}f}" if math.isfinite(distance_m) else "inf"


@dataclass(frozen=True)
class JointUnit:
    """The units of a joint's values, as they are named in files and shown.

    Attributes:
        position: Of its positions; those of velocities and accelerations follow from it.
        effort: Of its torque or force.
        columns: Ends of its columns in a CSV: position, velocity, acceleration, torque or force.
        shown: In what its positions are drawn.
        factor: How many of these one of its positions is.
        small: In what its errors are shown.
        small_factor: How many of these one of its positions is.
    """

    position: str
    effort: str
    columns: tuple[str, str, str, str]
    shown: str
    factor: float
    small: str
    small_factor: float

    @property
    def velocity(self) -> str:
        """Of its velocities."""
        return f"{self.position}/s"

    @property
    def acceleration(self) -> str:
        """Of its accelerations."""
        return f"{self.position}/s^2"

    def error(self, value: float, digits: str = ".4g") -> str:
        """An error of its position, as degrees or millimetres."""
        return f"{self.small_factor * value:{digits}} {self.small}"


#: Of a joint that turns, and of one that slides.
TURNING = JointUnit("rad", "N m", ("pos_rad", "vel_rad_s", "acc_rad_s2", "torque_nm"),
    "deg", 180.0 / math.pi, "deg", 180.0 / math.pi)  # fmt: skip
SLIDING = JointUnit("m", "N", ("pos_m", "vel_m_s", "acc_m_s2", "force_n"), "m", 1.0, "mm", 1e3)


def joint_unit(slides: bool) -> JointUnit:
    """The units of a joint that slides, or of one that turns."""
    return SLIDING if slides else TURNING


def joint_length(value: float, slides: Sequence[bool], digits: str = ".2f") -> str:
    """A length over all joints (Euclidean norm) in words: degrees, or as it is where some slide [rad and m]."""
    if not any(slides):
        return f"{math.degrees(value):{digits}} deg"
    return f"{value:.4g} {'m' if all(slides) else 'rad and m'}"
