"""Robot model: a tree of revolute, continuous and prismatic joints.

Pinocchio reads joints, axes, bodies and limits from the files. Acceleration and jerk limits, which URDF cannot express,
are read from a limits YAML in the same folder.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeVar, overload

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.base.arguments import (
    check_between,
    check_each,
    file_path,
    folder_path,
    instance,
    list_of,
    nearest_name,
    number,
    truth,
)
from hplan.base.arrays import BoolArray, FloatArray, Record, as_array, numbers, readonly
from hplan.base.files import is_file
from hplan.base.units import FARTHEST_JOINT, NAME_UNITS, JointUnit, joint_unit
from hplan.errors import (
    InputError,
    JointLimitError,
    MissingVisualWarning,
    OptionError,
    RobotFileError,
    RobotFileWarning,
    UncoveredLinkWarning,
)
from hplan.robot.drawn_links import ShapeFault, describe_shape_faults, find_shape_faults
from hplan.robot.dynamics import InverseDynamics, joints_that_slide
from hplan.robot.files import (
    build_models,
    filtered_links,
    neighbouring_links,
    read_group,
    read_group_state,
    read_srdf,
    robot_files,
)
from hplan.robot.limits_file import default_limits, find_limits, limits_file
from hplan.robot.mesh_files import MeshFinder
from hplan.robot.tool_axis import find_tool_axis
from hplan.robot.tool_tube import add_tool_tube
from hplan.robot.urdf_adaptation import AdaptedUrdf, RobotChoice, adapt_urdf
from hplan.robot.urdf_check import check_joints, frame_number
from hplan.robot.urdf_xml import URDF_TEXT, is_urdf_text, read_urdf_xml
from hplan.robot.xml_element import Element
from hplan.scene.robot_source import RobotSource

if TYPE_CHECKING:
    from hplan.scene.attached import Attached
    from hplan.scene.model import JointValues, Start

#: Excess of a joint limit that is permitted at the start of a motion, as encoders and rounding cause it [rad or m].
START_TOLERANCE = 1e-4

_T = TypeVar("_T")
_P = ParamSpec("_P")


@dataclass(frozen=True, eq=False)
class Robot(Record):
    """Robot: Pinocchio models and joint limits.

    Attributes:
        name: Name in the URDF.
        urdf_path: File it was read from.
        model: Pinocchio's kinematic and inertial model.
        collision_model: Collision geometry.
        visual_model: Visual geometry.
        joint_names: Names of the `dof` joints, base first, in the order of Pinocchio's model.
        tool_frame: Name of the frame at the end of the arm.
        lower: (dof,) lower joint limits.
        upper: (dof,) upper joint limits.
        velocity_limit: (dof,) [rad/s].
        acceleration_limit: (dof,) [rad/s^2].
        torque_limit: (dof,) [N m].
        jerk_limit: (dof,) [rad/s^3]; None if the limits file has no jerk limits.
        continuous: (dof,) True for a joint without limits in the URDF, or with limits beyond 1e3 rad on both sides; its
            range is a whole turn to either side, about where it is (`about`).
        held: Values of the URDF's fixed and held joints by name [rad, m]; None for joints of several coordinates.
        urdf_text: URDF that the models were built from, if it differs from the file's content.
        may_touch: Pairs of links that may touch, with the reason: SRDF, Drake filter groups, or neighbouring links.
        owners: Arm of each link by link name, for several arms joined to one robot; empty for a single robot.
        assumptions: Values that no file gives, and what was assumed instead.
        turns: (dof,) whole turns by which the ranges of continuous joints are shifted (`about`); empty for none.
        shape_faults: Drawn links whose collision shapes are missing or do not fit (`hplan.robot.drawn_links`).
        attached: Objects that it holds, part of its models (`hplan.collision.held_objects`); empty for none.
        without_attached: The robot as loaded, without these objects; None if it holds none.
    """

    name: str
    urdf_path: Path
    model: pin.Model
    collision_model: pin.GeometryModel
    visual_model: pin.GeometryModel
    joint_names: tuple[str, ...]
    tool_frame: str
    lower: FloatArray
    upper: FloatArray
    velocity_limit: FloatArray
    acceleration_limit: FloatArray
    torque_limit: FloatArray
    jerk_limit: FloatArray | None
    continuous: BoolArray
    held: Mapping[str, float | None]
    urdf_text: str | None
    may_touch: tuple[tuple[str, str, str], ...] = ()
    owners: Mapping[str, str] = field(default_factory=dict)
    shape_faults: tuple[ShapeFault, ...] = ()
    assumptions: tuple[str, ...] = ()
    turns: tuple[float, ...] = ()
    attached: tuple[Attached, ...] = ()
    without_attached: Robot | None = None

    def __repr__(self) -> str:
        joints = ", ".join(self.joint_names)
        return f"<Robot {self.name!r}: {self.dof} joints ({joints}), tool frame {self.tool_frame!r}>"

    def owner_of(self, link: str) -> str | None:
        """Name of the arm that a link belongs to.

        None for a single robot or an unknown link.

        Several arms joined to one robot (`hplan.robot.several`) each own the links of their URDF.
        """
        return self.owners.get(link)

    def link_in_words(self, link: str) -> str:
        """Name of a link or held object for messages.

        Includes its arm for a multi-arm robot.
        """
        if link in {item.name for item in self.attached}:
            return f"held object {link!r}"
        arm = self.owner_of(link)
        return f"link {link!r}" if arm is None else f"link {link.removeprefix(f'{arm}_')!r} of arm {arm!r}"

    @property
    def uncovered_links(self) -> tuple[str, ...]:
        """Names of links with visuals that no collision shape covers.

        Plans and certificates ignore these visuals.
        """
        return tuple(fault.link for fault in self.shape_faults if not fault.is_covered)

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @cached_property
    def slides(self) -> tuple[bool, ...]:
        """True for each prismatic joint.

        Its values are in metres and its effort in newtons.
        """
        return joints_that_slide(self.model)

    @property
    def units(self) -> tuple[JointUnit, ...]:
        """Units in which each joint is read and displayed."""
        return tuple(map(joint_unit, self.slides))

    @cached_property
    def tool_joint(self) -> int:
        """Index of the tool frame's joint in the model; 0 without one."""
        return int(self.model.frames[self.frame_number(self.tool_frame)].parentJoint)

    @cached_property
    def tool_axis(self) -> FloatArray:
        """(3,) pointing direction in the tool frame.

        It is z, or along the last link (`hplan.robot.tool_axis`).
        """
        return find_tool_axis(self.model, self.frame_number(self.tool_frame))

    @cached_property
    def _cache(self) -> dict[Hashable, Any]:
        return {}

    def cache(self, key: Hashable, make: Callable[[], _T]) -> _T:
        """Return `make`'s result, computed once per key.

        For values that depend on the robot alone.
        """
        if key not in self._cache:
            self._cache[key] = make()
        made: _T = self._cache[key]
        return made

    @cached_property
    def dynamics(self) -> InverseDynamics:
        """Inverse dynamics of the model."""
        return InverseDynamics.build(self.model)

    def tool_positions(self, q: ArrayLike) -> FloatArray:
        """Tool positions of configurations, (..., dof) -> (..., 3), in `base_link` [m].

        Raises:
            InputError: `q` is not an (..., dof) array of finite numbers.
        """
        return self.forward_kinematics(q)[..., :3, 3]

    def forward_kinematics(self, q: ArrayLike, frame: str | None = None) -> FloatArray:
        """Poses of a frame in `base_link`, (..., dof) -> (..., 4, 4).

        Args:
            q: (..., dof) configurations.
            frame: Name of the frame; None for the tool frame.

        Raises:
            InputError: The robot has no frame of that name, or `q` is not an (..., dof) array of finite numbers.
        """
        q = numbers("q", q, (..., self.dof), most=FARTHEST_JOINT)
        data, number = self.model.createData(), self.frame_number(self.tool_frame if frame is None else frame)
        poses = np.empty((*q.shape[:-1], 4, 4))
        for place in np.ndindex(q.shape[:-1]):
            pin.framesForwardKinematics(self.model, data, q[place])
            poses[place] = data.oMf[number].homogeneous
        return poses

    def frame_number(self, name: str) -> int:
        """Index in the model of a named frame.

        Prefers the link if several frames share the name.

        Raises:
            InputError: The robot has no frame of that name.
        """
        is_name = isinstance(name, str) and name.isprintable()
        found = frame_number(self.model, name) if is_name else self.model.nframes
        if found == self.model.nframes:
            names = ", ".join(frame.name for frame in self.model.frames if frame.type == pin.FrameType.BODY)
            raise InputError(f"the robot has no frame {name!r}; it has {names}", frame=name)
        return found

    def locked_mask(self, names: Sequence[str]) -> BoolArray:
        """(dof,) mask of the locked joints.

        Raises:
            InputError: A name is not a joint of the robot.
        """
        names = list_of("names", names, str, "names of joints")
        unknown = [name for name in names if name not in self.joint_names]
        if unknown:
            raise InputError(
                f"locked_joints names {unknown[0]!r}; the robot has {', '.join(self.joint_names)}", joint=unknown[0]
            )
        return np.array([name in names for name in self.joint_names], dtype=np.bool_)

    @property
    def loaded(self) -> Robot:
        """The robot as it was loaded: with the ranges of continuous joints about zero.

        For values that whole turns of joints do not change, and that all of these robots share.
        """
        return self.cache("loaded", lambda: self._turned(-np.array(self.turns))) if self.turns else self

    @property
    def bare(self) -> Robot:
        """The robot without the objects that it holds, as it was loaded."""
        return self.without_attached or self.loaded

    def about(self, q: ArrayLike) -> Robot:
        """Return the robot with the ranges of continuous joints shifted by whole turns to those about a configuration.

        A continuous joint reports any angle, for example 6.4 rad after a day of work. Its range is a whole turn to
        either side of the whole turn nearest to it. The robot caches the result; it has the same digest.

        Args:
            q: (dof,) configuration. An invalid one leaves the robot unchanged; `check_configuration` rejects it.

        Examples:
            >>> from hplan import load_robot
            >>> robot = load_robot()
            >>> robot.about([7.0, 0.0, 0.0, 0.0]) is robot  # its yaw has limits
            True
        """
        loaded, values = self.loaded, self._values_to_turn(q)
        if values is None or (np.abs(values) > FARTHEST_JOINT).any():
            return loaded
        return loaded.turned_by(np.where(self.continuous, np.rint(np.round(values / math.tau, 9)), 0.0))

    def turned_by(self, turns: FloatArray) -> Robot:
        """Return the robot with the ranges of its joints shifted by (dof,) whole turns, cached."""
        loaded = self.loaded
        if not turns.any():
            return loaded
        found = loaded.cache(("about", *turns.tolist()), lambda: loaded._turned(turns))
        found.cache("loaded", lambda: loaded)
        return found

    def about_start(self, start: Start) -> tuple[Robot, FloatArray]:
        """Return the robot with ranges about a scene's start (`about`), and the (dof,) start configuration.

        Raises:
            InputError: The start is not a configuration of the robot.
            JointLimitError: The start violates the joint limits.

        Examples:
            >>> from hplan import load_robot, load_scene
            >>> robot, q = load_robot().about_start(load_scene().start)
            >>> q.shape
            (4,)
        """
        given = self.joints_of(start, "start")
        robot = self.about(given)
        return robot, robot.check_configuration(given, "start")

    def _turned(self, turns: FloatArray) -> Robot:
        """The robot with the ranges of its joints shifted by (dof,) whole turns."""
        lower, upper, model = self.lower + math.tau * turns, self.upper + math.tau * turns, self.model.copy()
        model.lowerPositionLimit, model.upperPositionLimit = lower, upper
        after = () if self.turns else tuple(turns.tolist())
        return replace(self, model=model, lower=readonly(lower), upper=readonly(upper), turns=after)

    def turned_near(self, q: ArrayLike, start: ArrayLike) -> ArrayLike:
        """Shift continuous joints by whole turns to the values nearest a start.

        The motion to a goal then takes the short way: from 0, 350 deg becomes -10 deg, and the trajectory continues
        from the start without a jump. Values stay within the limits if any shifted value does. An invalid configuration
        is returned unchanged; `check_configuration` rejects it.

        Args:
            q: (dof,) configuration.
            start: (dof,) configuration.
        """
        values = self._values_to_turn(q)
        if values is None:
            return q
        near = np.asarray(start, dtype=np.float64)
        for joint in np.flatnonzero(self.continuous).tolist():
            first = math.ceil((self.lower[joint] - values[joint] - 1e-9) / math.tau)
            last = math.floor((self.upper[joint] - values[joint] + 1e-9) / math.tau)
            turns = min(max(round((near[joint] - values[joint]) / math.tau), first), last)
            values[joint] += math.tau * turns
        return values

    def _values_to_turn(self, q: ArrayLike) -> FloatArray | None:
        """A copy of a (dof,) configuration; None if it is invalid, or no joint is continuous."""
        try:
            values = np.array(as_array(q))
        except ValueError:
            return None
        usable = values.shape == (self.dof,) and values.dtype.kind in "fiu" and np.isfinite(values).all()
        return values.astype(np.float64) if usable and self.continuous.any() else None

    @overload
    def joints_of(self, values: Start, which: str) -> FloatArray: ...

    @overload
    def joints_of(self, values: JointValues, which: str, start: Start | None = None) -> FloatArray | None: ...

    def joints_of(self, values: JointValues, which: str, start: Start | None = None) -> FloatArray | None:
        """Joint values of a start or goal, unchecked [rad, m].

        None for non-joint goals.

        Args:
            values: A scene's start or goal.
            which: Name of the value for the error.
            start: Start whose values the joints keep that are not named; None if all have to be named.

        Raises:
            InputError: A prismatic joint is given in degrees; a name is of no joint, has another kind of unit, occurs
                twice or is missing.
        """
        if values.joints is not None:
            return self._named_joints(values.joints, which, start)
        if values.joints_deg is not None and any(self.slides):
            name = self.joint_names[self.slides.index(True)]
            raise InputError(
                f"{which}: joints_deg, but joint {name!r} is prismatic; give joints_rad: in radians or metres",
                which=which,
                joint=name,
            )
        return values.listed_joints()

    def _named_joints(self, given: Mapping[str, float], which: str, start: Start | None) -> FloatArray:
        """Joint values by names with units."""
        found: dict[str, float] = {}
        for key, value in given.items():
            name, _, suffix = key.rpartition("_")
            if key in self.joint_names:
                name, factor = key, 1.0
            elif suffix in NAME_UNITS and name in self.joint_names:
                is_length, factor = NAME_UNITS[suffix]
                if is_length != self.slides[self.joint_names.index(name)]:
                    expected = f"{name}_m or {name}_mm" if not is_length else f"{name}_deg or {name}_rad"
                    raise InputError(f"{which}: joints: {key!r} has the wrong unit; expected {expected}", joint=name)
            else:
                plain = name if suffix in NAME_UNITS else key
                raise InputError(f"{which}: joints: {key!r}: {nearest_name(plain, self.joint_names)}", joint=key)
            if name in found:
                raise InputError(f"{which}: joints: joint {name!r} is given twice", joint=name)
            found[name] = factor * value
        missing = [name for name in self.joint_names if name not in found]
        if not missing:
            return np.array([found[name] for name in self.joint_names])
        if start is None:
            raise InputError(f"{which}: joints: no value for {', '.join(missing)}", joint=missing[0])
        kept = self.joints_of(start, "start")
        return np.array([found.get(name, value) for name, value in zip(self.joint_names, kept, strict=True)])

    def check_configuration(self, q: ArrayLike, which: str) -> FloatArray:
        """Return `q` as a read-only (dof,) array.

        Raises:
            InputError: `q` is not a list of numbers, has the wrong number of joints, or has a value that is not finite.
            JointLimitError: `q` exceeds the joint limits by more than 1e-9 rad or m, as `start` by more than
                `START_TOLERANCE`; smaller excesses are clipped.
        """
        expected = f"{which}: expected {self.dof} joint values ({', '.join(self.joint_names)})"
        try:
            values = np.array(as_array(q))
        except ValueError as error:
            raise InputError(f"{expected}, got {q!r}", which=which, expected=self.dof) from error
        if values.shape != (self.dof,):
            got = str(values.size) if values.ndim == 1 else f"an array of shape {values.shape}"
            raise InputError(
                f"{expected}, got {got}; the robot is {self.name!r}",
                which=which,
                expected=self.dof,
                shape=list(values.shape),
            )
        if values.dtype.kind not in "fiu":
            raise InputError(f"{expected}, got {q!r}", which=which, expected=self.dof)
        values = values.astype(np.float64)
        for joint, value in zip(self.joint_names, values, strict=True):
            if not np.isfinite(value):
                raise InputError(
                    f"{which}: joint {joint!r} is at {value}, expected a finite number", which=which, joint=joint
                )
        tolerance = START_TOLERANCE if which == "start" else 1e-9
        fault = self.limit_fault(values, which, tolerance)
        if fault is not None:
            raise fault
        return readonly(np.clip(values, self.lower, self.upper))

    def limit_fault(self, q: FloatArray, which: str, tolerance: float = 1e-9) -> JointLimitError | None:
        """Error for the first joint outside its limits, or None.

        If the values would be within the limits when read as degrees, the error says so.

        Args:
            q: (dof,) configuration.
            which: Name of the configuration, for the error.
            tolerance: Excess that is permitted [rad or m].
        """
        outside = ~((self.lower - tolerance <= q) & (q <= self.upper + tolerance))
        if not outside.any():
            return None
        first = int(outside.argmax())
        value, lower, upper = (float(values[first]) for values in (q, self.lower, self.upper))
        found = JointLimitError(which, self.joint_names[first], value, lower, upper, self.units[first].position)
        turning = ~np.array(self.slides)
        in_degrees = np.where(turning, np.radians(q), q)
        fits = (self.lower - 1e-9 <= in_degrees) & (in_degrees <= self.upper + 1e-9)
        if turning[first] and abs(value) > math.tau and fits.all():
            found.add("are these degrees? Joint values are in radians: np.radians(q)")
        return found


