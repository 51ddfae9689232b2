"""Generates URDF and limits file of a family member as text."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import Any, NamedTuple

import yaml

from hplan.robot.family.spec import ArmSpec
from hplan.robot.limits_file import LIMITS_FORMAT

#: Colours of the moving links and of the base.
_COLORS = {"warm_white": "0.93 0.91 0.86 1", "graphite": "0.17 0.18 0.2 1"}

#: Roll, pitch, yaw that turn the z axis of a URDF cylinder onto a coordinate axis.
_TURNED = ((0.0, 0.5 * math.pi, 0.0), (0.5 * math.pi, 0.0, 0.0), (0.0, 0.0, 0.0))


class _Round(NamedTuple):
    """A cylinder, or a capsule if capped, parallel to a coordinate axis.

    It is both the visual and the collision shape.

    Attributes:
        axis: Index of the coordinate axis.
        ends: Start and end along the axis [m].
        radius: Radius [m].
        foot: A point of the centre line [m].
        capped: True if it has spheres at its ends.
    """

    name: str
    axis: int
    ends: tuple[float, float]
    radius: float
    foot: tuple[float, float, float] = (0.0, 0.0, 0.0)
    capped: bool = False

    def point_at(self, along: float) -> list[float]:
        """Point of the centre line at a coordinate along the axis."""
        return [along if k == self.axis else place for k, place in enumerate(self.foot)]

    def add_to(self, link: ET.Element, color: str) -> None:
        """Add its shapes to a link."""
        low, high = self.ends
        length, middle = high - low, 0.5 * (low + high)
        if not self.capped:
            length, middle = _round_to_nine(length), _round_to_nine(middle)
        side = {"radius": _number_text(self.radius), "length": _number_text(length)}
        shapes = [("_side" if self.capped else "", self.point_at(middle), "cylinder", side)]
        if self.capped:
            ball = {"radius": _number_text(self.radius)}
            shapes += [(part, self.point_at(end), "sphere", ball) for part, end in (("_near", low), ("_far", high))]
        for tag in ("visual", "collision"):
            for part, center, kind, size in shapes:
                shape = ET.SubElement(link, tag, name=self.name + part)
                origin = ET.SubElement(shape, "origin", xyz=_number_text(*center))
                if kind == "cylinder" and self.axis < 2:
                    origin.set("rpy", _number_text(*_TURNED[self.axis]))
                ET.SubElement(ET.SubElement(shape, "geometry"), kind, size)
                if tag == "visual":
                    ET.SubElement(shape, "material", name=color)


def urdf_text(spec: ArmSpec) -> str:
    """Text of the member's URDF, in chain order; deterministic."""
    root = ET.Element("robot", name=spec.name)
    words = f" {spec!r}, written by hplan.robot.family: do not edit, generate it again "
    root.append(ET.Comment(words))
    for name, color in _COLORS.items():
        ET.SubElement(ET.SubElement(root, "material", name=name), "color", rgba=color)
    height, radius, (x, y) = spec.shoulder_height, min(0.15, 2.8 * spec.link_half_widths[0]), spec.yaw_axis
    # Top of the pedestal as a fraction of the shoulder height.
    top = _round_to_nine(0.62 * height)
    pedestal = _Round("pedestal", 2, (0.0, top), _round_to_nine(radius), (x, y, 0.0))
    _add_link(root, "base_link", [pedestal], spec.base_mass, "graphite")
    # The turret's body ends at the shoulder axis: only the first link's own capsule extends above it.
    turret = [_Round("turret_body", 2, (top, height), _round_to_nine(0.8 * radius))]
    beside = spec.shoulder_offset + spec.body_offsets[0]
    if beside != 0.0:
        # Axle that carries a shoulder offset from the yaw axis.
        ends, thin = (min(0.0, beside), max(0.0, beside)), 0.8 * spec.link_half_widths[0]
        turret.append(_Round("turret_axle", 1, ends, thin, (0.0, 0.0, height)))
    # The turret's frame is on the ground, not on the pedestal, so that the shoulder height appears only once.
    ground, up = (x, y, 0.0), (0.0, 0.0, 1.0)
    _add_joint(root, spec, "base_yaw" if spec.has_yaw else "turret_mount", "base_link", "turret", ground, up)
    _add_link(root, "turret", turret, spec.turret_mass, "graphite")
    parent, place = "turret", (0.0, spec.shoulder_offset, height)
    for k, (joint, link) in enumerate(zip(spec.planar_joint_names, spec.arm_link_names, strict=True)):
        # About -y, a positive angle lifts the arm in the x-z plane.
        _add_joint(root, spec, joint, parent, link, place, (0.0, -1.0, 0.0))
        ends, foot = (0.0, spec.link_lengths[k]), (0.0, spec.body_offsets[k], 0.0)
        capsule = _Round(f"{link}_capsule", 0, ends, spec.link_half_widths[k], foot, capped=True)
        _add_link(root, link, [capsule], spec.link_masses[k], "warm_white")
        parent, place = link, (spec.link_lengths[k], 0.0, 0.0)
    _add_joint(root, spec, "tool_mount", parent, "tool0", place, up)
    if spec.gripper is None:
        ET.SubElement(root, "link", name="tool0")
    else:
        gripper = _Round("gripper_capsule", 0, (-spec.gripper.length, 0.0), spec.gripper.half_width, capped=True)
        _add_link(root, "tool0", [gripper], spec.gripper.mass, "graphite")
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode").replace(" />", "/>")
    return f'<?xml version="1.0"?>\n{text}\n'


