"""The shapes that a member of the robot family is made of: what collides, and what one sees.

What one sees of an arm link stays within 1 cm of the capsule it collides as, so that the picture does not lie about
the check.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from hplan.robot.family.spec import ArmSpec, Gripper

Vector = tuple[float, float, float]
Axis = Literal["x", "y", "z"]

PALETTE: Mapping[str, tuple[float, float, float, float]] = {
    "warm_white": (0.93, 0.91, 0.86, 1.0),
    "graphite": (0.17, 0.18, 0.20, 1.0),
    "steel": (0.55, 0.57, 0.60, 1.0),
    "orange": (0.95, 0.43, 0.10, 1.0),
}


@dataclass(frozen=True)
class Primitive:
    """A primitive shape in its link's frame.

    Its size [m] is (radius, length) of a cylinder, (x, y, z) of a box, (radius,) of a sphere.
    """

    name: str
    kind: Literal["cylinder", "box", "sphere"]
    center: Vector
    size: tuple[float, ...]
    axis: Axis = "z"
    material: str | None = None


def along(axis: Axis, start: float, end: float) -> tuple[Vector, float]:
    """Centre and length of a span of a coordinate axis [m]."""
    middle = (start + end) / 2
    centers: dict[str, Vector] = {"x": (middle, 0.0, 0.0), "y": (0.0, middle, 0.0), "z": (0.0, 0.0, middle)}
    return centers[axis], end - start


def _round(name: str, axis: Axis, start: float, end: float, radius: float, material: str | None = None) -> Primitive:
    """A cylinder around a coordinate axis, from `start` to `end` on it [m]."""
    center, length = along(axis, start, end)
    return Primitive(name, "cylinder", center, (radius, length), axis, material)


def capsule(link: str, length: float, radius: float) -> list[Primitive]:
    """The exact capsule around the segment from 0 to `length` on x."""
    return [
        _round(f"{link}_capsule_side", "x", 0.0, length, radius),
        Primitive(f"{link}_capsule_near", "sphere", (0.0, 0.0, 0.0), (radius,)),
        Primitive(f"{link}_capsule_far", "sphere", (length, 0.0, 0.0), (radius,)),
    ]


def moved(shapes: Sequence[Primitive], x: float, y: float) -> list[Primitive]:
    """Shapes shifted, at their height."""
    return [
        replace(shape, center=(shape.center[0] + x, shape.center[1] + y, shape.center[2])) if x or y else shape
        for shape in shapes
    ]


def _visual_reach(half_width: float) -> float:
    """Largest distance of a link's visuals from its axis: a little out of the capsule, never 1 cm."""
    return half_width + min(0.008, 0.2 * half_width)


def _drum(link: str, half_width: float) -> Primitive:
    """Housing of a link's own joint, at the origin of the link and along the joint axis."""
    radius = 0.92 * half_width
    half_length = min(0.6 * half_width, math.sqrt(_visual_reach(half_width) ** 2 - radius**2))
    return _round(f"{link}_housing", "y", -half_length, half_length, radius, "graphite")


def _fork(link: str, axis: Axis, root: float, joint: float, half_width: float) -> list[Primitive]:
    """Two cheeks that carry the next joint's housing between them.

    `axis` is the direction from the body of the link to the joint, `root` and `joint` the places on
    it of the fork's root and of the joint axis [m].
    """
    radius = 0.8 * half_width
    outer = min(0.9 * half_width, math.sqrt(_visual_reach(half_width) ** 2 - radius**2))
    inner = outer - 0.22 * half_width
    (x, _, z), length = along(axis, root, joint)
    hub, _ = along(axis, joint, joint)
    shapes = []
    for side, sign in (("left", 1.0), ("right", -1.0)):
        y = sign * (outer + inner) / 2
        width = outer - inner
        # Only as broad as stays within reach at the outer face; the hub is a full disc.
        breadth = 1.1 * half_width if axis == "x" else 1.6 * half_width
        size = (length, width, breadth) if axis == "x" else (breadth, width, length)
        hub_center, cap_center = ((hub[0], y, hub[2]), (hub[0], sign * (outer + 0.02 * half_width), hub[2]))
        shapes += [
            Primitive(f"{link}_fork_{side}", "box", (x, y, z), size, material="graphite"),
            Primitive(f"{link}_hub_{side}", "cylinder", hub_center, (radius, width), "y", "graphite"),
            Primitive(
                f"{link}_cap_{side}", "cylinder", cap_center, (0.4 * half_width, 0.08 * half_width), "y", "orange"
            ),
        ]
    return shapes


