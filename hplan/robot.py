"""From a URDF to the arm that hplan plans for: an optional yaw, then parallel revolute joints in one plane.

Everything is read from the files with Pinocchio: how many links, their lengths, axes, half-widths and limits.
What URDF cannot say (acceleration, jerk) stands in a limits YAML beside it.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, PositiveFloat, ValidationError

from hplan.arrays import FloatArray, readonly
from hplan.errors import InputError, JointLimitError, RobotFamilyError, RobotFileError
from hplan.resources import urdf_dir
from hplan.yaml_text import read_yaml

#: Lengths below this are zero, offsets below this are on the plane [m].
GEOMETRY_TOLERANCE = 1e-6

_REVOLUTE = ("JointModelRX", "JointModelRY", "JointModelRZ", "JointModelRevoluteUnaligned")


class LimitsFile(BaseModel):
    """The limits YAML: what URDF has no word for, by joint name."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)

    format: str
    acceleration_rad_s2: dict[str, PositiveFloat]
    jerk_rad_s3: dict[str, PositiveFloat] | None = None


@dataclass(frozen=True, eq=False)
class PlanarArm:
    """The planar chain inside the robot, in the coordinates of its own plane.

    The plane's origin is the first planar joint (the shoulder); its first axis is horizontal, its second points
    up. Link `k` is the segment from its joint to the next one (the last ends at the tool frame). Relative link
    angles, counter-clockwise from the first axis, are `signs * q + offsets`.

    Attributes:
        joint_names: Names of the `n` planar joints.
        link_names: Names of the `n` links they move.
        lengths: (n,) link lengths [m].
        half_widths: (n,) radii of the capsules that enclose the links [m].
        signs: (n,) +1 or -1, sense of each joint.
        offsets: (n,) relative link angles at q = 0.
        lower: (n,) lower joint limits.
        upper: (n,) upper joint limits.
    """

    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    lengths: FloatArray
    half_widths: FloatArray
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
class Robot:
    """A harvesting arm: Pinocchio's models, the planar chain inside, and every limit.

    Attributes:
        name: Name in the URDF.
        urdf_path: File it was read from.
        model: Pinocchio's kinematic and inertial model.
        collision_model: Collision geometry.
        visual_model: Visual geometry.
        joint_names: Names of the `dof` joints, base first.
        has_yaw: True where joint 0 turns the arm plane about the vertical.
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
    """

    name: str
    urdf_path: Path
    model: pin.Model
    collision_model: pin.GeometryModel
    visual_model: pin.GeometryModel
    joint_names: tuple[str, ...]
    has_yaw: bool
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

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def arm_slice(self) -> slice:
        """Where the planar joints stand in a configuration."""
        return slice(1 if self.has_yaw else 0, None)

    def yaw_of(self, q: ArrayLike) -> float:
        """Yaw of a configuration (0 for a robot without one)."""
        return float(np.asarray(q)[0]) if self.has_yaw else 0.0

    def plane_at(self, yaw: float) -> tuple[FloatArray, FloatArray]:
        """The arm plane turned by `yaw`.

        Returns:
            The (3,) origin in `base_link` [m] and the (3, 3) rows: horizontal axis, upward axis, unit normal.
        """
        turn = pin.utils.rotate("z", yaw)
        axes = np.vstack([self.plane_axes, np.cross(self.plane_axes[0], self.plane_axes[1])])
        return turn @ self.plane_origin, axes @ turn.T

    def tool_positions(self, q: ArrayLike) -> FloatArray:
        """Tool positions of configurations, (..., dof) -> (..., 3), in `base_link` [m]."""
        q = np.asarray(q, dtype=np.float64)
        tip = self.arm.joint_points(q[..., self.arm_slice])[..., -1, :]
        at_zero = self.plane_origin + tip @ self.plane_axes
        if not self.has_yaw:
            return at_zero
        cos, sin = np.cos(q[..., 0]), np.sin(q[..., 0])
        x, y, z = np.moveaxis(at_zero, -1, 0)
        return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)

    def sway(self, deviation: float) -> FloatArray:
        """How far an axis point of each link may be from its place when every joint is off by `deviation` [rad].

        The absolute angle of link i is off by i deviations at most, and each link adds its length times that; yaw
        adds its own times the largest distance from the yaw axis.

        Returns:
            (links,) distances [m].
        """
        lengths = self.arm.lengths
        sway: FloatArray = deviation * np.cumsum(lengths * np.arange(1, len(lengths) + 1))
        return sway + deviation * self.yaw_radius if self.has_yaw else sway

    @property
    def yaw_radius(self) -> FloatArray:
        """(links,) largest distance of any point of each link's axis from the yaw axis [m]."""
        radius: FloatArray = np.hypot(*self.plane_origin[:2]) + np.cumsum(self.arm.lengths)
        return radius

    def check_configuration(self, q: ArrayLike, which: str) -> FloatArray:
        """Return `q` as a read-only (dof,) array.

        Raises:
            InputError: No list of numbers, wrong number of joints, or a value that is not finite.
            JointLimitError: Outside the joint limits (by more than 1e-9 rad; closer values are clipped).
        """
        expected = f"{which}: expected {self.dof} joint values ({', '.join(self.joint_names)})"
        try:
            values = np.array(q, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f"{expected}, got {q!r}", which=which, expected=self.dof) from error
        if values.shape != (self.dof,):
            got = str(values.size) if values.ndim == 1 else f"an array of shape {values.shape}"
            raise InputError(f"{expected}, got {got}", which=which, expected=self.dof, shape=list(values.shape))
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
) -> Robot:
    """Load a robot of the family.

    Args:
        path: URDF file; None for the harvester that ships with hplan.
        limits: Limits YAML; None for the file beside the URDF, `NAME.limits.yaml`.
        tool_frame: Frame at the end of the last link.

    Raises:
        RobotFileError: The URDF or the limits file is missing, malformed or incomplete.
        RobotFamilyError: The URDF is well-formed but no planar arm on an optional yaw; says which element and why.
    """
    urdf_path = urdf_dir() / "harvester.urdf" if path is None else Path(path)
    model, collision_model, visual_model = read_models(urdf_path)
    kinematics = _FamilyReader(model, collision_model, tool_frame)
    joint_names = tuple(model.names)[1:]
    limits_path = urdf_path.with_suffix(".limits.yaml") if limits is None else Path(limits)
    acceleration, jerk = read_limits(limits_path, joint_names)
    lower, upper = _joint_range(model)
    arm_slice = slice(1 if kinematics.has_yaw else 0, None)
    arm = PlanarArm(
        joint_names=joint_names[arm_slice],
        link_names=kinematics.link_names,
        lengths=readonly(kinematics.lengths),
        half_widths=readonly(kinematics.half_widths),
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
    )


