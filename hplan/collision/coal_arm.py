"""Arm shapes in coal, self-collision pairs and their motion-bound coefficients.

The parts of an arm are its collision bodies (`hplan.collision.collision_bodies`), grouped by link name, and the parts
of neighbouring links that must not fold into each other (`hplan.collision.self_folds`). Bodies that no joint moves, and
shapes that are round about the axis of the only joint that carries them, are the base: they are not part of the motion
checks, and are checked once (`hplan.collision.coal_scene.base_contacts`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Final, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arrays import BoolArray, FloatArray, IntArray, Record, frozen, readonly
from hplan.base.ties import RASTER, on_raster
from hplan.collision.coal_accuracy import extents
from hplan.collision.coal_cloud import BareShape, distance_from
from hplan.collision.coal_pairs import ArmPairs
from hplan.collision.collision_bodies import CollisionBody, ball_about, body_shapes, collision_bodies
from hplan.collision.motion_coefficients import carriers, is_moved, joint_axis, joints_between, reach_of
from hplan.collision.self_folds import Fold, folds
from hplan.collision.self_pairs import BEYOND, RIGID, SelfPairs, self_pairs
from hplan.errors import RobotFileError
from hplan.geometry.lipschitz import is_always_within
from hplan.robot.model import Robot, made_once
from hplan.scene.obstacles import Solid

#: Permitted penetration between a body and the body that carries it [m].
BASE_DEPTH: Final = 1e-3

#: Remark on a pair of neighbours whose parts are checked.
_PARTS: Final = "their parts beyond the joint must not touch"

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
        bodies: Their collision bodies, in this order.
        farthest: Maximum sampled distance [m]; infinite if the full clearance is required.
    """

    mover_name: str
    other_name: str
    shapes: tuple[pin.GeometryObject, pin.GeometryObject]
    bodies: tuple[CollisionBody, CollisionBody]
    farthest: float = math.inf


@dataclass(frozen=True, eq=False)
class ArmParts(Record):
    """Shapes of an arm that meet obstacles, and its self-collision pairs.

    Attributes:
        robot: The robot.
        links: Shapes of each moving link, by link name.
        own: Self-collision pairs that are checked.
        exempt: Names of two links with bodies that are not checked against each other, and the reason; each once.
    """

    robot: Robot
    links: dict[str, list[pin.GeometryObject]]
    own: tuple[ArmPair, ...]
    exempt: tuple[tuple[str, str, str], ...] = ()

    @cached_property
    def mover_names(self) -> tuple[str, ...]:
        """Names of the moving bodies: links, then base bodies paired with another arm."""
        return tuple(dict.fromkeys([*self.links, *(pair.mover_name for pair in self.own)]))

    @cached_property
    def shapes(self) -> list[pin.GeometryObject]:
        """Shapes that are checked against obstacles."""
        return [*itertools.chain(*self.links.values())]

    @cached_property
    def all_shapes(self) -> tuple[pin.GeometryObject, ...]:
        """The `shapes`, then all other shapes of the pairs."""
        return tuple(self._all_objects.values())

    @cached_property
    def bare_shapes(self) -> tuple[BareShape, ...]:
        """`all_shapes` without their swept-sphere radii."""
        return tuple(BareShape.strip(shape.geometry) for shape in self.all_shapes)

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
    def maximum_distance(self) -> FloatArray:
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
        known |= {id(shape): body for pair in self.own for shape, body in zip(pair.shapes, pair.bodies, strict=True)}
        return tuple(known[id(shape)] for shape in self.all_shapes)

    @property
    def key(self) -> tuple[tuple[int, ...], bytes]:
        """Cache key within one robot: identities of the shapes, and the pairs."""
        return tuple(self._all_objects), self.movers[0].tobytes()

    @cached_property
    def _all_objects(self) -> dict[int, pin.GeometryObject]:
        return {id(shape): shape for shape in (*self.shapes, *itertools.chain(*(pair.shapes for pair in self.own)))}

    @cached_property
    def movers(self) -> tuple[IntArray, FloatArray]:
        """Moving bodies: the `shapes`, then the relative motion of each pair.

        Returns:
            (movers, 2) indices of the bodies, -1 for no second body; (movers, dof) 1 for joints that contribute to the
            (relative) motion, else 0.
        """
        alone, numbers = len(self.shapes), {shape: number for number, shape in enumerate(self._all_objects)}
        both = [(body, -1) for body in range(alone)]
        both += [(numbers[id(first)], numbers[id(second)]) for first, second in (pair.shapes for pair in self.own)]
        counts = np.zeros((len(both), self.robot.dof))
        for row, (one, other) in enumerate(both):
            joints = carriers(self.robot, self.bodies[one].joint)
            if other >= 0:
                joints = joints_between(self.robot, self.bodies[one], self.bodies[other])
            counts[row, list(joints)] = 1.0
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
    def motion_groups(self) -> IntArray:
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
        """Motion-bound coefficients (`hplan.collision.motion_coefficients`), cached.

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

    def deviated_reaches(self, deviations: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`reaches` for joints that deviate by at most (..., dof) [rad, m].

        For prismatic joints the maximum deviation is rounded up to a power of two, so that few distinct values occur.
        """
        largest = float(deviations.max(initial=0.0)) if any(self.robot.slides) else 0.0
        return self.reaches(2.0 ** math.ceil(math.log2(max(largest, 1e-3))) if largest > 0.0 else 0.0)

    @cached_property
    def _reaches(self) -> dict[float, tuple[FloatArray, FloatArray]]:
        return {}


