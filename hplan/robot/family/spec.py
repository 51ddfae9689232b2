"""Validated specification of a robot-family member: links, joints and limits.

`HARVESTER` specifies the robot that ships with hplan.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

from pydantic import Field

from hplan.base.checked import Options, Positive
from hplan.errors import OptionError

_HALF_PI = math.pi / 2


@dataclass(frozen=True)
class Gripper(Options):
    """A gripper: a collision capsule that ends at `tool0`.

    Attributes:
        mass: Its mass, distributed as a solid cylinder [kg].
        length: Its extent back from `tool0` [m].
        half_width: Radius of its capsule [m].
    """

    mass: Positive
    length: Positive
    half_width: Positive


@dataclass(frozen=True)
class ArmSpec(Options):
    """A member of the family: n planar links on an optional yaw.

    The per-joint values follow `joint_names`: the yaw first if the arm has one, then the n planar joints. Any sequence
    of numbers is accepted and stored as a tuple of floats.

    Attributes:
        name: Name of the robot: letters, digits, `_` and single `-` between them.
        link_lengths: n lengths from joint to joint, the last one to `tool0` [m].
        link_half_widths: n capsule radii [m].
        link_masses: n masses, each distributed as a solid cylinder along its link [kg].
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
        gripper: Gripper on the last link; None draws one within the link's capsule, without a mass of its own.
        yaw_axis: (2,) position of the pedestal and of the yaw axis in `base_link` [m].
        shoulder_offset: Distance of the arm plane from the yaw axis, to the left of the arm's pointing direction [m].
        link_offsets: Lateral offset of each link's body from the arm plane, to the left [m]; None for zero offsets.
    """

    # A double hyphen in the name would end the XML comment that quotes the spec.
    name: Annotated[str, Field(pattern="^[A-Za-z][A-Za-z0-9_]*(-[A-Za-z0-9_]+)*$")]
    link_lengths: Annotated[tuple[Positive, ...], Field(min_length=1)]
    link_half_widths: tuple[Positive, ...]
    link_masses: tuple[Positive, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    velocity: tuple[Positive, ...]
    effort: tuple[Positive, ...]
    acceleration: tuple[Positive, ...]
    jerk: tuple[Positive, ...] | None = None
    shoulder_height: Positive = 0.6
    has_yaw: bool = True
    base_mass: Positive = 40.0
    turret_mass: Positive = 12.0
    gripper: Gripper | None = None
    yaw_axis: tuple[float, float] = (0.0, 0.0)
    shoulder_offset: float = 0.0
    link_offsets: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        joints = self.n_links + int(self.has_yaw)
        for count, fields in (
            (self.n_links, ("link_half_widths", "link_masses", "link_offsets")),
            (joints, ("lower", "upper", "velocity", "effort", "acceleration", "jerk")),
        ):
            for field in fields:
                values = getattr(self, field)
                if values is not None and len(values) != count:
                    raise OptionError(field, values, f"{count} numbers")
        for joint, lower, upper in zip(self.joint_names, self.lower, self.upper, strict=True):
            if not lower < upper:
                raise OptionError(f"lower[{joint}]", lower, f"less than the upper limit {upper!r}")

    @property
    def n_links(self) -> int:
        """Number of planar links."""
        return len(self.link_lengths)

    @property
    def body_offsets(self) -> tuple[float, ...]:
        """Lateral offset of each link's body from the arm plane [m]."""
        return (0.0,) * self.n_links if self.link_offsets is None else self.link_offsets

    @property
    def planar_joint_names(self) -> tuple[str, ...]:
        """Names of the n planar joints, from the shoulder outwards."""
        if self.n_links == 3:
            return ("shoulder", "elbow", "wrist")
        return tuple(f"joint_{i}" for i in range(1, self.n_links + 1))

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the movable joints.

        `base_yaw` comes first if the arm has a yaw, then the planar joints.
        """
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

#: Orchard harvester: its joints bend both ways, so that it also reaches fruit below the shoulder; it has a gripper.
ORCHARD_HARVESTER = replace(
    HARVESTER,
    name="orchard_harvester",
    lower=(-math.pi, math.radians(-90.0), math.radians(-150.0), math.radians(-120.0)),
    upper=(math.pi, math.radians(135.0), math.radians(150.0), math.radians(120.0)),
    gripper=Gripper(mass=0.7, length=0.14, half_width=0.036),
)