def made_once(make: Callable[Concatenate[Robot, _P], _T]) -> Callable[Concatenate[Robot, _P], _T]:
    """Decorator that caches a function per robot and hashable arguments."""
    defaults = getattr(make, "__defaults__", None) or ()

    @wraps(make)
    def read_cache(robot: Robot, /, *given: _P.args, **named: _P.kwargs) -> _T:
        key = (make, *given, *defaults[len(given) :], *named.items())
        return robot.cache(key, lambda: make(robot, *given, **named))

    return read_cache


def load_robot(
    path: Path | str | RobotSource | None = None,
    *,
    limits: Path | str | None = None,
    tool_frame: str | None = None,
    tool_tube_m: float | None = None,
    joints: Sequence[str] | None = None,
    hold: Mapping[str, float] | None = None,
    package_dirs: Sequence[Path | str] = (),
    srdf: Path | str | None = None,
    allow_neighbours: bool = False,
    collision_from_visual: bool | Sequence[str] = False,
    xacro_args: Mapping[str, str] | None = None,
    acceleration_scale: float | None = None,
    group: str | None = None,
    group_state: str | None = None,
    repair_inertia: bool = False,
) -> Robot:
    """Load a robot from URDF, xacro or MJCF.

    Joints that do not move become fixed.

    Args:
        path: URDF, xacro or MJCF file (`hplan.robot.mjcf`, extra `execution`), or the text itself (begins with `<`);
            None for the harvester that ships with hplan. A name without suffix and folder that is not a file selects a
            robot that ships with hplan, `load_robot("orchard_harvester")`, or one of example-robot-data (extra
            `robots`): `panda`, `ur3`, `ur5`, `ur10`; `robot_descriptions:NAME` one of the package robot_descriptions. A
            `RobotSource`, as `scene.robot`, is a file with values for the following arguments; those that are given
            have priority.
        limits: Limits YAML, or the name of a robot whose limits ship with hplan, for example `ur5`; None for
            `NAME.limits.yaml` in the URDF's folder or, without that file, for acceleration and jerk in the URDF (1.2).
            Velocities and efforts in it take the place of the URDF's. MoveIt's `joint_limits.yaml` is read as well.
        tool_frame: Frame at the end of the arm; None for the default of a robot loaded by name, else for `tool0` or,
            without it, for the only frame without a body at the end of the arm.
        tool_tube_m: Length of a picking tube that is added at the tool frame, along the tool axis; the tool frame moves
            to its mouth, `tool_tube_end` [m]. None for none.
        joints: Names of the moving joints in the robot's order, from the base on; None for all revolute, continuous and
            prismatic joints up to the tool frame that are not held.
        hold: Values of held joints [rad, m]. Other joints that do not move are held at 0, at the limit nearest to 0, or
            at the value given by the joint that they mimic.
        package_dirs: Folders searched for packages and meshes before those around the URDF.
        xacro_args: Values of the arguments of a xacro file, by name: `{"ur_type": "ur5e"}`.
        group: Group of the SRDF with the moving joints: a chain, whose tip is the default tool frame, or joints; the
            others are held.
        group_state: Group state of the SRDF with values of held joints; those in `hold` have priority.
        repair_inertia: True to go on with inertias that no body has, with the smaller principal moments raised;
            `Robot.assumptions` and reports list them.
        acceleration_scale: Ratio of acceleration to velocity limits [1/s], if nothing gives acceleration limits; None
            for 2: full speed in half a second. `Robot.assumptions` and reports say so.
        srdf: SRDF with the pairs of links that may touch. Pairs that it disables because they never touch are checked
            nevertheless.
        allow_neighbours: True if links with one joint between them may touch, as in most SRDFs; False allows only those
            that always touch, and of those only the parts near the joint.
        collision_from_visual: True to build the collision shapes of all links in `Robot.shape_faults` from their
            visuals; or names of the links whose collision shapes are replaced in this way.

    Warns:
        RobotFileWarning: The file has faults that no motion depends on, a tilted base, or no acceleration limits; MJCF
            has no velocity limits.
        UncoveredLinkWarning: A link has a visual, but no collision shape or one of another size.
        MissingVisualWarning: The mesh file of a visual is missing; the link is not drawn.

    Raises:
        RobotFileError: The URDF, the limits file or the SRDF is missing, malformed or incomplete; a collision mesh is
            missing; a link of `collision_from_visual` does not exist or has no visual; the URDF is well-formed but has
            no moving joint, no tool frame, or a joint of the wrong kind. The message names every fault that was found,
            with its line, element and remedy.
        InputError: A joint to move or to hold does not exist or cannot be moved or held; xacro without `xacrodoc`; a
            robot by name without example-robot-data.
        JointLimitError: A joint is held outside its limits.
    """
    robot, adapted = _read_robot(
        path,
        limits=limits,
        tool_frame=tool_frame,
        tool_tube_m=tool_tube_m,
        joints=joints,
        hold=hold,
        package_dirs=package_dirs,
        srdf=srdf,
        allow_neighbours=allow_neighbours,
        collision_from_visual=collision_from_visual,
        xacro_args=xacro_args,
        acceleration_scale=acceleration_scale,
        group=group,
        group_state=group_state,
        repair_inertia=repair_inertia,
    )
    notes = (*adapted.mended, *robot.assumptions)
    if notes:
        message = f"robot file {robot.urdf_path}: " + "\n  ".join(notes)
        warnings.warn(message, RobotFileWarning, stacklevel=2)
    if adapted.missing_visuals:
        listed = ", ".join(f"{file} of link {link!r}" for link, file in adapted.missing_visuals)
        message = f"robot {robot.name!r}: visual meshes are missing, and their links are not drawn: {listed}"
        warnings.warn(message, MissingVisualWarning, stacklevel=2)
    if robot.shape_faults:
        message = describe_shape_faults(robot.name, robot.shape_faults)
        warnings.warn(message, UncoveredLinkWarning, stacklevel=2)
    return robot


