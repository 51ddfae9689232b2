"""Which links of a planar arm can touch each other as capsules, and which what carries the arm.

Two parts are left out where their capsules *always* touch: neighbours about their joint, parts that what lies between
holds so near together, and a link and the shape that carries the joint it turns about. Of the last two kinds those are
checked as the URDF has them that then can touch and do not always (`hplan.collision.arm_pairs.shaped_pairs`). Of all
others those are pairs that can touch within the joint limits, beyond these by the tracking error, or come nearer
than the clearance to keep. Where none can, as with the harvester, nothing is checked anywhere.

How two links lie to each other depends on the joints between them alone. The turret turns with the arm plane; seen from
the pedestal, which stands still, links move with the yaw too.

Which links can touch is decided by bisection of the joint ranges: a box of joint angles cannot hold a contact if the
links are farther apart at its middle than its half-widths can move them. Where that takes too long, they can touch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import lru_cache, partial
from typing import Final

import numpy as np

from hplan.base.arrays import FloatArray, frozen
from hplan.base.planar_geometry import convex_hull, polygon_distances
from hplan.robot.base_shapes import (
    TURRET,
    BaseShape,
    always,
    base_shapes,
)
from hplan.robot.model import Robot
from hplan.robot.planar_family import PlanarArm

#: Parts are taken to be able to touch if they come this near [m]: positions are kept to 1e-6 rad, distances to 1e-5 m.
SLACK: Final = 1e-4

#: Corners of the polygon that stands for a circle, drawn around it.
_CORNERS: Final = 32


@dataclass(frozen=True, eq=False)
class SelfContact:
    """The pairs that can touch.

    Attributes:
        links: Pairs (i, j) of links, i < j, that are no neighbours.
        bodies: Shapes of turret and pedestal that links can touch.
    """

    links: tuple[tuple[int, int], ...] = ()
    bodies: tuple[BaseShape, ...] = ()


def self_contact(robot: Robot, *, deviation: float = 0.0, clearance: float = 0.0) -> SelfContact:
    """The pairs of a robot that can touch, decided once.

    Args:
        deviation: How far any joint may be beyond its limits [rad]: the tracking error.
        clearance: Distance that parts have to keep [m]. Parts that are always nearer than that, as a low shoulder is to
            the pedestal, are asked only whether they can touch.
    """
    # So many pairs of tracking error and clearance are kept of a robot.
    most_known = 32
    decide = robot.cached("self_contact", lambda: lru_cache(most_known)(partial(_decided, robot)))
    return decide(rounded_up(deviation), float(clearance))


def _decided(robot: Robot, deviation: float, clearance: float) -> SelfContact:
    arm = replace(robot.arm, lower=robot.arm.lower - deviation, upper=robot.arm.upper + deviation)
    return SelfContact(
        links=_link_pairs(arm, clearance),
        bodies=tuple(_bodies(robot, arm, deviation, clearance)),
    )


def rounded_up(deviation: float) -> float:
    """A tracking error that is no less, one of few: that of a motion depends on how fast it is [rad]."""
    if not deviation < math.tau:
        return math.tau  # a whole turn either way is all that there is
    # Tracking errors are rounded up to multiples of this [rad].
    deviation_step = 5e-3
    return deviation_step * math.ceil(deviation / deviation_step - 1e-9)


def part_of_arm(arm: PlanarArm, first: int, last: int) -> PlanarArm:
    """Links `first` to `last` by themselves; the plane's first axis is the direction of the link before them."""
    part = slice(first, last + 1)
    return PlanarArm(**{field.name: getattr(arm, field.name)[part] for field in fields(arm)})


def radius_in_plane(radius: float, aside: float) -> float:
    """What is left of a radius in a plane at a distance from that of its centre; 0 where it does not reach it [m]."""
    return math.sqrt(max(0.0, radius * radius - aside * aside)) if aside else radius


def held_apart(arm: PlanarArm, i: int, j: int) -> float:
    """The links between two hold the end of one at the beginning of the other: never farther apart than this [m]."""
    aside = float(arm.lateral[j] - arm.lateral[i])
    return math.hypot(float(arm.lengths[i + 1 : j].sum()), aside) - float(arm.half_widths[i] + arm.half_widths[j])


def _link_pairs(arm: PlanarArm, clearance: float) -> tuple[tuple[int, int], ...]:
    pairs = []
    for i in range(arm.link_count):
        before = np.array([[-arm.lengths[i], 0.0], [0.0, 0.0]])  # link i, from where link i + 1 begins
        for j in range(i + 2, arm.link_count):
            radius, aside = float(arm.half_widths[i] + arm.half_widths[j]), float(arm.lateral[j] - arm.lateral[i])
            held = held_apart(arm, i, j)
            reach = radius_in_plane(radius + SLACK + (clearance if held > clearance else 0.0), aside)
            if held > 0.0 and reach > 0.0 and _can_touch(part_of_arm(arm, i + 1, j), before, reach):
                pairs.append((i, j))
    return tuple(pairs)


