"""The arm that hplan plans for: an optional yaw, then parallel revolute joints in one plane.

Everything is read from the files with Pinocchio: how many links, their lengths, axes, half-widths and limits.
What URDF cannot say (acceleration, jerk) stands in a limits YAML in the same folder.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.base.arguments import each, file_path, instance, list_of, number
from hplan.base.arrays import BoolArray, FloatArray, Record, readonly
from hplan.base.data_files import shipped_robots, urdf_dir
from hplan.errors import InputError, JointLimitError
from hplan.robot.dynamics import InverseDynamics
from hplan.robot.family_reader import FamilyReader, joint_range
from hplan.robot.files import build_models, find_limits
from hplan.robot.urdf_adaptation import RobotChoice, adapt_urdf
from hplan.robot.urdf_xml import URDF_TEXT, is_urdf_text, read_urdf_xml

_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class PlanarArm(Record):
    """The planar chain inside the robot, in the coordinates of its own plane.

    The plane's origin is the first planar joint (the shoulder); its first axis is horizontal, its second points
    up. Link `k` is the segment from its joint to the next one (the last ends at the tool frame). Relative link
    angles, counter-clockwise from the first axis, are `signs * q + offsets`. The tool moves in the plane; the body of
    a link may lie beside it, in a plane of its own.

    Attributes:
        joint_names: Names of the `n` planar joints.
        link_names: Names of the `n` links they move.
        lengths: (n,) link lengths [m].
        half_widths: (n,) radii of the capsules that enclose the links [m].
        lateral: (n,) distances of these capsules' axes from the plane, along its normal [m].
        signs: (n,) +1 or -1, sense of each joint.
        offsets: (n,) relative link angles at q = 0.
        lower: (n,) lower joint limits.
        upper: (n,) upper joint limits.
    """

    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    lengths: FloatArray
    half_widths: FloatArray
    lateral: FloatArray
    signs: FloatArray
    offsets: FloatArray
    lower: FloatArray
    upper: FloatArray

    @property
    def link_count(self) -> int:
        """Number of planar links."""
        return len(self.link_names)

    def joint_points(self, q: ArrayLike) -> FloatArray:
        """Joint and tool positions in the plane.

        Args:
            q: (..., n) planar joint angles.

        Returns:
            (..., n + 1, 2) positions [m]: the joints from the shoulder on, the tool frame last.
        """
        angles = np.cumsum(self.signs * np.asarray(q, dtype=np.float64) + self.offsets, axis=-1)
        steps = self.lengths[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        origin = np.zeros_like(steps[..., :1, :])
        return np.concatenate([origin, np.cumsum(steps, axis=-2)], axis=-2)


@dataclass(frozen=True, eq=False)
class Robot(Record):
    """A harvesting arm: Pinocchio's models, the planar chain inside, and every limit.

    Attributes:
        name: Name in the URDF.
        urdf_path: File it was read from.
        model: Pinocchio's kinematic and inertial model.
        collision_model: Collision geometry.
        visual_model: Visual geometry.
        joint_names: Names of the `dof` joints, base first.
        has_yaw: True where joint 0 turns the arm plane about the vertical.
        yaw_axis: (2,) where that vertical stands in `base_link` [m]; zeros without a yaw.
        arm: The planar chain.
        plane_origin: (3,) shoulder position at yaw 0, in `base_link` [m].
        plane_axes: (2, 3) the plane's horizontal and upward unit vectors at yaw 0.
        tool_frame: Name of the frame at the end of the arm.
        lower: (dof,) lower joint limits.
        upper: (dof,) upper joint limits.
        velocity_limit: (dof,) [rad/s].
        acceleration_limit: (dof,) [rad/s^2].
        torque_limit: (dof,) [N m].
        jerk_limit: (dof,) [rad/s^3], or None where the limits file gives none.
        continuous: (dof,) True where the URDF gives a joint no limits; it turns by a whole turn to either side.
        held: Where joints of the URDF stand that do not move, by name [rad, m]; None for those of several coordinates.
        urdf_text: The URDF that the models were built from, where it is not the file's content.
    """

    name: str
    urdf_path: Path
    model: pin.Model
    collision_model: pin.GeometryModel
    visual_model: pin.GeometryModel
    joint_names: tuple[str, ...]
    has_yaw: bool
    yaw_axis: FloatArray
    arm: PlanarArm
    plane_origin: FloatArray
    plane_axes: FloatArray
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

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @cached_property
    def _made(self) -> dict[Hashable, Any]:
        return {}

    def once(self, key: Hashable, make: Callable[[], _T]) -> _T:
        """The result of `make`, called for the first request of a key only: for what depends on the robot alone."""
        if key not in self._made:
            self._made[key] = make()
        made: _T = self._made[key]
        return made

    @cached_property
    def dynamics(self) -> InverseDynamics:
        """Inverse dynamics of the model."""
        return InverseDynamics.of(self.model)

    @property
    def yaw_joints(self) -> int:
        """Number of joints before the planar ones: 1 with a yaw, else 0."""
        return int(self.has_yaw)

    @property
    def arm_slice(self) -> slice:
        """Places of the planar joints in a configuration."""
        return slice(self.yaw_joints, None)

    def yaw_of(self, q: ArrayLike) -> float:
        """Yaw of a configuration (0 for a robot without one)."""
        return float(np.asarray(q)[0]) if self.has_yaw else 0.0

    def plane_at(self, yaw: float) -> tuple[FloatArray, FloatArray]:
        """The arm plane turned by `yaw`.

        Returns:
            The (3,) origin in `base_link` [m] and the (3, 3) rows: horizontal axis, upward axis, unit normal.
        """
        cos, sin = math.cos(yaw), math.sin(yaw)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        (ax, ay, az), (bx, by, bz) = self.plane_axes.tolist()
        axes = np.array([[ax, ay, az], [bx, by, bz], [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]])
        axis = np.append(self.yaw_axis, 0.0)
        return axis + turn @ (self.plane_origin - axis), axes @ turn.T

    def tool_positions(self, q: ArrayLike) -> FloatArray:
        """Tool positions of configurations, (..., dof) -> (..., 3), in `base_link` [m]."""
        q = np.asarray(q, dtype=np.float64)
        tip = self.arm.joint_points(q[..., self.arm_slice])[..., -1, :]
        at_zero = self.plane_origin + tip @ self.plane_axes
        if not self.has_yaw:
            return at_zero
        cos, sin, (ax, ay) = np.cos(q[..., 0]), np.sin(q[..., 0]), self.yaw_axis.tolist()
        x, y, z = np.moveaxis(at_zero, -1, 0)
        x, y = x - ax, y - ay
        return np.stack([ax + (cos * x - sin * y), ay + (sin * x + cos * y), z], axis=-1)

    def sway(self, deviation: ArrayLike) -> FloatArray:
        """Largest distance of an axis point of each link from its place when joints are off by `deviation` at most.

        The absolute angle of a link is off by no more than the joints up to it together, and each link adds its length
        times that; yaw adds its own deviation times the largest distance from the yaw axis.

        Args:
            deviation: One number for all joints, or (..., dof) [rad].

        Returns:
            (..., links) distances [m].
        """
        off = np.asarray(deviation, dtype=np.float64)
        off = off if off.ndim else np.full(self.dof, off)
        sway: FloatArray = np.cumsum(self.arm.lengths * np.cumsum(off[..., self.arm_slice], axis=-1), axis=-1)
        return sway + off[..., :1] * self.yaw_radius if self.has_yaw else sway

    @cached_property
    def shoulder_from_axis(self) -> tuple[float, float]:
        """The shoulder as seen from the yaw axis: along the plane's horizontal axis, and along its normal [m]."""
        (fx, fy), (x, y) = self.plane_axes[0, :2].tolist(), (self.plane_origin[:2] - self.yaw_axis).tolist()
        return fx * x + fy * y, fy * x - fx * y

    @property
    def yaw_radius(self) -> FloatArray:
        """(links,) largest distance of any point of each link's axis from the yaw axis [m]."""
        ahead, across = self.shoulder_from_axis
        radius: FloatArray = np.hypot(abs(ahead) + np.cumsum(self.arm.lengths), across + self.arm.lateral)
        return radius

    @property
    def tool_radius(self) -> float:
        """Largest distance of the tool from the yaw axis [m]."""
        ahead, across = self.shoulder_from_axis
        return math.hypot(abs(ahead) + float(self.arm.lengths.sum()), across)

    def locked_mask(self, names: Sequence[str]) -> BoolArray:
        """(dof,) mask of the locked joints.

        Raises:
            InputError: A joint that the robot does not have.
        """
        unknown = [name for name in names if name not in self.joint_names]
        if unknown:
            raise InputError(
                f"locked_joints names {unknown[0]!r}; the robot has {', '.join(self.joint_names)}", joint=unknown[0]
            )
        return np.array([name in names for name in self.joint_names], dtype=np.bool_)

    def turned_near(self, q: ArrayLike, start: ArrayLike) -> ArrayLike:
        """A configuration with its continuous joints moved by whole turns to the values nearest to those of a start.

        So a goal is reached the short way: from 0, 350 deg is reached at -10 deg, and the trajectory counts on from the
        start without a jump. Values stay within the limits where some are; what is no configuration is returned as it
        is, for `check_configuration` to refuse.

        Args:
            q: (dof,) configuration.
            start: (dof,) configuration.
        """
        try:
            values = np.array(q)
        except ValueError:
            return q
        usable = values.shape == (self.dof,) and values.dtype.kind in "fiu" and np.isfinite(values).all()
        if not (usable and self.continuous.any()):
            return q
        values, near = values.astype(np.float64), np.asarray(start, dtype=np.float64)
        for joint in np.flatnonzero(self.continuous).tolist():
            first = math.ceil((self.lower[joint] - values[joint] - 1e-9) / math.tau)
            last = math.floor((self.upper[joint] - values[joint] + 1e-9) / math.tau)
            turns = min(max(round((near[joint] - values[joint]) / math.tau), first), last)
            values[joint] += math.tau * turns
        return values

    def check_configuration(self, q: ArrayLike, which: str) -> FloatArray:
        """Return `q` as a read-only (dof,) array.

        Raises:
            InputError: No list of numbers, wrong number of joints, or a value that is not finite.
            JointLimitError: Outside the joint limits (by more than 1e-9 rad; closer values are clipped).
        """
        expected = f"{which}: expected {self.dof} joint values ({', '.join(self.joint_names)})"
        try:
            values = np.array(q)
        except ValueError as error:
            raise InputError(f"{expected}, got {q!r}", which=which, expected=self.dof) from error
        if values.shape != (self.dof,):
            got = str(values.size) if values.ndim == 1 else f"an array of shape {values.shape}"
            raise InputError(f"{expected}, got {got}", which=which, expected=self.dof, shape=list(values.shape))
        if values.dtype.kind not in "fiu":
            raise InputError(f"{expected}, got {q!r}", which=which, expected=self.dof)
        values = values.astype(np.float64)
        for joint, value in zip(self.joint_names, values, strict=True):
            if not np.isfinite(value):
                raise InputError(
                    f"{which}: joint {joint!r} is at {value}, expected a finite number", which=which, joint=joint
                )
        for joint, value, lower, upper in zip(self.joint_names, values, self.lower, self.upper, strict=True):
            if not lower - 1e-9 <= value <= upper + 1e-9:
                raise JointLimitError(which, joint, float(value), float(lower), float(upper))
        return readonly(np.clip(values, self.lower, self.upper))


