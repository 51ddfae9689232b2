"""Parts of the arm in coal: what of it meets obstacles, which pairs of its own may touch, and what joints do to them.

Of a planar arm the parts are the capsules of its links, and shapes of turret and pedestal. The turret's shapes that are
round about the yaw axis, and the pedestal, stand still: they are no part of any motion, and checked once
(`hplan.collision.coal_scene.base_contacts`). So is an obstacle that no point of a turning shape comes down to: a
horizontal plane between the two stays between them, whatever the yaw.

**Neighbours of a planar arm** overlap about the joint that they share, and that is their own. What of a link is
farther from it than `_FOLD_REACH` times the distance that their axes have to keep, both half-widths and the clearance,
must keep that distance from the whole of the other link: a link ends in a cap as wide as it is thick, and links that
meet at an angle overlap up to 1 / sin(angle) times their half-widths. So all angles down to 19.5 degrees are left to
the two.

Of a general (non-planar) arm the parts are its collision bodies (`hplan.collision`), each link's by the link's name.
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
from hplan.scene.solids import hull_of

#: Heights that differ by less are the same [m].
_ROUNDING: Final = 1e-9

#: Neighbours may overlap up to this many times the distance that they keep from their joint.
_FOLD_REACH: Final = 3.0

#: Pairs of the same links are one mover where their motion-bound coefficients differ by less than such a factor or so.
_AS_FAR: Final = 1.2

#: So many pairs of its own have a model that all scenes of the arm share: looks at two models take longer.
_MANY: Final = 256


@dataclass(frozen=True, eq=False)
class ArmPair:
    """Two parts of the arm by name, the moving one first, and their shapes.

    Attributes:
        farthest: How far apart they were seen at most [m]; infinite where they may be as far as is asked for.
    """

    mover_name: str
    other_name: str
    shapes: tuple[pin.GeometryObject, pin.GeometryObject]
    farthest: float = math.inf


@dataclass(frozen=True, eq=False)
class ArmParts(Record):
    """What of an arm meets obstacles, and which parts of it may touch each other.

    Attributes:
        links: The shapes of each link that moves, by its name.
        turret: By body, the shapes of the turret that are not round about the yaw axis.
        tool_joint: The joint of the shapes that may touch a fruit which is picked, as Pinocchio counts them.
        own: Pairs of parts.
        exempt: Names of two links of bodies that are not checked against each other, and the reason, each once.
    """

    robot: Robot
    links: dict[str, list[pin.GeometryObject]]
    turret: dict[str, list[BaseShape]]
    tool_joint: int
    own: tuple[ArmPair, ...]
    exempt: tuple[tuple[str, str, str], ...] = ()

    @cached_property
    def mover_names(self) -> tuple[str, ...]:
        """Names of the moving bodies: links, turret; then bodies of one arm's base that meet another arm's base."""
        return tuple(dict.fromkeys([*self.links, *self.turret, *(pair.mover_name for pair in self.own)]))

    @cached_property
    def shapes(self) -> list[pin.GeometryObject]:
        """The shapes that meet obstacles: links, then turret."""
        of_turret = (shape.placed for shape in itertools.chain(*self.turret.values()))
        return [*itertools.chain(*self.links.values()), *of_turret]

    @cached_property
    def all_shapes(self) -> tuple[pin.GeometryObject, ...]:
        """The `shapes`, then all others that are of pairs."""
        return tuple(self._every.values())

    @cached_property
    def bare_shapes(self) -> tuple[BareShape, ...]:
        """`all_shapes` without what is swept about them."""
        return tuple(BareShape.of(shape.geometry) for shape in self.all_shapes)

    @cached_property
    def shape_pairs(self) -> tuple[tuple[pin.GeometryObject, pin.GeometryObject], ...] | ArmPairs:
        """The shapes of the pairs of its own; of many in a model that all scenes share."""
        pairs = tuple(pair.shapes for pair in self.own)
        return ArmPairs(self.shapes, pairs) if len(pairs) >= _MANY else pairs

    @cached_property
    def own_names(self) -> tuple[tuple[str, ...], IntArray]:
        """Names of the parts that another can touch, and (pairs, 2) moving body and part of each pair."""
        movers = {name: number for number, name in enumerate(self.mover_names)}
        names = {name: number for number, name in enumerate(dict.fromkeys(pair.other_name for pair in self.own))}
        numbers = [(movers[pair.mover_name], names[pair.other_name]) for pair in self.own]
        return tuple(names), readonly(np.array(numbers).reshape(-1, 2), np.int64)

    @cached_property
    def farthest(self) -> FloatArray:
        """(pairs,) how far apart the two of each pair were seen at most [m]; infinite as in `ArmPair`."""
        return frozen(np.array([pair.farthest for pair in self.own]))

    @cached_property
    def extents(self) -> tuple[FloatArray, FloatArray]:
        """Of each of the `shapes`, (shapes, 3), and of both of each pair, (pairs, 2, 3), `coal_accuracy.extents`."""
        return extents(self.shapes), extents(itertools.chain(*(pair.shapes for pair in self.own))).reshape(-1, 2, 3)

    @cached_property
    def bodies(self) -> tuple[CollisionBody, ...]:
        """`all_shapes` as bodies."""
        known = dict(zip(map(id, body_shapes(self.robot)), collision_bodies(self.robot), strict=True))
        return tuple(known.get(id(shape)) or _body(shape) for shape in self.all_shapes)

    @property
    def key(self) -> tuple[tuple[int, ...], bytes]:
        """What tells parts from others of the robot whose shapes are made once: these, and which are pairs."""
        return tuple(self._every), self.movers[0].tobytes()

    @cached_property
    def _every(self) -> dict[int, pin.GeometryObject]:
        return {id(shape): shape for shape in (*self.shapes, *itertools.chain(*(pair.shapes for pair in self.own)))}

    @cached_property
    def movers(self) -> tuple[IntArray, FloatArray]:
        """What moves: each of the `shapes`, then each of the pairs as one of the two is seen from the other.

        Returns:
            (movers, 2) bodies, -1 for no second one; (movers, dof) 1 for the joints that move it, else 0.
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
        """How far bodies travel that `movers` are made of: by the joints from one of them outward.

        Returns:
            (bodies, dof) a number for each body and joint from which on that is asked for, -1 for others; (movers, 2)
            those of both bodies of each mover, -1 for one that does not move.
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
        """(movers,) one number for those of `movers` that move alike: pairs of the same two links, about as far out."""
        alone, reaches = len(self.shapes), self.reaches()[1]
        out = np.rint(np.log(on_raster(reaches[alone:].sum(axis=1)) + RASTER) / math.log(_AS_FAR))
        links = self.rows[self.movers[0][alone:], 0]
        _, number = np.unique(np.column_stack([links, out]), axis=0, return_inverse=True)
        return readonly(np.append(np.arange(alone), alone + number.ravel()), np.int64)

    @cached_property
    def rows(self) -> FloatArray:
        """(bodies, 5) joint of each (`dof` for the ground), and centre and radius of a ball that holds its core."""
        found = np.empty((len(self.bodies), 5))
        for row, body in zip(found, self.bodies, strict=True):
            row[1:4], radius = ball_about(body.core)
            row[0], row[4] = body.joint % (self.robot.dof + 1), radius * (1.0 + 1e-12)
            row[4] += 0.0 if body.exact else body.rounding
        return frozen(found)

    def reaches(self, beyond: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Motion-bound coefficients (`hplan.collision.reach`); found once.

        Args:
            beyond: How far joints that slide may be beyond their limits [m].

        Returns:
            (bodies, dof) those of bodies, and (movers, dof) of what moves.
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
    """A shape as a body that holds it."""
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
    """The parts of an arm; the same ones for the same pairs.

    Args:
        links: Shape of the links; of a general (non-planar) arm it is always the URDF's.
        deviation: How far joints may be beyond their limits [rad].
        clearance: Distance to be kept [m].
        single_joint_pairs: Whether those of a planar arm are among them that depend on one joint alone.
    """
    if robot.planar is None:
        return _parts_of_bodies(robot, _beyond(deviation))
    most_known = 32
    decide = robot.cached("arm_parts", lambda: lru_cache(most_known)(partial(_planar_parts, robot)))
    return decide(links, rounded_up(deviation), float(clearance), single_joint_pairs)


@made_once
def _parts_of_bodies(robot: Robot, deviation: float) -> ArmParts:
    """The parts of a general (non-planar) arm."""
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
    """Pairs of links of a planar arm of which not all shapes are checked against each other, with the reason.

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
        reason = "some or all of their shapes always touch, or cannot come within the clearance"
        if frozenset((name, other)) in neighbours:
            reason = "neighbours may overlap near their joint; only the parts beyond it must not touch"
        yield name, other, reason