def _bodies(robot: Robot, arm: PlanarArm, deviation: float, clearance: float) -> list[BaseShape]:
    """Shapes of turret and pedestal that some link can touch."""
    found = []
    normal = np.cross(*robot.plane_axes)
    for shape in base_shapes(robot):
        still_in_plane = not shape.is_round and (shape.carrier == TURRET or not robot.has_yaw)
        core = shape.core if still_in_plane else _swept(shape)
        # Its shadow in the arm plane holds its section there, at every yaw.
        shadow = convex_hull((core - robot.plane_origin) @ robot.plane_axes.T)
        aside = (core - robot.plane_origin) @ normal
        touching: list[int] = []
        for link in range(arm.link_count):
            radius = shape.rounding + float(arm.half_widths[link])
            held = partial(is_held, robot, shape, deviation, link)
            if held(0.0):
                continue  # it carries the shoulder, or the links between are too short to leave it
            reach = SLACK + (0.0 if clearance > 0.0 and held(clearance) else clearance)
            lateral = float(arm.lateral[link])
            off_plane = max(float(aside.min()) - lateral, lateral - float(aside.max()), 0.0)
            if off_plane <= radius + reach and _can_touch(part_of_arm(arm, 0, link), shadow, radius + reach):
                touching.append(link)
        if touching:
            own = frozen(np.unique(core if shape.is_round else shape.core, axis=0))
            found.append(replace(shape, core=own, links=tuple(touching)))
    return found


def is_held(robot: Robot, shape: BaseShape, deviation: float, link: int, clearance: float = 0.0) -> bool:
    """True if a link always touches a shape of the base, or is within the clearance of it, whatever the yaw.

    A link of half-width w begins no farther from the shoulder than the lengths before it, and so always touches what is
    within w less those lengths of the shoulder, as far beside the plane as the link is.
    """
    arm = robot.arm
    level = float(arm.half_widths[link] - arm.lengths[:link].sum()) + clearance
    if level < 0.0:
        return False
    shoulder = robot.plane_origin + arm.lateral[link] * np.cross(*robot.plane_axes)
    if not robot.has_yaw or shape.carrier == TURRET or shape.is_round:
        return shape.distance_from(shoulder) <= level
    (x, y), (ax, ay), z = shoulder[:2] - robot.yaw_axis, robot.yaw_axis, shoulder[2]
    radius = float(np.hypot(x, y))

    def distance(yaw: float) -> float:
        cos, sin = np.cos(yaw), np.sin(yaw)
        return shape.distance_from(np.array([ax + (cos * x - sin * y), ay + (sin * x + cos * y), z]))

    if radius <= 1e-9:
        return distance(0.0) <= level
    return always(distance, robot.lower[0] - deviation, robot.upper[0] + deviation, radius, level)


def _swept(shape: BaseShape) -> FloatArray:
    """Core points of a hull, to be grown by the rounding, that holds what a shape sweeps about the yaw axis."""
    points = shape.core - shape.axis
    # It lies in the hull of the rings that the points sweep.
    profile = np.column_stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]])
    profile = convex_hull(np.vstack([profile, profile * [-1.0, 1.0]]))
    radius, height = profile[profile[:, 0] >= 0.0].T
    angles = (np.arange(_CORNERS) + 0.5) * (2.0 * np.pi / _CORNERS)
    ring = radius / np.cos(np.pi / _CORNERS)
    rings = [np.outer(np.cos(angles), ring), np.outer(np.sin(angles), ring), np.tile(height, (_CORNERS, 1))]
    swept: FloatArray = shape.axis + np.stack(rings, axis=-1).reshape(-1, 3)
    return swept


def _can_touch(arm: PlanarArm, polygon: FloatArray, radius: float) -> bool:
    """True if the axis of the last link can come within a distance of a convex polygon; False is certain."""
    lower, upper = arm.lower[None], arm.upper[None]
    reach = np.cumsum(arm.lengths[::-1])[::-1]  # how far a point of the last link can be from each joint
    # Most boxes of joint angles that are examined together.
    most_boxes = 20_000
    while True:
        half = 0.5 * (upper - lower)
        points = arm.joint_points(lower + half)
        beyond = polygon_distances(points[:, -2], points[:, -1], polygon) - radius
        if (beyond <= 0.0).any():
            return True
        left = beyond <= half @ reach
        if not left.any():
            return False
        if int(left.sum()) > most_boxes:
            return True
        lower, upper, half = lower[left], upper[left], half[left]
        rows, widest = np.arange(len(half)), (half * reach).argmax(axis=1)
        middle = lower[rows, widest] + half[rows, widest]
        below, above = upper.copy(), lower.copy()
        below[rows, widest] = above[rows, widest] = middle
        lower, upper = np.concatenate([lower, above]), np.concatenate([below, upper])