def read_models(urdf_path: Path) -> tuple[pin.Model, pin.GeometryModel, pin.GeometryModel]:
    """Read a URDF of any robot with Pinocchio: kinematic, collision and visual model.

    Pinocchio raises one ValueError for every fault and writes the reason to the terminal, so the file and its XML
    are checked first.

    Raises:
        RobotFileError: Missing or unreadable file, malformed XML, or refused by Pinocchio.
    """
    try:
        root = ET.parse(urdf_path).getroot()
    except OSError as error:
        raise RobotFileError(urdf_path, error.strerror or str(error)) from error
    except (ET.ParseError, LookupError, ValueError) as error:  # the last two: an encoding that Python does not know
        raise RobotFileError(urdf_path, f"malformed XML: {error}") from error
    if root.tag != "robot":
        raise RobotFileError(urdf_path, f"the root element is <{root.tag}>, expected <robot>")
    _check_links_and_joints(urdf_path, root)
    _check_numbers(urdf_path, root)
    try:
        models: tuple[pin.Model, pin.GeometryModel, pin.GeometryModel]
        models = pin.buildModelsFromUrdf(str(urdf_path), package_dirs=[str(urdf_path.parent)])
    except (ValueError, RuntimeError) as error:
        reason = f"Pinocchio refuses it: {error} (its reader's own words, if any, are on the terminal)"
        raise RobotFileError(urdf_path, reason) from error
    return models