def arm_parts(robot: Robot, deviation: float, clearance: float) -> ArmParts:
    """Parts of an arm; cached, with identical results for identical pairs.

    Args:
        robot: The robot.
        deviation: Maximum excess of joints over their limits [rad, m].
        clearance: Required clearance [m].
    """
    most_known = 32
    decide = robot.cache("arm_parts", lambda: lru_cache(most_known)(partial(_parts, robot)))
    return decide(_round_up_deviation(deviation), folds(robot, deviation, clearance))


def _parts(robot: Robot, deviation: float, parts: tuple[Fold, ...]) -> ArmParts:
    shapes = body_shapes(robot)
    by_link = {name: [shapes[body] for body in bodies] for name, bodies in moving_bodies(robot).items()}
    pairs, bodies = self_pairs(robot, deviation), collision_bodies(robot)
    beyond = {frozenset((part.whole, part.other)) for part in parts}
    exempt = dict.fromkeys(
        (bodies[i].name, bodies[j].name, f"{why}; {_PARTS}" if {i, j} in beyond else why)
        for i, j, why in pairs.allowed
        if why != RIGID
    )
    return ArmParts(robot, by_link, tuple(_iterate_pairs(robot, pairs, parts)), tuple(exempt))


def _iterate_pairs(robot: Robot, pairs: SelfPairs, parts: Sequence[Fold]) -> Iterator[ArmPair]:
    """Checked pairs, those of parts of neighbours last; the body with more joints below it moves."""
    whole = list(zip(collision_bodies(robot), body_shapes(robot), strict=True))
    both = [(whole[i], whole[j]) for i, j in pairs.checked]
    both += [((part.body, part.shape), whole[part.other]) for part in parts]
    farthest = [*pairs.farthest.tolist(), *(part.farthest for part in parts)]
    for pair, apart in zip(both, farthest, strict=True):
        still, moved = sorted(pair, key=lambda each: len(carriers(robot, each[0].joint)))
        yield ArmPair(moved[0].name, still[0].name, (moved[1], still[1]), (moved[0], still[0]), apart)


def moving_bodies(robot: Robot) -> dict[str, list[int]]:
    """Indices of the bodies that joints move, by link name.

    Raises:
        RobotFileError: No moving link has a collision shape; a certificate would be void.
    """
    found: dict[str, list[int]] = {}
    for number, body in enumerate(collision_bodies(robot)):
        if is_moved(robot)[number]:
            found.setdefault(body.name, []).append(number)
    if not found:
        reason = (
            "no moving link has a <collision>: the robot could touch nothing, and a certificate would prove nothing"
        )
        raise RobotFileError(robot.urdf_path, reason)
    return found


class BaseBody(NamedTuple):
    """A body that no joint moves, in `base_link`.

    Attributes:
        body: The body.
        shape: Its shape in coal.
        place: Pose of the shape.
        centre: (3,) centre of a bounding ball [m].
        radius: Radius of that ball [m].
    """

    body: CollisionBody
    shape: pin.GeometryObject
    place: pin.SE3
    centre: FloatArray
    radius: float


