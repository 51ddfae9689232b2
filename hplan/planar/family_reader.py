"""Reads an arm of the planar family from Pinocchio's models.

Such an arm has an optional yaw, then parallel revolute joints in one plane.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from hplan.base import ties
from hplan.base.arrays import FloatArray, readonly
from hplan.errors import RobotFamilyError
from hplan.geometry.shape_outline import outline
from hplan.planar.planar_family import PlanarArm, PlanarFamily
from hplan.robot.dynamics import TURNING_JOINTS
from hplan.robot.model import Robot
from hplan.robot.urdf_check import frame_number, hold_advice

#: Key of the family in a robot's cache.
FAMILY = "planar family"

#: Lengths below this count as zero, and offsets below this as on the plane [m].
_GEOMETRY_TOLERANCE = 1e-6

#: Axes within this angle of a direction count as aligned [rad]: 10 nm over ten metres, negligible in all bounds.
_AXIS_TOLERANCE = 1e-9

#: Fraction of an interval that golden-section search keeps.
_GOLDEN_FRACTION = 0.5 * (math.sqrt(5.0) - 1.0)


def find_family(robot: Robot) -> PlanarFamily | RobotFamilyError:
    """Return the planar chain of a robot, or the error that names what excludes it; cached on the robot."""

    def read() -> PlanarFamily | RobotFamilyError:
        try:
            return read_family(robot.model, robot.collision_model, robot.tool_frame)
        except RobotFamilyError as error:
            return error

    return robot.cache(FAMILY, read)


def is_planar(robot: Robot) -> bool:
    """True if a robot belongs to the planar family."""
    return isinstance(find_family(robot), PlanarFamily)


def family_of(robot: Robot) -> PlanarFamily:
    """Return the planar chain of a robot; cached on the robot.

    Raises:
        RobotFamilyError: The robot does not belong to the family; the message names the element and the reason.

    Examples:
        >>> from hplan import load_robot
        >>> from hplan.planar.family_reader import family_of
        >>> family = family_of(load_robot())
        >>> family.has_yaw, family.arm.link_count
        (True, 3)
    """
    found = find_family(robot)
    if isinstance(found, RobotFamilyError):
        raise RobotFamilyError(robot.name, found.element, found.reason)
    return found


def with_planar_arm(robot: Robot, arm: PlanarArm) -> Robot:
    """Return a copy of a robot with another planar chain.

    Raises:
        RobotFamilyError: The robot does not belong to the family.
    """
    other, family = replace(robot), replace(family_of(robot), arm=arm)
    other.cache(FAMILY, lambda: family)
    return other


def read_family(model: pin.Model, collision_model: pin.GeometryModel, tool_frame: str) -> PlanarFamily:
    """Read the planar-family part of a robot at q = 0.

    The arm plane is the plane in which the tool frame moves. The position of a joint's origin along its axis does not
    matter, so the plane may pass the yaw axis at a distance, and links may lie off the plane.

    Raises:
        RobotFamilyError: The robot does not belong to the family; the message names the element and the reason.
    """
    _check_chain(model)
    data, tool = model.createData(), frame_number(model, tool_frame)
    pin.framesForwardKinematics(model, data, np.zeros(model.nq))
    if model.frames[tool].parentJoint != model.njoints - 1:
        raise RobotFamilyError(model.name, f"frame {tool_frame!r}", "it is not on the last link")
    axes = _joint_axes(model, data)
    first = int(_has_yaw(model, axes))
    names = tuple(map(str, model.names))[1:]
    links = tuple(_link_name(model, joint) for joint in range(first + 1, model.njoints))
    places = [data.oMi[joint].translation for joint in range(first + 1, model.njoints)]
    plane, points = _plane(model, axes[first:], np.array([*places, data.oMf[tool].translation]))
    steps = np.diff(points, axis=0) @ plane[:2].T
    lengths = np.linalg.norm(steps, axis=1)
    for name, length in zip(links, lengths, strict=True):
        if length < _GEOMETRY_TOLERANCE:
            raise RobotFamilyError(model.name, f"link {name!r}", "it has no length")
    relative = np.diff([math.atan2(y, x) for x, y in steps.tolist()], prepend=0.0)
    capsules = []
    for joint, name in enumerate(links, start=first + 1):
        shapes = [shape for shape in collision_model.geometryObjects if shape.parentJoint == joint]
        ends = points[joint - first - 1 : joint - first + 1]
        try:
            capsules.append(_capsule(shapes, data.oMi[joint], ends, plane[2]))
        except TypeError as error:
            raise RobotFamilyError(model.name, f"link {name!r}", str(error)) from error
    arm = PlanarArm(
        joint_names=names[first:],
        link_names=links,
        lengths=readonly(lengths),
        half_widths=readonly([width for width, _ in capsules]),
        lateral=readonly([aside for _, aside in capsules]),
        signs=readonly(np.sign(axes[first:] @ plane[2])),
        offsets=readonly([math.atan2(math.sin(bend), math.cos(bend)) for bend in relative.tolist()]),
        lower=readonly(model.lowerPositionLimit[first:]),
        upper=readonly(model.upperPositionLimit[first:]),
    )
    yaw_axis = data.oMi[1].translation[:2] if first else np.zeros(2)
    return PlanarFamily(bool(first), readonly(yaw_axis), arm, readonly(points[0]), readonly(plane[:2]))


def _check_chain(model: pin.Model) -> None:
    """Reject anything but a serial chain of revolute joints."""
    for index in range(1, model.njoints):
        name, kind = model.names[index], model.joints[index].shortname()
        if kind not in TURNING_JOINTS:
            reason = f"it is a {kind}; the family's joints are revolute; {hold_advice(name)}"
            raise RobotFamilyError(model.name, f"joint {name!r}", reason)
        if model.parents[index] != index - 1:
            raise RobotFamilyError(model.name, f"joint {name!r}", "the chain branches here; only serial arms")


def _joint_axes(model: pin.Model, data: pin.Data) -> FloatArray:
    """(joints, 3) rotation axes at q = 0 in the base frame."""
    pin.computeJointJacobians(model, data, np.zeros(model.nq))
    jacobian = pin.getJointJacobian(model, data, model.njoints - 1, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    axes: FloatArray = np.reshape(jacobian, (6, -1))[3:].T  # for a single joint Pinocchio returns a vector
    return axes


def _has_yaw(model: pin.Model, axes: FloatArray) -> bool:
    """True if joint 0 alone is vertical."""
    if len(axes) == 1:
        return False
    between = _angle_between(axes[0], axes[1])
    if between <= _AXIS_TOLERANCE:
        return False
    joint, tilt = f"joint {model.names[1]!r}", _angle_between(axes[0], np.array([0.0, 0.0, 1.0]))
    if tilt > _AXIS_TOLERANCE:
        reason = "it is neither parallel to the next joint nor vertical" + _advise_on_axis(min(between, tilt))
        raise RobotFamilyError(model.name, joint, reason)
    if axes[0, 2] < 0.0:
        raise RobotFamilyError(model.name, joint, "the yaw axis points down; turn it to +z")
    lean = abs(math.atan2(axes[1, 2], math.hypot(axes[1, 0], axes[1, 1])))
    if lean > _AXIS_TOLERANCE:
        reason = "it is not perpendicular to the yaw axis" + _advise_on_axis(lean)
        raise RobotFamilyError(model.name, f"joint {model.names[2]!r}", reason)
    return True


def _plane(model: pin.Model, axes: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Axes of the arm plane, and joints and tool in it.

    The (3, 3) rows are the horizontal axis, the upward axis and the normal.
    """
    planar = model.names[model.njoints - len(axes) :]
    for name, axis in zip(planar, axes, strict=True):
        angle = _angle_between(axis, axes[0])
        if angle > _AXIS_TOLERANCE:
            reason = f"it is not parallel to joint {planar[0]!r}{_advise_on_axis(angle)}; {hold_advice(name)}"
            raise RobotFamilyError(model.name, f"joint {name!r}", reason)
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
    return np.stack([forward, up, normal]), points - aside[:, None] * normal