def load_robot(
    path: Path | str | None = None,
    *,
    limits: Path | str | None = None,
    tool_frame: str = "tool0",
    joints: Sequence[str] | None = None,
    hold: Mapping[str, float] | None = None,
    package_dirs: Sequence[Path | str] = (),
) -> Robot:
    """Load a robot of the family; joints of its URDF that do not move are made fixed.

    Args:
        path: URDF or xacro file, or a URDF itself (a text that begins with `<`); None for the harvester that ships with
            hplan. A text without suffix and folder that is no file names a robot that ships:
            `load_robot("orchard_harvester")`.
        limits: Limits YAML; None for the file in the folder of the URDF, `NAME.limits.yaml`, and without one for
            acceleration and jerk in the URDF (1.2).
        tool_frame: Frame at the end of the last link.
        joints: Names of the joints that move, from the base on; None for all revolute and continuous ones up to the
            tool frame that are not held.
        hold: Values of joints that stand still [rad, m]. All that do not move do: without a value at 0, or at the limit
            nearest to it, or as they mimic another.
        package_dirs: Folders in which `package://` meshes are looked for, before those around the URDF.

    Raises:
        RobotFileError: The URDF or the limits file is missing, malformed or incomplete; a mesh is missing.
        RobotFamilyError: The URDF is well-formed but no planar arm on an optional yaw; says which element and why.
        InputError: A joint to move or to hold that does not exist or cannot; xacro without `xacrodoc`.
        JointLimitError: A joint held outside its limits.
    """
    instance("tool_frame", tool_frame, str)
    choice = RobotChoice(
        tool_frame,
        None if joints is None else list_of("joints", joints, str, "names"),
        {name: number(f"hold[{name!r}]", value, "a position") for name, value in _mapping(hold).items()},
        each("package_dirs", package_dirs, "a list of folders", file_path),
    )
    text = path if isinstance(path, str) and is_urdf_text(path) else None
    urdf_path = URDF_TEXT if text is not None else _urdf_path(path)
    adapted = adapt_urdf(urdf_path, read_urdf_xml(urdf_path, text, choice.package_dirs), choice)
    model, collision_model, visual_model = build_models(urdf_path, adapted.urdf, adapted.text)
    kinematics = FamilyReader(model, collision_model, tool_frame)
    joint_names = tuple(model.names)[1:]
    given = None if limits is None else file_path("limits", limits)
    acceleration, jerk = find_limits(urdf_path, adapted.urdf, joint_names, given, adapted.held)
    lower, upper = joint_range(model)
    arm_slice = slice(1 if kinematics.has_yaw else 0, None)
    arm = PlanarArm(
        joint_names=joint_names[arm_slice],
        link_names=kinematics.link_names,
        lengths=readonly(kinematics.lengths),
        half_widths=readonly(kinematics.half_widths),
        lateral=readonly(kinematics.lateral),
        signs=readonly(kinematics.signs),
        offsets=readonly(kinematics.offsets),
        lower=readonly(lower[arm_slice]),
        upper=readonly(upper[arm_slice]),
    )
    return Robot(
        name=model.name,
        urdf_path=urdf_path,
        model=model,
        collision_model=collision_model,
        visual_model=visual_model,
        joint_names=joint_names,
        has_yaw=kinematics.has_yaw,
        yaw_axis=readonly(kinematics.yaw_axis),
        arm=arm,
        plane_origin=readonly(kinematics.origin),
        plane_axes=readonly(kinematics.axes),
        tool_frame=tool_frame,
        lower=readonly(lower),
        upper=readonly(upper),
        velocity_limit=readonly(model.velocityLimit),
        acceleration_limit=readonly(acceleration),
        torque_limit=readonly(model.effortLimit),
        jerk_limit=None if jerk is None else readonly(jerk),
        continuous=readonly([name in adapted.continuous for name in joint_names], np.bool_),
        held=adapted.held,
        urdf_text=adapted.text,
    )


def _mapping(hold: Mapping[str, float] | None) -> dict[str, float]:
    return {} if hold is None else dict(instance("hold", hold, Mapping, "{joint: value}"))  # type: ignore[type-abstract]


def _urdf_path(path: Path | str | None) -> Path:
    found = urdf_dir() / "harvester.urdf" if path is None else file_path("path", path)
    return urdf_dir() / f"{path}.urdf" if str(path) in shipped_robots() and not found.is_file() else found
