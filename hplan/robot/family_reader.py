"""Reads an arm of the family out of Pinocchio's models: an optional yaw, then parallel revolute joints in one plane."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from hplan.base import ties
from hplan.base.arrays import FloatArray, readonly
from hplan.errors import RobotFamilyError, RobotFileError
from hplan.robot.dynamics import SLIDING, TURNING
from hplan.robot.planar_family import PlanarArm, PlanarFamily
from hplan.scene.solids import CUBE_CORNERS

#: Lengths below this are zero, offsets below this are on the plane [m].
_GEOMETRY_TOLERANCE = 1e-6

#: Axes this near to a direction have it [rad]: over ten metres 10 nm, of which no bound needs to take account.
_AXIS_TOLERANCE = 1e-9

#: Part of an interval that the golden section keeps.
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


def read_family(model: pin.Model, collision_model: pin.GeometryModel, tool_frame: str) -> PlanarFamily:
    """The planar family's part of a robot.

    Raises:
        RobotFamilyError: Not of the family; says which element and why.
    """
    found = FamilyReader(model, collision_model, tool_frame)
    lower, upper = np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit)
    joints = slice(1 if found.has_yaw else 0, None)
    arm = PlanarArm(
        joint_names=tuple(model.names)[1:][joints],
        link_names=found.link_names,
        lengths=readonly(found.lengths),
        half_widths=readonly(found.half_widths),
        lateral=readonly(found.lateral),
        signs=readonly(found.signs),
        offsets=readonly(found.offsets),
        lower=readonly(lower[joints]),
        upper=readonly(upper[joints]),
    )
    return PlanarFamily(found.has_yaw, readonly(found.yaw_axis), arm, readonly(found.origin), readonly(found.axes))


def check_joints(path: Path, model: pin.Model) -> None:
    """Refuse joints that no robot here has, of the family or not, and a tool frame that there is none of.

    Raises:
        RobotFileError: There is one; says which element and why.
    """
    if model.njoints < 2:
        raise RobotFileError(path, "it has no moving joint")
    for index in range(1, model.njoints):
        name, kind = model.names[index], model.joints[index].shortname()
        if kind not in TURNING + SLIDING:
            advice = hold_advice(name) if model.joints[index].nq == 1 else "make it fixed where it stands"
            reason = f"it is a {kind}; only revolute and prismatic joints move; {advice}"
            raise RobotFileError(path, f"joint {name!r}: {reason}")
        axis = model.joints[index].createData()
        model.joints[index].calc(axis, np.zeros(1))
        if not abs(np.linalg.norm(axis.S) - 1.0) <= 1e-9:
            raise RobotFileError(path, f"joint {name!r}: its axis has no direction")
        low, high = model.lowerPositionLimit[index - 1], model.upperPositionLimit[index - 1]
        if not low < high:
            unit = "rad" if kind in TURNING else "m"
            reason = f"its lower limit {low:g} {unit} is not below its upper limit {high:g} {unit}"
            raise RobotFileError(path, f"joint {name!r}: {reason}")


class FamilyReader:
    """The planar chain in Pinocchio's models at q = 0; what is not of the family is refused.

    The arm plane is the one in which the tool frame moves. Where along its axis a joint's origin lies is of no
    account, so the plane may pass the yaw axis at a distance, and links may lie off the plane.

    Attributes:
        has_yaw: True where joint 0 turns the arm plane about the vertical.
        yaw_axis: (2,) where that vertical stands [m]; zeros without a yaw.
        origin: (3,) first planar joint, where its axis meets the plane [m].
        axes: (2, 3) the plane's horizontal and upward unit vectors.
        link_names: Names of the `n` planar links.
        lengths: (n,) their lengths [m].
        half_widths: (n,) radii of the capsules that enclose them [m].
        lateral: (n,) distances of the capsules' axes from the plane, along its normal [m].
        signs: (n,) +1 or -1, sense of each planar joint.
        offsets: (n,) relative link angles.
    """

    def __init__(self, model: pin.Model, collision_model: pin.GeometryModel, tool_frame: str) -> None:
        """Read them.

        Raises:
            RobotFamilyError: Not of the family; says which element and why.
        """
        self.robot_name = model.name
        self._check_joints(model)
        self.data = model.createData()
        pin.framesForwardKinematics(model, self.data, np.zeros(model.nq))
        tool_id = model.getFrameId(tool_frame)
        if model.frames[tool_id].parentJoint != model.njoints - 1:
            raise self._fault(f"frame {tool_frame!r}", "it is not on the last link")
        axes = self._joint_axes(model)
        self.has_yaw = self._find_yaw(model, axes)
        first = 1 if self.has_yaw else 0
        self.yaw_axis: FloatArray = self.data.oMi[1].translation[:2].copy() if self.has_yaw else np.zeros(2)
        points = [self.data.oMi[i].translation.copy() for i in range(first + 1, model.njoints)]
        points.append(self.data.oMf[tool_id].translation.copy())
        self._read_plane(model, axes[first:], np.array(points), first)
        self._read_capsules(collision_model, first)

    def _fault(self, element: str, reason: str) -> RobotFamilyError:
        return RobotFamilyError(self.robot_name, element, reason)

    def _check_joints(self, model: pin.Model) -> None:
        for index in range(1, model.njoints):
            name, kind = model.names[index], model.joints[index].shortname()
            if kind not in TURNING:
                reason = f"it is a {kind}; the family's joints are revolute; {hold_advice(name)}"
                raise self._fault(f"joint {name!r}", reason)
            if model.parents[index] != index - 1:
                raise self._fault(f"joint {name!r}", "the chain branches here; only serial arms")

    def _joint_axes(self, model: pin.Model) -> FloatArray:
        """(joints, 3) rotation axes at q = 0 in the base frame."""
        pin.computeJointJacobians(model, self.data, np.zeros(model.nq))
        jacobian = pin.getJointJacobian(model, self.data, model.njoints - 1, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        axes: FloatArray = np.reshape(jacobian, (6, -1))[3:].T  # of one joint, Pinocchio gives a vector
        return axes

    def _find_yaw(self, model: pin.Model, axes: FloatArray) -> bool:
        """True where joint 0 is vertical and the others are not parallel to it."""
        if len(axes) == 1:
            return False
        between = _angle_between(axes[0], axes[1])
        if between <= _AXIS_TOLERANCE:
            return False
        name = model.names[1]
        tilt = _angle_between(axes[0], np.array([0.0, 0.0, 1.0]))
        if tilt > _AXIS_TOLERANCE:
            reason = "it is not parallel to the next joint and not vertical either"
            raise self._fault(f"joint {name!r}", reason + _nearly(min(between, tilt)))
        if axes[0, 2] < 0.0:
            raise self._fault(f"joint {name!r}", "the yaw axis points down; turn it to +z")
        lean = abs(math.atan2(axes[1, 2], math.hypot(axes[1, 0], axes[1, 1])))
        if lean > _AXIS_TOLERANCE:
            raise self._fault(f"joint {model.names[2]!r}", "it is not perpendicular to the yaw axis" + _nearly(lean))
        return True

    def _read_plane(self, model: pin.Model, axes: FloatArray, points: FloatArray, first: int) -> None:
        for offset, axis in enumerate(axes):
            angle = _angle_between(axis, axes[0])
            if angle > _AXIS_TOLERANCE:
                raise self._fault(
                    f"joint {model.names[first + 1 + offset]!r}",
                    f"it is not parallel to joint {model.names[first + 1]!r}{_nearly(angle)}; "
                    + hold_advice(model.names[first + 1 + offset]),
                )
        normal = axes[0]
        up = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
        up = up / np.linalg.norm(up) if np.linalg.norm(up) > 1e-6 else np.array([0.0, 1.0, 0.0])
        forward = np.cross(up, normal)
        reach = float(forward @ (points[-1] - points[0]))
        lead = reach if abs(reach) > _GEOMETRY_TOLERANCE else float(forward[ties.argmax(np.abs(forward))])
        if lead < 0.0:
            forward = -forward
        normal = np.cross(forward, up)
        aside = (points - points[-1]) @ normal
        aside[np.abs(aside) <= _GEOMETRY_TOLERANCE] = 0.0
        points = points - aside[:, None] * normal
        steps = np.diff(points, axis=0) @ np.stack([forward, up], axis=1)
        lengths = np.linalg.norm(steps, axis=1)
        self.link_names = tuple(self._link_name(model, index) for index in range(first + 1, model.njoints))
        for name, length in zip(self.link_names, lengths, strict=True):
            if length < _GEOMETRY_TOLERANCE:
                raise self._fault(f"link {name!r}", "it has no length")
        absolute = np.array([math.atan2(y, x) for x, y in steps.tolist()])
        relative = np.diff(absolute, prepend=0.0)
        self._points, self._normal, self.origin = points, normal, points[0]
        self.axes = np.stack([forward, up])
        self.lengths = lengths
        self.signs = np.sign(axes @ normal)
        self.offsets = np.array([math.atan2(math.sin(bend), math.cos(bend)) for bend in relative.tolist()])

    @staticmethod
    def _link_name(model: pin.Model, joint: int) -> str:
        """Name of the first body that the joint moves."""
        for frame in model.frames:
            if frame.parentJoint == joint and frame.type == pin.FrameType.BODY:
                return str(frame.name)
        return str(model.names[joint])

    def _read_capsules(self, collision_model: pin.GeometryModel, first: int) -> None:
        """Radius of the smallest capsule along each link that holds its collision geometry, and where it lies.

        Its axis is that of the link in the arm plane, or parallel to it off the plane where that makes it thinner.
        """
        widths, lateral = [], []
        for index, name in enumerate(self.link_names):
            joint = first + 1 + index
            shapes = [g for g in collision_model.geometryObjects if g.parentJoint == joint]
            if not shapes:
                raise self._fault(f"link {name!r}", "it has no collision geometry")
            placement, ends = self.data.oMi[joint], self._points[index : index + 2]
            try:
                aside = _thinnest([_outline_about(shape, placement, ends, self._normal) for shape in shapes])
                start, end = ends + aside * self._normal
                widths.append(max(_enclosing_radius(shape, placement, start, end) for shape in shapes))
            except TypeError as error:
                raise self._fault(f"link {name!r}", str(error)) from error
            lateral.append(aside)
        self.half_widths, self.lateral = np.array(widths), np.array(lateral)


def _angle_between(axis: FloatArray, other: FloatArray) -> float:
    """Angle between two lines of unit direction, 0 to a right angle (the cosine would lose small ones)."""
    return math.atan2(float(np.linalg.norm(np.cross(axis, other))), abs(float(axis @ other)))


def hold_advice(joint: str) -> str:
    """End of a message: the argument that lets a joint stand still."""
    return f"hold={{{joint!r}: 0.0}} (--hold {joint}=0) lets it stand still"


def _nearly(angle: float) -> str:
    """Advice about an axis that was surely meant to have a direction, and is off by a small angle."""
    if angle > 0.01:
        return ""
    return (
        f", by {angle:.3g} rad, of which {_AXIS_TOLERANCE:g} is taken: write angles in full, a right one as "
        "1.5707963267948966, or turn the <axis> instead of the <origin>"
    )


def _enclosing_radius(shape: pin.GeometryObject, joint_placement: pin.SE3, start: FloatArray, end: FloatArray) -> float:
    """Largest distance of a shape's points from the segment `start`-`end` [m]."""
    placement = joint_placement * shape.placement
    axis = end - start
    unit = axis / np.linalg.norm(axis)
    tilt = np.linalg.norm(np.cross(placement.rotation[:, 2], unit))
    aside = np.linalg.norm(np.cross(placement.translation - start, unit))
    corners, rounding = outline(shape, rim_from_outside=bool(tilt > 1e-9 or aside > 1e-9))
    world = corners @ placement.rotation.T + placement.translation
    along = np.clip((world - start) @ axis / (axis @ axis), 0.0, 1.0)
    return float(np.max(np.linalg.norm(world - start - along[:, None] * axis, axis=1))) + rounding


