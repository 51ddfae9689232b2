"""Reads an arm of the family out of Pinocchio's models: an optional yaw, then parallel revolute joints in one plane."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from hplan.base import ties
from hplan.base.arrays import FloatArray
from hplan.errors import RobotFamilyError
from hplan.scene.solids import CUBE_CORNERS

#: Lengths below this are zero, offsets below this are on the plane [m].
GEOMETRY_TOLERANCE = 1e-6

#: Axes this near to a direction have it [rad]: over ten metres 10 nm, of which no bound needs to take account.
AXIS_TOLERANCE = 1e-9

_INTO_THE_PLANE = "move the origin along the joint axis until it lies in the plane, and its link's shapes back"

_REVOLUTE = ("JointModelRX", "JointModelRY", "JointModelRZ", "JointModelRevoluteUnaligned")


class FamilyReader:
    """The planar chain in Pinocchio's models at q = 0; what is not of the family is refused.

    Attributes:
        has_yaw: True where joint 0 turns the arm plane about the vertical.
        origin: (3,) first planar joint [m].
        axes: (2, 3) the plane's horizontal and upward unit vectors.
        link_names: Names of the `n` planar links.
        lengths: (n,) their lengths [m].
        half_widths: (n,) radii of the capsules that enclose them [m].
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
                advice = hold_advice(name) if model.joints[index].nq == 1 else "make it fixed where it stands"
                raise self._fault(f"joint {name!r}", f"it is a {kind}; only revolute joints move; {advice}")
            if model.parents[index] != index - 1:
                raise self._fault(f"joint {name!r}", "the chain branches here; only serial arms")

    def _joint_axes(self, model: pin.Model) -> FloatArray:
        """(joints, 3) rotation axes at q = 0 in the base frame."""
        pin.computeJointJacobians(model, self.data, np.zeros(model.nq))
        jacobian = pin.getJointJacobian(model, self.data, model.njoints - 1, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        axes = np.reshape(jacobian, (6, -1))[3:].T  # of one joint, Pinocchio gives a vector
        for index, axis in enumerate(axes):
            if abs(np.linalg.norm(axis) - 1.0) > 1e-9:
                raise self._fault(f"joint {model.names[index + 1]!r}", "its axis has no direction")
        return axes

    def _find_yaw(self, model: pin.Model, axes: FloatArray) -> bool:
        """True where joint 0 is vertical and the others are not parallel to it."""
        if len(axes) == 1:
            return False
        between = _angle_between(axes[0], axes[1])
        if between <= AXIS_TOLERANCE:
            return False
        name = model.names[1]
        tilt = _angle_between(axes[0], np.array([0.0, 0.0, 1.0]))
        if tilt > AXIS_TOLERANCE:
            reason = "it is not parallel to the next joint and not vertical either"
            raise self._fault(f"joint {name!r}", reason + _nearly(min(between, tilt)))
        if axes[0, 2] < 0.0:
            raise self._fault(f"joint {name!r}", "the yaw axis points down; turn it to +z")
        lean = abs(math.atan2(axes[1, 2], math.hypot(axes[1, 0], axes[1, 1])))
        if lean > AXIS_TOLERANCE:
            raise self._fault(f"joint {model.names[2]!r}", "it is not perpendicular to the yaw axis" + _nearly(lean))
        x, y = self.data.oMi[1].translation[:2]
        if math.hypot(x, y) > GEOMETRY_TOLERANCE:
            reason = f"the yaw axis stands at ({x:.6g}, {y:.6g}) m; it must pass the root link's origin: call a link "
            reason += "'base_link' whose origin is on it"
            raise self._fault(f"joint {name!r}", reason)
        return True

    def _read_plane(self, model: pin.Model, axes: FloatArray, points: FloatArray, first: int) -> None:
        for offset, axis in enumerate(axes):
            angle = _angle_between(axis, axes[0])
            if angle > AXIS_TOLERANCE:
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
        lead = reach if abs(reach) > GEOMETRY_TOLERANCE else float(forward[ties.argmax(np.abs(forward))])
        if lead < 0.0:
            forward = -forward
        normal = np.cross(forward, up)
        offsets = (points - points[0]) @ normal
        names = [*tuple(model.names)[first + 1 :], "tool frame"]
        for name, offset in zip(names, offsets, strict=True):
            if abs(offset) > GEOMETRY_TOLERANCE:
                reason = f"it lies {offset:.6g} m beside the arm plane"
                raise self._fault(f"{name!r}", f"{reason}; {_INTO_THE_PLANE}")
        if self.has_yaw and abs(points[0] @ normal) > GEOMETRY_TOLERANCE:
            raise self._fault(
                f"joint {names[0]!r}",
                f"the arm plane passes the yaw axis at {points[0] @ normal:.6g} m; it must contain it; "
                + _INTO_THE_PLANE,
            )
        steps = np.diff(points, axis=0) @ np.stack([forward, up], axis=1)
        lengths = np.linalg.norm(steps, axis=1)
        self.link_names = tuple(self._link_name(model, index) for index in range(first + 1, model.njoints))
        for name, length in zip(self.link_names, lengths, strict=True):
            if length < GEOMETRY_TOLERANCE:
                raise self._fault(f"link {name!r}", "it has no length")
        absolute = np.array([math.atan2(y, x) for x, y in steps.tolist()])
        relative = np.diff(absolute, prepend=0.0)
        self.origin = points[0]
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

    def _read_half_widths(self, collision_model: pin.GeometryModel, points: FloatArray, first: int) -> None:
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
        f", by {angle:.3g} rad, of which {AXIS_TOLERANCE:g} is taken: write angles in full, a right one as "
        "1.5707963267948966, or turn the <axis> instead of the <origin>"
    )


def joint_range(model: pin.Model) -> tuple[FloatArray, FloatArray]:
    """Lower and upper joint limits, (joints,) each [rad].

    Raises:
        RobotFamilyError: A lower limit that is not below the upper one.
    """
    lower = np.array(model.lowerPositionLimit, dtype=np.float64)
    upper = np.array(model.upperPositionLimit, dtype=np.float64)
    for name, low, high in zip(tuple(model.names)[1:], lower, upper, strict=True):
        if not low < high:
            reason = f"its lower limit {low:g} rad is not below its upper limit {high:g} rad"
            raise RobotFamilyError(model.name, f"joint {name!r}", reason)
    return lower, upper


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


def outline(shape: pin.GeometryObject, *, rim_from_outside: bool) -> tuple[FloatArray, float]:
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
        return CUBE_CORNERS * np.asarray(geometry.halfSide), 0.0
    if hasattr(geometry, "vertices"):
        return np.asarray(geometry.vertices(), dtype=np.float64), 0.0
    raise TypeError(f"shape {kind} is not supported")