def read_robot(path: Path | str | RobotSource | None, **options: Any) -> Robot:
    """Load a robot like `load_robot` but without warnings; for reloading.

    Raises:
        InputError: The conditions of `load_robot`.
    """
    return _read_robot(path, **options)[0]


def _read_robot(path: Path | str | RobotSource | None, **options: Any) -> tuple[Robot, AdaptedUrdf]:
    """Return the robot of `load_robot`, and its URDF."""
    if isinstance(path, RobotSource):
        given = {name: value for name, value in options.items() if value not in (None, False, (), [], {})}
        options, path = path.options | given, path.urdf
    return _read_file(path, **options)


def _read_file(
    path: Path | str | None,
    *,
    limits: Path | str | None = None,
    tool_frame: str | None = None,
    tool_tube_m: float | None = None,
    joints: Sequence[str] | None = None,
    hold: Mapping[str, float] | None = None,
    package_dirs: Sequence[Path | str] = (),
    srdf: Path | str | None = None,
    allow_neighbours: bool = False,
    collision_from_visual: bool | Sequence[str] = False,
    xacro_args: Mapping[str, str] | None = None,
    acceleration_scale: float | None = None,
    group: str | None = None,
    group_state: str | None = None,
    repair_inertia: bool = False,
) -> tuple[Robot, AdaptedUrdf]:
    """Return the robot of `load_robot`, and its URDF."""
    files = robot_files(path)
    given = files.limits if limits is None else limits_file(file_path("limits", limits))
    allowed = files.srdf if srdf is None else file_path("srdf", srdf)
    for option, name in (("group", group), ("group_state", group_state)):
        if name is not None and allowed is None:
            raise OptionError(option, name, "no value without an SRDF (srdf)")
    frame = instance("tool_frame", files.tool_frame if tool_frame is None else tool_frame, str)
    choice = RobotChoice(
        frame,
        None if joints is None else list_of("joints", joints, str, "names"),
        {
            name: number(f"hold[{name!r}]", value, "a position")
            for name, value in _read_hold("hold", hold, "{joint: value}").items()
        },
        (*check_each("package_dirs", package_dirs, "a list of folders", folder_path), *files.package_dirs),
        ()
        if isinstance(collision_from_visual, bool)
        else list_of("collision_from_visual", collision_from_visual, str, "names of links"),
        limits=given if given is not None or files.urdf == URDF_TEXT else _find_existing(default_limits(files.urdf)),
        guesses_tool=tool_frame is None,
        xacro_args={
            **files.xacro_args,
            **{name: str(value) for name, value in _read_hold("xacro_args", xacro_args, "{name: value}").items()},
        },
        group=None if group is None or allowed is None else read_group(allowed, instance("group", group, str)),
        state=None
        if group_state is None or allowed is None
        else read_group_state(allowed, instance("group_state", group_state, str)),
        repairs_inertia=truth("repair_inertia", repair_inertia),
        # Beyond these lengths a tube is a slip of units [m].
        tool_tube_m=None if tool_tube_m is None else check_between("tool_tube_m", tool_tube_m, 0.01, 2.0),
    )
    text = path if isinstance(path, str) and is_urdf_text(path) else None
    urdf_path = files.urdf
    every = collision_from_visual is True
    choice, root, adapted, models = _build_models(urdf_path, text, choice, mend=every)
    undrawn = {link for link, _ in adapted.missing_visuals}
    faults = find_shape_faults(*models, undrawn)
    drawn = {shape.name.rpartition("_")[0] for shape in models[2].geometryObjects}
    from_visual = [fault.link for fault in faults if fault.link in drawn]
    if from_visual and every:
        choice = replace(choice, from_visual=(*choice.from_visual, *from_visual))
        choice, root, adapted, models = _build_models(urdf_path, text, choice)
        faults = find_shape_faults(*models, undrawn)
    model, collision_model, visual_model = models
    frame = adapted.tool_frame
    check_joints(urdf_path, model)
    joint_names = tuple(model.names)[1:]
    if choice.joints is not None and choice.joints != joint_names:
        expected = f"joints: {', '.join(choice.joints)}; expected in the robot's order: {', '.join(joint_names)}"
        raise InputError(expected, joints=list(choice.joints), expected=list(joint_names))
    may_touch = () if allowed is None else read_srdf(allowed, adapted.urdf.links)
    may_touch += filtered_links(urdf_path, root, adapted.urdf.links)
    if truth("allow_neighbours", allow_neighbours):
        may_touch += neighbouring_links(model)
    scale = (
        None
        if acceleration_scale is None
        else number("acceleration_scale", acceleration_scale, "a positive number [1/s]", lambda value: value > 0.0)
    )
    acceleration, jerk, assumed = find_limits(urdf_path, adapted.urdf, joint_names, given, adapted.held, scale)
    lower, upper = np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit)
    robot = Robot(
        name=model.name,
        urdf_path=urdf_path,
        model=model,
        collision_model=collision_model,
        visual_model=visual_model,
        joint_names=joint_names,
        tool_frame=frame,
        lower=readonly(lower),
        upper=readonly(upper),
        velocity_limit=readonly(model.velocityLimit),
        acceleration_limit=readonly(acceleration),
        torque_limit=readonly(model.effortLimit),
        jerk_limit=None if jerk is None else readonly(jerk),
        continuous=readonly([name in adapted.continuous for name in joint_names], np.bool_),
        held=adapted.held,
        urdf_text=adapted.text,
        may_touch=may_touch,
        shape_faults=faults,
        assumptions=(*adapted.assumptions, *(() if assumed is None else (assumed,))),
    )
    return robot, adapted


