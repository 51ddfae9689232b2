"""Compares Pinocchio's models with the URDF, element by element.

The reference is the strict reading of `hplan.robot.urdf_file`. Fixed joints merge links: their inertias are added to
the joint that moves them, and their shapes move with it.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.base.arrays import FloatArray
from hplan.errors import RobotFileError
from hplan.robot.dynamics import SLIDING_JOINTS, TURNING_JOINTS
from hplan.robot.urdf_file import CollisionShape, Joint, Link, Urdf
from hplan.robot.urdf_xml import line_of


def frame_number(model: pin.Model, name: str) -> int:
    """Index of a named frame; links take precedence over joints.

    Pinocchio's `nframes` if there is no such frame.
    """
    is_link = model.existFrame(name, pin.FrameType.BODY)
    return int(model.getFrameId(name, pin.FrameType.BODY) if is_link else model.getFrameId(name))


def check_joints(path: Path, model: pin.Model) -> None:
    """Reject unsupported joints, planar or not, and a missing tool frame.

    Raises:
        RobotFileError: A joint is unsupported or the tool frame is missing; the message names the element and the
            reason.
    """
    if model.njoints < 2:
        raise RobotFileError(path, "it has no moving joint")
    for index in range(1, model.njoints):
        name, kind = model.names[index], model.joints[index].shortname()
        if kind not in TURNING_JOINTS + SLIDING_JOINTS:
            advice = hold_advice(name) if model.joints[index].nq == 1 else "make it a fixed joint"
            reason = f"it is a {kind}; only revolute and prismatic joints move; {advice}"
            raise RobotFileError(path, f"joint {name!r}: {reason}")
        axis = model.joints[index].createData()
        model.joints[index].calc(axis, np.zeros(1))
        if not abs(np.linalg.norm(axis.S) - 1.0) <= 1e-9:
            raise RobotFileError(path, f"joint {name!r}: its axis has no direction")
        low, high = model.lowerPositionLimit[index - 1], model.upperPositionLimit[index - 1]
        if not low < high:
            unit = "rad" if kind in TURNING_JOINTS else "m"
            reason = f"its lower limit {low:g} {unit} is not below its upper limit {high:g} {unit}"
            raise RobotFileError(path, f"joint {name!r}: {reason}")


def hold_advice(joint: str) -> str:
    """End of a message: the argument that holds a joint."""
    return f"hold={{{joint!r}: 0.0}} (--hold {joint}=0) locks it"


def check_models(path: Path, urdf: Urdf, model: pin.Model, collision_model: pin.GeometryModel | None = None) -> None:
    """Compare Pinocchio's models with the content of the URDF.

    Compared are joints with their placements, axes and limits; placements of links; total inertias of links that move
    together; and, with a collision model, kinds, sizes and placements of shapes (for a mesh, its scale and that it is
    not empty).

    Args:
        path: The file, for messages.
        urdf: Its content.
        model: Pinocchio's kinematic model, not reduced.
        collision_model: Pinocchio's collision model; None to skip the shapes.

    Raises:
        RobotFileError: They differ; names the element, and both values.
    """
    check = _Check(path, model)
    moving = [joint for joint in urdf.joints.values() if joint.kind != "fixed"]
    if model.njoints - 1 != len(moving):
        raise RobotFileError(path, f"Pinocchio reads {model.njoints - 1} moving joints, the file has {len(moving)}")
    inertias = [np.zeros((6, 6)) for _ in range(model.njoints)]
    last: list[Link | None] = [None] * model.njoints
    shapes = {} if collision_model is None else {str(shape.name): shape for shape in collision_model.geometryObjects}
    count = 0
    for link, carrier, placement in _placed_links(check, urdf):
        check.link(link, carrier, placement)
        if link.inertial is not None:
            place = placement * link.inertial.placement
            inertias[carrier] += _spatial_inertia(link.inertial.mass, place, link.inertial.inertia)
            last[carrier] = link
        for number, shape in enumerate(link.shapes if collision_model is not None else ()):
            check.shape(link, shape, shapes.get(f"{link.name}_{number}"), carrier, placement * shape.placement)
            count += 1
    if count != len(shapes):
        raise RobotFileError(path, f"Pinocchio reads {len(shapes)} collision shapes, the file has {count}")
    for number, inertia in enumerate(inertias):
        found = np.array(model.inertias[number].matrix())
        what = "the inertia of its moving bodies" if number else "the inertia of the fixed bodies"
        owner = last[number]
        name = f"joint {model.names[number]!r}" if owner is None or number else f"link {owner.name!r}"
        check.check_same(None if owner is None else owner.element, name, what, found, inertia)


def _placed_links(check: _Check, urdf: Urdf) -> Iterator[tuple[Link, int, pin.SE3]]:
    """Yield each link, its carrying joint and its placement there, root first."""
    below: dict[str, list[Joint]] = {}
    for joint in urdf.joints.values():
        below.setdefault(joint.parent, []).append(joint)
    children = {joint.child for joint in urdf.joints.values()}
    waiting = [(link, 0, pin.SE3.Identity()) for name, link in urdf.links.items() if name not in children]
    while waiting:
        link, carrier, placement = waiting.pop()
        yield link, carrier, placement
        for joint in below.get(link.name, ()):
            place = placement * joint.placement
            if joint.kind == "fixed":
                waiting.append((urdf.links[joint.child], carrier, place))
            else:
                number = check.joint(joint, carrier, place)
                waiting.append((urdf.links[joint.child], number, pin.SE3.Identity()))


class _Check:
    """Compares elements of a URDF with one model."""

    def __init__(self, path: Path, model: pin.Model) -> None:
        self._path = path
        self._model = model

    def check_same(self, element: ET.Element | None, name: str, what: str, found: ArrayLike, said: ArrayLike) -> None:
        """Check that two readings of a number agree.

        Raises:
            RobotFileError: They differ; names the element, and both values.
        """
        ours, theirs = np.asarray(said, dtype=np.float64), np.asarray(found, dtype=np.float64)
        # Maximum difference between two readings of one number, relative to one plus its magnitude.
        if ours.shape == theirs.shape and np.abs(ours - theirs).max() <= 1e-9 * (1.0 + np.abs(ours).max()):
            return
        raise self._fault(element, f"{name}: Pinocchio reads {what} as {_short(theirs)}, the file says {_short(ours)}")

    def joint(self, joint: Joint, carrier: int, placement: pin.SE3) -> int:
        """Compare a moving joint; return its index."""
        model, name = self._model, f"joint {joint.name!r}"
        if not model.existJointName(joint.name):
            raise self._fault(joint.element, f"{name}: Pinocchio reads no joint with that name")
        number = int(model.getJointId(joint.name))
        self.check_same(joint.element, name, "its carrier", model.parents[number], carrier)
        self.check_same(
            joint.element, name, "its placement", model.jointPlacements[number].homogeneous, placement.homogeneous
        )
        if joint.kind not in ("revolute", "continuous", "prismatic"):
            return number
        self._axis(joint, name, number)
        moved = model.joints[number]
        limits = {"velocity": model.velocityLimit[moved.idx_v], "effort": model.effortLimit[moved.idx_v]}
        if joint.kind != "continuous":
            limits |= {"lower": model.lowerPositionLimit[moved.idx_q], "upper": model.upperPositionLimit[moved.idx_q]}
        for key, value in limits.items():
            if key in joint.limits or joint.kind != "continuous":
                self.check_same(joint.element, name, f"its {key} limit", value, joint.limits.get(key, 0.0))
        return number

    def _axis(self, joint: Joint, name: str, number: int) -> None:
        """Compare the axis of a joint; zero axes are refused elsewhere."""
        length = float(np.linalg.norm(joint.axis))
        if length == 0.0:
            return
        moved = self._model.joints[number]
        data = moved.createData()
        moved.calc(data, pin.neutral(self._model)[moved.idx_q : moved.idx_q + moved.nq])
        motion = np.ravel(data.S)
        rows = slice(0, 3) if joint.kind == "prismatic" else slice(3, 6)
        self.check_same(joint.element, name, "its axis", motion[rows], joint.axis / length)

    def link(self, link: Link, carrier: int, placement: pin.SE3) -> None:
        """Compare the placement of a link."""
        model, name = self._model, f"link {link.name!r}"
        if not model.existBodyName(link.name):
            raise self._fault(link.element, f"{name}: Pinocchio reads no link with that name")
        frame = model.frames[model.getBodyId(link.name)]
        self.check_same(link.element, name, "its carrier", frame.parentJoint, carrier)
        self.check_same(link.element, name, "its place", frame.placement.homogeneous, placement.homogeneous)

    def shape(
        self, link: Link, shape: CollisionShape, found: pin.GeometryObject | None, carrier: int, placement: pin.SE3
    ) -> None:
        """Compare a collision shape."""
        name = f"link {link.name!r}"
        if found is None:
            raise self._fault(shape.element, f"{name}: Pinocchio reads no such <collision>")
        kind, size = _kind_and_size(found)
        if kind != shape.kind:
            raise self._fault(shape.element, f"{name}: Pinocchio reads a {kind}, the file says {shape.kind}")
        self.check_same(shape.element, name, f"the size of its {kind}", size, shape.size)
        self.check_same(shape.element, name, f"the carrier of its {kind}", found.parentJoint, carrier)
        self.check_same(
            shape.element, name, f"the placement of its {kind}", found.placement.homogeneous, placement.homogeneous
        )

    def _fault(self, element: ET.Element | None, reason: str) -> RobotFileError:
        return RobotFileError(self._path, ("" if element is None else line_of(element)) + reason)


def _kind_and_size(shape: pin.GeometryObject) -> tuple[str, tuple[float, ...]]:
    """Kind and size of Pinocchio's shape, in the format of `hplan.robot.urdf_file.CollisionShape`."""
    geometry = shape.geometry
    if isinstance(geometry, coal.Box):
        return "box", tuple(2.0 * np.asarray(geometry.halfSide))
    if isinstance(geometry, coal.Sphere):
        return "sphere", (geometry.radius,)
    if isinstance(geometry, coal.Cylinder):
        return "cylinder", (geometry.radius, 2.0 * geometry.halfLength)
    if isinstance(geometry, coal.BVHModelBase) and geometry.num_tris > 0:
        return "mesh", tuple(shape.meshScale)
    return type(geometry).__name__, ()


def _spatial_inertia(mass: float, placement: pin.SE3, inertia: FloatArray) -> FloatArray:
    """(6, 6) spatial inertia about the origin of a body's reference frame.

    Args:
        mass: Mass [kg].
        placement: Centre of mass and axes of the inertia, in that frame.
        inertia: (3, 3) inertia about the centre of mass [kg m^2].
    """
    x, y, z = placement.translation
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    about = placement.rotation @ inertia @ placement.rotation.T - mass * cross @ cross
    return np.block([[mass * np.eye(3), -mass * cross], [mass * cross, about]])


def _short(numbers: FloatArray) -> str:
    rounded = np.round(numbers, 9) + 0.0
    return f"{float(rounded):.9g}" if rounded.ndim == 0 else str(rounded.tolist())
