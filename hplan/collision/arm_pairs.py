"""Pairs of parts of the arm in coal, and the bodies of the turret that meet obstacles.

The turret's shapes that are round about the yaw axis, and the pedestal, stand still: they are no part of any motion,
and looked at once (`hplan.collision.coal_scene.base_contacts`). So is an obstacle that no point of a turning shape
comes down to: a horizontal plane between the two stays between them, whatever the yaw.

Of a robot that is no planar arm the parts are its collision bodies (`hplan.bodies`), each link's by the link's name.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arrays import BoolArray
from hplan.bodies.collision_bodies import body_shapes, collision_bodies
from hplan.bodies.reach import carriers
from hplan.bodies.touching_pairs import BEYOND, SelfPairs, self_pairs
from hplan.collision.coal_cloud import distance_from
from hplan.robot.base_shapes import (
    BASE_DEPTH,
    GROUND,
    TURRET,
    BaseShape,
    always,
    base_joints,
    filled_shape,
    turning_shapes,
)
from hplan.robot.model import Robot
from hplan.robot.self_contact import SelfContact
from hplan.scene.obstacles import Solid

#: Heights that differ by less are the same [m].
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class ArmPair:
    """Two parts of the arm.

    Attributes:
        mover: The link, or `TURRET`.
        other: The body from which the motion is seen: a link before it, `TURRET`, or `GROUND`; of a robot that is no
            planar arm, the number of the other body.
        mover_name: Name of its body.
        other_name: Name of the other body.
        shapes: The two shapes.
    """

    mover: int
    other: int
    mover_name: str
    other_name: str
    shapes: tuple[pin.GeometryObject, pin.GeometryObject]


def link_pairs(robot: Robot, contact: SelfContact, shapes: Sequence[Sequence[pin.GeometryObject]]) -> Iterator[ArmPair]:
    """Links against one another and against pedestal and turret, where they can touch.

    Args:
        robot: The arm.
        contact: The pairs that can touch.
        shapes: Shapes of each link.
    """
    names = robot.arm.link_names
    for i, j in contact.links:
        for pair in itertools.product(shapes[j], shapes[i]):
            yield ArmPair(j, i, names[j], names[i], pair)
    for body in contact.bodies:
        placed = _placed(robot, body.shape)
        for link in body.links:
            for shape in shapes[link]:
                yield ArmPair(link, body.carrier, names[link], body.name, (shape, placed))


def fold_pairs(robot: Robot, contact: SelfContact, capsules: Sequence[pin.GeometryObject]) -> Iterator[ArmPair]:
    """Neighbours that can fold into one another: the part of one beyond the joint's own reach, and the whole other one.

    Args:
        robot: The arm.
        contact: The pairs that can touch.
        capsules: Capsule of each link, z from its joint to the next.
    """
    names = robot.arm.link_names
    for fold in contact.folds:
        inner, outer = capsules[fold.inner], capsules[fold.inner + 1]
        for trimmed in fold.trims:
            pair = (_beyond_joint(outer, fold.own_reach, 1.0), inner)
            if trimmed == fold.inner:
                pair = (outer, _beyond_joint(inner, fold.own_reach, -1.0))
            yield ArmPair(fold.inner + 1, fold.inner, names[fold.inner + 1], names[fold.inner], pair)


def turret_pairs(robot: Robot, contact: SelfContact) -> Iterator[ArmPair]:
    """Turning shapes of the turret against those of the pedestal."""
    for shape, other in contact.turret:
        pair = (_placed(robot, shape.number), _placed(robot, other.number))
        yield ArmPair(TURRET, GROUND, shape.name, other.name, pair)


def turret_shapes(robot: Robot) -> dict[str, tuple[list[BaseShape], list[pin.GeometryObject]]]:
    """By body, the shapes of the turret that are not round about the yaw axis, and the same in coal."""
    found: dict[str, tuple[list[BaseShape], list[pin.GeometryObject]]] = {}
    for shape in turning_shapes(robot):
        shapes, placed = found.setdefault(shape.name, ([], []))
        shapes.append(shape)
        placed.append(_placed(robot, shape.number))
    return found


def moving_bodies(robot: Robot) -> dict[str, list[int]]:
    """By link, the numbers of the bodies that joints move."""
    found: dict[str, list[int]] = {}
    for number, body in enumerate(collision_bodies(robot)):
        if body.joint >= 0:
            found.setdefault(body.name, []).append(number)
    return found


def base_bodies(robot: Robot) -> Iterator[tuple[str, pin.GeometryObject]]:
    """Names and shapes of what carries the arm: pedestal and turret; or what no joint moves, meshes in their pieces."""
    if robot.planar is None:
        for body, shape in zip(collision_bodies(robot), body_shapes(robot), strict=True):
            if body.joint < 0:
                yield body.name, shape
        return
    for number, shape in enumerate(robot.collision_model.geometryObjects):
        if shape.parentJoint <= base_joints(robot):
            name = str(robot.model.frames[shape.parentFrame].name)
            yield name, pin.GeometryObject(name, shape.parentJoint, shape.placement, filled_shape(robot, number))


def own_pairs(robot: Robot, deviation: float) -> SelfPairs:
    """The pairs of a robot's bodies where joints are beyond their limits by a deviation at most [rad]."""
    return self_pairs(robot, BEYOND * max(1, math.ceil(deviation / BEYOND - 1e-9)))