def _gripper(link: str, length: float, half_width: float, unit: float) -> list[Primitive]:
    """A palm and two fingers around the tool point at (`length`, 0, 0)."""
    w = half_width
    palm, knuckle = length - 4.0 * unit, length - 3.2 * unit
    tip = length + 0.5 * unit
    shapes = [
        _round(f"{link}_palm", "x", palm, knuckle, 0.85 * w, "graphite"),
        _round(f"{link}_ring", "x", palm - 0.3 * unit, palm, 0.7 * w, "orange"),
    ]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        finger, finger_length = along("x", knuckle, tip)
        pad, pad_length = along("x", length - 0.9 * unit, tip - 0.1 * unit)
        shapes += [
            Primitive(
                f"{link}_finger_{side}",
                "box",
                (finger[0], sign * 0.68 * w, 0.0),
                (finger_length, 0.2 * w, 0.6 * w),
                material="steel",
            ),
            Primitive(
                f"{link}_pad_{side}",
                "box",
                (pad[0], sign * 0.5 * w, 0.0),
                (pad_length, 0.16 * w, 0.5 * w),
                material="orange",
            ),
        ]
    return shapes


def gripper_visuals(gripper: Gripper) -> list[Primitive]:
    """Palm and fingers of a gripper, in the frame of `tool0`."""
    unit = min(gripper.length / 4.3, gripper.half_width)
    return _gripper("gripper", 0.0, gripper.half_width, unit)


def gripper_collisions(gripper: Gripper) -> list[Primitive]:
    """The exact capsule of a gripper, in the frame of `tool0`."""
    near = -gripper.length
    return [
        _round("gripper_capsule_side", "x", near, 0.0, gripper.half_width),
        Primitive("gripper_capsule_near", "sphere", (near, 0.0, 0.0), (gripper.half_width,)),
        Primitive("gripper_capsule_far", "sphere", (0.0, 0.0, 0.0), (gripper.half_width,)),
    ]


def arm_visuals(
    link: str, length: float, half_width: float, next_half_width: float | None, *, bare: bool = False
) -> list[Primitive]:
    """Housing, tube and collars of an arm link, then the fork for the next joint or, unless bare, the gripper."""
    w = half_width
    unit = min(w, length / 6)  # a stubby link gets its fittings shortened, so that they fit on it
    shapes = [
        _drum(link, w),
        _round(f"{link}_collar", "x", 0.5 * unit, 1.8 * unit, 0.8 * w, "graphite"),
        _round(f"{link}_accent", "x", 1.8 * unit, 2.05 * unit, 0.7 * w, "orange"),
    ]
    if next_half_width is None and bare:
        tube_end, end = length - 2.0 * unit, []
    elif next_half_width is None:
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
PEDESTAL_TOP = 0.62
_TURRET_TOP = 0.82


def base_radius(spec: ArmSpec) -> float:
    """Radius of the pedestal [m]."""
    return min(0.15, 2.8 * spec.link_half_widths[0])


def base_collisions(spec: ArmSpec) -> list[Primitive]:
    """The pedestal, for collisions."""
    top = PEDESTAL_TOP * spec.shoulder_height
    return [_round("pedestal", "z", 0.0, top, base_radius(spec))]


def turret_collisions(spec: ArmSpec) -> list[Primitive]:
    """The turret's body, for collisions."""
    # It ends at the shoulder axis: above it there is nothing but the first link's own capsule.
    bottom = PEDESTAL_TOP * spec.shoulder_height
    return [_round("turret_body", "z", bottom, spec.shoulder_height, 0.8 * base_radius(spec)), *_axle(spec, None)]


def shoulder_side(spec: ArmSpec) -> float:
    """How far the first link's body lies to the left of the yaw axis [m]."""
    return spec.shoulder_offset + spec.body_offsets[0]


def _axle(spec: ArmSpec, material: str | None) -> list[Primitive]:
    """What carries a shoulder that lies beside the yaw axis."""
    side = shoulder_side(spec)
    if side == 0.0:
        return []
    axle = _round("turret_axle", "y", min(0.0, side), max(0.0, side), 0.8 * spec.link_half_widths[0], material)
    return [replace(axle, center=(0.0, axle.center[1], spec.shoulder_height))]


def base_visuals(spec: ArmSpec) -> list[Primitive]:
    """Foot, skirt, column and flange of the pedestal."""
    radius, height = base_radius(spec), spec.shoulder_height
    top = PEDESTAL_TOP * height
    return [
        _round("pedestal_foot", "z", 0.0, 0.04 * height, radius, "graphite"),
        _round("pedestal_skirt", "z", 0.04 * height, 0.07 * height, 0.82 * radius, "steel"),
        _round("pedestal_column", "z", 0.07 * height, top - 0.05 * height, 0.62 * radius, "warm_white"),
        _round("pedestal_flange", "z", top - 0.05 * height, top, 0.76 * radius, "graphite"),
    ]


def turret_visuals(spec: ArmSpec) -> list[Primitive]:
    """Ring, body and cover of the turret, and the fork for the shoulder."""
    radius, height, w = base_radius(spec), spec.shoulder_height, spec.link_half_widths[0]
    bottom, top = PEDESTAL_TOP * height, _TURRET_TOP * height
    return [
        _round("turret_ring", "z", bottom, bottom + 0.015 * height, 0.72 * radius, "orange"),
        _round("turret_body", "z", bottom + 0.015 * height, top, 0.7 * radius, "warm_white"),
        _round("turret_cover", "z", top, top + 0.015 * height, 0.64 * radius, "graphite"),
        *_axle(spec, "steel"),
        *moved(_fork("turret", "z", top, height, w), 0.0, shoulder_side(spec)),
    ]
