"""The scene in coal, by way of Pinocchio: a collision checker that shares no formula with the analytic planner."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.base import ties
from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.base.deadline import check_deadline
from hplan.collision.arm_pairs import ArmPair, arm_parts, base_bodies, below
from hplan.collision.box_bounds import (
    ANYWHERE,
    RADIUS,
    boxes_about,
    boxes_about_solids,
    joints_as_pinocchio,
    lower_bounds,
)
from hplan.collision.coal_accuracy import distance_errors
from hplan.collision.coal_cloud import distance_from, obstacle_shapes
from hplan.collision.coal_shapes import LINK_SHAPES, LinkShapes, beyond_geometry
from hplan.collision.geometry_pairs import GeometryPairs
from hplan.collision.giving_way import pushing_links, yielded
from hplan.collision.moving_solids import MovingSolids
from hplan.collision.touching_pairs import required_distances
from hplan.errors import MovingObstacleError, OptionError
from hplan.robot.base_shapes import base_joints
from hplan.robot.model import Robot
from hplan.scene.obstacles import Solid
from hplan.scene.tracks import Movement


@dataclass(frozen=True)
class Contact:
    """A link and an obstacle, and the signed distance between them [m]."""

    link: str
    obstacle: str
    distance_m: float

    @property
    def other(self) -> str:
        """The obstacle, as messages name it."""
        return f"obstacle {self.obstacle!r}"


@dataclass(frozen=True)
class OwnContact(Contact):
    """A link and another part of the arm, `obstacle`, and the signed distance between them [m]."""

    @property
    def other(self) -> str:
        """The other part of the arm, as messages name it."""
        return f"link {self.obstacle!r}"


class CoalScene:
    """Arm and obstacles as pairs of shapes, and their distances.

    Pairs are each link shape with each obstacle, link by link, and so each shape of the turret that is not round about
    the yaw axis; then those that there are of parts of the arm (`hplan.robot.self_contact`). Pedestal, and what of the
    turret is round, do not meet obstacles here; `base_contacts` looks at those. By `links`, link shapes are

    - `capsule`: the capsules of `robot.arm`, which hold the URDF's collision geometry;
    - `box`: square beams from joint to joint, of the capsules' half-widths (in the arm plane: the paper's rectangle);
    - `urdf`: the URDF's collision geometry itself, meshes by their convex hulls (as surfaces they are hollow to coal).

    Neighbours that fold into one another are asked as capsules always. Of a general (non-planar) arm the links are
    those of the URDF that move, as `hplan.collision.collision_bodies.body_shapes` has them, and the pairs of its own
    those of `hplan.collision.touching_pairs`; `links` is `urdf` then.

    A cloud is its points in trees of bounding volumes, asked with its radius taken off the distance. Wherever a
    link does not reach the points themselves the distance is right, and at most 2e-7 m too small; where it does, so
    is the depth of capsules whose axes do not, and that of others is at least the radius, and may be less than the true
    one.

    Obstacles that move are where their movement has them at the time that is asked for; `in_collision` takes none.

    Several threads may ask at once. A scene can be pickled; it is built anew from robot and obstacles.

    Attributes:
        mover_names: Names of the links, then names of the turret's bodies that have other shapes than round ones, then
            of bodies that no joint moves, of which another arm's base is to keep clear.
        obstacle_names: Names of the obstacles; from `own_first` on of the parts of the arm that another can touch.
        link_shapes: Shapes of the links, link by link.
        pairs: Moving body, by its place in `mover_names`, and obstacle or part, in `obstacle_names`, of each pair.
        parts: What of the arm meets obstacles, and the pairs of its own, the last of `pairs`.
        deviation: How far joints may be beyond their limits [rad]; parts of the arm that touch up to there are pairs.
        clearance: Distance that parts of the arm are to keep from each other [m]; those that come nearer are pairs.
        moving: Those of the obstacles that move, and how; None where none does.
    """

    def __init__(
        self,
        robot: Robot,
        obstacles: Sequence[Solid],
        *,
        links: LinkShapes = "capsule",
        growth: ArrayLike = 0.0,
        deviation: float = 0.0,
        clearance: float = 0.0,
        single_joint_pairs: bool = True,
        movements: Sequence[Movement | None] = (),
        yield_links: Sequence[str] | None = None,
    ) -> None:
        """Build the geometry of a robot among obstacles.

        Args:
            growth: By how much obstacles are grown [m], one number or one for each.
            deviation: How far joints may be beyond their limits [rad].
            clearance: Distance to be kept [m]; parts of the arm that cannot come so near to each other are no pairs.
            single_joint_pairs: Whether pairs that depend on one joint alone, turret and folded neighbours, are among
                the pairs: the C-space does not hold them, ranges of joints are narrowed instead.
            movements: How each obstacle moves, None for one that stands still; empty where all do.
            yield_links: Names of the links that may push what gives way; None for those of the last two joints.

        Raises:
            OptionError: Unknown link shape, or no link of that name.
        """
        if links not in LINK_SHAPES:
            raise OptionError("links", links, f"one of {', '.join(LINK_SHAPES)}")
        self.robot = robot
        self._built: dict[str, Any] = {
            "robot": robot,
            "obstacles": tuple(obstacles),
            "links": links,
            "growth": growth,
            "deviation": deviation,
            "clearance": clearance,
            "single_joint_pairs": single_joint_pairs,
            "movements": tuple(movements),
            "yield_links": None if yield_links is None else tuple(yield_links),
        }
        self.moving = MovingSolids.of(obstacles, movements)
        self._touched: tuple[tuple[str, tuple[str, ...]], ...] = ()
        self.deviation, self.clearance = float(deviation), float(clearance)
        parts = arm_parts(robot, links, self.deviation, self.clearance, single_joint_pairs=single_joint_pairs)
        self.parts = parts
        self.link_names = tuple(parts.links)
        self.mover_names = parts.mover_names
        movers = [*parts.links.values(), *([shape.placed for shape in shapes] for shapes in parts.turret.values())]
        # The shapes of moving body k are the rows from `_first_shape[k]` on.
        self._first_shape = np.cumsum([0, *(len(of_mover) for of_mover in movers[:-1])])
        self.link_shapes = list(itertools.chain(*parts.links.values()))
        self._mover_shapes = parts.shapes
        self._last = np.flatnonzero([shape.parentJoint == parts.tool_joint for shape in self.link_shapes])
        # To be taken off coal's distance of each shape from each obstacle [m].
        beyond = np.array([beyond_geometry(obstacle) for obstacle in obstacles], dtype=np.float64)
        grown = np.broadcast_to(np.asarray(growth, dtype=np.float64), beyond.shape)
        beyond += grown
        self._beyond: FloatArray = np.tile(beyond, (len(self._mover_shapes), 1))
        for row, shape in enumerate(itertools.chain(*parts.turret.values()), len(self.link_shapes)):
            never = below(robot, shape, obstacles, grown)
            if self.moving is not None:
                never = self.moving.keep_below(never, shape.bottom)
            self._beyond[row, never] = -np.inf
        check_deadline()
        self.own_first = len(obstacles)
        own_names, own = parts.own_names
        self.obstacle_names = (*(obstacle.name for obstacle in obstacles), *own_names)
        mover_of = [mover for mover, of_mover in enumerate(movers) for _ in of_mover]
        self.pairs = list(itertools.product(mover_of, range(len(obstacles))))
        self.pairs += zip(own[:, 0].tolist(), (self.own_first + own[:, 1]).tolist(), strict=True)
        self._yielded = self._depths(yielded(robot, obstacles, yield_links), yield_links)
        # Parts of the arm do not grow.
        self._taken_off: FloatArray = np.append(self._beyond, np.zeros(len(parts.own)))
        solids = obstacle_shapes(obstacles)
        check_deadline()
        self._geometry = GeometryPairs(robot.model, self._mover_shapes, solids, parts.shape_pairs, parts.bare_shapes)

    def __getstate__(self) -> dict[str, Any]:
        """The arguments that it is built from: Pinocchio's data cannot be pickled."""
        return {"built": self._built, "touched": self._touched}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(vars(_rebuilt(state["built"], state["touched"])))

    @cached_property
    def distance_errors(self) -> FloatArray:
        """(pairs,) by how much distances of `pairs` may be too large [m] (`hplan.collision.coal_accuracy`)."""
        movers, own = self.parts.extents
        return distance_errors(movers, self._built["obstacles"], own)

    @property
    def grown_obstacles(self) -> tuple[tuple[Solid, float], ...]:
        """The obstacles, and by how much each is grown [m]."""
        obstacles = self._built["obstacles"]
        growth = np.broadcast_to(np.asarray(self._built["growth"], dtype=np.float64), len(obstacles))
        return tuple(zip(obstacles, growth.tolist(), strict=True))

    @cached_property
    def obstacle_balls(self) -> FloatArray:
        """(obstacles, 4) centre and radius of a ball about each grown obstacle, where it is listed [m]."""
        found = np.zeros((self.own_first, 4))
        for row, (solid, growth) in zip(found, self.grown_obstacles, strict=True):
            low, high = solid.core.min(axis=0), solid.core.max(axis=0)
            row[:3] = 0.5 * (low + high)
            row[3] = 0.5 * float(np.linalg.norm(high - low)) + solid.rounding + growth
        return found

    def covering(self, deviation: float, clearance: float) -> CoalScene:
        """The scene with the pairs that a tracking error [rad] and a clearance [m] require."""
        if deviation <= self.deviation and clearance == self.clearance:
            return self
        most, single = max(deviation, self.deviation), self._built["single_joint_pairs"]
        parts = arm_parts(self.robot, self._built["links"], most, clearance, single_joint_pairs=single)
        if parts is self.parts or not (parts.own or self.parts.own):
            return self
        built = {**self._built, "deviation": most, "clearance": clearance}
        return _rebuilt(built, self._touched)

    def touching(self, name: str, hangs_from: Sequence[str] = ()) -> CoalScene:
        """The scene where the last link may touch the obstacles of a name: their distance counts as infinite.

        Args:
            name: Of the obstacles.
            hangs_from: Names of others, which links that may push may push then (`hplan.collision.giving_way`).
        """
        other = object.__new__(CoalScene)
        vars(other).update(vars(self))
        other._touched = (*self._touched, (name, tuple(hangs_from)))
        if hangs_from:
            links, hanging = self._built["yield_links"], {each for _, names in other._touched for each in names}
            other._yielded = self._depths(yielded(self.robot, self._built["obstacles"], links, hanging), links)
        other._beyond = self._beyond.copy()
        named = np.flatnonzero([obstacle == name for obstacle in self.obstacle_names[: self.own_first]])
        other._beyond[np.ix_(self._last, named)] = -np.inf
        other._taken_off = self._taken_off.copy()
        other._taken_off[: self._beyond.size] = other._beyond.ravel()
        return other

    def _depths(self, yielded: FloatArray | None, yield_links: Sequence[str] | None) -> FloatArray | None:
        """(pairs,) how deep the two may be in one another, 0 where they must not touch [m]; None where none may."""
        if yielded is None:
            return None
        names = pushing_links(self.robot, yield_links)
        own, shapes = len(self.parts.own), self.pairs[: self._beyond.size : self.own_first]
        pushes = np.array([self.mover_names[mover] in names for mover, _ in shapes])
        return np.append(np.where(pushes[:, None], yielded, 0.0), np.zeros(own))

    @property
    def meetings(self) -> tuple[list[pin.GeometryObject], tuple[Solid, ...], FloatArray]:
        """What moves, the obstacles, and how deep each may be in each; infinite where they may touch, (k, n) [m]."""
        first = self._beyond.size
        depths = np.zeros(first) if self._yielded is None else self._yielded[:first]
        depths = np.where(self._beyond == -np.inf, np.inf, depths.reshape(self._beyond.shape))
        return self._mover_shapes, self._built["obstacles"], depths

    @property
    def pushed(self) -> IntArray:
        """Numbers of the `pairs` of which one gives way to the other."""
        return np.flatnonzero(self._yielded) if self._yielded is not None else np.zeros(0, dtype=np.int64)

    def kept(self, clearance: float) -> float | FloatArray:
        """The distance that each of `pairs` is to keep where a clearance is asked for, for all or (pairs,) [m].

        It is 0 for bodies of one arm that are never so far apart (`touching_pairs.required_distances`). A compliant
        obstacle may be pushed: it is negative then, whatever the clearance.
        """
        if self._yielded is None and not np.isfinite(self.parts.farthest).any():
            return clearance
        found = np.full(len(self.pairs), clearance)
        found[self._beyond.size :] = required_distances(self.parts.farthest, clearance)
        return self._but_pushed(found)

    def own_required(self, clearance: float) -> Iterator[tuple[ArmPair, float]]:
        """Pairs of the arm's own, and the distance that each keeps [m]."""
        required = required_distances(self.parts.farthest, clearance) if self.parts.own else np.zeros(0)
        yield from zip(self.parts.own, required.tolist(), strict=True)

    def _but_pushed(self, kept: FloatArray) -> FloatArray:
        """(pairs,) distances to keep, but of what gives way how deep it may be pushed, below 0 [m]."""
        return kept if self._yielded is None else np.where(self._yielded > 0.0, -self._yielded, kept)

    def counted(self, clearance: float) -> FloatArray:
        """(pairs,) to be added to distances, so that what gives way is as near as what it is to keep says [m]."""
        if self._yielded is None:
            return np.zeros(len(self.pairs))
        return np.where(self._yielded > 0.0, clearance + self._yielded, 0.0)

    def distances(self, q: ArrayLike, time_s: float | None = None) -> FloatArray:
        """Signed distances at one configuration, (dof,) -> (bodies, obstacle names) [m]; negative is the depth.

        Infinite where a link, or the turret, cannot touch that part of the arm or obstacle. As the other methods it
        takes a time where obstacles move, and only there.
        """
        found = self.pair_distances(q, time_s)
        table = (found[: self._beyond.size] if self.parts.own else found).reshape(self._beyond.shape)
        if len(self._mover_shapes) != len(self._first_shape):
            table = np.minimum.reduceat(table, self._first_shape)
        if not self.parts.own:
            return table
        whole = np.full((len(self.mover_names), len(self.obstacle_names)), np.inf)
        whole[: len(table), : self.own_first] = table
        movers, columns = np.array(self.pairs[self._beyond.size :]).T
        np.minimum.at(whole, (movers, columns), found[self._beyond.size :])
        return whole

    def pair_distances(self, q: ArrayLike, time_s: float | None = None) -> FloatArray:
        """Signed distances of all `pairs` at one configuration, (dof,) -> (pairs,) [m]."""
        self._put(time_s)
        return self._geometry.distances(np.asarray(q, dtype=np.float64)) - self._taken_off

    def place(self, q: FloatArray, time_s: float | None = None) -> None:
        """Put the links, and what moves, where `distances_of` is to look at them, in this thread.

        Raises:
            MovingObstacleError: Obstacles move, and no time is given.
        """
        if self.moving is not None:
            self._put(time_s)
        self._geometry.place(q)

    def _put(self, time_s: float | None) -> None:
        """Have what moves placed, with the arm, where it is at a time."""
        if self.moving is not None:
            if time_s is None:
                raise MovingObstacleError(self.obstacle_names[self.moving.numbers[0]])
            self._geometry.put(self.moving.places(time_s))

    def distances_of(self, pairs: IntArray) -> FloatArray:
        """Signed distances of some of the `pairs` where the links were last placed, (k,) numbers -> (k,) [m]."""
        return self._geometry.distances_of(pairs) - self._taken_off[pairs]

    @cached_property
    def boxes(self) -> tuple[FloatArray, IntArray]:
        """Boxes about bodies of the arm and obstacles, as `box_bounds` has them, and (pairs, 2) those of each pair."""
        parts, count, obstacles = self.parts, self.own_first, self._built["obstacles"]
        bodies = self.robot.cached(("boxes", *parts.key), lambda: boxes_about(parts))
        solids = boxes_about_solids(obstacles, self.robot.dof)
        if self.moving is not None:
            solids[list(self.moving.numbers), RADIUS] = ANYWHERE
        mover, solid = np.divmod(np.arange(self._beyond.size), max(count, 1))
        of_own = parts.movers[0][len(parts.shapes) :]
        return np.concatenate([bodies, solids]), np.concatenate([np.column_stack([mover, len(bodies) + solid]), of_own])

    def lower_bounds(self, q: FloatArray, pairs: IntArray) -> FloatArray:
        """Lower bounds of signed distances of some of the `pairs` at a configuration, (k,) numbers -> (k,) [m].

        They are hundreds of times as quick; of a pair of what moves they are huge negative numbers.
        """
        boxes, sides = self.boxes
        return lower_bounds(q, pairs, sides, boxes, joints_as_pinocchio(self.robot)) - self._taken_off[pairs]

    @property
    def taken_off(self) -> FloatArray:
        """(pairs,) what is taken off distances of shapes; minus infinity for pairs that may touch [m]."""
        return self._taken_off

    def nearest_pair(self, q: FloatArray, kept: FloatArray, time_s: float | None = None) -> tuple[int, float]:
        """The pair with the least distance beyond what each of (pairs,) is to keep, and its distance [m]."""
        # So many pairs are asked before the others, where bounds tell which are near.
        first_asked = 16
        if len(kept) <= 2 * first_asked:
            found = self.pair_distances(q, time_s)
            pair = ties.argmin(found - kept)
            return pair, float(found[pair])
        self.place(q, time_s)
        bounds = self.lower_bounds(q, np.arange(len(kept))) - kept
        first = np.sort(np.argpartition(bounds, first_asked)[:first_asked])
        least = (self.distances_of(first) - kept[first]).min()
        asked = np.flatnonzero(bounds <= least + ties.RASTER)
        found = self.distances_of(asked)
        place = ties.argmin(found - kept[asked])
        return int(asked[place]), float(found[place])

    def contact(self, mover: int, obstacle: int, distance: float) -> Contact:
        """A distance between what has a place in `mover_names` and what has one in `obstacle_names`, by name."""
        kind = Contact if obstacle < self.own_first else OwnContact
        return kind(self.mover_names[mover], self.obstacle_names[obstacle], distance)

    def nearest(self, q: ArrayLike, time_s: float | None = None) -> Contact | None:
        """The link and obstacle, or part of the arm, nearest to each other, or None where there is nothing to meet."""
        if not self.pairs:
            return None
        pair, distance = self.nearest_pair(np.asarray(q, dtype=np.float64), -self.counted(0.0), time_s)
        return self.contact(*self.pairs[pair], distance)

    def in_collision(self, configurations: ArrayLike, *, margin: float = 0.0) -> BoolArray:
        """True where (n, dof) configurations touch an obstacle or the arm itself, in one compiled call.

        Args:
            configurations: (n, dof) joint angles.
            margin: Distance up to which a pair counts as touching [m]; where it is negative, depth from which on (of a
                cloud no more than its radius: the points themselves count always).

        Raises:
            MovingObstacleError: Obstacles move.
        """
        if self.moving is not None:
            raise MovingObstacleError(self.obstacle_names[self.moving.numbers[0]])
        q = np.asarray(configurations, dtype=np.float64)
        if not self.obstacle_names:
            return np.zeros(len(q), dtype=np.bool_)
        kept = self.kept(margin) if margin > 0.0 else self._but_pushed(np.full(len(self.pairs), margin))
        margins = kept + self._taken_off
        # Of trees coal knows no negative margin.
        margins[self._taken_off > 0.0] = np.maximum(0.0, margins[self._taken_off > 0.0])
        return self._geometry.in_collision(q, margins)


