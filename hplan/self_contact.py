r"""Where an arm can touch itself: link against link, and links against what carries the arm.

Neighbours meet at their joint and are left out; so is every pair that what lies between holds so near together that it
always touches. Of all others those are pairs that can touch within the joint limits. Where none can, as with the
harvester, nothing is looked at anywhere.

**Links** :math:`i < j`: how they lie to each other depends on the joints :math:`i + 1 \ldots j` alone. Seen from link
:math:`i` a point of link :math:`j` moves no farther than

.. math:: \sum_{m = i + 1}^{j} L_m \, |\Delta \varphi_m - \Delta \varphi_i|,

with :math:`\varphi` the absolute angles in the plane. **The turret** turns with the arm plane: it is as a link
before the first, of angle 0. **The pedestal** stands still; to the motion seen from it comes that of the yaw.

For planning, each convex shape of turret and pedestal is a hull that holds it. Where there is a yaw, the hull holds all
that the shape sweeps about it, so that it is the same at every yaw; judging is done with the shapes themselves.

Which pairs can touch is decided by bisection of the joint ranges: a box of joint angles cannot hold a contact if the
links are farther apart at its middle than its half-widths can move them. Where that takes too long, they can touch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from hplan.arrays import FloatArray, frozen
from hplan.family_reader import outline
from hplan.plane import convex_hull, polygon_distances
from hplan.robot import PlanarArm, Robot

#: What a link can touch that is no link: what turns with the arm plane, and what stands still.
TURRET: Final = -1
GROUND: Final = -2

#: Most boxes of joint angles that are looked at together.
_MOST_BOXES: Final = 20_000

#: Corners of the polygon that stands for a circle, drawn around it.
_CORNERS: Final = 32


@dataclass(frozen=True, eq=False)
class BaseBody:
    """A convex shape of turret or pedestal that some link can touch.

    Attributes:
        name: Name of its body in the URDF.
        shape: Its number among the geometry objects of `Robot.collision_model`.
        carrier: `TURRET` or `GROUND`.
        core: (k, 3) points in `base_link` at any yaw whose hull, grown by `rounding`, holds it [m].
        rounding: Radius about the core [m].
        links: The links that can touch it.
    """

    name: str
    shape: int
    carrier: int
    core: FloatArray
    rounding: float
    links: tuple[int, ...]

    @property
    def loose(self) -> Literal[False]:
        """Never: it is the hull of its core grown by its rounding."""
        return False


@dataclass(frozen=True, eq=False)
class SelfContact:
    """The pairs that can touch.

    Attributes:
        links: Pairs (i, j) of links, i < j.
        bodies: Shapes of turret and pedestal.
    """

    links: tuple[tuple[int, int], ...]
    bodies: tuple[BaseBody, ...]

    @property
    def possible(self) -> bool:
        """Whether any pair can touch."""
        return bool(self.links or self.bodies)


_KNOWN: WeakKeyDictionary[Robot, SelfContact] = WeakKeyDictionary()


def self_contact(robot: Robot) -> SelfContact:
    """The pairs of a robot that can touch within its joint limits, decided once."""
    found = _KNOWN.get(robot)
    if found is None:
        found = _KNOWN[robot] = SelfContact(_link_pairs(robot.arm), tuple(_bodies(robot)))
    return found


def pair_sway(robot: Robot, link: int, other: int, deviation: ArrayLike) -> FloatArray:
    """How much nearer a link may come to another part of the arm when joints are off by `deviation` at most.

    Args:
        robot: The arm.
        link: The link.
        other: A link before it, `TURRET` or `GROUND`.
        deviation: One number for all joints, or (..., dof) [rad].

    Returns:
        (...) distances [m].
    """
    off = np.asarray(deviation, dtype=np.float64)
    off = off if off.ndim else np.full(robot.dof, off)
    after = max(other, TURRET) + 1
    turns = np.cumsum(off[..., robot.arm_slice][..., after : link + 1], axis=-1)
    sway: FloatArray = turns @ robot.arm.lengths[after : link + 1]
    if robot.has_yaw and other == GROUND:
        sway = sway + off[..., 0] * robot.yaw_radius[link]
    return sway


def pair_rates(robot: Robot, link: int, other: int, rates: FloatArray) -> FloatArray:
    """How fast points of a link move at most, seen from another part of the arm.

    Args:
        robot: The arm.
        link: The link.
        other: A link before it, `TURRET` or `GROUND`.
        rates: (pieces, c, dof) joint rates of each piece of a motion; every rate within it lies in the hull of its c.

    Returns:
        (pieces,) speeds, metres in the unit of the rates.
    """
    arm, after = robot.arm, max(other, TURRET) + 1
    turns = np.cumsum(arm.signs * rates[..., robot.arm_slice], axis=2)
    if after > 0:
        turns = turns - turns[..., after - 1 : after]
    speeds: FloatArray = np.abs(turns[..., after : link + 1]).max(axis=1) @ arm.lengths[after : link + 1]
    if robot.has_yaw and other == GROUND:
        speeds = speeds + np.abs(rates[..., 0]).max(axis=1) * robot.yaw_radius[link]
    return speeds


def part_of_arm(arm: PlanarArm, first: int, last: int) -> PlanarArm:
    """Links `first` to `last` by themselves; the plane's first axis is the direction of the link before them."""
    part = slice(first, last + 1)
    return replace(
        arm,
        joint_names=arm.joint_names[part],
        link_names=arm.link_names[part],
        lengths=arm.lengths[part],
        half_widths=arm.half_widths[part],
        signs=arm.signs[part],
        offsets=arm.offsets[part],
        lower=arm.lower[part],
        upper=arm.upper[part],
    )