def _build_models(
    urdf_path: Path, text: str | None, choice: RobotChoice, *, mend: bool = False
) -> tuple[RobotChoice, Element, AdaptedUrdf, tuple[pin.Model, pin.GeometryModel, pin.GeometryModel]]:
    """Adapt a URDF and build its kinematic, collision and visual models.

    Unreadable visual meshes are dropped.

    Args:
        mend: True to build the shapes of links with an unreadable collision mesh from their visuals.

    Returns:
        The final choice of reading options, the elements, the adapted URDF and the models.
    """
    root = read_urdf_xml(urdf_path, text, choice.package_dirs, choice.xacro_args)
    meshes = MeshFinder(urdf_path, choice.package_dirs)
    try:
        adapted = adapt_urdf(urdf_path, root, choice)
    except RobotFileError:
        missing = meshes.links_without_mesh(root, tries=False) if mend and not choice.from_visual else ()
        if not missing:
            raise
        return _build_models(urdf_path, text, replace(choice, from_visual=missing))
    if choice.tool_tube_m is not None:
        adapted = add_tool_tube(urdf_path, root, adapted, choice.tool_tube_m)
    try:
        return choice, root, adapted, build_models(urdf_path, adapted.urdf, adapted.text)
    except RobotFileError as error:
        unread = replace(choice, tries_visuals=True)
        if meshes.drop_missing_visuals(root, tries=True):
            return _build_models(urdf_path, text, unread, mend=mend)
        broken = meshes.links_without_mesh(root, tries=True)
        if not broken:
            raise
        if not mend:
            error.add(
                f"collision_from_visual={list(broken)} (--collision-from-visual) builds the shapes from the visuals"
            )
            raise
    return _build_models(urdf_path, text, replace(choice, from_visual=broken))


def _read_hold(name: str, given: Mapping[str, _T] | None, expected: str) -> dict[str, _T]:
    return {} if given is None else dict(instance(name, given, Mapping, expected))  # type: ignore[type-abstract]


def _find_existing(file: Path) -> Path | None:
    return file if is_file(file) else None
