"""Specification of a member of the robot family: its links, joints and limits, checked; and the one that ships."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from hplan.base.arguments import each, instance, keep_checked, number, truth
from hplan.errors import OptionError

_HALF_PI = math.pi / 2


@dataclass(frozen=True)
class Gripper:
    """A gripper about the end of the last link, which collides as a capsule that ends at `tool0`.

    Attributes:
        mass: Its mass, spread as a solid cylinder [kg].
        length: How far it reaches back from `tool0` [m].
        half_width: Radius of its capsule [m].
    """

    mass: float
    length: float
    half_width: float

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            OptionError: A value that is no positive number.
        """
        keep_checked(self, dict.fromkeys(("mass", "length", "half_width"), (_positive,)))


@dataclass(frozen=True)
class ArmSpec:
    """One member of the family: n planar links on an optional yaw.

    The per-joint values follow `joint_names`: the yaw first where there is one, then the n planar
    joints. Any sequence of numbers is accepted and kept as a tuple of floats.

    Attributes:
        name: Name of the robot: letters, digits, `_` and single `-` between them.
        link_lengths: n lengths from joint to joint, the last one to `tool0` [m].
        link_half_widths: n capsule radii [m].
        link_masses: n masses, each spread as a solid cylinder along its link [kg].
        lower: Lower position limits, n or n + 1 of them [rad].
        upper: Upper position limits [rad].
        velocity: Velocity limits [rad/s].
        effort: Torque limits [N m].
        acceleration: Acceleration limits [rad/s^2].
        jerk: Jerk limits [rad/s^3]; None leaves them out of the limits file.
        shoulder_height: Height of the first planar axis above the ground [m].
        has_yaw: True if the turret turns about the vertical through `yaw_axis`.
        base_mass: Mass of the pedestal [kg].
        turret_mass: Mass of the turret [kg].
        gripper: What the last link carries; None draws one within its capsule, without a mass of its own.
        yaw_axis: Where the pedestal stands, and the yaw axis with it, in `base_link` (2,) [m].
        shoulder_offset: How far the arm plane passes the yaw axis, to the left of where the arm points [m].
        link_offsets: How far each link's body lies beside the arm plane, to the left; None where all lie in it [m].
    """

    name: str
    link_lengths: tuple[float, ...]
    link_half_widths: tuple[float, ...]
    link_masses: tuple[float, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]
    acceleration: tuple[float, ...]
    jerk: tuple[float, ...] | None = None
    shoulder_height: float = 0.6
    has_yaw: bool = True
    base_mass: float = 40.0
    turret_mass: float = 12.0
    gripper: Gripper | None = None
    yaw_axis: tuple[float, float] = (0.0, 0.0)
    shoulder_offset: float = 0.0
    link_offsets: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        """Check every value and keep sequences as tuples of floats.

        Raises:
            OptionError: A value is no finite number or out of its range, or a count does not match.
        """
        positive, finite = (_numbers, _positive), (_numbers, _finite)
        keep_checked(self, {"name": (_name,), "has_yaw": (truth,), "link_lengths": (*positive, None)})
        joints = self.n_links + int(self.has_yaw)
        keep_checked(self, dict.fromkeys(("link_half_widths", "link_masses"), (*positive, self.n_links)))
        keep_checked(self, dict.fromkeys(("velocity", "effort", "acceleration"), (*positive, joints)))
        if self.jerk is not None:
            keep_checked(self, {"jerk": (*positive, joints)})
        keep_checked(self, dict.fromkeys(("lower", "upper"), (*finite, joints)))
        for joint, lower, upper in zip(self.joint_names, self.lower, self.upper, strict=True):
            if not lower < upper:
                raise OptionError(f"lower[{joint}]", lower, f"less than the upper limit {upper!r}")
        keep_checked(self, dict.fromkeys(("shoulder_height", "base_mass", "turret_mass"), (_positive,)))
        keep_checked(self, {"yaw_axis": (*finite, 2), "shoulder_offset": (_finite,)})
        if self.link_offsets is not None:
            keep_checked(self, {"link_offsets": (*finite, self.n_links)})
        if self.gripper is not None:
            instance("gripper", self.gripper, Gripper)

    @property
    def n_links(self) -> int:
        """Number of planar links."""
        return len(self.link_lengths)

    @property
    def body_offsets(self) -> tuple[float, ...]:
        """How far each link's body lies beside the arm plane [m]."""
        return (0.0,) * self.n_links if self.link_offsets is None else self.link_offsets

    @property
    def planar_joint_names(self) -> tuple[str, ...]:
        """Names of the n planar joints, from the shoulder outwards."""
        if self.n_links == 3:
            return ("shoulder", "elbow", "wrist")
        return tuple(f"joint_{i}" for i in range(1, self.n_links + 1))

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the movable joints: `base_yaw` where there is a yaw, then the planar ones."""
        return (("base_yaw",) if self.has_yaw else ()) + self.planar_joint_names

    @property
    def arm_link_names(self) -> tuple[str, ...]:
        """Names of the n planar links, from the shoulder outwards."""
        if self.n_links == 3:
            return ("upper_arm", "forearm", "hand")
        return tuple(f"link_{i}" for i in range(1, self.n_links + 1))

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of all links, from the ground to the tool."""
        return ("base_link", "turret", *self.arm_link_names, "tool0")


def _name(option: str, name: Any) -> str:
    # A double hyphen would end the XML comment that quotes the spec.
    pattern = r"[A-Za-z][A-Za-z0-9_]*(-[A-Za-z0-9_]+)*"
    if not (isinstance(name, str) and re.fullmatch(pattern, name)):
        raise OptionError(option, name, "letters, digits, '_' and single '-', a letter first")
    return name


def _finite(option: str, value: Any) -> float:
    return number(option, value, "a finite number")


def _positive(option: str, value: Any) -> float:
    found = _finite(option, value)
    if not found > 0.0:
        raise OptionError(option, found, "a positive number")
    return found


def _numbers(option: str, values: Any, check: Callable[[str, Any], float], count: int | None) -> tuple[float, ...]:
    expected = "at least one number" if count is None else f"{count} numbers"
    found = each(option, values, expected, check)
    if not found or (count is not None and len(found) != count):
        raise OptionError(option, values, expected)
    return found


HARVESTER = ArmSpec(
    name="harvester",
    link_lengths=(1.0, 0.8, 0.4),
    link_half_widths=(0.05, 0.04, 0.03),
    link_masses=(6.0, 3.5, 1.2),
    lower=(-math.pi, 0.0, 0.0, 0.0),
    upper=(math.pi, _HALF_PI, _HALF_PI, _HALF_PI),
    velocity=(1.5, 1.2, 1.5, 2.0),
    effort=(150.0, 250.0, 120.0, 30.0),
    acceleration=(3.0, 3.0, 4.0, 6.0),
    jerk=(150.0, 150.0, 200.0, 300.0),
)

#: As an orchard needs it: joints that bend both ways, so that fruit below the shoulder is reached too, and a gripper.
ORCHARD_HARVESTER = replace(
    HARVESTER,
    name="orchard_harvester",
    lower=(-math.pi, math.radians(-90.0), math.radians(-150.0), math.radians(-120.0)),
    upper=(math.pi, math.radians(135.0), math.radians(150.0), math.radians(120.0)),
    gripper=Gripper(mass=0.7, length=0.14, half_width=0.036),
)
