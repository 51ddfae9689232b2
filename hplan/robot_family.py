"""Members of the robot family, written as URDF with a limits YAML beside it.

A member is an optional yaw about the vertical, then n >= 1 revolute joints with parallel
horizontal axes: a planar arm on a turret. `ArmSpec` says which one, `write_robot` writes its two
files and `cross_check` compares what two independent readers, Pinocchio and yourdfpy, make of a
URDF. The robot that ships with hplan is `HARVESTER`.

Every arm link is a segment of its length along its own +x and collides as an exact capsule around
it: one `<cylinder>` and two `<sphere>` elements, since URDF has no capsule that every tool reads.
What one sees of a link stays within 1 cm of that capsule, so that the picture does not lie about
the check.
"""

from __future__ import annotations

import math
import re
import textwrap
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast
from xml.sax.saxutils import quoteattr

import numpy as np
import yaml
from numpy.typing import NDArray

from hplan.errors import OptionError, OutputError, RobotFileError
from hplan.files import write_text

LIMITS_FORMAT = "hplan-limits/1"
LIMITS_SUFFIX = ".limits.yaml"

_HALF_PI = math.pi / 2

# ------------------------------------------------------------------------------
# What a member of the family is
# ------------------------------------------------------------------------------


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
        has_yaw: Whether the turret turns about the vertical through the origin of `base_link`.
        base_mass: Mass of the pedestal [kg].
        turret_mass: Mass of the turret [kg].
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

    def __post_init__(self) -> None:
        """Check every value and keep sequences as tuples of floats.

        Raises:
            OptionError: A value is no finite number or out of its range, or a count does not match.
        """
        _check_name(self.name)
        if self.has_yaw not in (True, False):
            raise OptionError("has_yaw", self.has_yaw, "True or False")
        n_links = self._keep_positive("link_lengths", None)
        n_joints = n_links + int(self.has_yaw)
        for option in ("link_half_widths", "link_masses"):
            self._keep_positive(option, n_links)
        for option in ("velocity", "effort", "acceleration"):
            self._keep_positive(option, n_joints)
        if self.jerk is not None:
            self._keep_positive("jerk", n_joints)
        for option in ("lower", "upper"):
            object.__setattr__(self, option, _floats(option, getattr(self, option), n_joints))
        for joint, lower, upper in zip(self.joint_names, self.lower, self.upper, strict=True):
            if not lower < upper:
                raise OptionError(f"lower[{joint}]", lower, f"less than the upper limit {upper!r}")
        for option in ("shoulder_height", "base_mass", "turret_mass"):
            value = _finite(option, getattr(self, option))
            _require_positive(option, value)
            object.__setattr__(self, option, value)

    def _keep_positive(self, option: str, count: int | None) -> int:
        """Replace a field by its tuple of positive floats and return how many they are."""
        values = _floats(option, getattr(self, option), count)
        for index, value in enumerate(values):
            _require_positive(f"{option}[{index}]", value)
        object.__setattr__(self, option, values)
        return len(values)

    @property
    def n_links(self) -> int:
        """Number of planar links."""
        return len(self.link_lengths)

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


def _check_name(name: Any) -> None:
    # A double hyphen would end the XML comment that quotes the spec.
    pattern = r"[A-Za-z][A-Za-z0-9_]*(-[A-Za-z0-9_]+)*"
    if not (isinstance(name, str) and re.fullmatch(pattern, name)):
        raise OptionError("name", name, "letters, digits, '_' and single '-', a letter first")


