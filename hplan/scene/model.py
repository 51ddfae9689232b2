"""The scene: obstacles, fruit, start and goal.

A scene never changes; `with_` gives a checked copy with other values, `with_obstacles` one with other obstacles. The
classes are the scene file's schema too (`hplan.scene.file`). The arm keeps clear of an obstacle's `solids`: itself, or
the solids of a mesh or a point cloud (`hplan.scene.solids`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Final, Literal, Self
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field, field_validator, model_validator

from hplan.base.arguments import instance, list_of, number
from hplan.base.arrays import FloatArray, numbers
from hplan.base.data_files import robot_names
from hplan.errors import MovingObstacleError, SceneError
from hplan.scene.fault import StrictModel, check_values, fault
from hplan.scene.limits import FARTHEST_M, MOST_OBSTACLES, Size, Vector
from hplan.scene.obstacle_kind import (
    CovarianceField,
    Item,
    Name,
    Sigma,
    TrackField,
    largest_deviation,
    moved,
    turned_covariance,
)
from hplan.scene.obstacles import AnyObstacle, Obstacle, Solid, Sphere
from hplan.scene.solids import Cloud, Hull, quaternion_rotation, rpy_rotation
from hplan.scene.tracks import Movement

FORMAT: Final = "hplan-scene/1"

#: How far the length of a quaternion may be from 1; it is taken as if it were 1.
QUATERNION_LENGTH: Final = 1e-3


def _listed(names: Any) -> Any:
    """One name as a list of it."""
    return (names,) if isinstance(names, str) else names


class Fruit(Item):
    """A fruit: a ball, an obstacle unless it is the one being reached for.

    What it hangs from, obstacles by their names, gives way while this fruit may be touched: as deep as each yields, and
    where it does not, `hplan.collision.giving_way.HANGING_M`.
    """

    name: Name
    center: Vector
    radius: Size
    sigma: Sigma = 0.0
    hangs_from: Annotated[tuple[Name, ...], BeforeValidator(_listed), Field(exclude=True)] = ()


class JointValues(StrictModel):
    """A configuration: one of `joints_deg`, `joints_rad`."""

    joints_deg: tuple[float, ...] | None = None
    joints_rad: tuple[float, ...] | None = None

    #: The keys of which one is to be given.
    _choices: ClassVar[tuple[str, ...]] = ("joints_deg", "joints_rad")

    @model_validator(mode="after")
    def _one_of(self) -> Self:
        given = [key for key in self._choices if getattr(self, key) is not None]
        if len(given) != 1:
            keys = ", ".join(self._choices)
            raise ValueError(f"give exactly one of {keys}; got {', '.join(given) or 'none'}")
        return self

    def joints(self) -> FloatArray | None:
        """The configuration [rad], or None for a goal given otherwise."""
        if self.joints_deg is not None:
            return np.radians(self.joints_deg)
        return None if self.joints_rad is None else np.array(self.joints_rad, dtype=np.float64)

    @property
    def configuration(self) -> FloatArray:
        """The configuration [rad].

        Raises:
            SceneError: It is a goal given otherwise.
        """
        joints = self.joints()
        if joints is None:
            raise SceneError("expected a goal given by joints", where="goal")
        return joints


class Start(JointValues):
    """The start of the motion: one of `joints_deg`, `joints_rad`; at rest unless velocity or acceleration is given.

    A motion that starts in motion leaves this state as it is: position, velocity and acceleration go on without a jump.
    """

    velocity_rad_s: Annotated[tuple[float, ...] | None, Field(exclude=True)] = None
    acceleration_rad_s2: Annotated[tuple[float, ...] | None, Field(exclude=True)] = None

    @model_validator(mode="after")
    def _lengths_agree(self) -> Self:
        joints = self.joints_deg if self.joints_deg is not None else self.joints_rad or ()
        for key, values in self.rates.items():
            if len(values) != len(joints):
                raise fault(f"expected a value for each of {len(joints)} joints, got {len(values)}", key)
        return self

    @property
    def rates(self) -> dict[str, tuple[float, ...]]:
        """Velocity and acceleration, as far as they are given, by their keys. They are no part of a dump of the scene.

        So a start at rest is what it was before there were others, in digests too.
        """
        given = {"velocity_rad_s": self.velocity_rad_s, "acceleration_rad_s2": self.acceleration_rad_s2}
        return {key: values for key, values in given.items() if values is not None}

    @property
    def is_moving(self) -> bool:
        """True if a velocity or an acceleration is not zero."""
        return any(any(values) for values in self.rates.values())


class Goal(JointValues):
    """The goal of the motion: joints, a `tool0` position, the name of a fruit, or a pose of the tool frame.

    To a position or a fruit, `approach_deg` fixes or bounds the angle of the last link in the arm plane or, of a robot
    that is general (non-planar), of its tool frame's z axis (0: outward, 90: up). A position with `quaternion_xyzw` is
    a pose, for robots of any kind: of the tool frame, or of `frame`.
    """

    position: Vector | None = None
    fruit: str | None = None
    approach_deg: float | tuple[float, float] | None = None
    quaternion_xyzw: Annotated[tuple[float, float, float, float] | None, Field(exclude=True)] = None
    frame: Annotated[Name | None, Field(exclude=True)] = None

    _choices: ClassVar[tuple[str, ...]] = ("joints_deg", "joints_rad", "position", "fruit")

    @model_validator(mode="after")
    def _approach_is_free(self) -> Goal:
        if self.approach_deg is not None and self.joints() is not None:
            raise ValueError("approach_deg belongs to a position or a fruit; joints leave nothing to choose")
        return self

    @model_validator(mode="after")
    def _pose_is_whole(self) -> Goal:
        if self.quaternion_xyzw is None:
            if self.frame is not None:
                raise fault("frame belongs to a pose: give position and quaternion_xyzw too", "frame")
            return self
        if self.position is None:
            raise fault("quaternion_xyzw belongs to a position", "quaternion_xyzw")
        if self.approach_deg is not None:
            raise fault("approach_deg and quaternion_xyzw exclude one another", "approach_deg")
        length = math.hypot(*self.quaternion_xyzw)
        if not abs(length - 1.0) <= QUATERNION_LENGTH:
            raise fault(f"expected a quaternion (x, y, z, w) of length 1, got length {length:.6g}", "quaternion_xyzw")
        return self

    @property
    def orientation(self) -> dict[str, Any]:
        """Quaternion and frame, as far as they are given, by their keys. They are no part of a dump of the scene.

        So a goal without them is what it was before there were any, in digests too.
        """
        given = {"quaternion_xyzw": self.quaternion_xyzw, "frame": self.frame}
        return {key: value for key, value in given.items() if value is not None}

    @property
    def pose(self) -> FloatArray | None:
        """The (4, 4) homogeneous matrix of the pose in `base_link`; None for a goal given otherwise."""
        if self.quaternion_xyzw is None or self.position is None:
            return None
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = quaternion_rotation(self.quaternion_xyzw), self.position
        return pose


class Scene(StrictModel):
    """Everything around the arm, and what it is asked to do.

    Attributes:
        name: Name of the scene.
        robot: Name of the robot that it is meant for, as `load_robot` knows it; None for the default one. Commands take
            it unless they are given another, as `load_robot(scene.robot)` does; it is no part of what is planned or
            certified.
        start: Configuration at which the motion begins, and how it moves there.
        goal: Configuration, tool position, fruit or pose to reach.
        locked_joints: Joints that keep their start value.
        clearance: Distance kept from every obstacle, but for those that may be pushed (`yields`) by links that may [m].
        yield_links: Names of the links that may push what gives way; None for those of the last two joints.
        obstacles: What must not be touched.
        fruits: Fruit; obstacles too, except the one reached for.
        covariance: Covariance of an error that is the same of all obstacles and fruits, as of a camera or the base that
            is not where it should be; it comes to that of each [m^2]. None for no such error.
        base_track: How the base moves, of a platform that creeps along the row; None for one that stands still.
            Obstacles, and their tracks, are where the base is without a shift; start and goal are seen from the base.
    """

    format: Literal["hplan-scene/1"] = FORMAT
    name: Name
    robot: Annotated[str | None, Field(exclude=True)] = None  # no part of the digest: the robot has its own
    start: Start
    goal: Goal
    locked_joints: tuple[str, ...] = ()
    clearance: Annotated[float, Field(ge=0.0, le=FARTHEST_M)] = 0.0
    obstacles: Annotated[tuple[Obstacle, ...], Field(max_length=MOST_OBSTACLES)] = ()
    fruits: Annotated[tuple[Fruit, ...], Field(max_length=MOST_OBSTACLES)] = ()
    base_track: TrackField = None
    covariance: CovarianceField = None
    yield_links: Annotated[tuple[Name, ...] | None, Field(exclude=True)] = None

    @field_validator("robot")
    @classmethod
    def _robot_ships(cls, robot: str | None) -> str | None:
        if robot is not None and robot not in robot_names():
            raise ValueError(f"no robot has that name in hplan; there are {', '.join(robot_names())}")
        return robot

    @model_validator(mode="after")
    def _names_are_unique(self) -> Scene:
        seen: set[str] = set()
        for key, items in (("obstacles", self.obstacles), ("fruits", self.fruits)):
            for index, item in enumerate(items):
                if item.name in seen:
                    raise fault(f"two obstacles are called {item.name!r}; names must differ", key, index, "name")
                seen.add(item.name)
        if self.goal.fruit is not None and self.goal.fruit not in {fruit.name for fruit in self.fruits}:
            raise fault(f"{self.goal.fruit!r} is not among the fruits", "goal", "fruit")
        wood = {obstacle.name for obstacle in self.obstacles}
        for index, fruit in enumerate(self.fruits):
            for name in fruit.hangs_from:
                if name not in wood:
                    raise fault(f"{name!r} is not among the obstacles", "fruits", index, "hangs_from")
        return self

    @property
    def goal_fruit(self) -> Fruit | None:
        """The fruit that is the goal; None where the goal is given otherwise."""
        return next((fruit for fruit in self.fruits if fruit.name == self.goal.fruit), None)

    @property
    def gives_way(self) -> bool:
        """True if something may be pushed: an obstacle, a fruit, or what a fruit hangs from."""
        return any(item.yields for item in (*self.obstacles, *self.fruits)) or any(f.hangs_from for f in self.fruits)

    @property
    def moves(self) -> bool:
        """True if the base or an obstacle has a track."""
        return self.base_track is not None or self.first_moving is not None

    @property
    def first_moving(self) -> str | None:
        """Name of the first obstacle or fruit that has a track; None where there is none."""
        return next((item.name for item in (*self.obstacles, *self.fruits) if item.track is not None), None)

    @property
    def solids(self) -> tuple[Solid, ...]:
        """All that the arm must keep clear of: the obstacles' solids, and each fruit that is not the goal as a ball.

        Those of one obstacle have its name and stand together.

        Raises:
            MovingObstacleError: Something moves.
        """
        return tuple(solid for solid in self.solids_with_goal if solid.name != self.goal.fruit)

    @property
    def solids_with_goal(self) -> tuple[Solid, ...]:
        """As `solids`, the fruit that is the goal among them.

        Raises:
            MovingObstacleError: Something moves.
        """
        if self.moves:
            raise MovingObstacleError(self.first_moving)
        return self.listed_solids

    @property
    def listed_solids(self) -> tuple[Solid, ...]:
        """As `solids_with_goal`, each where it is listed, whether it moves from there or not (`movements`)."""
        balls = (
            Sphere(name=f.name, center=f.center, radius=f.radius, sigma=f.sigma, sway=f.sway, yields=f.yields).solids[0]
            for f in self.fruits
        )
        listed = (*(solid for obstacle in self.obstacles for solid in obstacle.solids), *balls)
        if self.covariance is None:
            return listed
        sigmas = {name: largest_deviation(error + self.shared_error) for name, error in self.errors.items()}
        return tuple(
            replace(solid, sigma=sigmas[solid.name])
            if isinstance(solid, Hull | Cloud)
            else solid.copy_unchecked({"sigma": sigmas[solid.name]})
            for solid in listed
        )

    @property
    def errors(self) -> dict[str, FloatArray]:
        """(3, 3) covariance of the place of each obstacle and fruit, by name, without what is common to all [m^2]."""
        return {item.name: item.place_covariance for item in (*self.obstacles, *self.fruits)}

    @property
    def shared_error(self) -> FloatArray:
        """(3, 3) covariance of the error that is the same of all [m^2]."""
        return np.zeros((3, 3)) if self.covariance is None else np.array(self.covariance)

    @property
    def movements(self) -> tuple[Movement | None, ...]:
        """How each of `listed_solids` moves as seen from the base; None of what stands still."""
        found: list[Movement | None] = []
        for item, movement in self._listed_movements():
            found += [movement] * (1 if isinstance(item, Fruit) else len(item.solids))
        return tuple(found)

    def _listed_movements(self) -> Iterator[tuple[Obstacle | Fruit, Movement | None]]:
        """Each obstacle and fruit, and how it moves as seen from the base; one movement of all that have no track."""
        still = None if self.base_track is None else Movement.of(None, self.base_track)
        for item in (*self.obstacles, *self.fruits):
            yield item, still if item.track is None else Movement.of(item.track, self.base_track)

    @property
    def at_rest_s(self) -> float:
        """Time from which on nothing moves [s]; 0 where nothing ever does."""
        tracks = (self.base_track, *(item.track for item in (*self.obstacles, *self.fruits)))
        return max((track.times_s[-1] for track in tracks if track is not None), default=0.0)

    def poses_at(self, times_s: ArrayLike) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Where what moves is at times, as seen from the base.

        Args:
            times_s: (k,) times [s].

        Returns:
            For each obstacle and fruit that moves, by name, (k, 3, 3) rotations R and (k, 3) shifts s [m]: its point
            that is listed at x is at R x + s.

        Raises:
            InputError: Times that are none.
        """
        clock = numbers("times_s", times_s, (None,))
        listed = self._listed_movements()
        return {item.name: movement.at(clock) for item, movement in listed if movement is not None}

    def at(self, time_s: float) -> Scene:
        """The scene as it stands at a time [s], without tracks.

        Raises:
            InputError: A time that is none.
        """
        poses = {name: (turns[0], shifts[0]) for name, (turns, shifts) in self.poses_at([time_s]).items()}
        changed = self._each(lambda item: moved(item, *poses[item.name]) if item.name in poses else {})
        return self.copy_unchecked(changed | {"base_track": None})

    def since(self, time_s: float) -> Scene:
        """The scene with the times of all tracks counted from a time on [s].

        What the scene has at a time t, the new one has at `t - time_s`, of times before its zero too. So a motion that
        begins at that time is to the new scene what it is to this one with `certify(..., begin_s=time_s)`.

        Raises:
            OptionError: A time that is not finite, or so large that times of tracks are no longer distinct.
        """
        number("time_s", time_s, "a finite number of seconds")
        if time_s == 0.0 or not self.moves:
            return self
        changed = self._each(lambda item: {} if item.track is None else {"track": item.track.since(time_s)})
        base_track = None if self.base_track is None else self.base_track.since(time_s)
        return self.copy_unchecked(changed | {"base_track": base_track})

    def _each(self, changes: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """Obstacles and fruits, each with the values that are others."""
        found: dict[str, Any] = {}
        for key in ("obstacles", "fruits"):
            pairs = [(item, changes(item)) for item in getattr(self, key)]
            found[key] = tuple(item.copy_unchecked(update) if update else item for item, update in pairs)
        return found

    def shifted(self, shift: ArrayLike, yaw_deg: float = 0.0) -> Scene:
        """The scene as a base sees it that stands elsewhere: all of it turned about the base's z axis, then shifted.

        Obstacles, fruits and a goal that is a place keep their names; start and goals given by joints stay as they are.

        Args:
            shift: (3,) shift [m].
            yaw_deg: Turn before that [deg].

        Raises:
            InputError: A shift that is none.
            OptionError: A turn that is not finite.
            MovingObstacleError: Something moves.
        """
        by = numbers("shift", shift, (3,))
        number("yaw_deg", yaw_deg, "a finite number of degrees")
        if self.moves:
            raise MovingObstacleError(self.first_moving)
        turn = rpy_rotation(0.0, 0.0, math.radians(yaw_deg))
        goal = self.goal
        if goal.position is not None:
            place: dict[str, Any] = {"position": tuple((turn @ np.array(goal.position) + by).tolist())}
            if goal.quaternion_xyzw is not None:
                x, y, z, w = goal.quaternion_xyzw
                cos, sin = math.cos(0.5 * math.radians(yaw_deg)), math.sin(0.5 * math.radians(yaw_deg))
                place["quaternion_xyzw"] = cos * x - sin * y, cos * y + sin * x, cos * z + sin * w, cos * w - sin * z
            goal = goal.copy_unchecked(place)
        update = self._each(lambda item: moved(item, turn, by)) | {"goal": goal}
        if self.covariance is not None:
            update["covariance"] = turned_covariance(self.covariance, turn)
        return self.copy_unchecked(update)

    def cropped(self, reach: float, centre: ArrayLike = (0.0, 0.0, 0.0)) -> Scene:
        """The scene without what is farther from a point than a reach; what moves stays, and so does the goal's fruit.

        An obstacle counts as near as a ball about it is. What is certified among the rest says nothing of what is left
        out: take a reach that the arm does not have.

        Args:
            reach: Distance up to which obstacles and fruits are kept [m].
            centre: (3,) the point [m].

        Raises:
            InputError: A point that is none.
            OptionError: A reach that is negative or not finite.
        """
        point = numbers("centre", centre, (3,))
        number("reach", reach, "a finite number of metres >= 0", lambda value: value >= 0.0)
        obstacles = tuple(
            item
            for item in self.obstacles
            if item.track is not None or any(_apart(solid, point) <= reach for solid in item.solids)
        )
        fruits = tuple(
            fruit
            for fruit in self.fruits
            if fruit.track is not None
            or fruit.name == self.goal.fruit
            or math.dist(fruit.center, point) - fruit.radius <= reach
        )
        return self.copy_unchecked({"obstacles": obstacles, "fruits": hanging_from(obstacles, fruits)})

    def with_obstacles(self, obstacles: Sequence[AnyObstacle]) -> Scene:
        """The scene's task among other obstacles.

        Raises:
            InputError: They are no list of obstacles, or two have one name.
        """
        obstacles = list_of("obstacles", obstacles, AnyObstacle, "obstacles")
        parts = {key: getattr(self, key) for key in type(self).model_fields}
        fruits = hanging_from(obstacles, self.fruits)
        return Scene.model_validate({**parts, "obstacles": obstacles, "fruits": fruits})


#: Scenes that `checked_scene` has checked, by their identity: their values do not change.
_CHECKED: Final[WeakValueDictionary[int, Scene]] = WeakValueDictionary()


def checked_scene(scene: Scene) -> Scene:
    """Return the scene after a check that it, and all its parts, hold valid values.

    Scenes are checked when they are made. The second check, of one scene once, is for values that were changed past
    the first, so that nothing is certified that no scene can be.

    Raises:
        OptionError: It is no scene.
        SceneError: A value of the wrong kind or range.
    """
    instance("scene", scene, Scene, "load_scene")
    if _CHECKED.get(id(scene)) is not scene:
        check_values(scene)
        _CHECKED[id(scene)] = scene
    return scene


def hanging_from(obstacles: Iterable[Obstacle], fruits: Iterable[Fruit]) -> tuple[Fruit, ...]:
    """Fruits that hang from those of the obstacles alone from which they hung."""
    wood = {obstacle.name for obstacle in obstacles}
    return tuple(
        fruit
        if wood.issuperset(fruit.hangs_from)
        else fruit.copy_unchecked({"hangs_from": tuple(name for name in fruit.hangs_from if name in wood)})
        for fruit in fruits
    )


def _apart(solid: Solid, point: FloatArray) -> float:
    """How far a point is from a ball about a solid [m]."""
    middle = 0.5 * (solid.core.min(axis=0) + solid.core.max(axis=0))
    size = float(np.linalg.norm(solid.core - middle, axis=1).max()) + solid.rounding
    return float(np.linalg.norm(middle - point)) - size
