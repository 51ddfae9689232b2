"""Arm shapes in coal, self-collision pairs and their motion-bound coefficients.

The parts of a planar arm are the capsules of its links, and shapes of turret and pedestal. The pedestal, and the
turret's shapes that are round about the yaw axis, are static: they are not part of the motion checks, and are checked
once (`hplan.collision.coal_scene.base_contacts`). The same holds for a turning shape and an obstacle below its lowest
point: a horizontal plane separates the two at every yaw.

**Neighbouring links of a planar arm** overlap around their common joint, which is allowed. The part of a link that is
farther from the joint than `_FOLD_REACH` times the required distance of the links' axes (both half-widths and the
clearance) must keep that distance from the whole other link. The factor is necessary because a link ends in a cap with
the radius of its half-width, and links that meet at an angle overlap up to 1 / sin(angle) times their half-widths. Thus
all angles down to 19.5 degrees are allowed.

The parts of a general (non-planar) arm are its collision bodies (`hplan.collision`), grouped by link name.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Final

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arrays import BoolArray, FloatArray, IntArray, Record, frozen, readonly
from hplan.base.ties import RASTER, on_raster
from hplan.collision.coal_accuracy import extents
from hplan.collision.coal_cloud import BareShape, distance_from
from hplan.collision.coal_shapes import LinkShapes, link_shapes, urdf_shapes
from hplan.collision.collision_bodies import MOST_POINTS, CollisionBody, ball_about, body_shapes, collision_bodies
from hplan.collision.geometry_pairs import ArmPairs
from hplan.collision.reach import carriers, reach_of
from hplan.collision.touching_pairs import BEYOND, RIGID, SelfPairs, one_joint, pairs_among, self_pairs
from hplan.errors import RobotFileError
from hplan.geometry.hull import hull_of
from hplan.robot.base_shapes import (
    BASE_DEPTH,
    TURRET,
    BaseShape,
    always,
    base_joints,
    base_shapes,
    turning_shapes,
)
from hplan.robot.family_reader import outline
from hplan.robot.model import Robot, made_once
from hplan.robot.self_contact import SLACK, SelfContact, held_apart, is_held, rounded_up, self_contact
from hplan.scene.obstacles import Solid

#: Tolerance of equal heights [m].
_ROUNDING: Final = 1e-9

#: Neighbouring links may overlap up to this multiple of their required distance from their joint.
_FOLD_REACH: Final = 3.0

#: Pairs of the same links are grouped if their summed motion-bound coefficients differ by at most about this factor.
_AS_FAR: Final = 1.2

#: From this number of pairs on, the arm's own pairs have a model shared by all scenes. Below it one model is faster,
#: because distance queries on two models take longer.
_MANY: Final = 256


@dataclass(frozen=True, eq=False)
class ArmPair:
    """Two parts of the arm with names and shapes.

    The moving one is first.

    Attributes:
        mover_name: Name of the moving part.
        other_name: Name of the other part.
        shapes: Their shapes, in this order.
        farthest: Maximum sampled distance [m]; infinite if the full clearance is required.
    """

    mover_name: str
    other_name: str
    shapes: tuple[pin.GeometryObject, pin.GeometryObject]
    farthest: float = math.inf


@dataclass(frozen=True, eq=False)
class ArmParts(Record):
    """Shapes of an arm that meet obstacles, and its self-collision pairs.

    Attributes:
        robot: The robot.
        links: Shapes of each moving link, by link name.
        turret: Shapes of the turret that are not round about the yaw axis, by body name.
        tool_joint: Pinocchio's index of the joint whose shapes may touch a picked fruit.
        own: Self-collision pairs that are checked.
        exempt: Names of two links with bodies that are not checked against each other, and the reason; each once.
    """

    robot: Robot
    links: dict[str, list[pin.GeometryObject]]
    turret: dict[str, list[BaseShape]]
    tool_joint: int
    own: tuple[ArmPair, ...]
    exempt: tuple[tuple[str, str, str], ...] = ()

    @cached_property
    def mover_names(self) -> tuple[str, ...]:
        """Names of the moving bodies.

        Links, turret, then base bodies that are paired with another arm.
        """
        return tuple(dict.fromkeys([*self.links, *self.turret, *(pair.mover_name for pair in self.own)]))

    @cached_property
    def shapes(self) -> list[pin.GeometryObject]:
        """Shapes that are checked against obstacles: links, then turret."""
        of_turret = (shape.placed for shape in itertools.chain(*self.turret.values()))
        return [*itertools.chain(*self.links.values()), *of_turret]

    @cached_property
    def all_shapes(self) -> tuple[pin.GeometryObject, ...]:
        """The `shapes`, then all other shapes of the pairs."""
        return tuple(self._every.values())

    @cached_property
    def bare_shapes(self) -> tuple[BareShape, ...]:
        """`all_shapes` without their swept-sphere radii."""
        return tuple(BareShape.of(shape.geometry) for shape in self.all_shapes)

    @cached_property
    def shape_pairs(self) -> tuple[tuple[pin.GeometryObject, pin.GeometryObject], ...] | ArmPairs:
        """Shapes of the self-collision pairs.

        They are in a shared model if they are many.
        """
        pairs = tuple(pair.shapes for pair in self.own)
        return ArmPairs(self.shapes, pairs) if len(pairs) >= _MANY else pairs

    @cached_property
    def own_names(self) -> tuple[tuple[str, ...], IntArray]:
        """Names of the pairs' second parts; (pairs, 2) indices of both."""
        movers = {name: number for number, name in enumerate(self.mover_names)}
        names = {name: number for number, name in enumerate(dict.fromkeys(pair.other_name for pair in self.own))}
        numbers = [(movers[pair.mover_name], names[pair.other_name]) for pair in self.own]
        return tuple(names), readonly(np.array(numbers).reshape(-1, 2), np.int64)

    @cached_property
    def farthest(self) -> FloatArray:
        """(pairs,) maximum sampled distance of each pair [m]; infinite as in `ArmPair`."""
        return frozen(np.array([pair.farthest for pair in self.own]))

    @cached_property
    def extents(self) -> tuple[FloatArray, FloatArray]:
        """Extents of the shapes, (shapes, 3), and pairs, (pairs, 2, 3).

        As returned by `coal_accuracy.extents`.
        """
        return extents(self.shapes), extents(itertools.chain(*(pair.shapes for pair in self.own))).reshape(-1, 2, 3)

    @cached_property
    def bodies(self) -> tuple[CollisionBody, ...]:
        """`all_shapes` as collision bodies."""
        known = dict(zip(map(id, body_shapes(self.robot)), collision_bodies(self.robot), strict=True))
        return tuple(known.get(id(shape)) or _body(shape) for shape in self.all_shapes)

    @property
    def key(self) -> tuple[tuple[int, ...], bytes]:
        """Cache key within one robot: identities of the shapes, and the pairs."""
        return tuple(self._every), self.movers[0].tobytes()

    @cached_property
    def _every(self) -> dict[int, pin.GeometryObject]:
        return {id(shape): shape for shape in (*self.shapes, *itertools.chain(*(pair.shapes for pair in self.own)))}

    @cached_property
    def movers(self) -> tuple[IntArray, FloatArray]:
        """Moving bodies: the `shapes`, then the relative motion of each pair.

        Returns:
            (movers, 2) indices of the bodies, -1 for no second body; (movers, dof) 1 for joints that contribute to the
            (relative) motion, else 0.
        """
        alone, numbers = len(self.shapes), {shape: number for number, shape in enumerate(self._every)}
        both = [(body, -1) for body in range(alone)]
        both += [(numbers[id(first)], numbers[id(second)]) for first, second in (pair.shapes for pair in self.own)]
        counts = np.zeros((len(both), self.robot.dof))
        for row, pair in enumerate(both):
            for body in pair:
                joints = list(carriers(self.robot, self.bodies[body].joint)) if body >= 0 else []
                counts[row, joints] = 1.0 - counts[row, joints]
        return readonly(np.array(both).reshape(-1, 2), np.int64), frozen(counts)

    @cached_property
    def travellers(self) -> tuple[IntArray, IntArray]:
        """Indices of the body travels that compose the `movers`' travel.

        A body travel is the travel of a body due to the joints from a given joint outward.

        Returns:
            (bodies, dof) index of each required travel by body and first joint, -1 if it is not required; (movers, 2)
            indices of the travels of both bodies of each mover, -1 for a body that does not move.
        """
        (both, counts), dof = self.movers, self.robot.dof
        slots, found = np.full((len(self.bodies), dof), -1), np.full(both.shape, -1)
        for mover, pair in enumerate(both.tolist()):
            for side, body in enumerate(pair):
                joints = carriers(self.robot, self.bodies[body].joint) if body >= 0 else ()
                first = min((joint for joint in joints if counts[mover, joint] > 0.0), default=-1)
                if first >= 0:
                    if slots[body, first] < 0:
                        slots[body, first] = slots.max() + 1
                    found[mover, side] = slots[body, first]
        return readonly(slots, np.int64), readonly(found, np.int64)

    @cached_property
    def alike(self) -> IntArray:
        """(movers,) group index of the `movers` with similar motion.

        A group contains pairs of the same two links with similar motion-bound coefficients.
        """
        alone, reaches = len(self.shapes), self.reaches()[1]
        out = np.rint(np.log(on_raster(reaches[alone:].sum(axis=1)) + RASTER) / math.log(_AS_FAR))
        links = self.rows[self.movers[0][alone:], 0]
        _, number = np.unique(np.column_stack([links, out]), axis=0, return_inverse=True)
        return readonly(np.append(np.arange(alone), alone + number.ravel()), np.int64)

    @cached_property
    def rows(self) -> FloatArray:
        """(bodies, 5) joint and bounding ball of each body.

        The joint is `dof` for the ground; then follow centre and radius of the ball [m].

        The ball contains the core, and for a body that is not exact also its rounding.
        """
        found = np.empty((len(self.bodies), 5))
        for row, body in zip(found, self.bodies, strict=True):
            row[1:4], radius = ball_about(body.core)
            row[0], row[4] = body.joint % (self.robot.dof + 1), radius * (1.0 + 1e-12)
            row[4] += 0.0 if body.exact else body.rounding
        return frozen(found)

    def reaches(self, beyond: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Motion-bound coefficients (`hplan.collision.reach`), cached.

        Args:
            beyond: Maximum excess of prismatic joints over their limits [m].

        Returns:
            (bodies, dof) coefficients of the bodies, and (movers, dof) coefficients of the moving bodies.
        """
        if beyond not in self._reaches:
            both, counts = self.movers
            alone = reach_of(self.robot, self.bodies, beyond)
            found = np.vstack([alone, np.zeros(self.robot.dof)])
            self._reaches[beyond] = alone, counts * found[both].sum(axis=1)
        return self._reaches[beyond]

    @cached_property
    def _reaches(self) -> dict[float, tuple[FloatArray, FloatArray]]:
        return {}


def _body(shape: pin.GeometryObject) -> CollisionBody:
    """Collision body that contains a shape."""
    (points, rounding), place = outline(shape, rim_from_outside=True), shape.placement
    exact = len(points) <= MOST_POINTS
    if not exact:
        hull = hull_of(points, most=MOST_POINTS)
        points, rounding = hull.core, rounding + hull.rounding
    core = frozen(points @ place.rotation.T + place.translation)
    return CollisionBody(shape.name, int(shape.parentJoint) - 1, core, rounding, "", exact, 0.0, -1)


def arm_parts(
    robot: Robot, links: LinkShapes, deviation: float, clearance: float, *, single_joint_pairs: bool = True
) -> ArmParts:
    """Parts of an arm; cached, with identical results for identical pairs.

    Args:
        robot: The robot.
        links: Shape of the links; for a general (non-planar) arm it is always the URDF's.
        deviation: Maximum excess of joints over their limits [rad, m].
        clearance: Required clearance [m].
        single_joint_pairs: Whether to include the pairs of a planar arm that depend on one joint alone.
    """
    if robot.planar is None:
        return _parts_of_bodies(robot, _beyond(deviation))
    most_known = 32
    decide = robot.cached("arm_parts", lambda: lru_cache(most_known)(partial(_planar_parts, robot)))
    return decide(links, rounded_up(deviation), float(clearance), single_joint_pairs)


@made_once
def _parts_of_bodies(robot: Robot, deviation: float) -> ArmParts:
    """Parts of a general (non-planar) arm."""
    shapes = body_shapes(robot)
    by_link = {name: [shapes[body] for body in bodies] for name, bodies in moving_bodies(robot).items()}
    pairs, bodies = self_pairs(robot, deviation), collision_bodies(robot)
    exempt = dict.fromkeys((bodies[i].name, bodies[j].name, why) for i, j, why in pairs.allowed if why != RIGID)
    return ArmParts(robot, by_link, {}, robot.tool_joint, tuple(_as_shaped(robot, pairs)), tuple(exempt))


def _planar_parts(robot: Robot, links: LinkShapes, deviation: float, clearance: float, single: bool) -> ArmParts:
    names = robot.arm.link_names
    of_links = urdf_shapes(robot) if links == "urdf" else [[shape] for shape in link_shapes(robot, links)]
    own = list(_link_pairs(robot, self_contact(robot, deviation=deviation, clearance=clearance), of_links))
    turret: dict[str, list[BaseShape]] = {}
    if single:
        for turning in turning_shapes(robot):
            turret.setdefault(turning.name, []).append(turning)
        own += [*_fold_pairs(robot, deviation, clearance), *_turret_pairs(robot, deviation, clearance)]
        own += _as_shaped(robot, shaped_pairs(robot, deviation))
    by_link = dict(zip(names, of_links, strict=True))
    exempt = tuple(_planar_exemptions(robot, by_link, own)) if single else ()
    return ArmParts(robot, by_link, turret, robot.dof, tuple(own), exempt)


def _planar_exemptions(
    robot: Robot, by_link: dict[str, list[pin.GeometryObject]], own: Sequence[ArmPair]
) -> Iterator[tuple[str, str, str]]:
    """Link pairs of a planar arm with unchecked shapes, and the reason.

    A pair is listed even if some of its shapes are checked: the reported clearance claims nothing about such links.
    """
    shapes: dict[str, list[pin.GeometryObject]] = {}
    for shape in base_shapes(robot):
        shapes.setdefault(shape.name, []).append(shape.placed)
    shapes |= by_link
    checked = {frozenset(map(id, pair.shapes)) for pair in own}
    neighbours = {frozenset(pair) for pair in itertools.pairwise(robot.arm.link_names)}
    for (name, some), (other, others) in itertools.combinations(shapes.items(), 2):
        if all(frozenset((id(one), id(two))) in checked for one, two in itertools.product(some, others)):
            continue
        reason = "some or all of their shapes always touch or never come within the clearance"
        if frozenset((name, other)) in neighbours:
            reason = "neighbours may overlap near their joint; only the parts beyond it must not touch"
        yield name, other, reason


def _link_pairs(
    robot: Robot, contact: SelfContact, shapes: Sequence[Sequence[pin.GeometryObject]]
) -> Iterator[ArmPair]:
    """Pairs of links with links, pedestal and turret that can touch."""
    names = robot.arm.link_names
    for i, j in contact.links:
        for pair in itertools.product(shapes[j], shapes[i]):
            yield ArmPair(names[j], names[i], pair)
    for body in contact.bodies:
        for link in body.links:
            for shape in shapes[link]:
                yield ArmPair(names[link], body.name, (shape, body.placed))


def _fold_pairs(robot: Robot, deviation: float, clearance: float) -> Iterator[ArmPair]:
    """Neighbouring links that can fold into each other.

    Each pair is the part of one link beyond the joint's overlap region, and the whole other link.
    """
    arm, capsules = robot.arm, link_shapes(robot, "capsule")
    for inner in range(arm.link_count - 1):
        outer, joint = inner + 1, robot.arm_slice.start + inner + 1
        own_reach = _FOLD_REACH * (float(arm.half_widths[inner] + arm.half_widths[outer]) + clearance)
        for trimmed in (inner, outer):
            if arm.lengths[trimmed] > own_reach:
                pair = (_beyond_joint(capsules[outer], own_reach, 1.0), capsules[inner])
                if trimmed == inner:
                    pair = (capsules[outer], _beyond_joint(capsules[inner], own_reach, -1.0))
                if one_joint(robot, pair, joint, deviation).ever(SLACK + clearance):
                    yield ArmPair(arm.link_names[outer], arm.link_names[inner], pair)


def _turret_pairs(robot: Robot, deviation: float, clearance: float) -> Iterator[ArmPair]:
    """Pairs of turning turret shapes and pedestal shapes that can touch."""
    for shape, other in itertools.product(turning_shapes(robot), base_shapes(robot)):
        if other.carrier == TURRET or other.is_round:
            continue
        # A horizontal plane separates them at every yaw.
        if shape.bottom >= other.top - BASE_DEPTH or other.bottom >= shape.top - BASE_DEPTH:
            continue
        pair = (shape.placed, other.placed)
        turn = one_joint(robot, pair, 0, deviation)
        if turn.always(0.0):
            continue
        held = clearance > 0.0 and turn.always(clearance)
        if turn.ever(SLACK + (0.0 if held else clearance)):
            yield ArmPair(shape.name, other.name, pair)


def shaped_pairs(robot: Robot, deviation: float) -> SelfPairs:
    """Pairs whose capsules always touch, unlike their URDF shapes.

    These are links that the links between them hold close together, and links that start in or near a shape of turret
    or pedestal. Neighbouring links are not included.

    Args:
        robot: The robot.
        deviation: Maximum excess of joints over their limits [rad].
    """
    beyond = _beyond(deviation)
    return robot.cached(("shaped_pairs", beyond), lambda: pairs_among(robot, _held_pairs(robot), beyond))


def _held_pairs(robot: Robot) -> Iterator[tuple[int, int]]:
    """Pairs of non-neighbouring bodies whose capsules always touch.

    They are (i, j) with i < j.
    """
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
    """Checked pairs; the body with more joints below it moves."""
    bodies, shapes = collision_bodies(robot), body_shapes(robot)
    for pair, farthest in zip(pairs.checked, pairs.farthest.tolist(), strict=True):
        still, moved = sorted(pair, key=lambda body: len(carriers(robot, bodies[body].joint)))
        yield ArmPair(bodies[moved].name, bodies[still].name, (shapes[moved], shapes[still]), farthest)


def moving_bodies(robot: Robot) -> dict[str, list[int]]:
    """Indices of the bodies that joints move, by link name.

    Raises:
        RobotFileError: No moving link has a collision shape; a certificate would be void.
    """
    found: dict[str, list[int]] = {}
    for number, body in enumerate(collision_bodies(robot)):
        if body.joint >= 0:
            found.setdefault(body.name, []).append(number)
    if not found:
        reason = (
            "no moving link has a <collision>: the robot could touch nothing, and a certificate would prove nothing"
        )
        raise RobotFileError(robot.urdf_path, reason)
    return found


def base_bodies(robot: Robot) -> Iterator[tuple[str, pin.GeometryObject]]:
    """Names and shapes of the base.

    The base is pedestal and turret, or the bodies that no joint moves. Meshes are decomposed into their convex pieces.
    """
    for body, shape in zip(collision_bodies(robot), body_shapes(robot), strict=True):
        if body.joint < base_joints(robot):
            yield body.name, shape


def _beyond(deviation: float) -> float:
    """Deviation rounded up to a multiple of `BEYOND`, to limit recomputation."""
    return BEYOND * max(1, math.ceil(deviation / BEYOND - 1e-9))


def below(robot: Robot, shape: BaseShape, obstacles: Sequence[Solid], growth: FloatArray) -> BoolArray:
    """(obstacles,) mask of obstacles below a turning shape, or supporting it.

    Heights are constant under a rotation about the vertical: an obstacle whose top, grown by its `growth` [m], is not
    above the bottom of the shape is never penetrated. An obstacle whose top is higher by at most `BASE_DEPTH` supports
    the shape if it is within `BASE_DEPTH` of the shape at every yaw, like the ground. If the shape only turns over or
    into the obstacle, the obstacle blocks it.
    """
    tops = np.array([float(obstacle.core[:, 2].max()) + obstacle.rounding for obstacle in obstacles])
    never: BoolArray = tops + growth <= shape.bottom + _ROUNDING
    for number in np.flatnonzero(~never & (tops <= shape.bottom + BASE_DEPTH)).tolist():
        asked = distance_from(obstacles[number])

        def distance(yaw: float, asked: Callable[[coal.CollisionGeometry, pin.SE3], float] = asked) -> float:
            return asked(shape.placed.geometry, shape.placed_at(yaw))

        low, high = float(robot.lower[0]), float(robot.upper[0])
        never[number] = always(distance, low, high, shape.radius, BASE_DEPTH)
    return never


def _beyond_joint(capsule: pin.GeometryObject, reach: float, along: float) -> pin.GeometryObject:
    """Part of a link's capsule beyond distance `reach` from a joint [m].

    The joint is the link's own (`along` = 1) or the next one (`along` = -1).
    """
    geometry = capsule.geometry
    length = 2.0 * float(geometry.halfLength) - reach
    shifted = capsule.placement * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5 * along * reach]))
    return pin.GeometryObject(
        f"{capsule.name}:beyond:{along:g}", capsule.parentJoint, shifted, coal.Capsule(float(geometry.radius), length)
    )