@made_once
def base_bodies(robot: Robot) -> tuple[BaseBody, ...]:
    """The bodies that no joint moves (`hplan.collision.motion_coefficients.is_moved`)."""
    data, found = robot.model.createData(), list[BaseBody]()
    pin.forwardKinematics(robot.model, data, pin.neutral(robot.model))
    for body, shape, moved in zip(collision_bodies(robot), body_shapes(robot), is_moved(robot).tolist(), strict=True):
        if not moved:
            place, (centre, radius) = data.oMi[shape.parentJoint], ball_about(body.core)
            centre = place.rotation @ centre + place.translation
            found.append(BaseBody(body, shape, place * shape.placement, centre, radius + body.rounding))
    return tuple(found)


def base_radius(robot: Robot) -> float:
    """Radius of a ball about the origin of `base_link` that contains the base [m]."""
    return max((float(np.linalg.norm(body.centre)) + body.radius for body in base_bodies(robot)), default=0.0)


def _round_up_deviation(deviation: float) -> float:
    """Deviation rounded up to a multiple of `BEYOND`, to limit recomputation."""
    return BEYOND * max(1, math.ceil(deviation / BEYOND - 1e-9))


def supports(robot: Robot, obstacles: Sequence[Solid]) -> BoolArray:
    """(bodies, obstacles) mask of static obstacles that support a body, as the ground supports a turntable.

    The body turns about one joint alone. Its extent along the joint's axis is constant, and no obstacle that supports
    it overlaps that extent by more than `BASE_DEPTH`. The obstacle is within `BASE_DEPTH` of the body at every value of
    the joint: if the body only turns over or into it, the obstacle blocks it.
    """
    bodies = collision_bodies(robot)
    found = np.zeros((len(bodies), len(obstacles)), dtype=np.bool_)
    if len(obstacles):
        for number in _turning_bodies(robot):
            found[number] = _supports(robot, bodies[number], body_shapes(robot)[number], obstacles)
    return found


@made_once
def _turning_bodies(robot: Robot) -> tuple[int, ...]:
    """Indices of the bodies that one joint turns, and no other moves."""
    joints = {number: collision_bodies(robot)[number].joint for number in np.flatnonzero(is_moved(robot)).tolist()}
    return tuple(
        number for number, joint in joints.items() if len(carriers(robot, joint)) == 1 and not robot.slides[joint]
    )


def _supports(robot: Robot, body: CollisionBody, shape: pin.GeometryObject, obstacles: Sequence[Solid]) -> BoolArray:
    """(obstacles,) mask of the obstacles that support a body on the first joint."""
    place, (axis, _) = robot.model.jointPlacements[body.joint + 1], joint_axis(robot, body.joint)
    heights = body.core @ axis
    low, high = float(heights.min()) - body.rounding, float(heights.max()) + body.rounding
    turned, foot = place.rotation @ axis, float(place.translation @ place.rotation @ axis)
    ends = [(solid.core @ turned - foot, solid.rounding) for solid in obstacles]
    below = np.array([float(along.max()) + rounding for along, rounding in ends]) <= low + BASE_DEPTH
    above = np.array([float(along.min()) - rounding for along, rounding in ends]) >= high - BASE_DEPTH
    rate = float(np.linalg.norm(body.core - np.outer(heights, axis), axis=1).max()) + body.rounding
    # A ball that contains the body at every value of the joint.
    centre, radius = place.translation + 0.5 * (low + high) * turned, math.hypot(rate, 0.5 * (high - low))
    found = np.zeros(len(obstacles), dtype=np.bool_)
    for number in np.flatnonzero(below | above).tolist():
        solid = obstacles[number]
        nearest = np.clip(centre, solid.core.min(axis=0), solid.core.max(axis=0))
        if np.linalg.norm(nearest - centre) > radius + solid.rounding + 2.0 * BASE_DEPTH:
            continue
        asked = distance_from(solid)

        def distance(value: float, asked: Callable[[coal.CollisionGeometry, pin.SE3], float] = asked) -> float:
            turn = pin.SE3(pin.AngleAxis(value, axis).toRotationMatrix(), np.zeros(3))
            return asked(shape.geometry, place * turn * shape.placement)

        ends_at = float(robot.lower[body.joint]), float(robot.upper[body.joint])
        found[number] = is_always_within(distance, *ends_at, rate, BASE_DEPTH)
    return found