def _link_name(model: pin.Model, joint: int) -> str:
    """Name of the first body moved by a joint."""
    bodies = (frame for frame in model.frames if frame.parentJoint == joint and frame.type == pin.FrameType.BODY)
    return str(next((frame.name for frame in bodies), model.names[joint]))


def _capsule(
    shapes: Sequence[pin.GeometryObject], placement: pin.SE3, ends: FloatArray, normal: FloatArray
) -> tuple[float, float]:
    """Radius and lateral offset of a link's smallest capsule [m].

    The capsule's axis is the link's axis in the arm plane or, if that makes it thinner, a parallel to it off the plane.
    """
    if not shapes:
        raise TypeError("it has no collision geometry")
    aside = _thinnest([_outline_about(shape, placement, ends, normal) for shape in shapes])
    start, end = ends + aside * normal
    return max(_enclosing_radius(shape, placement, start, end) for shape in shapes), aside


def _angle_between(axis: FloatArray, other: FloatArray) -> float:
    """Angle between two lines, from 0 to pi/2 [rad].

    The lines are given by unit vectors.

    It uses atan2, because the arccosine loses small angles.
    """
    return math.atan2(float(np.linalg.norm(np.cross(axis, other))), abs(float(axis @ other)))


def _advise_on_axis(angle: float) -> str:
    """Advice about an axis that is off by a small angle."""
    if angle > 0.01:
        return ""
    return (
        f" by {angle:.3g} rad, more than the tolerance of {_AXIS_TOLERANCE:g}: write angles in full, a right angle as "
        "1.5707963267948966, or turn the <axis> instead of the <origin>"
    )