def body_pairs(robot: Robot, pairs: SelfPairs) -> tuple[ArmPair, ...]:
    """Pairs of a robot's bodies, in their order; the one that more joints carry is the mover. Made once."""
    return robot.once(("body_pairs", pairs), lambda: tuple(_body_pairs(robot, pairs)))


def _body_pairs(robot: Robot, pairs: SelfPairs) -> Iterator[ArmPair]:
    bodies, shapes, links = collision_bodies(robot), body_shapes(robot), list(moving_bodies(robot))
    for pair in pairs.checked:
        still, moved = sorted(pair, key=lambda body: len(carriers(robot, bodies[body].joint)))
        names = bodies[moved].name, bodies[still].name
        yield ArmPair(links.index(names[0]), still, *names, (shapes[moved], shapes[still]))


def below(robot: Robot, shape: BaseShape, obstacles: Sequence[Solid]) -> BoolArray:
    """(obstacles,) mask of those that a turning shape never comes down to, or stands on.

    Turning about the vertical keeps heights: an obstacle whose top is not above the shape's bottom is never entered.
    One that is, by `BASE_DEPTH` at most, carries the shape where it is within `BASE_DEPTH` of it at every yaw, as the
    ground is; one that the shape only turns over, or into, blocks it.
    """
    tops = np.array([float(obstacle.core[:, 2].max()) + obstacle.rounding for obstacle in obstacles])
    never: BoolArray = tops <= shape.bottom + _ROUNDING
    for number in np.flatnonzero(~never & (tops <= shape.bottom + BASE_DEPTH)).tolist():
        asked = distance_from(obstacles[number])

        def distance(yaw: float, asked: Callable[[coal.CollisionGeometry, pin.SE3], float] = asked) -> float:
            return asked(shape.geometry, shape.placed_at(yaw))

        low, high = float(robot.lower[0]), float(robot.upper[0])
        never[number] = always(distance, low, high, shape.radius, BASE_DEPTH)
    return never


def _placed(robot: Robot, number: int) -> pin.GeometryObject:
    """A shape of pedestal or turret, filled."""
    shape = robot.collision_model.geometryObjects[number]
    return pin.GeometryObject(f"body:{number}", shape.parentJoint, shape.placement, filled_shape(robot, number))


def _beyond_joint(capsule: pin.GeometryObject, reach: float, along: float) -> pin.GeometryObject:
    """The part of a link's capsule farther than `reach` from its joint (`along` 1), or from the next one (-1)."""
    geometry = capsule.geometry
    length = 2.0 * float(geometry.halfLength) - reach
    shifted = capsule.placement * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5 * along * reach]))
    return pin.GeometryObject(
        f"{capsule.name}:beyond:{along:g}", capsule.parentJoint, shifted, coal.Capsule(float(geometry.radius), length)
    )