def _link_pairs(arm: PlanarArm) -> tuple[tuple[int, int], ...]:
    pairs = []
    for i in range(arm.link_count):
        before = np.array([[-arm.lengths[i], 0.0], [0.0, 0.0]])  # link i, from where link i + 1 begins
        for j in range(i + 1, arm.link_count):
            radius = float(arm.half_widths[i] + arm.half_widths[j])
            # What lies between holds them together. That holds for neighbours too.
            if arm.lengths[i + 1 : j].sum() > radius and _can_touch(part_of_arm(arm, i + 1, j), before, radius):
                pairs.append((i, j))
    return tuple(pairs)


def _bodies(robot: Robot) -> list[BaseBody]:
    """Shapes of turret and pedestal that some link can touch; a link's neighbour is what carries its joint."""
    arm, found = robot.arm, []
    for number, shape in enumerate(robot.collision_model.geometryObjects):
        if shape.parentJoint >= (2 if robot.has_yaw else 1):
            continue
        carrier = GROUND if shape.parentJoint == 0 else TURRET
        core, rounding = _hull_points(robot, number)
        # Its shadow in the arm plane holds its section there.
        shadow = convex_hull((core - robot.plane_origin) @ robot.plane_axes.T)
        shoulder = np.zeros((1, 2))
        away = float(polygon_distances(shoulder, shoulder, shadow)[0]) - rounding
        first = 0 if robot.has_yaw and carrier == GROUND else 1
        touching: list[int] = []
        for link in range(first, arm.link_count):
            radius = float(arm.half_widths[link])
            if away + arm.lengths[:link].sum() <= radius:
                touching.clear()
            elif _can_touch(part_of_arm(arm, 0, link), shadow, rounding + radius):
                touching.append(link)
        if touching:
            name = str(robot.model.frames[shape.parentFrame].name)
            found.append(BaseBody(name, number, carrier, core, rounding, tuple(touching)))
    return found


def _hull_points(robot: Robot, number: int) -> tuple[FloatArray, float]:
    """Core points in `base_link`, and the radius about them, of a hull that holds a shape at every yaw."""
    shape = robot.collision_model.geometryObjects[number]
    placement = robot.model.jointPlacements[shape.parentJoint] * shape.placement
    upright = abs(abs(placement.rotation[2, 2]) - 1.0) < 1e-12 and not placement.translation[:2].any()
    points, rounding = outline(shape, rim_from_outside=not (robot.has_yaw and upright))
    points = points @ placement.rotation.T + placement.translation
    if robot.has_yaw:
        # All that it sweeps lies in the hull of the rings that its points sweep.
        profile = np.column_stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]])
        profile = convex_hull(np.vstack([profile, profile * [-1.0, 1.0]]))
        radius, height = profile[profile[:, 0] >= 0.0].T
        angles = (np.arange(_CORNERS) + 0.5) * (2.0 * np.pi / _CORNERS)
        ring = radius / np.cos(np.pi / _CORNERS)
        points = np.stack(
            [np.outer(np.cos(angles), ring), np.outer(np.sin(angles), ring), np.tile(height, (_CORNERS, 1))], axis=-1
        ).reshape(-1, 3)
    return frozen(np.unique(points, axis=0)), float(rounding)


def _can_touch(arm: PlanarArm, polygon: FloatArray, radius: float) -> bool:
    """Whether the axis of the last link can come within a distance of a convex polygon; sure where it says no."""
    lower, upper = arm.lower[None], arm.upper[None]
    reach = np.cumsum(arm.lengths[::-1])[::-1]  # how far a point of the last link can be from each joint
    while True:
        half = 0.5 * (upper - lower)
        points = arm.joint_points(lower + half)
        spare = polygon_distances(points[:, -2], points[:, -1], polygon) - radius
        if (spare <= 0.0).any():
            return True
        left = spare <= half @ reach
        if not left.any():
            return False
        if int(left.sum()) > _MOST_BOXES:
            return True
        lower, upper, half = lower[left], upper[left], half[left]
        rows, widest = np.arange(len(half)), (half * reach).argmax(axis=1)
        middle = lower[rows, widest] + half[rows, widest]
        below, above = upper.copy(), lower.copy()
        below[rows, widest] = above[rows, widest] = middle
        lower, upper = np.concatenate([lower, above]), np.concatenate([below, upper])
