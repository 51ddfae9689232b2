"""Units of joint values: radians for revolute joints, metres for prismatic joints.

All messages and files take units from here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

#: Units at the end of a joint's name: True for a length, and radians or metres per unit.
NAME_UNITS: Final = {"deg": (False, math.radians(1.0)), "rad": (False, 1.0), "m": (True, 1.0), "mm": (True, 1e-3)}

#: Maximum magnitude of a joint value [rad, m].
FARTHEST_JOINT: Final = 1e6


def at_least_mm(distance_m: float, digits: int = 2) -> str:
    """Format a lower bound of a distance in millimetres, rounded down.

    The printed number is a lower bound too.
    """
    scale = 10**digits
    return f"{math.floor(1e3 * distance_m * scale + 1e-6) / scale:.{digits}f}" if math.isfinite(distance_m) else "inf"


@dataclass(frozen=True)
class JointUnit:
    """Units of a joint's values in files and messages.

    Attributes:
        position: Unit of positions; the units of velocity and acceleration follow.
        effort: Unit of torque or force.
        columns: Suffixes of the CSV columns: position, velocity, acceleration, torque or force.
        shown: Display unit of positions.
        factor: Display units per unit of position.
        small: Display unit of position errors.
        small_factor: Display units of errors per unit of position.
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
        """Unit of velocities."""
        return f"{self.position}/s"

    @property
    def acceleration(self) -> str:
        """Unit of accelerations."""
        return f"{self.position}/s^2"

    def error(self, value: float, digits: str = ".4g") -> str:
        """Format a position error in degrees or millimetres."""
        return f"{self.small_factor * value:{digits}} {self.small}"


def at_most_deg(angle: float) -> str:
    """Format an upper bound of an angle in degrees, rounded up.

    Examples:
        >>> at_most_deg(0.1)
        '5.73'
    """
    return f"{math.ceil(1e2 * math.degrees(angle) - 1e-6) / 1e2:.2f}"


#: Units of a revolute joint, and of a prismatic joint.
TURNING = JointUnit("rad", "N m", ("pos_rad", "vel_rad_s", "acc_rad_s2", "torque_nm"),
    "deg", 180.0 / math.pi, "deg", 180.0 / math.pi)  # fmt: skip
SLIDING = JointUnit("m", "N", ("pos_m", "vel_m_s", "acc_m_s2", "force_n"), "m", 1.0, "mm", 1e3)


def joint_unit(slides: bool) -> JointUnit:
    """Units of a prismatic joint if `slides`, else of a revolute joint."""
    return SLIDING if slides else TURNING


def joint_length(value: float, slides: Sequence[bool], digits: str = ".2f") -> str:
    """Format a Euclidean length in joint space, in degrees.

    With prismatic joints the length is given in m, or in mixed rad and m.
    """
    if not any(slides):
        return f"{math.degrees(value):{digits}} deg"
    return f"{value:.4g} {'m' if all(slides) else 'rad and m'}"
