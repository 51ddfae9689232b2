"""Finds the link pairs of a planar arm that can touch.

Links are capsules; pairs with the arm's base are included.

Pairs whose capsules *always* touch are excluded: neighbours about their joint, links held together by the links between
them, and a link and the shape that carries its joint. Pairs of the last two kinds are checked with the URDF's shapes
if these can touch and do not always touch (`hplan.collision.coal_arm.shaped_pairs`). Any other pair is included if it
can touch, or come nearer than the required clearance, within the joint limits widened by the tracking error. If there
is no such pair, as for the harvester, no self-collision check is needed.

The relative pose of two links depends only on the joints between them. The turret turns with the arm plane; relative to
the fixed pedestal, links move with the yaw too.

Bisection of the joint ranges decides which links can touch: a box of joint angles contains no contact if the distance
of the links at its middle exceeds the motion that its half-widths allow. If this takes too long, the links are assumed
to touch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import lru_cache, partial
from typing import Final

import numpy as np

from hplan.base.arrays import FloatArray, frozen
from hplan.geometry.lipschitz import is_always_within
from hplan.geometry.polygon import convex_hull, polygon_distances
from hplan.planar.base_shapes import TURRET, BaseShape, base_shapes
from hplan.planar.family_reader import family_of
from hplan.planar.planar_family import PlanarArm
from hplan.robot.model import Robot

#: Parts within this distance count as able to touch [m]: positions hold to 1e-6 rad, distances to 1e-5 m.
CONTACT_SLACK: Final = 1e-4

#: Number of corners of the polygon circumscribed about a circle.
_CIRCLE_CORNERS: Final = 32


@dataclass(frozen=True, eq=False)
class SelfContact:
    """The pairs that can touch.

    Attributes:
        links: Pairs (i, j) of non-adjacent links, i < j.
        bodies: Shapes of turret and pedestal that links can touch.
    """

    links: tuple[tuple[int, int], ...] = ()
    bodies: tuple[BaseShape, ...] = ()


def self_contact(robot: Robot, *, deviation: float = 0.0, clearance: float = 0.0) -> SelfContact:
    """Pairs of a robot that can touch, cached on the robot.

    Args:
        deviation: Tracking error [rad]; any joint may exceed its limits by this angle.
        clearance: Required distance between parts [m]. Parts that are always nearer, for example a low shoulder and the
            pedestal, are checked only for contact.
    """
    # Maximum number of cached (tracking error, clearance) pairs per robot.
    most_known = 32
    decide = robot.cache("self_contact", lambda: lru_cache(most_known)(partial(_decide_contact, robot)))
    return decide(rounded_up(deviation), float(clearance))


def _decide_contact(robot: Robot, deviation: float, clearance: float) -> SelfContact:
    arm = family_of(robot).arm
    arm = replace(arm, lower=arm.lower - deviation, upper=arm.upper + deviation)
    return SelfContact(
        links=_planar_link_pairs(arm, clearance),
        bodies=tuple(_bodies(robot, arm, deviation, clearance)),
    )


def rounded_up(deviation: float) -> float:
    """Round a tracking error up to one of few values [rad].

    A motion's tracking error depends on its speed; rounding lets the cache be shared between motions.
    """
    if not deviation < math.tau:
        return math.tau  # a whole turn either way covers all angles
    # Tracking errors are rounded up to multiples of this [rad].
    deviation_step = 5e-3
    return deviation_step * math.ceil(deviation / deviation_step - 1e-9)


def part_of_arm(arm: PlanarArm, first: int, last: int) -> PlanarArm:
    """Sub-arm of links `first` to `last`.

    The plane's first axis is the direction of the link before them.
    """
    part = slice(first, last + 1)
    return PlanarArm(**{field.name: getattr(arm, field.name)[part] for field in fields(arm)})


def radius_in_plane(radius: float, aside: float) -> float:
    """Radius of a ball's section by a plane [m].

    `aside` is the distance of the plane from the ball's centre; the radius is 0 if the plane misses the ball.
    """
    return math.sqrt(max(0.0, radius * radius - aside * aside)) if aside else radius


def held_apart(arm: PlanarArm, i: int, j: int) -> float:
    """Upper bound on the gap between two links' capsules [m].

    Those of links i and j.

    The links between the two hold the end of link i near the start of link j.
    """
    aside = float(arm.lateral[j] - arm.lateral[i])
    return math.hypot(float(arm.lengths[i + 1 : j].sum()), aside) - float(arm.half_widths[i] + arm.half_widths[j])


def _planar_link_pairs(arm: PlanarArm, clearance: float) -> tuple[tuple[int, int], ...]:
    pairs = []
    for i in range(arm.link_count):
        before = np.array([[-arm.lengths[i], 0.0], [0.0, 0.0]])  # link i, relative to the start of link i + 1
        for j in range(i + 2, arm.link_count):
            radius, aside = float(arm.half_widths[i] + arm.half_widths[j]), float(arm.lateral[j] - arm.lateral[i])
            held = held_apart(arm, i, j)
            reach = radius_in_plane(radius + CONTACT_SLACK + (clearance if held > clearance else 0.0), aside)
            if held > 0.0 and reach > 0.0 and _can_touch(part_of_arm(arm, i + 1, j), before, reach):
                pairs.append((i, j))
    return tuple(pairs)


def _bodies(robot: Robot, arm: PlanarArm, deviation: float, clearance: float) -> list[BaseShape]:
    """Shapes of turret and pedestal that some link can touch."""
    family = family_of(robot)
    found = []
    normal = np.cross(*family.plane_axes)
    for shape in base_shapes(robot):
        still_in_plane = not shape.is_round and (shape.carrier == TURRET or not family.has_yaw)
        core = shape.core if still_in_plane else _swept(shape)
        # The shape's projection onto the arm plane contains its section at every yaw.
        shadow = convex_hull((core - family.plane_origin) @ family.plane_axes.T)
        aside = (core - family.plane_origin) @ normal
        touching: list[int] = []
        for link in range(arm.link_count):
            radius = shape.rounding + float(arm.half_widths[link])
            held = partial(is_held, robot, shape, deviation, link)
            if held(0.0):
                continue  # the shape carries the shoulder, or the links between are too short to leave it
            reach = CONTACT_SLACK + (0.0 if clearance > 0.0 and held(clearance) else clearance)
            lateral = float(arm.lateral[link])
            off_plane = max(float(aside.min()) - lateral, lateral - float(aside.max()), 0.0)
            if off_plane <= radius + reach and _can_touch(part_of_arm(arm, 0, link), shadow, radius + reach):
                touching.append(link)
        if touching:
            own = frozen(np.unique(core if shape.is_round else shape.core, axis=0))
            found.append(replace(shape, core=own, links=tuple(touching)))
    return found


def is_held(robot: Robot, shape: BaseShape, deviation: float, link: int, clearance: float = 0.0) -> bool:
    """True if a link always violates a base shape's clearance.

    At every yaw.

    A link of half-width w starts at most the sum of the preceding lengths from the shoulder. It therefore always
    touches a shape within w minus that sum of the shoulder, taken at the link's lateral offset from the plane.
    """
    family = family_of(robot)
    arm = family.arm
    level = float(arm.half_widths[link] - arm.lengths[:link].sum()) + clearance
    if level < 0.0:
        return False
    shoulder = family.plane_origin + arm.lateral[link] * np.cross(*family.plane_axes)
    if not family.has_yaw or shape.carrier == TURRET or shape.is_round:
        return shape.distance_from(shoulder) <= level
    (x, y), (ax, ay), z = shoulder[:2] - family.yaw_axis, family.yaw_axis, shoulder[2]
    radius = float(np.hypot(x, y))

    def distance(yaw: float) -> float:
        cos, sin = np.cos(yaw), np.sin(yaw)
        return shape.distance_from(np.array([ax + (cos * x - sin * y), ay + (sin * x + cos * y), z]))

    if radius <= 1e-9:
        return distance(0.0) <= level
    return is_always_within(distance, robot.lower[0] - deviation, robot.upper[0] + deviation, radius, level)


def _swept(shape: BaseShape) -> FloatArray:
    """Core points of a hull around a shape's yaw sweep.

    The hull is grown by the rounding.
    """
    points = shape.core - shape.axis
    # The sweep lies in the hull of the rings that the points sweep.
    profile = np.column_stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]])
    profile = convex_hull(np.vstack([profile, profile * [-1.0, 1.0]]))
    radius, height = profile[profile[:, 0] >= 0.0].T
    angles = (np.arange(_CIRCLE_CORNERS) + 0.5) * (2.0 * np.pi / _CIRCLE_CORNERS)
    ring = radius / np.cos(np.pi / _CIRCLE_CORNERS)
    rings = [np.outer(np.cos(angles), ring), np.outer(np.sin(angles), ring), np.tile(height, (_CIRCLE_CORNERS, 1))]
    swept: FloatArray = shape.axis + np.stack(rings, axis=-1).reshape(-1, 3)
    return swept


def _can_touch(arm: PlanarArm, polygon: FloatArray, radius: float) -> bool:
    """True if the last link can come within `radius` of a polygon.

    The distance is measured from the link's axis to the convex polygon. False is certain.
    """
    lower, upper = arm.lower[None], arm.upper[None]
    reach = np.cumsum(arm.lengths[::-1])[::-1]  # how far a point of the last link can be from each joint
    # Maximum number of boxes of joint angles examined per batch.
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