def _finite(option: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise OptionError(option, value, "a number") from None
    if not math.isfinite(number):
        raise OptionError(option, value, "a finite number")
    return number


def _floats(option: str, values: Any, count: int | None) -> tuple[float, ...]:
    expected = "at least one number" if count is None else f"{count} numbers"
    if isinstance(values, str):
        raise OptionError(option, values, expected)
    try:
        items = list(values)
    except TypeError:
        raise OptionError(option, values, expected) from None
    if not items or (count is not None and len(items) != count):
        raise OptionError(option, values, expected)
    return tuple(_finite(f"{option}[{index}]", item) for index, item in enumerate(items))


def _require_positive(option: str, value: float) -> None:
    if not value > 0.0:
        raise OptionError(option, value, "a positive number")


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

# ------------------------------------------------------------------------------
# Shapes
# ------------------------------------------------------------------------------

_Vector = tuple[float, float, float]
_Axis = Literal["x", "y", "z"]

# Roll, pitch, yaw that turn the z axis of a URDF cylinder onto the axis named.
_CYLINDER_RPY: Mapping[str, _Vector] = {
    "x": (0.0, _HALF_PI, 0.0),
    "y": (_HALF_PI, 0.0, 0.0),
    "z": (0.0, 0.0, 0.0),
}

_PALETTE: Mapping[str, tuple[float, float, float, float]] = {
    "warm_white": (0.93, 0.91, 0.86, 1.0),
    "graphite": (0.17, 0.18, 0.20, 1.0),
    "steel": (0.55, 0.57, 0.60, 1.0),
    "orange": (0.95, 0.43, 0.10, 1.0),
}


@dataclass(frozen=True)
class _Shape:
    """A primitive in its link's frame.

    Its size [m] is (radius, length) of a cylinder, (x, y, z) of a box, (radius,) of a sphere.
    """

    name: str
    kind: Literal["cylinder", "box", "sphere"]
    center: _Vector
    size: tuple[float, ...]
    axis: _Axis = "z"
    material: str | None = None


def _along(axis: _Axis, start: float, end: float) -> tuple[_Vector, float]:
    """Centre and length of a span of a coordinate axis [m]."""
    middle = (start + end) / 2
    centers: dict[str, _Vector] = {
        "x": (middle, 0.0, 0.0),
        "y": (0.0, middle, 0.0),
        "z": (0.0, 0.0, middle),
    }
    return centers[axis], end - start


def _round(name: str, axis: _Axis, start: float, end: float, radius: float, material: str | None = None) -> _Shape:
    """A cylinder around a coordinate axis, from `start` to `end` on it [m]."""
    center, length = _along(axis, start, end)
    return _Shape(name, "cylinder", center, (radius, length), axis, material)


def _to_four_digits(shapes: Sequence[_Shape]) -> list[_Shape]:
    """The same shapes with short numbers: all but the capsules, whose numbers the planner uses."""
    return [
        replace(
            shape,
            center=cast(_Vector, tuple(_significant(value, 4) for value in shape.center)),
            size=tuple(_significant(value, 4) for value in shape.size),
        )
        for shape in shapes
    ]


def _significant(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


def _capsule(link: str, length: float, radius: float) -> list[_Shape]:
    """The exact capsule around the segment from 0 to `length` on x."""
    return [
        _round(f"{link}_capsule_side", "x", 0.0, length, radius),
        _Shape(f"{link}_capsule_near", "sphere", (0.0, 0.0, 0.0), (radius,)),
        _Shape(f"{link}_capsule_far", "sphere", (length, 0.0, 0.0), (radius,)),
    ]


def _visual_reach(half_width: float) -> float:
    """How far from a link's axis its visuals may go: a little out of the capsule, never 1 cm."""
    return half_width + min(0.008, 0.2 * half_width)


def _drum(link: str, half_width: float) -> _Shape:
    """Housing of a link's own joint, at the origin of the link and along the joint axis."""
    radius = 0.92 * half_width
    half_length = min(0.6 * half_width, math.sqrt(_visual_reach(half_width) ** 2 - radius**2))
    return _round(f"{link}_housing", "y", -half_length, half_length, radius, "graphite")


def _fork(link: str, axis: _Axis, root: float, joint: float, half_width: float) -> list[_Shape]:
    """Two cheeks that carry the next joint's housing between them.

    `axis` is the direction from the body of the link to the joint, `root` and `joint` the places on
    it of the fork's root and of the joint axis [m].
    """
    radius = 0.8 * half_width
    outer = min(0.9 * half_width, math.sqrt(_visual_reach(half_width) ** 2 - radius**2))
    inner = outer - 0.22 * half_width
    (x, _, z), length = _along(axis, root, joint)
    hub, _ = _along(axis, joint, joint)
    shapes = []
    for side, sign in (("left", 1.0), ("right", -1.0)):
        y = sign * (outer + inner) / 2
        width = outer - inner
        # Only as broad as stays within reach at the outer face; the hub is a full disc.
        breadth = 1.1 * half_width if axis == "x" else 1.6 * half_width
        size = (length, width, breadth) if axis == "x" else (breadth, width, length)
        hub_center, cap_center = (
            (hub[0], y, hub[2]),
            (hub[0], sign * (outer + 0.02 * half_width), hub[2]),
        )
        shapes += [
            _Shape(f"{link}_fork_{side}", "box", (x, y, z), size, material="graphite"),
            _Shape(f"{link}_hub_{side}", "cylinder", hub_center, (radius, width), "y", "graphite"),
            _Shape(
                f"{link}_cap_{side}",
                "cylinder",
                cap_center,
                (0.4 * half_width, 0.08 * half_width),
                "y",
                "orange",
            ),
        ]
    return shapes


def _gripper(link: str, length: float, half_width: float, unit: float) -> list[_Shape]:
    """A palm and two fingers around the tool point at (`length`, 0, 0)."""
    w = half_width
    palm, knuckle = length - 4.0 * unit, length - 3.2 * unit
    tip = length + 0.5 * unit
    shapes = [
        _round(f"{link}_palm", "x", palm, knuckle, 0.85 * w, "graphite"),
        _round(f"{link}_ring", "x", palm - 0.3 * unit, palm, 0.7 * w, "orange"),
    ]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        finger, finger_length = _along("x", knuckle, tip)
        pad, pad_length = _along("x", length - 0.9 * unit, tip - 0.1 * unit)
        shapes += [
            _Shape(
                f"{link}_finger_{side}",
                "box",
                (finger[0], sign * 0.68 * w, 0.0),
                (finger_length, 0.2 * w, 0.6 * w),
                material="steel",
            ),
            _Shape(
                f"{link}_pad_{side}",
                "box",
                (pad[0], sign * 0.5 * w, 0.0),
                (pad_length, 0.16 * w, 0.5 * w),
                material="orange",
            ),
        ]
    return shapes


def _arm_visuals(link: str, length: float, half_width: float, next_half_width: float | None) -> list[_Shape]:
    """Housing, tube and collars of an arm link, then the fork for the next joint or the gripper."""
    w = half_width
    unit = min(w, length / 6)  # a stubby link gets its fittings shortened, so that they fit on it
    shapes = [
        _drum(link, w),
        _round(f"{link}_collar", "x", 0.5 * unit, 1.8 * unit, 0.8 * w, "graphite"),
        _round(f"{link}_accent", "x", 1.8 * unit, 2.05 * unit, 0.7 * w, "orange"),
    ]
    if next_half_width is None:
        tube_end = length - 3.8 * unit
        end = _gripper(link, length, w, unit)
    else:
        collar_end = length - min(1.3 * next_half_width, 2.0 * unit)
        tube_end = collar_end - 0.5 * unit
        end = [
            _round(f"{link}_end_collar", "x", collar_end - unit, collar_end, 0.8 * w, "graphite"),
            *_fork(link, "x", tube_end, length, w),
        ]
    tube = _round(f"{link}_tube", "x", 0.0, tube_end, 0.6 * w, "warm_white")
    return [tube, *shapes, *end]


# Where the pedestal ends and where the turret's body ends, as parts of the shoulder height.
_PEDESTAL_TOP = 0.62
_TURRET_TOP = 0.82


def _base_radius(spec: ArmSpec) -> float:
    return min(0.15, 2.8 * spec.link_half_widths[0])


def _base_collisions(spec: ArmSpec) -> list[_Shape]:
    top = _PEDESTAL_TOP * spec.shoulder_height
    return [_round("pedestal", "z", 0.0, top, _base_radius(spec))]


def _turret_collisions(spec: ArmSpec) -> list[_Shape]:
    # It ends at the shoulder axis: above it there is nothing but the first link's own capsule.
    bottom = _PEDESTAL_TOP * spec.shoulder_height
    return [_round("turret_body", "z", bottom, spec.shoulder_height, 0.8 * _base_radius(spec))]


def _base_visuals(spec: ArmSpec) -> list[_Shape]:
    radius, height = _base_radius(spec), spec.shoulder_height
    top = _PEDESTAL_TOP * height
    return [
        _round("pedestal_foot", "z", 0.0, 0.04 * height, radius, "graphite"),
        _round("pedestal_skirt", "z", 0.04 * height, 0.07 * height, 0.82 * radius, "steel"),
        _round("pedestal_column", "z", 0.07 * height, top - 0.05 * height, 0.62 * radius, "warm_white"),
        _round("pedestal_flange", "z", top - 0.05 * height, top, 0.76 * radius, "graphite"),
    ]


def _turret_visuals(spec: ArmSpec) -> list[_Shape]:
    radius, height, w = _base_radius(spec), spec.shoulder_height, spec.link_half_widths[0]
    bottom, top = _PEDESTAL_TOP * height, _TURRET_TOP * height
    return [
        _round("turret_ring", "z", bottom, bottom + 0.015 * height, 0.72 * radius, "orange"),
        _round("turret_body", "z", bottom + 0.015 * height, top, 0.7 * radius, "warm_white"),
        _round("turret_cover", "z", top, top + 0.015 * height, 0.64 * radius, "graphite"),
        *_fork("turret", "z", top, height, w),
    ]


# ------------------------------------------------------------------------------
# yourdfpy objects
# ------------------------------------------------------------------------------


def _transform(xyz: Sequence[float], rpy: Sequence[float] = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
    """Homogeneous (4, 4) matrix of a URDF origin with at most one angle that is not zero."""
    matrix = np.eye(4)
    for axis, angle in enumerate(rpy):
        if angle != 0.0:
            i, j = (axis + 1) % 3, (axis + 2) % 3
            c, s = math.cos(angle), math.sin(angle)
            matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    matrix[:3, 3] = xyz
    return matrix


def _geometry(shape: _Shape) -> Any:
    import yourdfpy

    if shape.kind == "cylinder":
        radius, length = shape.size
        return yourdfpy.Geometry(cylinder=yourdfpy.Cylinder(radius=radius, length=length))
    if shape.kind == "box":
        return yourdfpy.Geometry(box=yourdfpy.Box(size=np.array(shape.size)))
    (radius,) = shape.size
    return yourdfpy.Geometry(sphere=yourdfpy.Sphere(radius=radius))


def _collision(shape: _Shape) -> Any:
    import yourdfpy

    origin = _transform(shape.center, _CYLINDER_RPY[shape.axis])
    return yourdfpy.Collision(name=shape.name, origin=origin, geometry=_geometry(shape))


def _visual(shape: _Shape) -> Any:
    import yourdfpy

    return yourdfpy.Visual(
        name=shape.name,
        origin=_transform(shape.center, _CYLINDER_RPY[shape.axis]),
        geometry=_geometry(shape),
        material=yourdfpy.Material(name=shape.material),
    )


def _cylinder_inertial(mass: float, radius: float, axis: _Axis, start: float, end: float) -> Any:
    """Inertial of a solid cylinder from `start` to `end` on `axis`, about its centre."""
    import yourdfpy

    center, length = _along(axis, start, end)
    # Nine digits hide the noise of binary fractions and nothing that one could weigh.
    spin = _significant(mass * radius**2 / 2, 9)
    tumble = _significant(mass * (3 * radius**2 + length**2) / 12, 9)
    moments = [spin if name == axis else tumble for name in ("x", "y", "z")]
    return yourdfpy.Inertial(origin=_transform(center), mass=mass, inertia=np.diag(moments))


def _base_link(spec: ArmSpec) -> Any:
    import yourdfpy

    top = _PEDESTAL_TOP * spec.shoulder_height
    return yourdfpy.Link(
        name="base_link",
        inertial=_cylinder_inertial(spec.base_mass, _base_radius(spec), "z", 0.0, top),
        visuals=[_visual(shape) for shape in _to_four_digits(_base_visuals(spec))],
        collisions=[_collision(shape) for shape in _to_four_digits(_base_collisions(spec))],
    )


def _turret_link(spec: ArmSpec) -> Any:
    import yourdfpy

    bottom = _PEDESTAL_TOP * spec.shoulder_height
    radius = 0.8 * _base_radius(spec)
    return yourdfpy.Link(
        name="turret",
        inertial=_cylinder_inertial(spec.turret_mass, radius, "z", bottom, spec.shoulder_height),
        visuals=[_visual(shape) for shape in _to_four_digits(_turret_visuals(spec))],
        collisions=[_collision(shape) for shape in _to_four_digits(_turret_collisions(spec))],
    )


def _arm_link(spec: ArmSpec, index: int) -> Any:
    import yourdfpy

    name, length, radius = (
        spec.arm_link_names[index],
        spec.link_lengths[index],
        spec.link_half_widths[index],
    )
    next_radius = spec.link_half_widths[index + 1] if index + 1 < spec.n_links else None
    visuals = _arm_visuals(name, length, radius, next_radius)
    return yourdfpy.Link(
        name=name,
        inertial=_cylinder_inertial(spec.link_masses[index], radius, "x", 0.0, length),
        visuals=[_visual(shape) for shape in _to_four_digits(visuals)],
        collisions=[_collision(shape) for shape in _capsule(name, length, radius)],
    )


def _revolute(spec: ArmSpec, name: str, parent: str, child: str, xyz: _Vector, axis: _Vector) -> Any:
    import yourdfpy

    k = spec.joint_names.index(name)
    return yourdfpy.Joint(
        name=name,
        type="revolute",
        parent=parent,
        child=child,
        origin=_transform(xyz),
        axis=np.array(axis),
        limit=yourdfpy.Limit(
            lower=spec.lower[k],
            upper=spec.upper[k],
            velocity=spec.velocity[k],
            effort=spec.effort[k],
        ),
    )


def _fixed(name: str, parent: str, child: str, xyz: _Vector) -> Any:
    import yourdfpy

    return yourdfpy.Joint(name=name, type="fixed", parent=parent, child=child, origin=_transform(xyz))


def _joints(spec: ArmSpec) -> list[Any]:
    """The joints, one for each link but the root, in chain order."""
    ground = (0.0, 0.0, 0.0)
    # The turret's frame lies in base_link's origin, not on the pedestal: the shoulder height is
    # then written once.
    joints = [
        _revolute(spec, "base_yaw", "base_link", "turret", ground, (0.0, 0.0, 1.0))
        if spec.has_yaw
        else _fixed("turret_mount", "base_link", "turret", ground)
    ]
    parent, xyz = "turret", (0.0, 0.0, spec.shoulder_height)
    for name, child, length in zip(spec.planar_joint_names, spec.arm_link_names, spec.link_lengths, strict=True):
        # About -y, a positive angle lifts the arm in the x-z plane.
        joints.append(_revolute(spec, name, parent, child, xyz, (0.0, -1.0, 0.0)))
        parent, xyz = child, (length, 0.0, 0.0)
    joints.append(_fixed("tool_mount", parent, "tool0", xyz))
    return joints


def build_robot(spec: ArmSpec) -> Any:
    """Build the member of the family as yourdfpy objects.

    Args:
        spec: The arm.

    Returns:
        A `yourdfpy.Robot`.
    """
    import yourdfpy

    links = [
        _base_link(spec),
        _turret_link(spec),
        *(_arm_link(spec, index) for index in range(spec.n_links)),
        yourdfpy.Link(name="tool0"),
    ]
    materials = [
        yourdfpy.Material(name=name, color=yourdfpy.Color(rgba=np.array(rgba))) for name, rgba in _PALETTE.items()
    ]
    return yourdfpy.Robot(name=spec.name, links=links, joints=_joints(spec), materials=materials)


# ------------------------------------------------------------------------------
# Text
# ------------------------------------------------------------------------------

_NAME_ATTRIBUTES = frozenset({"name", "type", "link", "filename"})
_ONE_LINE_TAGS = frozenset({"geometry", "material"})


def urdf_text(spec: ArmSpec) -> str:
    """Text of the member's URDF: what yourdfpy writes, in chain order and laid out to be read.

    Args:
        spec: The arm.

    Returns:
        The URDF, ASCII only; the same spec gives the same text.
    """
    import yourdfpy

    writer = yourdfpy.URDF(robot=build_robot(spec), build_scene_graph=False, load_meshes=False)
    root = ET.fromstring(writer.write_xml_string())
    for element in root.iter():
        _tidy_attributes(element)
    lines = ['<?xml version="1.0"?>', *_header_lines(spec), f"<robot name={quoteattr(spec.name)}>"]
    for title, elements in _sections(spec, root):
        lines += ["", f"  <!-- {title} -->"]
        for element in elements:
            lines += _element_lines(element, 1)
    lines += ["", "</robot>", ""]
    return "\n".join(lines)


def _header_lines(spec: ArmSpec) -> list[str]:
    if spec == HARVESTER:
        names, argument = "HARVESTER, write_robot", "HARVESTER"
    else:
        names, argument = "ArmSpec, write_robot", "spec"
    links = ", ".join(
        f"{name} {length:g} (radius {radius:g})"
        for name, length, radius in zip(spec.arm_link_names, spec.link_lengths, spec.link_half_widths, strict=True)
    )
    count = "1 revolute joint" if spec.n_links == 1 else f"{spec.n_links} revolute joints"
    prose = [
        f"{spec.name}: {'a yaw about the vertical, then ' if spec.has_yaw else ''}{count} in one vertical plane.",
        f"Link lengths and capsule radii [m]: {links}. All links point along +x at zero; positive"
        f" angles lift the arm. The shoulder axis is {spec.shoulder_height:g} m above the ground.",
        "Metres, kilograms, radians. Each arm link collides as an exact capsule: a cylinder and two"
        f" spheres. Acceleration limits, which URDF lacks, are in the {LIMITS_SUFFIX} file beside"
        " this one.",
        "Written by hplan.robot_family with yourdfpy. Do not edit: write it again.",
    ]
    lines = ["<!--"]
    for paragraph in prose:
        lines += textwrap.wrap(paragraph, 98, initial_indent="  ", subsequent_indent="  ")
    lines += ["", f"    from hplan.robot_family import {names}"]
    if spec != HARVESTER:
        lines += textwrap.wrap(
            f"spec = {spec!r}",
            98,
            initial_indent="    ",
            subsequent_indent="        ",
            break_long_words=False,
            break_on_hyphens=False,
        )
    return [*lines, f'    write_robot({argument}, "{spec.name}.urdf")', "-->"]


def _sections(spec: ArmSpec, root: ET.Element) -> Iterator[tuple[str, list[ET.Element]]]:
    """Titles and elements in reading order: palette, base, then each joint with its link."""
    yield "Palette", root.findall("material")
    links = {link.get("name"): link for link in root.findall("link")}
    yield "Pedestal: origin on the ground, z up", [links["base_link"]]
    titles = ["Turret: its frame is base_link's, turned by the yaw" if spec.has_yaw else "Turret"]
    titles += [f"{name}: link {i} of {spec.n_links}" for i, name in enumerate(spec.arm_link_names, start=1)]
    titles.append("Tool point, between the fingers")
    for title, joint, name in zip(titles, root.findall("joint"), spec.link_names[1:], strict=True):
        yield title, [joint, links[name]]


def _tidy_attributes(element: ET.Element) -> None:
    """Write numbers as short as they stay exact, and leave out angles that are all zero."""
    for key, text in element.items():
        if key not in _NAME_ATTRIBUTES:
            element.set(key, " ".join(_shortest(float(word)) for word in text.split()))
    if element.get("rpy") == "0 0 0":
        del element.attrib["rpy"]


def _shortest(value: float) -> str:
    """Shortest text that reads back as the same double, without `.0` or a negative zero."""
    return repr(value + 0.0).removesuffix(".0")


def _element_lines(element: ET.Element, depth: int) -> list[str]:
    indent = "  " * depth
    if len(element) == 0 or element.tag in _ONE_LINE_TAGS:
        return [indent + _inline(element)]
    inner = [line for child in element for line in _element_lines(child, depth + 1)]
    return [f"{indent}<{_opening(element)}>", *inner, f"{indent}</{element.tag}>"]


def _inline(element: ET.Element) -> str:
    if len(element) == 0:
        return f"<{_opening(element)}/>"
    return f"<{_opening(element)}>{''.join(_inline(child) for child in element)}</{element.tag}>"


def _opening(element: ET.Element) -> str:
    return " ".join([element.tag, *(f"{key}={quoteattr(value)}" for key, value in element.items())])


def limits_text(spec: ArmSpec) -> str:
    """Text of the member's limits file: what URDF has no place for.

    Args:
        spec: The arm.

    Returns:
        The YAML document; the same spec gives the same text.
    """
    document: dict[str, Any] = {
        "format": LIMITS_FORMAT,
        "acceleration_rad_s2": dict(zip(spec.joint_names, spec.acceleration, strict=True)),
    }
    if spec.jerk is not None:
        document["jerk_rad_s3"] = dict(zip(spec.joint_names, spec.jerk, strict=True))
    body: str = yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=100)
    return f"# Limits of {spec.name} that URDF cannot hold. Written by hplan.robot_family.\n{body}"


# ------------------------------------------------------------------------------
# Files
# ------------------------------------------------------------------------------


def write_robot(spec: ArmSpec, urdf_path: Path | str) -> tuple[Path, Path]:
    """Write a member of the family: the URDF, and the limits YAML beside it.

    Args:
        spec: The arm.
        urdf_path: Where to write the URDF, in a folder that exists; its suffix is `.urdf`.

    Returns:
        Paths of the URDF and of the limits file (`NAME.urdf` and `NAME.limits.yaml`).

    Raises:
        OptionError: The path does not end in `.urdf`.
        OutputError: A file cannot be written; nothing half-written is left behind then.
    """
    urdf_path = Path(urdf_path)
    if urdf_path.suffix != ".urdf":
        raise OptionError("urdf_path", str(urdf_path), "a file name ending in .urdf")
    limits_path = urdf_path.with_suffix(LIMITS_SUFFIX)
    texts = {limits_path: limits_text(spec), urdf_path: urdf_text(spec)}
    for path in texts:
        # Found out before the first file is in place, or one would be left without the other.
        if path.is_dir():
            raise OutputError(path, "it is a folder")
    for path, text in texts.items():
        write_text(path, text)
    return urdf_path, limits_path


# ------------------------------------------------------------------------------
# Two readers, one robot
# ------------------------------------------------------------------------------


@dataclass(frozen=True)
class CrossCheck:
    """What Pinocchio and yourdfpy make of the same URDF.

    Attributes:
        frames: Names of the link frames that were compared.
        samples: Number of random configurations.
        max_position_deviation: Largest distance between the two placements of a frame [m].
        max_rotation_deviation: Largest angle between them [rad].
        limits_equal: Whether position, velocity and effort limits agree to the last bit.
        masses_equal: Whether the mass that each joint carries, up to the next joint, agrees to
            1e-12 of itself.
    """

    frames: tuple[str, ...]
    samples: int
    max_position_deviation: float
    max_rotation_deviation: float
    limits_equal: bool
    masses_equal: bool


def cross_check(urdf_path: Path | str, samples: int = 100, seed: int = 0) -> CrossCheck:
    """Compare what Pinocchio and yourdfpy read from a URDF.

    Args:
        urdf_path: The file; every movable joint in it is revolute or prismatic.
        samples: Number of random configurations at which all link frames are placed.
        seed: Seed of their generator.

    Returns:
        The deviations found.

    Raises:
        OptionError: `samples` is not positive.
        RobotFileError: The file cannot be read, or has a joint of another kind.
    """
    import yourdfpy

    from hplan.robot import read_models

    if samples < 1:
        raise OptionError("samples", samples, "a positive number")
    path = Path(urdf_path)
    model, _, _ = read_models(path)
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        if joint.nq != 1:
            raise RobotFileError(path, f"joint {name!r} is neither revolute nor prismatic")
    reader = yourdfpy.URDF.load(str(path), build_scene_graph=True, load_meshes=False)
    frames = tuple(link.name for link in reader.robot.links)
    position, rotation = _frame_deviations(model, reader, frames, samples, seed)
    return CrossCheck(
        frames=frames,
        samples=samples,
        max_position_deviation=position,
        max_rotation_deviation=rotation,
        limits_equal=_limits_equal(model, reader),
        masses_equal=_masses_equal(model, reader),
    )


def _frame_deviations(model: Any, reader: Any, frames: Sequence[str], samples: int, seed: int) -> tuple[float, float]:
    """Largest distance [m] and angle [rad] between the two readers' placements."""
    import pinocchio as pin

    data = model.createData()
    names = list(model.names)[1:]
    lower = np.maximum(model.lowerPositionLimit, -math.pi)
    upper = np.minimum(model.upperPositionLimit, math.pi)
    rng = np.random.default_rng(seed)
    position = rotation = 0.0
    for q in rng.uniform(lower, upper, (samples, model.nq)):
        pin.framesForwardKinematics(model, data, q)
        reader.update_cfg({name: float(angle) for name, angle in zip(names, q, strict=True)})
        for frame in frames:
            placement = data.oMf[model.getFrameId(frame, pin.BODY)].homogeneous
            difference = placement - reader.get_transform(frame)
            position = max(position, float(np.linalg.norm(difference[:3, 3])))
            # By the chord between the rotations: acos of the trace loses half the digits near zero.
            chord = float(np.linalg.norm(difference[:3, :3])) / math.sqrt(8.0)
            rotation = max(rotation, 2.0 * math.asin(min(1.0, chord)))
    return position, rotation


def _limits_equal(model: Any, reader: Any) -> bool:
    joints = [reader.joint_map[name] for name in list(model.names)[1:]]
    pairs = [
        (model.lowerPositionLimit, [joint.limit.lower for joint in joints]),
        (model.upperPositionLimit, [joint.limit.upper for joint in joints]),
        (model.velocityLimit, [joint.limit.velocity for joint in joints]),
        (model.effortLimit, [joint.limit.effort for joint in joints]),
    ]
    return all(np.array_equal(np.asarray(ours), np.asarray(theirs)) for ours, theirs in pairs)


def _masses_equal(model: Any, reader: Any) -> bool:
    """Compare joint by joint: Pinocchio fuses a link that is fixed to another with it."""
    movers = {joint.child: joint for joint in reader.robot.joints}
    names = list(model.names)
    totals = [0.0] * len(names)
    for link in reader.robot.links:
        carrier = link.name
        while carrier in movers and movers[carrier].type == "fixed":
            carrier = movers[carrier].parent
        joint = names.index(movers[carrier].name) if carrier in movers else 0
        if link.inertial is not None and link.inertial.mass is not None:
            totals[joint] += link.inertial.mass
    return all(
        math.isclose(inertia.mass, total, rel_tol=1e-12) for inertia, total in zip(model.inertias, totals, strict=True)
    )
