"""URDF and limits file of a member of the robot family, as text: built with yourdfpy, laid out to be read.

Import it where it is used: yourdfpy takes its time.
"""

from __future__ import annotations

import math
import textwrap
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, cast
from xml.sax.saxutils import quoteattr

import numpy as np
import yaml
import yourdfpy

from hplan.base.arrays import FloatArray
from hplan.base.data_files import LIMITS_SUFFIX
from hplan.robot.family.shapes import (
    PALETTE,
    PEDESTAL_TOP,
    Axis,
    Primitive,
    Vector,
    along,
    arm_visuals,
    base_collisions,
    base_radius,
    base_visuals,
    capsule,
    gripper_collisions,
    gripper_visuals,
    moved,
    turret_collisions,
    turret_visuals,
)
from hplan.robot.family.spec import HARVESTER, ORCHARD_HARVESTER, ArmSpec
from hplan.robot.files import LIMITS_FORMAT

_HALF_PI = math.pi / 2

# Roll, pitch, yaw that turn the z axis of a URDF cylinder onto the axis named.
_CYLINDER_RPY: Mapping[str, Vector] = {"x": (0.0, _HALF_PI, 0.0), "y": (_HALF_PI, 0.0, 0.0), "z": (0.0, 0.0, 0.0)}


def _transform(xyz: Sequence[float], rpy: Sequence[float] = (0.0, 0.0, 0.0)) -> FloatArray:
    """Homogeneous (4, 4) matrix of a URDF origin with at most one angle that is not zero."""
    matrix = np.eye(4)
    for axis, angle in enumerate(rpy):
        if angle != 0.0:
            i, j = (axis + 1) % 3, (axis + 2) % 3
            c, s = math.cos(angle), math.sin(angle)
            matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    matrix[:3, 3] = xyz
    return matrix


def _to_four_digits(shapes: Sequence[Primitive]) -> list[Primitive]:
    """Shapes with short numbers: all but the capsules, whose numbers the planner uses."""
    return [
        replace(
            shape,
            center=cast(Vector, tuple(_significant(value, 4) for value in shape.center)),
            size=tuple(_significant(value, 4) for value in shape.size),
        )
        for shape in shapes
    ]