def _rebuilt(built: dict[str, Any], touched: Sequence[tuple[str, tuple[str, ...]]]) -> CoalScene:
    """A scene from the arguments that one is built from, and what the last link may touch (`CoalScene.touching`)."""
    scene = CoalScene(**built)
    for name, hangs_from in touched:
        scene = scene.touching(name, hangs_from)
    return scene


def base_contacts(
    robot: Robot, obstacles: Sequence[Solid], yaw: float = 0.0, *, margin: float = 0.0
) -> tuple[Contact, ...]:
    """Obstacles that touch what the planar joints do not move: pedestal and turret, as the URDF gives them.

    They are no part of the C-space, since no motion of the arm at this yaw changes them. Of a general (non-planar)
    arm it is what no joint moves.

    Args:
        margin: Distance up to which a pair counts as touching [m].
    """
    if not obstacles:
        return ()
    q, joints = np.zeros(robot.dof), base_joints(robot)
    q[:joints] = yaw
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    found = []
    distances = [(obstacle, distance_from(obstacle, margin)) for obstacle in obstacles]
    for name, shape in base_bodies(robot):
        place = data.oMi[shape.parentJoint] * shape.placement
        for obstacle, distance_of in distances:
            distance = distance_of(shape.geometry, place)
            if distance <= margin:
                found.append(Contact(name, obstacle.name, distance))
    return tuple(found)