def _enclosing_radius(shape: pin.GeometryObject, joint_placement: pin.SE3, start: FloatArray, end: FloatArray) -> float:
    """Maximum distance of a shape's points from the segment `start`-`end` [m]."""
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
    """Offsets of a shape's points, their distances, and rounding [m].

    Offsets are from the plane, distances from the link's axis.

    The distances from the axis are measured in projection along the plane's normal.
    """
    placement = joint_placement * shape.placement
    corners, rounding = outline(shape, rim_from_outside=True)
    from_start = corners @ placement.rotation.T + placement.translation - ends[0]
    axis = ends[1] - ends[0]
    aside = from_start @ normal
    in_plane = from_start - aside[:, None] * normal
    along = np.clip(in_plane @ axis / (axis @ axis), 0.0, 1.0)
    return aside, np.linalg.norm(in_plane - along[:, None] * axis, axis=1), rounding


def _thinnest(outlines: Sequence[tuple[FloatArray, FloatArray, float]]) -> float:
    """Offset from the plane with the thinnest capsule [m].

    The capsule contains all outlines.

    The offset is 0 if a nonzero one brings no gain. The radius, a maximum of distances, is convex in the offset, so
    golden-section search finds the minimum.
    """

    def radius(at: float) -> float:
        return max(float(np.hypot(aside - at, away).max()) + rounding for aside, away, rounding in outlines)

    low, high = (float(end([end(aside) for aside, _, _ in outlines])) for end in (np.min, np.max))
    while high - low > 1e-3 * _GEOMETRY_TOLERANCE:
        left, right = high - _GOLDEN_FRACTION * (high - low), low + _GOLDEN_FRACTION * (high - low)
        if radius(left) <= radius(right):
            high = right
        else:
            low = left
    found = round(0.5 * (low + high), 6)
    return found if radius(found) < radius(0.0) - _GEOMETRY_TOLERANCE else 0.0
