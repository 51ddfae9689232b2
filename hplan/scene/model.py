"""The scene: obstacles, fruit, start and goal.

A scene is immutable; `with_` returns a checked copy with other values, `with_obstacles` one with other obstacles. The
classes are also the schema of the scene file (`hplan.scene.file`). The arm keeps its clearance from an obstacle's
`solids`: the obstacle itself, or the hulls of a mesh (`hplan.geometry.hull`) or a cloud (`hplan.geometry.cloud`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal, Self
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, Field, ValidationInfo, model_validator

from hplan.base.arguments import instance, list_of, nearest_name, number
from hplan.base.arrays import FloatArray, numbers
from hplan.base.checked import StrictModel, check_values, fault
from hplan.errors import InputError, MovingObstacleError, SceneError
from hplan.geometry.cloud import Cloud
from hplan.geometry.hull import Hull
from hplan.geometry.rotation import quaternion_rotation, rpy_rotation
from hplan.scene.attached import Attached
from hplan.scene.fruit import Fruit
from hplan.scene.imports import Import, flatten_imports
from hplan.scene.limb_contacts import as_rigid, contact_solids, limbs_of
from hplan.scene.limbs import find_parents
from hplan.scene.limits import FARTHEST_M, MOST_ATTACHED, MOST_OBSTACLES, Vector
from hplan.scene.obstacle_kind import (
    CovarianceField,
    Name,
    TrackField,
    largest_deviation,
    transform_fields,
    turned_covariance,
)
from hplan.scene.obstacles import AnyObstacle, Capsule, Obstacle, Solid, Sphere
from hplan.scene.robot_source import RobotField
from hplan.scene.tracks import Movement, Poses, Sway
from hplan.scene.upright import Upright
from hplan.scene.wood import Wood, limits_by_segment

#: Format of scene files, the value of their key `format`.
FORMAT: Final = "hplan-scene/1"

#: An angle up to half a turn [deg].
Angle = Annotated[float, Field(ge=0.0, le=180.0)]

#: Rotation of the base off the vertical that counts as none [rad].
LEVEL: Final = 1e-6

#: Tolerance of a quaternion's norm about 1; quaternions are normalized.
QUATERNION_LENGTH: Final = 1e-3


if TYPE_CHECKING:
    _Listed = Obstacle
else:  # an import gives way to its obstacles
    _Listed = Annotated[AnyObstacle | Import, Field(discriminator="kind")]


class JointValues(StrictModel):
    """A configuration: one of `joints_deg`, `joints_rad`, `joints`."""

    joints_deg: tuple[float, ...] | None = None
    joints_rad: tuple[float, ...] | None = None
    joints: Annotated[Mapping[Name, float] | None, Field(exclude=True)] = None

    #: Keys, exactly one must be given.
    _choices: ClassVar[tuple[str, ...]] = ("joints_deg", "joints_rad", "joints")

    @model_validator(mode="after")
    def _one_of(self) -> Self:
        given = [key for key in self._choices if getattr(self, key) is not None]
        if len(given) != 1:
            keys = ", ".join(self._choices)
            raise ValueError(f"give exactly one of {keys}; got {', '.join(given) or 'none'}")
        return self

    @property
    def has_joints(self) -> bool:
        """True if a configuration is given, as a list or by the names of joints."""
        return self.joints is not None or self.listed_joints() is not None

    def listed_joints(self) -> FloatArray | None:
        """Return the configuration [rad] if it is given as a list, or None.

        `hplan.robot.model.Robot.joints_of` reads names of joints, too.
        """
        if self.joints_deg is not None:
            return np.radians(self.joints_deg)
        return None if self.joints_rad is None else np.array(self.joints_rad, dtype=np.float64)

    @property
    def configuration(self) -> FloatArray:
        """The configuration [rad].

        Raises:
            SceneError: The goal is not given by a list of joint values.
        """
        joints = self.listed_joints()
        if joints is None:
            raise SceneError("expected joint values as a list", where="goal")
        return joints


class Start(JointValues):
    """Start of the motion: configuration, optional velocity and acceleration.

    Exactly one of `joints_deg`, `joints_rad` and `joints` is given. Position, velocity and acceleration of the motion
    are continuous at the start.

    Attributes:
        joints_deg: Joint values [deg]; for general robots with prismatic joints use `joints_rad`.
        joints_rad: Joint values [rad or m].
        joints: Joint values by name: `{"rail_m": 0.3, "shoulder_deg": 40}`. A name ends in a unit, `_deg`, `_rad`, `_m`
            or `_mm`, or has none for rad and m. All joints are named.
        contact_depth: Maximum depth of contacts with obstacles at the start, which the arm leaves [m]; 0 for a start
            that is only nearer than the clearance. Links that are too near at the start come no nearer than there (up
            to 0.1 mm) during the motion; at its end all keep the clearance. None if the start keeps it, too.
        velocity_rad_s: Joint velocities [rad/s or m/s]; None for zero.
        acceleration_rad_s2: Joint accelerations [rad/s^2 or m/s^2]; None for zero.

    Examples:
        >>> from hplan.scene import Start
        >>> start = Start(joints_deg=(0.0, 90.0, -90.0, 0.0), velocity_rad_s=(0.1, 0.0, 0.0, 0.0))
        >>> start.is_moving
        True
        >>> start.configuration.round(4).tolist()
        [0.0, 1.5708, -1.5708, 0.0]
    """

    contact_depth: Annotated[float | None, Field(ge=0.0, le=0.05, exclude=True)] = None
    velocity_rad_s: Annotated[tuple[float, ...] | None, Field(exclude=True)] = None
    acceleration_rad_s2: Annotated[tuple[float, ...] | None, Field(exclude=True)] = None

    @model_validator(mode="after")
    def _lengths_agree(self) -> Self:
        joints = self.joints_deg or self.joints_rad or self.joints or ()
        for key, values in self.rates.items():
            if len(values) != len(joints):
                raise fault(f"expected a value for each of {len(joints)} joints, got {len(values)}", key)
        return self

    @property
    def rates(self) -> dict[str, tuple[float, ...]]:
        """Velocity and acceleration by key, if given.

        They are not part of a dump of the scene, so that a start at rest keeps the digest of earlier versions.
        """
        given = {"velocity_rad_s": self.velocity_rad_s, "acceleration_rad_s2": self.acceleration_rad_s2}
        return {key: values for key, values in given.items() if values is not None}

    @property
    def is_moving(self) -> bool:
        """True if a velocity or an acceleration is not zero."""
        return any(any(values) for values in self.rates.values())


class Goal(JointValues):
    """Goal of the motion: joints, tool position, fruit or tool pose.

    Exactly one of `joints_deg`, `joints_rad`, `joints`, `position` and `fruit` is given.

    Attributes:
        joints_deg: Joint values [deg].
        joints_rad: Joint values [rad or m].
        joints: Joint values by name, as for `Start`; joints that are not named keep the start's values.
        position: Position of `tool0` in `base_link` [m].
        fruit: Name of a fruit of the scene.
        approach_deg: Angle, or interval of angles, of the tool axis at a position or fruit (0: outward, 90: up) [deg].
            None for any angle.
        quaternion_xyzw: Orientation of the frame; with `position` it makes a pose, for any robot. None for no pose.
        frame: Name of the frame of a pose; None for the tool frame.
        rotation_tolerance_deg: Maximum rotation of the frame away from the pose, about x, y and z of the pose: the
            components of the rotation vector (axis times angle) [deg]; 180 leaves the rotation free. None for the exact
            orientation.

    Examples:
        >>> from hplan.scene import Goal
        >>> Goal(fruit="apple", approach_deg=(-30.0, 30.0)).approach_deg
        (-30.0, 30.0)
        >>> pose = Goal(position=(0.5, 0.0, 0.4), quaternion_xyzw=(0.0, 0.0, 0.0, 1.0)).pose
        >>> pose[:3, 3].tolist()
        [0.5, 0.0, 0.4]
    """

    position: Vector | None = None
    fruit: str | None = None
    approach_deg: float | tuple[float, float] | None = None
    quaternion_xyzw: Annotated[tuple[float, float, float, float] | None, Field(exclude=True)] = None
    frame: Annotated[Name | None, Field(exclude=True)] = None
    rotation_tolerance_deg: Annotated[tuple[Angle, Angle, Angle] | None, Field(exclude=True)] = None

    _choices: ClassVar[tuple[str, ...]] = ("joints_deg", "joints_rad", "joints", "position", "fruit")

    @model_validator(mode="after")
    def _approach_is_free(self) -> Goal:
        if self.approach_deg is not None and self.has_joints:
            raise ValueError("approach_deg belongs to a position or a fruit; a joint goal fixes the approach angle")
        return self

    @model_validator(mode="after")
    def _pose_is_whole(self) -> Goal:
        if self.quaternion_xyzw is None:
            if self.frame is not None:
                raise fault("frame belongs to a pose: give position and quaternion_xyzw too", "frame")
            if self.rotation_tolerance_deg is not None:
                reason = "rotation_tolerance_deg belongs to a pose: give position and quaternion_xyzw too"
                raise fault(reason, "rotation_tolerance_deg")
            return self
        if self.position is None:
            raise fault("quaternion_xyzw belongs to a position", "quaternion_xyzw")
        if self.approach_deg is not None:
            raise fault("approach_deg and quaternion_xyzw exclude each other", "approach_deg")
        length = math.hypot(*self.quaternion_xyzw)
        if not abs(length - 1.0) <= QUATERNION_LENGTH:
            raise fault(f"expected a quaternion (x, y, z, w) of length 1, got length {length:.6g}", "quaternion_xyzw")
        return self

    @property
    def orientation(self) -> dict[str, Any]:
        """Quaternion, frame and tolerance by key, if given.

        They are not part of a dump of the scene, so that a goal without them keeps the digest of earlier versions.
        """
        given = {key: getattr(self, key) for key in ("quaternion_xyzw", "frame", "rotation_tolerance_deg")}
        return {key: value for key, value in given.items() if value is not None}

    @property
    def rotation_tolerance(self) -> FloatArray | None:
        """(3,) maximum rotation away from the pose, about its axes [rad]; None for the exact orientation."""
        return None if self.rotation_tolerance_deg is None else np.radians(self.rotation_tolerance_deg)

    @property
    def pose(self) -> FloatArray | None:
        """(4, 4) homogeneous matrix of the pose in `base_link`, or None."""
        if self.quaternion_xyzw is None or self.position is None:
            return None
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = quaternion_rotation(self.quaternion_xyzw), self.position
        return pose


class Scene(StrictModel):
    """The environment of the arm and its task.

    Attributes:
        name: Name of the scene.
        robot: The intended robot, for `load_robot`: its name, or its file with options (`RobotSource`; the path of a
            file alone is one without options); None for the default robot. Commands use it unless another robot is
            given, as `load_robot(scene.robot)` does. It is not part of the plan or the certificate.
        start: Start configuration, with velocity and acceleration.
        goal: Goal configuration, tool position, fruit or pose.
        locked_joints: Joints that keep their start value.
        clearance: Minimum distance from every obstacle [m]; compliant obstacles (`yields`) are exempt for links that
            may deflect them.
        yield_links: Names of the links that may deflect compliant obstacles; None for the links of the last two joints.
        wood: Limits of force and stress for limbs (capsules with a `parent`) and the fruit on them; they replace
            `yields` for these. None for none.
        upright: Maximum tilt of the tool during the whole motion; None if it may tilt.
        obstacles: Obstacles.
        fruits: Fruit; obstacles too, except the goal.
        covariance: Covariance of a position error that all obstacles and fruits share, for example of the camera or the
            base; it adds to each one's own covariance [m^2]. None for no shared error.
        base_track: Motion of the base, for example of a platform along the tree row; None for a fixed base. Obstacles
            and their tracks are in the frame of the base without shift; start and goal are in the frame of the moving
            base.
        attached: Objects that the arm holds during the whole motion.

    Examples:
        >>> from hplan.scene import Capsule, Goal, Scene, Start
        >>> post = Capsule(name="post", start=(1.0, 0.5, 0.0), end=(1.0, 0.5, 2.0), radius=0.05)
        >>> start, goal = Start(joints_deg=(0.0, 90.0, 90.0, 90.0)), Goal(joints_deg=(30.0, 45.0, 0.0, 0.0))
        >>> scene = Scene(name="post", start=start, goal=goal, obstacles=(post,), clearance=0.01)
        >>> len(scene.solids), scene.moves
        (1, False)
        >>> scene.with_values(clearance=0.02).clearance
        0.02
    """

    format: Literal["hplan-scene/1"] = FORMAT
    name: Name
    robot: Annotated[RobotField, Field(exclude=True)] = None  # not in the digest: the robot has its own
    start: Start
    goal: Goal
    locked_joints: tuple[str, ...] = ()
    clearance: Annotated[float, Field(ge=0.0, le=FARTHEST_M)] = 0.0
    obstacles: Annotated[tuple[_Listed, ...], AfterValidator(flatten_imports), Field(max_length=MOST_OBSTACLES)] = ()
    fruits: Annotated[tuple[Fruit, ...], Field(max_length=MOST_OBSTACLES)] = ()
    base_track: TrackField = None
    covariance: CovarianceField = None
    yield_links: Annotated[tuple[Name, ...] | None, Field(exclude=True)] = None
    wood: Annotated[Wood | None, Field(exclude=True)] = None
    attached: Annotated[tuple[Attached, ...], Field(max_length=MOST_ATTACHED, exclude=True)] = ()
    upright: Annotated[Upright | None, Field(exclude=True)] = None

    @model_validator(mode="after")
    def _names_are_unique(self) -> Scene:
        seen: set[str] = set()
        for key, items in (("obstacles", self.obstacles), ("fruits", self.fruits), ("attached", self.attached)):
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
        self._check_limbs()
        return self

    @model_validator(mode="after")
    def _is_certain_where_needed(self) -> Scene:
        """Refuse a drift of the base, whose motion is known, and of the goal fruit, whose place of rest must be."""
        if self.base_track is not None and self.base_track.drift is not None:
            raise fault("expected none: a base_track is exact; give the obstacles drifts", "base_track", "drift")
        for index, fruit in enumerate(self.fruits):
            if fruit.name == self.goal.fruit and fruit.track is not None and fruit.track.drift is not None:
                message = "expected none for the goal fruit: it is touched where its track ends; use sigma"
                raise fault(message, "fruits", index, "track", "drift")
        return self

    @model_validator(mode="after")
    def _base_is_level(self) -> Scene:
        """Refuse a base that tilts below a tool that has to stay upright: its tilt is measured in `base_link`."""
        if self.upright is not None and self.base_track is not None:
            base = Poses.from_track(self.base_track)
            leans = 1.0 - base.rotations[:, 2, 2], np.abs(base.turns[:, :2]).ravel()
            if max(float(lean.max()) for lean in leans) > LEVEL:
                raise fault(
                    "the base tilts on its track; an upright tool needs a base that turns about z only", "upright"
                )
        return self

    @model_validator(mode="after")
    def _limits_have_limbs(self, info: ValidationInfo) -> Scene:
        """Check the names of limits where a scene is read: later, its obstacles may be removed."""
        unknown = self._unknown_limits if "folder" in (info.context or {}) else None
        if unknown is not None:
            raise fault(f"{unknown[1]!r} is the name of no limb or fruit", "wood", "limits", unknown[0], "names")
        return self

    @property
    def _unknown_limits(self) -> tuple[int, str] | None:
        """Number and name of the first limits of wood that are for no limb or fruit; None without any."""
        if self.wood is None or not self.wood.limits:
            return None
        return self.wood.unknown_limits([*limbs_of(self.obstacles, self.wood).names, *(f.name for f in self.fruits)])

    def _check_limbs(self) -> None:
        """Check that parents are capsules of the scene, and that no limb is its own ancestor."""
        capsules = {obstacle.name for obstacle in self.obstacles if isinstance(obstacle, Capsule)}
        grown = [(i, o.parent) for i, o in enumerate(self.obstacles) if isinstance(o, Capsule) and o.parent is not None]
        for index, parent in grown:
            if parent not in capsules:
                raise fault(f"{parent!r} is not among the capsules", "obstacles", index, "parent")
        if self.wood is not None and not grown:
            how = "with_limbs(scene, wood) finds them, or --contact-force" if capsules else "the scene has no capsules"
            raise fault(f"no capsule has a parent; {how}", "wood")
        if grown and self.wood is not None:
            limits_by_segment(limbs_of(self.obstacles, self.wood), self.wood)

    @property
    def goal_fruit(self) -> Fruit | None:
        """The fruit that is the goal; None for another kind of goal."""
        return next((fruit for fruit in self.fruits if fruit.name == self.goal.fruit), None)

    @property
    def resting_goal_fruit(self) -> tuple[Fruit, float] | None:
        """The goal fruit at its last pose relative to the base, and the time from which it rests there [s].

        The time is -inf if it never moves; None for another kind of goal.
        """
        for item, movement in self._listed_movements():
            if isinstance(item, Fruit) and item.name == self.goal.fruit:
                if movement is None:
                    return item, -math.inf
                rotations, shifts = movement.displacement_at(movement.breaks[-1:])
                return item.copy_unchecked(transform_fields(item, rotations[0], shifts[0])), float(movement.breaks[-1])
        return None

    @property
    def gives_way(self) -> bool:
        """True if an obstacle, a fruit or an attached branch is compliant."""
        items = (*self.obstacles, *self.fruits)
        return self.wood is not None or any(item.yields for item in items) or any(f.hangs_from for f in self.fruits)

    @property
    def moves(self) -> bool:
        """True if the base or an obstacle has a track."""
        return self.base_track is not None or self.first_moving is not None

    @property
    def first_moving(self) -> str | None:
        """Name of the first obstacle or fruit with a track, or None."""
        return next((item.name for item in (*self.obstacles, *self.fruits) if item.track is not None), None)

    @property
    def without_goal_fruit(self) -> Scene:
        """The scene in which any fruit may be the goal, as for tours; its goal is none."""
        return self.copy_unchecked({"goal": self.goal.copy_unchecked({"fruit": None})}) if self.goal.fruit else self

    @property
    def surroundings(self) -> tuple[Any, ...]:
        """All values but the name and the task (start, goal and locked joints)."""
        task = "name", "start", "goal", "locked_joints"
        return tuple(getattr(self, key) for key in type(self).model_fields if key not in task)

    @property
    def solids(self) -> tuple[Solid, ...]:
        """Solids that the arm must avoid: obstacles and fruits except the goal.

        Solids of one obstacle share its name and are consecutive.

        Raises:
            MovingObstacleError: The base or an obstacle has a track.
        """
        return tuple(solid for solid in self.solids_with_goal if solid.name != self.goal.fruit)

    @property
    def solids_with_goal(self) -> tuple[Solid, ...]:
        """Solids of all obstacles and fruits, including the goal fruit.

        Raises:
            MovingObstacleError: The base or an obstacle has a track.
        """
        if self.moves:
            raise MovingObstacleError(self.first_moving)
        return self.listed_solids

    @property
    def listed_solids(self) -> tuple[Solid, ...]:
        """Solids of all obstacles and fruits at their listed positions.

        Tracks are ignored; `movements` has them.
        """
        listed = tuple(solid for _, solids in self._solids_of_items() for solid in solids)
        if self.covariance is None:
            return listed
        sigmas = {name: largest_deviation(error + self.shared_error) for name, error in self.errors.items()}
        return tuple(
            replace(solid, sigma=sigmas[solid.name])
            if isinstance(solid, Hull | Cloud)
            else solid.copy_unchecked({"sigma": sigmas[solid.name]})
            for solid in listed
        )

    def _solids_of_items(self) -> Iterator[tuple[Obstacle | Fruit, tuple[Solid, ...]]]:
        """Obstacles and fruits, each with its solids."""
        bending = {} if self.wood is None else contact_solids(self.obstacles, self.fruits, self.wood)
        for obstacle in self.obstacles:
            yield obstacle, bending.get(obstacle.name) or obstacle.solids
        for f in self.fruits:
            solids = bending.get(f.name)
            if solids is not None and f.name == self.goal.fruit:
                # A fruit that swings after a push would not be where the hand closes.
                solids = as_rigid(solids)
            yield f, solids or _ball_of(f.name, f.center, f.radius, f.sigma, f.sway, f.yields).solids

    @property
    def errors(self) -> dict[str, FloatArray]:
        """(3, 3) position covariance of each obstacle and fruit, by name [m^2].

        The shared error is not included.
        """
        return {item.name: item.place_covariance for item in (*self.obstacles, *self.fruits)}

    @property
    def shared_error(self) -> FloatArray:
        """(3, 3) covariance of the position error shared by all obstacles [m^2]."""
        return np.zeros((3, 3)) if self.covariance is None else np.array(self.covariance)

    @property
    def movements(self) -> tuple[Movement | None, ...]:
        """Movement of each of `listed_solids` relative to the base, or None.

        None is a solid that does not move relative to the base.
        """
        found: list[Movement | None] = []
        for (_, movement), (_, solids) in zip(self._listed_movements(), self._solids_of_items(), strict=True):
            found += [movement] * len(solids)
        return tuple(found)

    def _listed_movements(self) -> Iterator[tuple[Obstacle | Fruit, Movement | None]]:
        """Iterate over obstacles and fruits with their movement relative to the base.

        Those without a track share one movement.
        """
        still = None if self.base_track is None else Movement.relative_to(None, self.base_track)
        for item in (*self.obstacles, *self.fruits):
            yield item, still if item.track is None else Movement.relative_to(item.track, self.base_track)

    @property
    def at_rest_s(self) -> float:
        """Time after which the scene is static, 0 if always [s]."""
        tracks = (self.base_track, *(item.track for item in (*self.obstacles, *self.fruits)))
        return max((track.times_s[-1] for track in tracks if track is not None), default=0.0)

    def poses_at(self, times_s: ArrayLike) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Poses of the moving obstacles at given times, relative to the base.

        Args:
            times_s: (k,) times [s].

        Returns:
            For each moving obstacle and fruit, by name, (k, 3, 3) rotations R and (k, 3) shifts s [m]: its listed point
            x is at R x + s.

        Raises:
            InputError: `times_s` is not a list of finite numbers.

        Examples:
            >>> from hplan.scene import Goal, Scene, Sphere, Start, Track
            >>> track = Track(times_s=(0.0, 2.0), shifts_m=((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
            >>> cart = Sphere(name="cart", center=(1.0, 0.0, 0.0), radius=0.3, track=track)
            >>> rest = (0.0, 90.0, 90.0, 90.0)
            >>> scene = Scene(name="cart", start=Start(joints_deg=rest), goal=Goal(joints_deg=rest), obstacles=(cart,))
            >>> rotations, shifts = scene.poses_at([1.0])["cart"]
            >>> shifts.tolist()
            [[0.0, 0.5, 0.0]]
            >>> scene.snapshot(1.0).obstacles[0].center
            (1.0, 0.5, 0.0)
        """
        clock = numbers("times_s", times_s, (None,))
        listed = self._listed_movements()
        return {item.name: movement.displacement_at(clock) for item, movement in listed if movement is not None}

    def snapshot(self, time_s: float) -> Scene:
        """Static snapshot of the scene at a time [s].

        Raises:
            InputError: `time_s` is not a finite number.
        """
        poses = {name: (turns[0], shifts[0]) for name, (turns, shifts) in self.poses_at([time_s]).items()}
        changed = self._change_each(
            lambda item: transform_fields(item, *poses[item.name]) if item.name in poses else {}
        )
        return self.copy_unchecked(changed | {"base_track": None})

    def starting_at(self, time_s: float) -> Scene:
        """Scene whose tracks count time from `time_s` on [s].

        The new scene at time `t - time_s` equals this scene at time t, also for negative times. So a motion that starts
        at `time_s` is certified in the new scene as in this one with `certify(..., begin_s=time_s)`.

        Raises:
            OptionError: `time_s` is not finite, or so large that times of a track would coincide.
        """
        number("time_s", time_s, "a finite number of seconds")
        if time_s == 0.0 or not self.moves:
            return self
        changed = self._change_each(
            lambda item: {} if item.track is None else {"track": item.track.starting_at(time_s)}
        )
        base_track = None if self.base_track is None else self.base_track.starting_at(time_s)
        return self.copy_unchecked(changed | {"base_track": base_track})

    def _change_each(self, changes: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """Return obstacles and fruits with changed values."""
        found: dict[str, Any] = {}
        for key in ("obstacles", "fruits"):
            pairs = [(item, changes(item)) for item in getattr(self, key)]
            found[key] = tuple(item.copy_unchecked(update) if update else item for item, update in pairs)
        return found

    def shift(self, shift: ArrayLike, yaw_deg: float = 0.0) -> Scene:
        """Rotate the scene about the base's z axis, then shift it.

        It is the scene as seen from a base at another place. Obstacles, fruits and a position or pose goal are
        transformed and keep their names; the start and a goal given by joints stay.

        Args:
            shift: (3,) shift [m].
            yaw_deg: Rotation before the shift [deg].

        Raises:
            InputError: `shift` is not three finite numbers.
            OptionError: `yaw_deg` is not finite.
            MovingObstacleError: The base or an obstacle has a track.

        Examples:
            >>> from hplan.scene import Goal, Scene, Sphere, Start
            >>> ball = Sphere(name="ball", center=(1.0, 0.0, 1.0), radius=0.1)
            >>> start, goal = Start(joints_deg=(0.0, 90.0, 90.0, 90.0)), Goal(position=(1.0, 0.0, 1.5))
            >>> scene = Scene(name="ball", start=start, goal=goal, obstacles=(ball,))
            >>> shifted = scene.shift((0.0, 0.5, 0.0))
            >>> shifted.obstacles[0].center, shifted.goal.position
            ((1.0, 0.5, 1.0), (1.0, 0.5, 1.5))
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
        update = self._change_each(lambda item: transform_fields(item, turn, by)) | {"goal": goal}
        if self.covariance is not None:
            update["covariance"] = turned_covariance(self.covariance, turn)
        return self.copy_unchecked(update)

    def crop(self, reach: float, centre: ArrayLike = (0.0, 0.0, 0.0)) -> Scene:
        """Remove static obstacles and fruits farther than `reach` from a point.

        Moving obstacles and the goal fruit stay. An obstacle's distance is measured to its bounding ball. A certificate
        for the cropped scene says nothing about the removed obstacles: choose a radius beyond the arm's reach.

        Args:
            reach: Radius of the kept region [m].
            centre: (3,) centre of the kept region [m].

        Raises:
            InputError: `centre` is not three finite numbers.
            OptionError: `reach` is negative or not finite.

        Examples:
            >>> from hplan.scene import Goal, Scene, Sphere, Start
            >>> balls = [Sphere(name=f"ball {x}", center=(x, 0.0, 1.0), radius=0.1) for x in (1.0, 9.0)]
            >>> rest = (0.0, 90.0, 90.0, 90.0)
            >>> scene = Scene(name="balls", start=Start(joints_deg=rest), goal=Goal(joints_deg=rest), obstacles=balls)
            >>> [obstacle.name for obstacle in scene.crop(3.0).obstacles]
            ['ball 1.0']
        """
        point = numbers("centre", centre, (3,))
        number("reach", reach, "a finite number of metres >= 0", lambda value: value >= 0.0)
        obstacles = tuple(
            item
            for item in self.obstacles
            if item.track is not None or any(_ball_distance(solid, point) <= reach for solid in item.solids)
        )
        fruits = tuple(
            fruit
            for fruit in self.fruits
            if fruit.track is not None
            or fruit.name == self.goal.fruit
            or math.dist(fruit.center, point) - fruit.radius <= reach
        )
        return self.copy_unchecked({"obstacles": growing_from(obstacles), "fruits": hanging_from(obstacles, fruits)})

    def with_obstacles(self, obstacles: Sequence[AnyObstacle]) -> Scene:
        """Return a checked copy with other obstacles.

        Fruits keep attachments to obstacles that remain.

        Raises:
            InputError: `obstacles` is not a list of obstacles, or two have the same name.

        Examples:
            >>> from hplan.scene import Sphere, load_scene
            >>> ball = Sphere(name="ball", center=(1.0, 0.0, 1.0), radius=0.1)
            >>> len(load_scene().with_obstacles([ball]).obstacles)
            1
        """
        obstacles = list_of("obstacles", obstacles, AnyObstacle, "obstacles")
        parts = {key: getattr(self, key) for key in type(self).model_fields}
        parts |= {"obstacles": growing_from(obstacles), "fruits": hanging_from(obstacles, self.fruits)}
        return Scene.model_validate(parts)

    def with_attached(self, attached: Sequence[Attached]) -> Scene:
        """Return a checked copy with other objects in the arm's hand.

        Raises:
            InputError: `attached` is not a list of `Attached`.
            SceneError: A name occurs twice, or is that of an obstacle or fruit.

        Examples:
            >>> from hplan.scene import Attached, Box, load_scene
            >>> crate = Box(name="crate", center=(0.1, 0.0, 0.0), size=(0.1, 0.1, 0.1))
            >>> scene = load_scene().with_attached([Attached(object=crate, mass=0.5)])
            >>> [item.name for item in scene.attached]
            ['crate']
        """
        return self.with_values(attached=list_of("attached", attached, Attached, "held objects"))

    def pick_up(self, name: str, pose: ArrayLike, **held: Any) -> Scene:
        """Return a checked copy in which the arm holds an obstacle or fruit, where it is.

        Args:
            name: Name of the obstacle or fruit.
            pose: (4, 4) pose of the frame that holds it, in `base_link` [m].
            held: Values of `Attached` besides the object: `frame`, `mass`, `may_touch`.

        Raises:
            InputError: There is no such obstacle or fruit, or `pose` is not a (4, 4) matrix.
            SceneError: It has a track, a sway, a deflection or an uncertain position.

        Examples:
            >>> import numpy as np
            >>> from hplan.scene import Sphere, load_scene
            >>> pear = Sphere(name="pear", center=(1.0, 0.0, 1.0), radius=0.04)
            >>> pose = np.eye(4)
            >>> pose[:3, 3] = 1.0, 0.0, 0.9
            >>> scene = load_scene().with_obstacles([pear]).pick_up("pear", pose, mass=0.2)
            >>> np.round(scene.attached[0].object.center, 9).tolist()
            [0.0, 0.0, 0.1]
            >>> scene.put_down("pear", pose).obstacles[0].center
            (1.0, 0.0, 1.0)
        """
        matrix = numbers("pose", pose, (4, 4))
        items = {item.name: item for item in (*self.obstacles, *self.fruits)}
        if name not in items:
            raise InputError(f"no obstacle or fruit {name!r}; {nearest_name(name, items)}", name=name)
        item = items[name]
        if item.track is not None:
            raise SceneError(f"{name!r} has a track; an object that is picked up is at rest", where=name)
        shape: AnyObstacle = (
            Sphere(name=name, center=item.center, radius=item.radius) if isinstance(item, Fruit) else item
        )
        rotation, position = matrix[:3, :3].T, -matrix[:3, :3].T @ matrix[:3, 3]
        moved = shape.with_values(**transform_fields(shape, rotation, position))
        rest = growing_from(item for item in self.obstacles if item.name != name)
        fruits = hanging_from(rest, (fruit for fruit in self.fruits if fruit.name != name))
        attached = (*self.attached, Attached(object=moved, **held))
        return self.with_values(obstacles=rest, fruits=fruits, attached=attached)

    def put_down(self, name: str, pose: ArrayLike) -> Scene:
        """Return a checked copy in which a held object is an obstacle, where it is.

        Args:
            name: Name of the held object.
            pose: (4, 4) pose of the frame that held it, in `base_link` [m].

        Raises:
            InputError: The arm holds no such object, or `pose` is not a (4, 4) matrix.
        """
        matrix = numbers("pose", pose, (4, 4))
        item = next((item for item in self.attached if item.name == name), None)
        if item is None:
            names = [item.name for item in self.attached]
            raise InputError(f"no held object {name!r}; {nearest_name(name, names)}", name=name)
        fields = transform_fields(item.object, matrix[:3, :3], matrix[:3, 3])
        placed = item.object.with_values(**fields)
        left = tuple(each for each in self.attached if each is not item)
        return self.with_values(obstacles=(*self.obstacles, placed), attached=left)


#: Scenes that `checked_scene` has checked, by id: their values do not change.
_CHECKED: Final[WeakValueDictionary[int, Scene]] = WeakValueDictionary()


def checked_scene(scene: Scene) -> Scene:
    """Return the scene after a check of all its values.

    The constructor checks scenes already. This second check, once per scene, finds values that were changed by
    bypassing the first, so that no invalid scene is certified.

    Raises:
        OptionError: `scene` is not a `Scene`.
        SceneError: A value has the wrong type or range.
    """
    instance("scene", scene, Scene, "load_scene")
    if _CHECKED.get(id(scene)) is not scene:
        check_values(scene)
        _CHECKED[id(scene)] = scene
    return scene


def hanging_from(obstacles: Iterable[Obstacle], fruits: Iterable[Fruit]) -> tuple[Fruit, ...]:
    """Fruits with attachments restricted to the listed obstacles."""
    wood = {obstacle.name for obstacle in obstacles}
    return tuple(
        fruit
        if wood.issuperset(fruit.hangs_from)
        else fruit.copy_unchecked({"hangs_from": tuple(name for name in fruit.hangs_from if name in wood)})
        for fruit in fruits
    )


def growing_from(obstacles: Iterable[Obstacle]) -> tuple[Obstacle, ...]:
    """Obstacles of which none grows from a capsule that is not listed.

    A limb without its parent is clamped at its start, so it counts as stiffer.
    """
    obstacles = tuple(obstacles)
    capsules = {obstacle.name for obstacle in obstacles if isinstance(obstacle, Capsule)}
    return tuple(
        obstacle.copy_unchecked({"parent": None})
        if isinstance(obstacle, Capsule) and obstacle.parent is not None and obstacle.parent not in capsules
        else obstacle
        for obstacle in obstacles
    )


def with_limbs(scene: Scene, wood: Wood | None = None) -> Scene:
    """Return a scene whose wood bends: parents of the limbs found, and limits of force and stress.

    Parents are found by `hplan.scene.limbs.find_parents` unless a capsule has one already. Capsules that are named wire
    or post are no limbs.

    Args:
        scene: A scene with trees of capsules.
        wood: Limits and properties; None for the scene's own, or the defaults.

    Raises:
        SceneError: No two capsules touch each other, or `wood.limits` names no limb or fruit.

    Examples:
        >>> from hplan.scene import load_scene, with_limbs
        >>> scene = with_limbs(load_scene("orchard-row"))
        >>> next(obstacle.parent for obstacle in scene.obstacles if obstacle.name == "tree 1 branch 1")
        'tree 1 trunk 2'
        >>> scene.wood.contact_force
        10.0
    """
    instance("scene", scene, Scene, "load_scene")
    obstacles = scene.obstacles
    if not any(isinstance(piece, Capsule) and piece.parent is not None for piece in obstacles):
        trees = [piece for piece in obstacles if isinstance(piece, Capsule) and not is_trellis(piece.name)]
        parents = find_parents(trees)
        obstacles = tuple(
            piece.copy_unchecked({"parent": parents[piece.name]}) if piece.name in parents else piece
            for piece in obstacles
        )
    wood = scene.wood or Wood() if wood is None else instance("wood", wood, Wood)
    found = scene.with_values(obstacles=obstacles, wood=wood)
    unknown = found._unknown_limits
    if unknown is not None:
        where = f"wood.limits[{unknown[0]}].names"
        raise SceneError(f"{unknown[1]!r} is the name of no limb or fruit", where=where, value=unknown[1])
    return found


def is_trellis(name: str) -> bool:
    """True for names of wires and posts."""
    return not {"wire", "post"}.isdisjoint(name.lower().split())


@lru_cache(maxsize=1024)
def _ball_of(name: str, center: Vector, radius: float, sigma: float, sway: Sway | None, yields: float) -> Sphere:
    """A fruit as an obstacle; kept, since every replan asks for the balls of the same fruit."""
    return Sphere(name=name, center=center, radius=radius, sigma=sigma, sway=sway, yields=yields)


def _ball_distance(solid: Solid, point: FloatArray) -> float:
    """Distance of a point from the bounding ball of a solid [m]."""
    middle = 0.5 * (solid.core.min(axis=0) + solid.core.max(axis=0))
    size = float(np.linalg.norm(solid.core - middle, axis=1).max()) + solid.rounding
    return float(np.linalg.norm(middle - point)) - size