def _add_link(root: ET.Element, name: str, shapes: Sequence[_Round], mass: float, color: str) -> None:
    """Add a link.

    Its mass is distributed as a solid cylinder in the first shape's place.
    """
    link, body = ET.SubElement(root, "link", name=name), shapes[0]
    length, radius = body.ends[1] - body.ends[0], body.radius
    spin, tumble = mass * radius**2 / 2.0, mass * (3.0 * radius**2 + length**2) / 12.0
    moments = dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0")
    for axis, key in enumerate(("ixx", "iyy", "izz")):
        moments[key] = _number_text(_round_to_nine(spin if axis == body.axis else tumble))
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=_number_text(*body.point_at(_round_to_nine(0.5 * sum(body.ends)))))
    ET.SubElement(inertial, "mass", value=_number_text(mass))
    ET.SubElement(inertial, "inertia", moments)
    for shape in shapes:
        shape.add_to(link, color)


def _add_joint(
    root: ET.Element,
    spec: ArmSpec,
    name: str,
    parent: str,
    child: str,
    place: tuple[float, float, float],
    axis: tuple[float, float, float],
) -> None:
    """Add a joint: revolute with limits in the specification, else fixed."""
    moves = name in spec.joint_names
    joint = ET.SubElement(root, "joint", name=name, type="revolute" if moves else "fixed")
    ET.SubElement(joint, "origin", xyz=_number_text(*place))
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    if moves:
        k = spec.joint_names.index(name)
        ET.SubElement(joint, "axis", xyz=_number_text(*axis))
        limits = {key: _number_text(getattr(spec, key)[k]) for key in ("lower", "upper", "velocity", "effort")}
        ET.SubElement(joint, "limit", limits)


def _round_to_nine(value: float) -> float:
    """Round to nine digits, which hides binary rounding noise."""
    return float(f"{value:.9g}")


def _number_text(*values: float) -> str:
    """Shortest exact text of numbers, without `.0` or a negative zero."""
    return " ".join(repr(value + 0.0).removesuffix(".0") for value in values)


def limits_text(spec: ArmSpec) -> str:
    """Text of the member's limits file.

    Returns:
        The YAML document; deterministic.
    """
    document: dict[str, Any] = {
        "format": LIMITS_FORMAT,
        "acceleration_rad_s2": dict(zip(spec.joint_names, spec.acceleration, strict=True)),
    }
    if spec.jerk is not None:
        document["jerk_rad_s3"] = dict(zip(spec.joint_names, spec.jerk, strict=True))
    body: str = yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=100)
    return f"# Limits of {spec.name} that URDF cannot contain. Written by hplan.robot.family.\n{body}"