def _outline_about(
    shape: pin.GeometryObject, joint_placement: pin.SE3, ends: FloatArray, normal: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Points of a shape: how far off the plane, and how far from a link's axis seen along the normal; rounding."""
    placement = joint_placement * shape.placement
    corners, rounding = outline(shape, rim_from_outside=True)
    from_start = corners @ placement.rotation.T + placement.translation - ends[0]
    axis = ends[1] - ends[0]
    aside = from_start @ normal
    in_plane = from_start - aside[:, None] * normal
    along = np.clip(in_plane @ axis / (axis @ axis), 0.0, 1.0)
    return aside, np.linalg.norm(in_plane - along[:, None] * axis, axis=1), rounding


def _thinnest(outlines: Sequence[tuple[FloatArray, FloatArray, float]]) -> float:
    """Distance from the plane at which a capsule that holds all outlines is thinnest; 0 where that is no gain [m].

    The radius is convex in that distance, as a maximum of distances: the interval is narrowed by the golden section.
    """

    def radius(at: float) -> float:
        return max(float(np.hypot(aside - at, away).max()) + rounding for aside, away, rounding in outlines)

    low, high = (float(end([end(aside) for aside, _, _ in outlines])) for end in (np.min, np.max))
    while high - low > 1e-3 * _GEOMETRY_TOLERANCE:
        left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        if radius(left) <= radius(right):
            high = right
        else:
            low = left
    found = round(0.5 * (low + high), 6)
    return found if radius(found) < radius(0.0) - _GEOMETRY_TOLERANCE else 0.0


def outline(shape: pin.GeometryObject, *, rim_from_outside: bool) -> tuple[FloatArray, float]:
    """Points and a rounding radius whose hull holds the shape.

    Exact but for the rim of a cylinder, a 64-gon: on the rim where the cylinder lies about the link's axis (every
    rim point is then equally far from it), around it (0.12 % larger) where it does not.

    Raises:
        TypeError: It is neither a shape that URDF knows, nor a convex one that coal judges by.
    """
    geometry = shape.geometry
    kind = type(geometry).__name__
    if isinstance(geometry, coal.BVHModelBase):
        return np.asarray(geometry.vertices(), dtype=np.float64), 0.0
    if not isinstance(geometry, coal.ShapeBase):
        raise TypeError(f"shape {kind} is not supported")
    rounding = float(geometry.getSweptSphereRadius())
    if isinstance(geometry, coal.ConvexBase):
        return np.array(geometry.points(), dtype=np.float64).reshape(-1, 3), rounding
    if kind == "Sphere":
        return np.zeros((1, 3)), rounding + float(geometry.radius)
    if kind == "Capsule":
        return np.array([[0, 0, -1.0], [0, 0, 1.0]]) * geometry.halfLength, rounding + float(geometry.radius)
    if kind == "Cylinder":
        angles = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
        radius = geometry.radius / np.cos(np.pi / 64) if rim_from_outside else geometry.radius
        rim = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        ends = [np.c_[rim, np.full(64, h)] for h in (-geometry.halfLength, geometry.halfLength)]
        return np.vstack(ends), rounding
    if kind == "Box":
        return CUBE_CORNERS * np.asarray(geometry.halfSide), rounding
    raise TypeError(f"shape {kind} is not supported")