def _link_pairs(
    robot: Robot, contact: SelfContact, shapes: Sequence[Sequence[pin.GeometryObject]]
) -> Iterator[ArmPair]:
    """Links against one another and against pedestal and turret, where they can touch."""
    names = robot.arm.link_names
    for i, j in contact.links:
        for pair in itertools.product(shapes[j], shapes[i]):
            yield ArmPair(names[j], names[i], pair)
    for body in contact.bodies:
        for link in body.links:
            for shape in shapes[link]:
                yield ArmPair(names[link], body.name, (shape, body.placed))


def _fold_pairs(robot: Robot, deviation: float, clearance: float) -> Iterator[ArmPair]:
    """Neighbours that can fold into one another: of one what the joint's own reach leaves, and the whole other one."""
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
    """Turning shapes of the turret against those of the pedestal, where they can touch as the base turns."""
    for shape, other in itertools.product(turning_shapes(robot), base_shapes(robot)):
        if other.carrier == TURRET or other.is_round:
            continue
        # A horizontal plane between them stays between them.
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
    """The pairs of a planar arm's bodies that its capsules say nothing of, and that can touch as the URDF has them.

    Those are links that others between hold near together, and links that begin in a shape of turret or pedestal, or
    near it: as capsules they always touch. What of neighbours is near their joint is their own.

    Args:
        deviation: How far joints may be beyond their limits [rad].
    """
    beyond = _beyond(deviation)
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
    """Pairs of a robot's bodies, in their order; the one that more joints carry is the moving body."""
    bodies, shapes = collision_bodies(robot), body_shapes(robot)
    for pair, farthest in zip(pairs.checked, pairs.farthest.tolist(), strict=True):
        still, moved = sorted(pair, key=lambda body: len(carriers(robot, bodies[body].joint)))
        yield ArmPair(bodies[moved].name, bodies[still].name, (shapes[moved], shapes[still]), farthest)


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
    """Names and shapes of what carries the arm: pedestal and turret, or what no joint moves; meshes in their pieces."""
    for body, shape in zip(collision_bodies(robot), body_shapes(robot), strict=True):
        if body.joint < base_joints(robot):
            yield body.name, shape


def _beyond(deviation: float) -> float:
    """A deviation that is no less, one of few for which pairs of bodies are found."""
    return BEYOND * max(1, math.ceil(deviation / BEYOND - 1e-9))


def below(robot: Robot, shape: BaseShape, obstacles: Sequence[Solid], growth: FloatArray) -> BoolArray:
    """(obstacles,) mask of those that a turning shape never comes down to, or stands on.

    Turning about the vertical keeps heights: an obstacle whose top, grown by its `growth` [m], is not above the shape's
    bottom is never entered.
    One that is, by `BASE_DEPTH` at most, carries the shape where it is within `BASE_DEPTH` of it at every yaw, as the
    ground is; one that the shape only turns over, or into, blocks it.
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
    """The part of a link's capsule farther than `reach` from its joint (`along` 1), or from the next one (-1)."""
    geometry = capsule.geometry
    length = 2.0 * float(geometry.halfLength) - reach
    shifted = capsule.placement * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5 * along * reach]))
    return pin.GeometryObject(
        f"{capsule.name}:beyond:{along:g}", capsule.parentJoint, shifted, coal.Capsule(float(geometry.radius), length)
    )