def _significant(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


def _geometry(shape: Primitive) -> Any:
    if shape.kind == "cylinder":
        radius, length = shape.size
        return yourdfpy.Geometry(cylinder=yourdfpy.Cylinder(radius=radius, length=length))
    if shape.kind == "box":
        return yourdfpy.Geometry(box=yourdfpy.Box(size=np.array(shape.size)))
    (radius,) = shape.size
    return yourdfpy.Geometry(sphere=yourdfpy.Sphere(radius=radius))


def _collision(shape: Primitive) -> Any:
    return yourdfpy.Collision(name=shape.name, origin=_origin(shape), geometry=_geometry(shape))


def _visual(shape: Primitive) -> Any:
    material = yourdfpy.Material(name=shape.material)
    return yourdfpy.Visual(name=shape.name, origin=_origin(shape), geometry=_geometry(shape), material=material)


def _origin(shape: Primitive) -> FloatArray:
    return _transform(shape.center, _CYLINDER_RPY[shape.axis])


def _cylinder_inertial(
    mass: float, radius: float, axis: Axis, span: tuple[float, float], foot: tuple[float, float] = (0.0, 0.0)
) -> Any:
    """Inertial of a solid cylinder that spans a part of an axis through `foot`, about its centre."""
    (x, y, z), length = along(axis, *span)
    center = (x + foot[0], y + foot[1], z)
    # Nine digits hide the noise of binary fractions and nothing that one could weigh.
    spin = _significant(mass * radius**2 / 2, 9)
    tumble = _significant(mass * (3 * radius**2 + length**2) / 12, 9)
    moments = [spin if name == axis else tumble for name in ("x", "y", "z")]
    return yourdfpy.Inertial(origin=_transform(center), mass=mass, inertia=np.diag(moments))


def _base_link(spec: ArmSpec) -> Any:
    top = PEDESTAL_TOP * spec.shoulder_height
    inertial = _cylinder_inertial(spec.base_mass, base_radius(spec), "z", (0.0, top), spec.yaw_axis)
    # Moved after rounding: the pedestal is to be round about the yaw axis.
    collisions = moved(_to_four_digits(base_collisions(spec)), *spec.yaw_axis)
    return _link("base_link", inertial, moved(base_visuals(spec), *spec.yaw_axis), collisions)


def _turret_link(spec: ArmSpec) -> Any:
    bottom, radius = PEDESTAL_TOP * spec.shoulder_height, 0.8 * base_radius(spec)
    inertial = _cylinder_inertial(spec.turret_mass, radius, "z", (bottom, spec.shoulder_height))
    return _link("turret", inertial, turret_visuals(spec), _to_four_digits(turret_collisions(spec)))


def _arm_link(spec: ArmSpec, index: int) -> Any:
    name, length, radius = spec.arm_link_names[index], spec.link_lengths[index], spec.link_half_widths[index]
    next_radius = spec.link_half_widths[index + 1] if index + 1 < spec.n_links else None
    visuals = arm_visuals(name, length, radius, next_radius, bare=spec.gripper is not None)
    side = (0.0, spec.body_offsets[index])
    inertial = _cylinder_inertial(spec.link_masses[index], radius, "x", (0.0, length), side)
    return _link(name, inertial, moved(visuals, *side), moved(capsule(name, length, radius), *side))


def _link(name: str, inertial: Any, visuals: Sequence[Primitive], collisions: Sequence[Primitive]) -> Any:
    return yourdfpy.Link(
        name=name,
        inertial=inertial,
        visuals=[_visual(shape) for shape in _to_four_digits(visuals)],
        collisions=[_collision(shape) for shape in collisions],
    )


def _tool_link(spec: ArmSpec) -> Any:
    """The tool point, with the gripper that ends there."""
    gripper = spec.gripper
    if gripper is None:
        return yourdfpy.Link(name="tool0")
    inertial = _cylinder_inertial(gripper.mass, gripper.half_width, "x", (-gripper.length, 0.0))
    return _link("tool0", inertial, gripper_visuals(gripper), gripper_collisions(gripper))


def _revolute(spec: ArmSpec, name: str, parent: str, child: str, xyz: Vector, axis: Vector) -> Any:
    k = spec.joint_names.index(name)
    return yourdfpy.Joint(
        name=name,
        type="revolute",
        parent=parent,
        child=child,
        origin=_transform(xyz),
        axis=np.array(axis),
        limit=yourdfpy.Limit(
            lower=spec.lower[k], upper=spec.upper[k], velocity=spec.velocity[k], effort=spec.effort[k]
        ),
    )


def _fixed(name: str, parent: str, child: str, xyz: Vector) -> Any:
    return yourdfpy.Joint(name=name, type="fixed", parent=parent, child=child, origin=_transform(xyz))


def _joints(spec: ArmSpec) -> list[Any]:
    """The joints, one for each link but the root, in chain order."""
    ground = (*spec.yaw_axis, 0.0)
    # The turret's frame lies on the ground, not on the pedestal: the shoulder height is then written once.
    joints = [
        _revolute(spec, "base_yaw", "base_link", "turret", ground, (0.0, 0.0, 1.0))
        if spec.has_yaw
        else _fixed("turret_mount", "base_link", "turret", ground)
    ]
    parent, xyz = "turret", (0.0, spec.shoulder_offset, spec.shoulder_height)
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
    links = [
        _base_link(spec),
        _turret_link(spec),
        *(_arm_link(spec, index) for index in range(spec.n_links)),
        _tool_link(spec),
    ]
    materials = [
        yourdfpy.Material(name=name, color=yourdfpy.Color(rgba=np.array(rgba))) for name, rgba in PALETTE.items()
    ]
    return yourdfpy.Robot(name=spec.name, links=links, joints=_joints(spec), materials=materials)


_NAME_ATTRIBUTES = frozenset({"name", "type", "link", "filename"})
_ONE_LINE_TAGS = frozenset({"geometry", "material"})


def urdf_text(spec: ArmSpec) -> str:
    """Text of the member's URDF: what yourdfpy writes, in chain order and laid out to be read.

    Args:
        spec: The arm.

    Returns:
        The URDF, ASCII only; the same spec gives the same text.
    """
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
    shipped = {HARVESTER: "HARVESTER", ORCHARD_HARVESTER: "ORCHARD_HARVESTER"}
    argument = shipped.get(spec, "spec")
    names = f"{argument if spec in shipped else 'ArmSpec, Gripper' if spec.gripper else 'ArmSpec'}, write_robot"
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
        *_gripper_prose(spec),
        *_offset_prose(spec),
        "Written by hplan.robot.family with yourdfpy. Do not edit: write it again.",
    ]
    lines = ["<!--"]
    for paragraph in prose:
        lines += textwrap.wrap(paragraph, 98, initial_indent="  ", subsequent_indent="  ")
    lines += ["", f"    from hplan.robot.family import {names}"]
    if spec not in shipped:
        lines += textwrap.wrap(
            f"spec = {spec!r}",
            98,
            initial_indent="    ",
            subsequent_indent="        ",
            break_long_words=False,
            break_on_hyphens=False,
        )
    return [*lines, f'    write_robot({argument}, "{spec.name}.urdf")', "-->"]


def _gripper_prose(spec: ArmSpec) -> list[str]:
    """Lines of the header about the gripper."""
    if spec.gripper is None:
        return []
    gripper = spec.gripper
    return [
        f"tool0 carries a gripper: {gripper.mass:g} kg, {gripper.length:g} m long, radius {gripper.half_width:g} m."
    ]


def _offset_prose(spec: ArmSpec) -> list[str]:
    """Lines of the header about what lies aside."""
    prose = []
    if any(spec.yaw_axis):
        prose.append(f"The yaw axis stands at ({spec.yaw_axis[0]:g}, {spec.yaw_axis[1]:g}) m.")
    if spec.shoulder_offset:
        prose.append(f"The arm plane passes the yaw axis at {spec.shoulder_offset:g} m, along y.")
    if spec.link_offsets is not None:
        beside = ", ".join(f"{offset:g}" for offset in spec.link_offsets)
        prose.append(f"The links' bodies lie beside the arm plane, along y: {beside} m.")
    return [" ".join(prose)] if prose else []


def _sections(spec: ArmSpec, root: ET.Element) -> Iterator[tuple[str, list[ET.Element]]]:
    """Titles and elements in reading order: palette, base, then each joint with its link."""
    yield "Palette", root.findall("material")
    links = {link.get("name"): link for link in root.findall("link")}
    yield "Pedestal: origin on the ground, z up", [links["base_link"]]
    titles = ["Turret: its frame is base_link's, turned by the yaw" if spec.has_yaw else "Turret"]
    if any(spec.yaw_axis) and spec.has_yaw:
        titles = ["Turret: its frame stands on the yaw axis"]
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
    return f"# Limits of {spec.name} that URDF cannot hold. Written by hplan.robot.family.\n{body}"
