"""Pairs of parts of the arm in coal, and the bodies of the turret that meet obstacles.

The turret's shapes that are round about the yaw axis, and the pedestal, stand still: they are no part of any motion,
and checked once (`hplan.collision.coal_scene.base_contacts`). So is an obstacle that no point of a turning shape
comes down to: a horizontal plane between the two stays between them, whatever the yaw.

Of a general (non-planar) arm the parts are its collision bodies (`hplan.collision`), each link's by the link's name.
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
from hplan.collision.coal_cloud import distance_from
from hplan.collision.coal_shapes import LinkShapes, link_shapes, urdf_shapes
from hplan.collision.collision_bodies import body_shapes, collision_bodies
from hplan.collision.reach import carriers
from hplan.collision.touching_pairs import BEYOND, SelfPairs, pairs_among, self_pairs
from hplan.errors import RobotFileError
from hplan.robot.base_shapes import (
    BASE_DEPTH,
    GROUND,
    TURRET,
    BaseShape,
    always,
    base_joints,
    base_shapes,
    filled_shape,
    turning_shapes,
)
from hplan.robot.model import Robot, made_once
from hplan.robot.self_contact import SHAPED, SelfContact, held_apart, is_held, self_contact
from hplan.scene.obstacles import Solid

#: Heights that differ by less are the same [m].
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class ArmPair:
    """Two parts of the arm.

    Attributes:
        mover: The link, or `TURRET`.
        other: The body from which the motion is seen: a link before it, `TURRET`, or `GROUND`, with `SHAPED` added
            where both are as the URDF has them; of a general (non-planar) arm, the number of the other body.
    """

    mover: int
    other: int
    mover_name: str
    other_name: str
    shapes: tuple[pin.GeometryObject, pin.GeometryObject]


def link_pairs(robot: Robot, contact: SelfContact, shapes: Sequence[Sequence[pin.GeometryObject]]) -> Iterator[ArmPair]:
    """Links against one another and against pedestal and turret, where they can touch."""
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


@dataclass(frozen=True, eq=False)
class ArmParts:
    """What of an arm meets obstacles, and which parts of it may touch each other.

    Attributes:
        links: The shapes of each link that moves, by its name.
        turret: By body, the shapes of the turret that are not round about the yaw axis, and the same in coal.
        tool_joint: The joint of the shapes that may touch a fruit which is picked, as Pinocchio counts them.
        held: Those of them, the last ones, that are asked as the URDF has them.
        shaped: Shape of the links.
        own_bodies: All pairs of a general (non-planar) arm; None of a planar one.
    """

    links: dict[str, list[pin.GeometryObject]]
    turret: dict[str, tuple[list[BaseShape], list[pin.GeometryObject]]]
    tool_joint: int
    own: Sequence[ArmPair]
    held: SelfPairs
    shaped: LinkShapes
    own_bodies: SelfPairs | None = None


def arm_parts(
    robot: Robot, links: LinkShapes, deviation: float, clearance: float, *, single_joint_pairs: bool = True
) -> ArmParts:
    """The parts of an arm.

    Args:
        links: Shape of the links; of a general (non-planar) arm it is always the URDF's.
        deviation: How far joints may be beyond their limits [rad].
        clearance: Distance to be kept [m].
        single_joint_pairs: Whether those of a planar arm are among them that depend on one joint alone.
    """
    if robot.planar is None:
        shapes, held = body_shapes(robot), own_pairs(robot, deviation)
        by_link = {name: [shapes[body] for body in bodies] for name, bodies in moving_bodies(robot).items()}
        return ArmParts(by_link, {}, robot.tool_joint, body_pairs(robot, held), held, "urdf", held)
    of_links = urdf_shapes(robot) if links == "urdf" else [[shape] for shape in link_shapes(robot, links)]
    contact = self_contact(robot, deviation=deviation, clearance=clearance)
    own = list(link_pairs(robot, contact, of_links))
    turret, held = {}, SelfPairs((), (), np.zeros(0))
    if single_joint_pairs:
        turret, held = turret_shapes(robot), shaped_pairs(robot, deviation)
        own += [*fold_pairs(robot, contact, link_shapes(robot, "capsule")), *turret_pairs(robot, contact)]
        own += _as_shaped(robot, held)
    by_link = dict(zip(robot.arm.link_names, of_links, strict=True))
    return ArmParts(by_link, turret, robot.dof, own, held, links)


def shaped_pairs(robot: Robot, deviation: float) -> SelfPairs:
    """The pairs of a planar arm's bodies that its capsules say nothing of, and that can touch as the URDF has them.

    Those are links that others between hold near together, and links that begin in a shape of turret or pedestal, or
    near it: as capsules they always touch. What of neighbours is near their joint is their own
    (`hplan.robot.folding`).

    Args:
        deviation: How far joints may be beyond their limits [rad].
    """
    beyond = _rounded_up(deviation)
    return robot.cached(("shaped_pairs", beyond), lambda: pairs_among(robot, _held_pairs(robot), beyond))


def _held_pairs(robot: Robot) -> Iterator[tuple[int, int]]:
    """Pairs (i, j), i < j, of bodies that are no neighbours, and whose capsules always touch."""
    arm, bodies = robot.arm, collision_bodies(robot)
    links = range(arm.link_count)
    held = {(shape.number, link) for shape in base_shapes(robot) for link in links if is_held(robot, shape, 0.0, link)}
    for i, j in itertools.combinations(range(len(bodies)), 2):
        inner, outer = sorted((i, j), key=lambda body: bodies[body].joint)
        first, last = (bodies[body].joint - robot.yaw_joints for body in (inner, outer))
        if first < 0 <= last:
            near = (bodies[inner].shape, last) in held
        else:
            near = 0 <= first < last - 1 and held_apart(arm, first, last) <= 0.0
        if near:
            yield i, j


def _as_shaped(robot: Robot, pairs: SelfPairs) -> Iterator[ArmPair]:
    bodies, shapes, names = collision_bodies(robot), body_shapes(robot), robot.arm.link_names
    for pair in pairs.checked:
        inner, outer = sorted(pair, key=lambda body: bodies[body].joint)
        first, last = (bodies[body].joint - robot.yaw_joints for body in (inner, outer))
        other, name = (first, names[first]) if first >= 0 else (GROUND, bodies[inner].name)
        if first < 0 and bodies[inner].joint >= 0:
            other = TURRET
        yield ArmPair(last, SHAPED + other, names[last], name, (shapes[outer], shapes[inner]))


def moving_bodies(robot: Robot) -> dict[str, list[int]]:
    """By link, the numbers of the bodies that joints move.

    Raises:
        RobotFileError: There are none: whatever the motion, a certificate would say nothing.
    """
    found: dict[str, list[int]] = {}
    for number, body in enumerate(collision_bodies(robot)):
        if body.joint >= 0:
            found.setdefault(body.name, []).append(number)
    if not found:
        reason = "no link that moves has a <collision>: it could touch nothing, and a certificate would say nothing"
        raise RobotFileError(robot.urdf_path, reason)
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
    return self_pairs(robot, _rounded_up(deviation))


def _rounded_up(deviation: float) -> float:
    """A deviation that is no less, one of few for which pairs are found."""
    return BEYOND * max(1, math.ceil(deviation / BEYOND - 1e-9))


@made_once
def body_pairs(robot: Robot, pairs: SelfPairs) -> tuple[ArmPair, ...]:
    """Pairs of a robot's bodies, in their order; the one that more joints carry is the moving body. Made once."""
    bodies, shapes, links = collision_bodies(robot), body_shapes(robot), list(moving_bodies(robot))
    found = []
    for pair in pairs.checked:
        still, moved = sorted(pair, key=lambda body: len(carriers(robot, bodies[body].joint)))
        names = bodies[moved].name, bodies[still].name
        found.append(ArmPair(links.index(names[0]), still, *names, (shapes[moved], shapes[still])))
    return tuple(found)


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
