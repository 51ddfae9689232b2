"""Collision checker in coal and Pinocchio, sharing no formula with the planner."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.base import ties
from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.base.deadline import check_deadline
from hplan.collision.coal_accuracy import distance_errors
from hplan.collision.coal_arm import (
    BASE_DEPTH,
    ArmPair,
    arm_parts,
    base_bodies,
    base_radius,
    moving_bodies,
    supports,
)
from hplan.collision.coal_boxes import (
    ANYWHERE,
    NO_HULLS,
    PairBoxes,
    boxes_about,
    boxes_about_solids,
    hulls_in_boxes,
    joints_as_pinocchio,
    lower_bounds,
)
from hplan.collision.coal_cloud import distance_from, obstacle_shapes
from hplan.collision.coal_moving_solids import MovingSolids
from hplan.collision.coal_pairs import GeometryPairs, MeshPair
from hplan.collision.coal_shapes import beyond_geometry
from hplan.collision.collision_bodies import closed_meshes
from hplan.collision.compliant_solids import maximum_deflection, pushing_links
from hplan.collision.distance_checker import FAR
from hplan.collision.self_pairs import required_distances
from hplan.errors import MovingObstacleError
from hplan.geometry.cloud import Cloud
from hplan.robot.model import Robot
from hplan.robot.upright import UprightTool
from hplan.scene.obstacle_kind import ContactLimit
from hplan.scene.obstacles import Solid
from hplan.scene.tracks import Movement


@dataclass(frozen=True)
class Contact:
    """Signed distance between a link and an obstacle [m]."""

    link: str
    obstacle: str
    distance_m: float

    @property
    def other_name(self) -> str:
        """Name of the obstacle for messages."""
        return f"obstacle {self.obstacle!r}"


@dataclass(frozen=True)
class OwnContact(Contact):
    """Signed distance between a link and another part, `obstacle` [m]."""

    @property
    def other_name(self) -> str:
        """Name of the other part of the arm for messages."""
        return f"link {self.obstacle!r}"


#: The arm may come this much nearer than it was at a start that it leaves [m].
LEAVE_TOLERANCE: Final = 1e-4


class Leaving(NamedTuple):
    """A start nearer to obstacles than the clearance.

    Attributes:
        q: (dof,) the configuration.
        depth: Maximum depth of a contact that the arm may leave [m].
    """

    q: tuple[float, ...]
    depth: float


class CoalScene:
    """Collision checker of an arm among obstacles.

    It has pairs of shapes and their distances.

    The pairs are each shape of each moving link with each obstacle, link by link; then the self-collision pairs
    (`hplan.collision.self_pairs`, `hplan.collision.self_folds`). The shapes are those of
    `hplan.collision.collision_bodies.body_shapes`. Bodies that no joint moves are not paired with obstacles here;
    `base_contacts` checks them.

    A cloud is stored as its points in bounding-volume trees; its radius is subtracted from their distance. If a link
    does not reach the points themselves, the distance is exact or at most 2e-7 m too small. If it does, the depth of a
    capsule whose axis does not reach them has the same accuracy; the depth of any other shape is at least the radius,
    but may be less than the true depth.

    A moving obstacle is at the pose of its movement at the time given with the query; `in_collision` does not accept
    moving obstacles.

    Queries are thread-safe. A scene can be pickled; unpickling rebuilds it from robot and obstacles.

    Attributes:
        mover_names: Names of the moving links, then of bodies that no joint moves but that are checked against another
            arm's base.
        obstacle_names: Names of the obstacles; from `own_first` on, names of the second parts of self-collision pairs.
        link_shapes: Shapes of the links, link by link.
        pairs: Index of the moving body in `mover_names` and of the obstacle or part in `obstacle_names`, for each pair.
        parts: Parts of the arm and its self-collision pairs, which are the last of `pairs`.
        deviation: Tracking error of each joint [rad]; parts that can touch if joints exceed their limits by it form
            pairs.
        clearance: Required clearance [m]; parts of the arm that can come nearer form pairs.
        moving: The moving obstacles with their movements; None if no obstacle moves.
        upright: The tool axis that stays upright during certified motions; None if the tool may tilt.
        supported: Names of a link and an obstacle that supports it (`hplan.collision.coal_arm.supports`); their
            distance counts as infinite.
    """

    def __init__(
        self,
        robot: Robot,
        obstacles: Sequence[Solid],
        *,
        growth: ArrayLike = 0.0,
        deviation: float = 0.0,
        clearance: float = 0.0,
        movements: Sequence[Movement | None] = (),
        yield_links: Sequence[str] | None = None,
        leaving: Leaving | None = None,
        upright: UprightTool | None = None,
    ) -> None:
        """Build the geometry of a robot among obstacles.

        Args:
            robot: The robot.
            obstacles: The obstacles.
            growth: Growth of the obstacles [m], one number or one for each.
            deviation: Maximum excess of joints over their limits [rad].
            clearance: Required clearance [m]; parts of the arm that cannot come this near to each other form no pair.
            movements: Movement of each obstacle, None for a static one; empty if all are static.
            yield_links: Names of the links that may push compliant obstacles; None for the links on the last two
                joints.
            leaving: Start whose obstacles may be nearer than the clearance; None for none.
            upright: The tool axis that stays upright; None if the tool may tilt.

        Raises:
            OptionError: A name in `yield_links` is not a moving link.
        """
        self.robot = robot
        self._built: dict[str, Any] = {
            "robot": robot,
            "obstacles": tuple(obstacles),
            "growth": growth,
            "deviation": deviation,
            "clearance": clearance,
            "movements": tuple(movements),
            "yield_links": None if yield_links is None else tuple(yield_links),
            "leaving": leaving,
            "upright": upright,
        }
        self.upright = upright
        self.moving = MovingSolids.combine(obstacles, movements)
        self._touched: tuple[tuple[str, tuple[str, ...]], ...] = ()
        self.deviation, self.clearance = float(deviation), float(clearance)
        parts = arm_parts(robot, self.deviation, self.clearance)
        self.parts = parts
        self.link_names = tuple(parts.links)
        self.mover_names = parts.mover_names
        movers = list(parts.links.values())
        mover_of = [mover for mover, of_mover in enumerate(movers) for _ in of_mover]
        # The shapes of moving body k start at index `_first_shape[k]`.
        self._first_shape = np.cumsum([0, *(len(of_mover) for of_mover in movers[:-1])])
        self.link_shapes = list(itertools.chain(*parts.links.values()))
        self._mover_shapes = parts.shapes
        self._last = np.flatnonzero([shape.parentJoint == robot.tool_joint for shape in self.link_shapes])
        # Offset subtracted from coal's distance, for each shape and obstacle [m].
        beyond = np.array([beyond_geometry(obstacle) for obstacle in obstacles], dtype=np.float64)
        grown = np.broadcast_to(np.asarray(growth, dtype=np.float64), beyond.shape)
        beyond += grown
        self._beyond: FloatArray = np.tile(beyond, (len(self._mover_shapes), 1))
        supporting = supports(robot, obstacles)[np.concatenate(list(moving_bodies(robot).values()))]
        if self.moving is not None:
            supporting[:, list(self.moving.numbers)] = False
        self._beyond[supporting] = -np.inf
        rows, columns = (places.tolist() for places in np.nonzero(supporting))
        held = ((self.mover_names[mover_of[row]], obstacles[k].name) for row, k in zip(rows, columns, strict=True))
        self.supported = tuple(dict.fromkeys(held))
        self._beyond[self._unmet(mover_of, obstacles, yield_links)] = -np.inf
        check_deadline()
        self.own_first = len(obstacles)
        own_names, own = parts.own_names
        self.obstacle_names = (*(obstacle.name for obstacle in obstacles), *own_names)
        self.pairs = list(itertools.product(mover_of, range(len(obstacles))))
        self.pairs += zip(own[:, 0].tolist(), (self.own_first + own[:, 1]).tolist(), strict=True)
        # Parts of the arm do not grow.
        self._taken_off: FloatArray = np.append(self._beyond, np.zeros(len(parts.own)))
        solids = obstacle_shapes(obstacles)
        check_deadline()
        self._geometry = GeometryPairs(robot.model, self._mover_shapes, solids, parts.shape_pairs, parts.bare_shapes)
        self._near = self._near_at_start(leaving)
        self._yielded = self._depths(maximum_deflection(robot, obstacles, yield_links), yield_links)

    def __getstate__(self) -> dict[str, Any]:
        """Constructor arguments, because Pinocchio's data cannot be pickled."""
        return {"built": self._built, "touched": self._touched}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(vars(_rebuilt(state["built"], state["touched"])))

    @cached_property
    def distance_errors(self) -> FloatArray:
        """(pairs,) upper bound of the error of each distance [m].

        Distances may be too large by this amount (`hplan.collision.coal_accuracy`).
        """
        movers, own = self.parts.extents
        return distance_errors(movers, self._built["obstacles"], own)

    @property
    def grown_obstacles(self) -> tuple[tuple[Solid, float], ...]:
        """The obstacles, each with its growth [m]."""
        obstacles = self._built["obstacles"]
        growth = np.broadcast_to(np.asarray(self._built["growth"], dtype=np.float64), len(obstacles))
        return tuple(zip(obstacles, growth.tolist(), strict=True))

    @cached_property
    def obstacle_balls(self) -> FloatArray:
        """(obstacles, 4) bounding ball of each grown obstacle [m].

        Centre and radius, at its listed pose.
        """
        found = np.zeros((self.own_first, 4))
        for row, (solid, growth) in zip(found, self.grown_obstacles, strict=True):
            low, high = solid.core.min(axis=0), solid.core.max(axis=0)
            row[:3] = 0.5 * (low + high)
            row[3] = 0.5 * float(np.linalg.norm(high - low)) + solid.rounding + growth
        return found

    @cached_property
    def base_contacts(self) -> tuple[Contact, ...]:
        """Contacts of the obstacles that do not move with the base, if deeper than `BASE_DEPTH`."""
        balls, moving = self.obstacle_balls, () if self.moving is None else self.moving.numbers
        in_reach = np.linalg.norm(balls[:, :3], axis=1) <= balls[:, 3] + base_radius(self.robot)
        in_reach[list(moving)] = False
        close = [self._built["obstacles"][number] for number in np.flatnonzero(in_reach)]
        return base_contacts(self.robot, close, margin=-BASE_DEPTH)

    def with_margins(self, deviation: float, clearance: float) -> CoalScene:
        """Checker with the pairs required by tracking error and clearance.

        Tracking error [rad], clearance [m].
        """
        if deviation <= self.deviation and clearance == self.clearance:
            return self
        most = max(deviation, self.deviation)
        parts = arm_parts(self.robot, most, clearance)
        if parts is self.parts or not (parts.own or self.parts.own):
            return self
        built = {**self._built, "deviation": most, "clearance": clearance}
        return _rebuilt(built, self._touched)

    def without_leaving(self) -> CoalScene:
        """Checker in which pairs that are too near at the start keep the clearance, too."""
        return _rebuilt({**self._built, "leaving": None}, self._touched) if len(self.near_pairs) else self

    def rests_from(self, name: str) -> float:
        """Time from which an obstacle rests relative to the base; -inf if it never moves [s]."""
        moving = () if self.moving is None else zip(self.moving.solids, self.moving.movements, strict=True)
        times = (float(how.breaks[-1]) for solid, how in moving if how is not None and solid.name == name)
        return max(times, default=-math.inf)

    def allow_touch(self, name: str, hangs_from: Sequence[str] = ()) -> CoalScene:
        """Checker whose last link may touch the obstacles of a name.

        Their distance to the last link counts as infinite.

        Args:
            name: Name of the obstacles.
            hangs_from: Names of obstacles that become compliant for the pushing links
                (`hplan.collision.compliant_solids`).
        """
        # Of the obstacles alone, and the same for all copies.
        _ = self.obstacle_balls, self.distance_errors, self.boxes
        other = object.__new__(CoalScene)
        vars(other).update(vars(self))
        for name_of_cached in ("required_distances", "meeting_pairs"):
            vars(other).pop(name_of_cached, None)
        other._touched = (*self._touched, (name, tuple(hangs_from)))
        if hangs_from:
            links, hanging = self._built["yield_links"], {each for _, names in other._touched for each in names}
            other._yielded = self._depths(
                maximum_deflection(self.robot, self._built["obstacles"], links, hanging), links
            )
        other._beyond = self._beyond.copy()
        named = np.flatnonzero([obstacle == name for obstacle in self.obstacle_names[: self.own_first]])
        other._beyond[np.ix_(self._last, named)] = -np.inf
        other._taken_off = self._taken_off.copy()
        other._taken_off[: self._beyond.size] = other._beyond.ravel()
        return other

    def _unmet(
        self, mover_of: Sequence[int], obstacles: Sequence[Solid], yield_links: Sequence[str] | None
    ) -> BoolArray:
        """(shapes, obstacles) mask of pairs that a limb's other solids account for (`Convex.meets`)."""
        meets = np.array([obstacle.meets for obstacle in obstacles], dtype=object)
        if (meets == "all").all():
            return np.zeros((len(self._mover_shapes), len(obstacles)), dtype=np.bool_)
        names = pushing_links(self.robot, yield_links)
        pushes = np.array([self.mover_names[mover] in names for mover in mover_of])
        found: BoolArray = np.where(pushes[:, None], meets == "others", meets == "pushing")
        return found

    def _depths(self, yielded: FloatArray | None, yield_links: Sequence[str] | None) -> FloatArray | None:
        """Permitted depth of each pair, (pairs,) [m].

        0 for pairs that keep the clearance, negative for those that keep less; None if all pairs keep the clearance.
        """
        if yielded is None:
            return None if self._near is None else np.where(self._near > -np.inf, self._near, 0.0)
        names = pushing_links(self.robot, yield_links)
        own, shapes = len(self.parts.own), self.pairs[: self._beyond.size : self.own_first]
        pushes = np.array([self.mover_names[mover] in names for mover, _ in shapes])
        depths = np.append(np.where(pushes[:, None], yielded, 0.0), np.zeros(own))
        if self._near is None:
            return depths
        is_near = self._near > -np.inf
        return np.where(is_near, np.where(depths > 0.0, np.maximum(depths, self._near), self._near), depths)

    def _near_at_start(self, leaving: Leaving | None) -> FloatArray | None:
        """(pairs,) permitted depth of the pairs that are too near at a start; -inf for others; None without any."""
        if leaving is None:
            return None
        q, near_m, distances = np.array(leaving.q), self.clearance + LEAVE_TOLERANCE, np.full(len(self.pairs), np.inf)
        pairs = self.meeting_pairs[self.meeting_pairs < self._beyond.size]
        pairs = pairs[self.lower_bounds(q, pairs) < near_m]
        self.place(q)
        distances[pairs] = self.distances_of(pairs)
        is_near = (distances < near_m) & (distances >= -leaving.depth)
        # Zero would mean the full clearance.
        depths = LEAVE_TOLERANCE - distances
        depths[depths == 0.0] = LEAVE_TOLERANCE
        return np.where(is_near, depths, -np.inf) if is_near.any() else None

    @property
    def near_pairs(self) -> IntArray:
        """Indices of the `pairs` that are too near at the start."""
        return np.zeros(0, dtype=np.int64) if self._near is None else np.flatnonzero(self._near > -np.inf)

    @property
    def near_solids(self) -> tuple[tuple[int, int, float], ...]:
        """Number of the obstacle, joint, and required distance [m] of the pairs that are too near at the start.

        Of several links on one joint, the smallest distance counts.
        """
        required = np.broadcast_to(self.required_distance(self.clearance), len(self.pairs))
        found: dict[tuple[int, int], float] = {}
        for pair in self.near_pairs.tolist():
            key = pair % self.own_first, self._mover_shapes[pair // self.own_first].parentJoint - 1
            found[key] = min(found.get(key, math.inf), float(required[pair]))
        return tuple((*key, distance) for key, distance in found.items())

    @property
    def meetings(self) -> tuple[list[pin.GeometryObject], tuple[Solid, ...], FloatArray]:
        """Moving shapes, obstacles, and their maximum penetration depths, (k, n) [m].

        The depth is infinite for pairs that may touch.
        """
        first = self._beyond.size
        depths = np.zeros(first) if self._yielded is None else self._yielded[:first]
        depths = np.where(self._beyond == -np.inf, np.inf, depths.reshape(self._beyond.shape))
        return self._mover_shapes, self._built["obstacles"], depths

    @property
    def compliant_pairs(self) -> IntArray:
        """Indices of the `pairs` with a compliant obstacle."""
        return np.flatnonzero(self._yielded > 0.0) if self._yielded is not None else np.zeros(0, dtype=np.int64)

    @cached_property
    def contact_limits(self) -> Sequence[ContactLimit | None]:
        """For each obstacle what the deepest permitted contact does, if it is a part of a limb or a hanging fruit."""
        return [obstacle.contact_limit for obstacle in self._built["obstacles"]]

    @cached_property
    def has_limbs(self) -> bool:
        """True if an obstacle is a part of a limb or a hanging fruit that a link may push."""
        return any(limit is not None and limit.depth > 0.0 for limit in self.contact_limits)

    @property
    def fruit_limits(self) -> Sequence[tuple[str, FloatArray, ContactLimit]]:
        """Names, centres [m] and contact limits of the hanging fruit that the last link may touch."""
        touched = {name for name, _ in self._touched}
        solids = [solid for solid in self._built["obstacles"] if solid.name in touched] if touched else []
        limits = [(solid.name, solid.core.mean(axis=0), solid.contact_limit) for solid in solids]
        return [(name, center, limit) for name, center, limit in limits if limit is not None and limit.swing > 0.0]

    def joint_of(self, pair: int) -> int:
        """Pinocchio's number of the joint that carries the moving body of a pair with an obstacle."""
        return int(self._mover_shapes[pair // self.own_first].parentJoint)

    def required_distance(self, clearance: float) -> float | FloatArray:
        """Required distances of the `pairs` [m].

        For a clearance, one number or (pairs,) [m].

        The required distance is 0 for bodies of one arm that are always closer together than the clearance
        (`self_pairs.required_distances`). For a compliant obstacle it is negative at any clearance.
        """
        if self._yielded is None and not np.isfinite(self.parts.maximum_distance).any():
            return clearance
        found = np.full(len(self.pairs), clearance)
        found[self._beyond.size :] = required_distances(self.parts.maximum_distance, clearance)
        return self._but_pushed(found)

    def own_required(self, clearance: float) -> Iterator[tuple[ArmPair, float]]:
        """Self-collision pairs, each with its required distance [m]."""
        required = required_distances(self.parts.maximum_distance, clearance) if self.parts.own else np.zeros(0)
        yield from zip(self.parts.own, required.tolist(), strict=True)

    def _but_pushed(self, kept: FloatArray) -> FloatArray:
        """(pairs,) required distances [m]; for compliant obstacles the negative maximum deflection."""
        return kept if self._yielded is None else np.where(self._yielded != 0.0, -self._yielded, kept)

    def deflection_offsets(self, clearance: float) -> FloatArray:
        """(pairs,) offsets of distances of compliant obstacles [m].

        They make these distances comparable to the clearance.

        With its offset, a compliant obstacle at its maximum deflection is exactly at the clearance.
        """
        if self._yielded is None:
            return np.zeros(len(self.pairs))
        return np.where(self._yielded != 0.0, clearance + self._yielded, 0.0)

    def distances(self, q: ArrayLike, time_s: float | None = None) -> FloatArray:
        """Signed distances at one configuration, (dof,) -> (bodies, obstacle names) [m].

        Negative values are penetration depths. The distance is infinite if a link cannot touch that part of the arm, or
        if the obstacle supports it. As in the other methods, `time_s` [s] is required if obstacles move, and otherwise
        has no effect.
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
        self._move_obstacles(time_s)
        return self._geometry.distances(np.asarray(q, dtype=np.float64)) - self._taken_off

    def place(self, q: FloatArray, time_s: float | None = None) -> None:
        """Set the poses of links and moving obstacles for `distances_of`.

        They hold in this thread.

        Raises:
            MovingObstacleError: Obstacles move, and no time is given.
        """
        if self.moving is not None:
            self._move_obstacles(time_s)
        self._geometry.place(q)

    def _move_obstacles(self, time_s: float | None) -> None:
        """Set the poses of the moving obstacles at a time [s]."""
        if self.moving is not None:
            if time_s is None:
                raise MovingObstacleError(self.obstacle_names[self.moving.numbers[0]])
            self._geometry.move_obstacles(self.moving.places(time_s), self.moving.spreads(time_s))

    def distances_of(self, pairs: IntArray) -> FloatArray:
        """Signed distances of some `pairs`, (k,) indices -> (k,) [m].

        At the last placement.
        """
        return self._geometry.distances_of(pairs) - self._taken_off[pairs]

    def shape_distances(self, pairs: IntArray) -> FloatArray:
        """Signed distances of the shapes of some `pairs` at the last placement, nothing subtracted, (k,) [m]."""
        return self._geometry.distances_of(pairs)

    def mesh_distances(self, pairs: IntArray) -> FloatArray:
        """Distances of some `pairs` by closed meshes in place of their hulls and pieces, (k,) indices -> (k,) [m].

        At the last placement. -inf for pairs without such a mesh, and in contact.
        """
        meshes = [self._meshes_of(pair) for pair in pairs.tolist()]
        found, has_mesh = np.full(len(pairs), -np.inf), np.array([any(both) for both in meshes])
        chosen = np.flatnonzero(has_mesh)
        found[chosen] = self._geometry.mesh_distances(pairs[chosen], [meshes[k] for k in chosen])
        return found - self._taken_off[pairs]

    def _meshes_of(self, pair: int) -> MeshPair:
        """The meshes of both shapes of a pair."""
        meshes, obstacles = closed_meshes(self.robot), self._beyond.size
        if pair < obstacles:
            return meshes.get(id(self._mover_shapes[pair // self.own_first])), None
        first, second = self.parts.own[pair - obstacles].shapes
        return meshes.get(id(first)), meshes.get(id(second))

    def whole_fruit_pairs(self, pairs: IntArray) -> IntArray:
        """For `pairs` with a hanging fruit those with the whole fruit, (k,); -1 for others.

        The solid that links push is extended along the stalk, and the whole fruit is a solid for the others.
        """
        rows = pairs % max(self.own_first, 1)
        return np.where(self._whole_fruit[rows] >= 0, pairs - rows + self._whole_fruit[rows], -1)

    @cached_property
    def _whole_fruit(self) -> IntArray:
        """(obstacles,) number of the whole fruit for each hanging fruit that is pushed; -1 for others."""
        whole = {solid.name: row for row, solid in enumerate(self._built["obstacles"]) if solid.meets == "others"}
        limits = zip(self.obstacle_names[: self.own_first], self.contact_limits, strict=True)
        found = [-1 if limit is None or limit.swing == 0.0 else whole.get(name, -1) for name, limit in limits]
        return np.array(found, dtype=np.int64)

    @cached_property
    def boxes(self) -> PairBoxes:
        """Bounding boxes of bodies and obstacles; see `coal_boxes`."""
        parts, count, obstacles = self.parts, self.own_first, self._built["obstacles"]
        bodies = self.robot.cache(("boxes", *parts.key), lambda: boxes_about(parts))
        hulls = NO_HULLS
        if any(isinstance(solid, Cloud) for solid in obstacles):
            hulls = self.robot.cache(("hulls", *parts.key), lambda: hulls_in_boxes(parts))
        solids = boxes_about_solids(obstacles, self.robot.dof)
        if self.moving is not None:
            solids["radius"][list(self.moving.numbers)] = ANYWHERE
        mover, solid = np.divmod(np.arange(self._beyond.size), max(count, 1))
        of_own = parts.movers[0][len(parts.shapes) :]
        sides = np.concatenate([np.column_stack([mover, len(bodies) + solid]), of_own])
        return PairBoxes.join(bodies, hulls, obstacles, solids, sides)

    def lower_bounds(self, q: FloatArray, pairs: IntArray) -> FloatArray:
        """Lower bounds of some `pairs`' distances, (k,) indices -> (k,) [m].

        They are hundreds of times faster than the distances. For a moving obstacle they are huge negative numbers.
        """
        return lower_bounds(q, pairs, self.boxes, joints_as_pinocchio(self.robot)) - self._taken_off[pairs]

    @property
    def taken_off(self) -> FloatArray:
        """(pairs,) offsets subtracted from distances of shapes [m].

        Minus infinity for pairs that may touch.
        """
        return self._taken_off

    @cached_property
    def meeting_pairs(self) -> IntArray:
        """Indices of the `pairs` that keep a distance; the others may touch."""
        return np.flatnonzero(self._taken_off > -np.inf)

    def nearest_pair(self, q: FloatArray, kept: FloatArray, time_s: float | None = None) -> tuple[int, float]:
        """Pair with the minimum distance beyond its required one.

        With its distance [m]; `kept` (pairs,) are the required distances.
        """
        # Number of pairs, nearest by lower bound, whose distances limit the other queries.
        first_asked = 16
        if len(kept) <= 2 * first_asked:
            found = self.pair_distances(q, time_s)
            pair = ties.argmin(found - kept)
            return pair, float(found[pair])
        self.place(q, time_s)
        pairs = self.meeting_pairs if len(self.meeting_pairs) > first_asked else np.arange(len(kept))
        bounds, kept = self.lower_bounds(q, pairs) - kept[pairs], kept[pairs]
        first = np.sort(np.argpartition(bounds, first_asked)[:first_asked])
        near = self.distances_of(pairs[first]) - kept[first]
        # Of the nearest one, coal's distance may be below its bound by coal's error.
        asked = np.union1d(first[near.argmin()], np.flatnonzero(bounds <= near.min() + ties.RASTER))
        found = self.distances_of(pairs[asked])
        place = ties.argmin(found - kept[asked])
        return int(pairs[asked[place]]), float(found[place])

    def contact(self, mover: int, obstacle: int, distance: float) -> Contact:
        """Contact from indices in `mover_names` and `obstacle_names`, and a distance [m]."""
        kind = Contact if obstacle < self.own_first else OwnContact
        return kind(self.mover_names[mover], self.obstacle_names[obstacle], distance)

    def nearest_contact(self, q: ArrayLike, time_s: float | None = None) -> Contact | None:
        """Contact of the nearest pair; None without pairs."""
        if not self.pairs:
            return None
        pair, distance = self.nearest_pair(np.asarray(q, dtype=np.float64), -self.deflection_offsets(0.0), time_s)
        return self.contact(*self.pairs[pair], distance)

    def pair_sways(self, deviations: FloatArray) -> FloatArray:
        """Tracking displacement bound of each pair, (pairs, k) [m].

        `deviations` is (k, dof) [rad].
        """
        _, reaches = self.parts.deviated_reaches(deviations)
        sways: FloatArray = reaches @ deviations.T
        return sways[self.pair_movers]

    @cached_property
    def pair_movers(self) -> IntArray:
        """(pairs,) index of each pair's moving body in `ArmParts.movers`."""
        alone, own = len(self.parts.shapes), len(self.parts.own)
        return np.concatenate([np.repeat(np.arange(alone), self.own_first), np.arange(alone, alone + own)])

    @cached_property
    def required_distances(self) -> tuple[FloatArray, FloatArray]:
        """(pairs,) required distances and (pairs,) tracking displacement bounds that come on top [m].

        They belong to the checker's own `clearance` and `deviation`.
        """
        count = len(self.pairs)
        kept = np.broadcast_to(np.asarray(self.required_distance(self.clearance), dtype=np.float64), (count,))
        if self.deviation == 0.0:
            return kept, np.zeros(count)
        return kept, self.pair_sways(np.full((1, self.robot.dof), self.deviation))[:, 0]

    def nearest_spare(self, q: FloatArray) -> tuple[int, float, float]:
        """Pair with the minimum spare clearance, its distance, and that clearance [m]; there must be pairs."""
        kept, sways = self.required_distances
        worst, distance = self.nearest_pair(q, kept + sways)
        return worst, distance, (distance - float(sways[worst])) - float(kept[worst])

    def spare_clearance(self, q: ArrayLike, enough: float = FAR) -> float:
        """Minimum distance beyond the required one at one configuration, clamped to `enough` [m].

        Raises:
            MovingObstacleError: An obstacle moves.
        """
        return min(self.nearest_spare(np.asarray(q, dtype=np.float64))[2], enough) if self.pairs else enough

    def spare_clearances(self, configurations: ArrayLike, enough: float = FAR) -> FloatArray:
        """Minimum distance beyond the required one at each configuration, clamped to `enough`, (n,) [m].

        Raises:
            MovingObstacleError: An obstacle moves.
        """
        return np.array([self.spare_clearance(q, enough) for q in np.asarray(configurations, dtype=np.float64)])

    def in_collision(self, configurations: ArrayLike, *, margin: float = 0.0) -> BoolArray:
        """(n,) mask of the configurations whose spare clearance is at most a margin.

        All configurations are checked in one compiled call.

        Args:
            configurations: (n, dof) joint values [rad, m].
            margin: Maximum spare clearance that counts as collision [m]; if the required distance plus margin is
                negative, minimum depth that does (for a cloud at most its radius: contact with the points themselves
                always counts).

        Raises:
            MovingObstacleError: An obstacle moves.
        """
        if self.moving is not None:
            raise MovingObstacleError(self.obstacle_names[self.moving.numbers[0]])
        q = np.asarray(configurations, dtype=np.float64)
        if not self.obstacle_names:
            return np.zeros(len(q), dtype=np.bool_)
        kept, sways = self.required_distances
        margins = (kept + sways + margin) + self._taken_off
        # Coal does not support negative margins for trees.
        margins[self._taken_off > 0.0] = np.maximum(0.0, margins[self._taken_off > 0.0])
        return self._geometry.in_collision(q, margins)


def _rebuilt(built: dict[str, Any], touched: Sequence[tuple[str, tuple[str, ...]]]) -> CoalScene:
    """Rebuild a scene from its constructor arguments and the obstacles of `CoalScene.touching`."""
    scene = CoalScene(**built)
    for name, hangs_from in touched:
        scene = scene.allow_touch(name, hangs_from)
    return scene


def base_contacts(robot: Robot, obstacles: Sequence[Solid], *, margin: float = 0.0) -> tuple[Contact, ...]:
    """Contacts of obstacles with the base: the bodies that no joint moves.

    These contacts are not part of the C-space, since no motion changes them.

    Args:
        robot: The robot.
        obstacles: The obstacles.
        margin: Maximum distance that counts as contact [m].
    """
    if not obstacles:
        return ()
    found = []
    distances = [(obstacle, distance_from(obstacle, margin)) for obstacle in obstacles if obstacle.meets != "pushing"]
    for base in base_bodies(robot):
        for obstacle, distance_of in distances:
            distance = distance_of(base.shape.geometry, base.place)
            if distance <= margin:
                found.append(Contact(base.body.name, obstacle.name, distance))
    return tuple(found)