def read_limits(path: Path, joint_names: tuple[str, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Read acceleration [rad/s^2] and, where given, jerk limits [rad/s^3] in the order of `joint_names`.

    Raises:
        RobotFileError: Missing or malformed file, a joint missing or unknown, a limit that is not positive.
    """
    try:
        content, _ = read_yaml(path.read_text(encoding="utf-8"))
        limits = LimitsFile.model_validate(content)
    except OSError as error:
        raise RobotFileError(path, f"{error.strerror}; it gives the acceleration limits, which URDF cannot") from error
    except UnicodeDecodeError as error:
        raise RobotFileError(path, "it is not UTF-8 text") from error
    except yaml.MarkedYAMLError as error:
        line = "" if error.problem_mark is None else f"line {error.problem_mark.line + 1}: "
        raise RobotFileError(path, f"{line}malformed YAML: {error.problem}") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = "".join(f"{part}: " for part in first["loc"])
        raise RobotFileError(path, f"{where}{first['msg']} (got {first['input']!r})") from error
    if limits.format != "hplan-limits/1":
        raise RobotFileError(path, f"format is {limits.format!r}, expected 'hplan-limits/1'")

    def ordered(key: str, table: dict[str, float]) -> NDArray[np.float64]:
        missing = [name for name in joint_names if name not in table]
        unknown = [name for name in table if name not in joint_names]
        if missing or unknown:
            raise RobotFileError(path, f"{key}: joints missing {missing}, unknown {unknown}")
        return np.array([table[name] for name in joint_names])

    jerk = limits.jerk_rad_s3
    return (
        ordered("acceleration_rad_s2", limits.acceleration_rad_s2),
        None if jerk is None else ordered("jerk_rad_s3", jerk),
    )


def _check_links_and_joints(path: Path, root: ET.Element) -> None:
    """Refuse what Pinocchio would refuse without a reason, or take in silence: names and what joins what."""
    if not root.get("name"):
        raise RobotFileError(path, "the robot has no name")
    links = [link.get("name") for link in root.findall("link")]
    joints = [joint.get("name") for joint in root.findall("joint")]
    for kind, names in (("link", links), ("joint", joints)):
        if None in names:
            raise RobotFileError(path, f"a <{kind}> has no name")
        twice = sorted({str(name) for name in names if names.count(name) > 1})
        if twice:
            raise RobotFileError(path, f"{kind} {twice[0]!r} is defined twice")
    for joint in root.findall("joint"):
        for end in ("parent", "child"):
            element = joint.find(end)
            link = None if element is None else element.get("link")
            if link not in links:
                raise RobotFileError(path, f"joint {joint.get('name')!r}: its {end} link {link!r} does not exist")
        if joint.find("mimic") is not None:
            raise RobotFileError(path, f"joint {joint.get('name')!r} mimics another; every joint must move by itself")


def _check_numbers(path: Path, root: ET.Element) -> None:
    """The same for the numbers that safety depends on: sizes of collision geometry, masses, joint limits."""
    for link in root.findall("link"):
        where = f"link {link.get('name')!r}"
        for mass in link.findall("inertial/mass"):
            _number(path, where, mass, "value", "not negative", lambda value: value >= 0.0)
        for collision in link.findall("collision"):
            shape = collision.find("geometry/*")
            if shape is None:
                raise RobotFileError(path, f"{where}: a <collision> has no geometry")
            for attribute in ("radius", "length", "size"):
                if attribute in shape.attrib:
                    _number(path, where, shape, attribute, "positive", lambda value: value > 0.0)
    for joint in root.findall("joint"):
        if joint.get("type") != "revolute":
            continue
        where = f"joint {joint.get('name')!r}"
        limit = joint.find("limit")
        if limit is None:
            raise RobotFileError(path, f"{where}: it has no <limit>")
        for attribute in sorted(limit.attrib.keys() & {"lower", "upper"}):
            _number(path, where, limit, attribute, "in radians", math.isfinite)
        for attribute in ("velocity", "effort"):
            _number(path, where, limit, attribute, "positive", lambda value: value > 0.0)


def _number(
    path: Path,
    where: str,
    element: ET.Element,
    attribute: str,
    expected: str,
    accepts: Callable[[float], bool],
) -> None:
    """Require an attribute that holds a finite number, or several with spaces between, that `accepts` lets pass."""
    text = element.get(attribute)
    if text is None:
        raise RobotFileError(path, f"{where}: <{element.tag}> has no {attribute}")
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if not values or not all(math.isfinite(value) and accepts(value) for value in values):
        reason = f"{where}: {attribute} of <{element.tag}> is {text!r}, expected a finite number that is {expected}"
        raise RobotFileError(path, reason)


def _joint_range(model: pin.Model) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    lower = np.array(model.lowerPositionLimit, dtype=np.float64)
    upper = np.array(model.upperPositionLimit, dtype=np.float64)
    for name, low, high in zip(tuple(model.names)[1:], lower, upper, strict=True):
        if not low < high:
            reason = f"its lower limit {low:g} rad is not below its upper limit {high:g} rad"
            raise RobotFamilyError(model.name, f"joint {name!r}", reason)
    return lower, upper


class _FamilyReader:
    """Reads the planar chain out of Pinocchio's models at q = 0, refusing what is not of the family."""

    def __init__(self, model: pin.Model, collision_model: pin.GeometryModel, tool_frame: str) -> None:
        self.robot_name = model.name
        self._check_joints(model)
        if not model.existFrame(tool_frame):
            raise self._fault(f"frame {tool_frame!r}", "it marks the end of the arm and is missing")
        self.data = model.createData()
        pin.framesForwardKinematics(model, self.data, np.zeros(model.nq))
        tool_id = model.getFrameId(tool_frame)
        if model.frames[tool_id].parentJoint != model.njoints - 1:
            raise self._fault(f"frame {tool_frame!r}", "it is not on the last link")
        axes = self._joint_axes(model)
        self.has_yaw = self._find_yaw(model, axes)
        first = 1 if self.has_yaw else 0
        points = [self.data.oMi[i].translation.copy() for i in range(first + 1, model.njoints)]
        points.append(self.data.oMf[tool_id].translation.copy())
        self._read_plane(model, axes[first:], np.array(points), first)
        self._read_half_widths(collision_model, np.array(points), first)

    def _fault(self, element: str, reason: str) -> RobotFamilyError:
        return RobotFamilyError(self.robot_name, element, reason)

    def _check_joints(self, model: pin.Model) -> None:
        if model.njoints < 2:
            raise self._fault("joints", "it has no moving joint")
        for index in range(1, model.njoints):
            name, kind = model.names[index], model.joints[index].shortname()
            if kind.startswith("JointModelRUB") or "Unbounded" in kind:
                raise self._fault(f"joint {name!r}", "it is continuous; make it revolute with limits")
            if kind not in _REVOLUTE:
                raise self._fault(f"joint {name!r}", f"it is a {kind}; only revolute joints")
            if model.parents[index] != index - 1:
                raise self._fault(f"joint {name!r}", "the chain branches here; only serial arms")

    def _joint_axes(self, model: pin.Model) -> NDArray[np.float64]:
        """(joints, 3) rotation axes at q = 0 in the base frame."""
        pin.computeJointJacobians(model, self.data, np.zeros(model.nq))
        jacobian = pin.getJointJacobian(model, self.data, model.njoints - 1, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        axes = np.reshape(jacobian, (6, -1))[3:].T  # of one joint, Pinocchio gives a vector
        for index, axis in enumerate(axes):
            if abs(np.linalg.norm(axis) - 1.0) > 1e-9:
                raise self._fault(f"joint {model.names[index + 1]!r}", "its axis has no direction")
        return axes

    def _find_yaw(self, model: pin.Model, axes: NDArray[np.float64]) -> bool:
        """True where joint 0 is vertical and the others are not parallel to it."""
        if len(axes) == 1 or np.allclose(np.abs(axes[0] @ axes[1]), 1.0, atol=1e-9):
            return False
        name = model.names[1]
        if not np.allclose(np.abs(axes[0, 2]), 1.0, atol=1e-9):
            raise self._fault(f"joint {name!r}", "it is not parallel to the next joint and not vertical either")
        if axes[0, 2] < 0.0:
            raise self._fault(f"joint {name!r}", "the yaw axis points down; turn it to +z")
        if abs(axes[1, 2]) > 1e-9:
            raise self._fault(f"joint {model.names[2]!r}", "it is not perpendicular to the yaw axis")
        beside = self.data.oMi[1].translation[:2]
        if np.linalg.norm(beside) > GEOMETRY_TOLERANCE:
            raise self._fault(
                f"joint {name!r}",
                f"the yaw axis stands at ({beside[0]:.6g}, {beside[1]:.6g}) m; it must pass the root link's origin",
            )
        return True

    def _read_plane(
        self,
        model: pin.Model,
        axes: NDArray[np.float64],
        points: NDArray[np.float64],
        first: int,
    ) -> None:
        for offset, axis in enumerate(axes):
            if abs(abs(axis @ axes[0]) - 1.0) > 1e-9:
                raise self._fault(
                    f"joint {model.names[first + 1 + offset]!r}",
                    f"it is not parallel to joint {model.names[first + 1]!r}",
                )
        normal = axes[0]
        up = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
        up = up / np.linalg.norm(up) if np.linalg.norm(up) > 1e-6 else np.array([0.0, 1.0, 0.0])
        forward = np.cross(up, normal)
        reach = float(forward @ (points[-1] - points[0]))
        lead = reach if abs(reach) > GEOMETRY_TOLERANCE else float(forward[np.argmax(np.abs(forward))])
        if lead < 0.0:
            forward = -forward
        normal = np.cross(forward, up)
        offsets = (points - points[0]) @ normal
        names = [*tuple(model.names)[first + 1 :], "tool frame"]
        for name, offset in zip(names, offsets, strict=True):
            if abs(offset) > GEOMETRY_TOLERANCE:
                raise self._fault(f"{name!r}", f"it lies {offset:.6g} m beside the arm plane")
        if self.has_yaw and abs(points[0] @ normal) > GEOMETRY_TOLERANCE:
            raise self._fault(
                f"joint {names[0]!r}",
                f"the arm plane passes the yaw axis at {points[0] @ normal:.6g} m; it must contain it",
            )
        steps = np.diff(points, axis=0) @ np.stack([forward, up], axis=1)
        lengths = np.linalg.norm(steps, axis=1)
        self.link_names = tuple(self._link_name(model, index) for index in range(first + 1, model.njoints))
        for name, length in zip(self.link_names, lengths, strict=True):
            if length < GEOMETRY_TOLERANCE:
                raise self._fault(f"link {name!r}", "it has no length")
        absolute = np.arctan2(steps[:, 1], steps[:, 0])
        relative = np.diff(absolute, prepend=0.0)
        self.origin = points[0]
        self.axes = np.stack([forward, up])
        self.lengths = lengths
        self.signs = np.sign(axes @ normal)
        self.offsets = np.arctan2(np.sin(relative), np.cos(relative))

    @staticmethod
    def _link_name(model: pin.Model, joint: int) -> str:
        """Name of the first body that the joint moves."""
        for frame in model.frames:
            if frame.parentJoint == joint and frame.type == pin.FrameType.BODY:
                return str(frame.name)
        return str(model.names[joint])

    def _read_half_widths(
        self,
        collision_model: pin.GeometryModel,
        points: NDArray[np.float64],
        first: int,
    ) -> None:
        """Radius of the smallest capsule about each link's axis that holds its collision geometry."""
        widths = []
        for index, name in enumerate(self.link_names):
            joint = first + 1 + index
            shapes = [g for g in collision_model.geometryObjects if g.parentJoint == joint]
            if not shapes:
                raise self._fault(f"link {name!r}", "it has no collision geometry")
            placement, start, end = self.data.oMi[joint], points[index], points[index + 1]
            try:
                widths.append(max(_enclosing_radius(shape, placement, start, end) for shape in shapes))
            except TypeError as error:
                raise self._fault(f"link {name!r}", str(error)) from error
        self.half_widths = np.array(widths)


def _enclosing_radius(
    shape: pin.GeometryObject,
    joint_placement: pin.SE3,
    start: NDArray[np.float64],
    end: NDArray[np.float64],
) -> float:
    """Largest distance of a shape's points from the segment `start`-`end` [m]."""
    placement = joint_placement * shape.placement
    axis = end - start
    unit = axis / np.linalg.norm(axis)
    tilt = np.linalg.norm(np.cross(placement.rotation[:, 2], unit))
    aside = np.linalg.norm(np.cross(placement.translation - start, unit))
    corners, rounding = _outline(shape, rim_from_outside=bool(tilt > 1e-9 or aside > 1e-9))
    world = corners @ placement.rotation.T + placement.translation
    along = np.clip((world - start) @ axis / (axis @ axis), 0.0, 1.0)
    return float(np.max(np.linalg.norm(world - start - along[:, None] * axis, axis=1))) + rounding


def _outline(shape: pin.GeometryObject, *, rim_from_outside: bool) -> tuple[NDArray[np.float64], float]:
    """Points and a rounding radius whose hull holds the shape.

    Exact but for the rim of a cylinder, a 64-gon: on the rim where the cylinder lies about the link's axis (every
    rim point is then equally far from it), around it (0.12 % larger) where it does not.
    """
    geometry = shape.geometry
    kind = type(geometry).__name__
    if kind == "Sphere":
        return np.zeros((1, 3)), float(geometry.radius)
    if kind == "Capsule":
        return np.array([[0, 0, -1.0], [0, 0, 1.0]]) * geometry.halfLength, float(geometry.radius)
    if kind == "Cylinder":
        angles = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
        radius = geometry.radius / np.cos(np.pi / 64) if rim_from_outside else geometry.radius
        rim = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        ends = [np.c_[rim, np.full(64, h)] for h in (-geometry.halfLength, geometry.halfLength)]
        return np.vstack(ends), 0.0
    if kind == "Box":
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        return signs * np.asarray(geometry.halfSide), 0.0
    if hasattr(geometry, "vertices"):
        return np.asarray(geometry.vertices(), dtype=np.float64), 0.0
    raise TypeError(f"shape {kind} is not supported")
