"""Reads any robot's URDF, reduced to its moving joints, and their limits.

The robot need not be planar: any URDF that Pinocchio reads is supported.

Revolute, prismatic and continuous joints can move. A continuous joint becomes a revolute one without limits: its
waypoints are angles that count beyond a whole turn, and nothing is wrapped. Floating, planar and other joints with
several coordinates, and joints that mimic another or are mimicked, cannot move; they keep their default position or a
held one.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.base.arguments import file_path, instance, list_of, number, truth
from hplan.base.arrays import FloatArray, Record, as_array, readonly
from hplan.errors import InputError, RobotFileError
from hplan.robot.files import robot_files
from hplan.robot.limits import Limits
from hplan.robot.urdf_adaptation import fix_joint, standing_values
from hplan.robot.urdf_check import check_models
from hplan.robot.urdf_file import Joint, read_urdf
from hplan.robot.urdf_xml import read_urdf_xml

#: Position limit that represents a continuous joint's endless range [rad].
ENDLESS = 1e9


@dataclass(frozen=True, eq=False)
class Machine(Record):
    """Robot reduced to its moving joints.

    Attributes:
        model: Pinocchio's model of the moving joints; nq = nv. A limit missing in the URDF is inf.
        held: Positions of the other joints by name [rad, m]; None for joints with several coordinates, which are at
            their neutral position.
    """

    model: pin.Model
    held: Mapping[str, float | None]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints, in the model's order."""
        return tuple(self.model.names)[1:]


def read_machine(
    path: Path | str, joints: Sequence[str] | None = None, *, hold: Mapping[str, float] | None = None
) -> Machine:
    """Read any robot's kinematics and inertia from its URDF, without geometry.

    Args:
        path: URDF file, or the name of a robot as for `load_robot`.
        joints: Names of the moving joints; None for all joints that neither mimic another nor are mimicked.
        hold: Positions of joints that do not move [rad, m]. Other fixed joints are at 0, or at the limit nearest to 0.

    Raises:
        RobotFileError: The file is missing or malformed XML, `hplan.robot.urdf_file` or Pinocchio refuses its content,
            or Pinocchio reads it differently.
        InputError: A named joint does not exist or cannot move, no joint moves, or example-robot-data is not installed
            for a robot given by name.
        JointLimitError: A joint is held outside its limits.
    """
    path = robot_files(file_path("path", path)).urdf
    if joints is not None:
        joints = list_of("joints", joints, str, "names")
    hold = {} if hold is None else dict(instance("hold", hold, dict))
    for name, value in hold.items():
        number(f"hold[{name!r}]", value, "a position [rad]")
    root = read_urdf_xml(path)
    joints_of = read_urdf(path, root, any_robot=True).joints
    elements = {name: joint for name, joint in joints_of.items() if joint.kind != "fixed"}
    tied = _tied(elements)
    moving = [name for name in elements if name not in tied] if joints is None else list(joints)
    movable = ("revolute", "prismatic", "continuous")
    for name in [*moving, *hold]:
        if name not in elements:
            raise InputError(f"robot file {path}: there is no moving joint {name!r}", path=str(path), joint=name)
        if name in tied and name in moving:
            raise _immovable(path, name, "moved", f"it and {tied[name]!r} move as one (mimic)")
        kind = elements[name].kind
        if kind not in movable:
            raise _immovable(
                path, name, "moved or held", f"it is {kind}; only revolute, prismatic and continuous joints can"
            )
        if name in moving and name in hold:
            raise InputError(f"joint {name!r} cannot both move and be held", joint=name)
    if not moving:
        raise InputError(f"robot file {path}: there is no joint to move", path=str(path))
    values = standing_values(path, joints_of, hold)
    held = {name: values[name] for name in elements if name not in moving}
    for name in held:
        fix_joint(path, elements[name], values[name])
    missing = {name: _make_revolute(elements[name].element) for name in moving if elements[name].kind == "continuous"}
    try:
        model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        reason = f"Pinocchio refuses it: {error} (its own messages, if any, are on the terminal)"
        raise RobotFileError(path, reason) from error
    check_models(path, read_urdf(path, root, any_robot=True), model)
    for name, attributes in missing.items():
        for attribute in attributes:
            limit = model.velocityLimit if attribute == "velocity" else model.effortLimit
            limit[model.joints[model.getJointId(name)].idx_v] = np.inf
    return Machine(model, held)


def _tied(joints: Mapping[str, Joint]) -> dict[str, str]:
    """Map each joint that mimics or is mimicked to its counterpart."""
    tied: dict[str, str] = {}
    for follower, joint in joints.items():
        for mimic in joint.element.findall("mimic"):
            leader = str(mimic.get("joint"))
            tied[follower] = leader
            tied.setdefault(leader, follower)
    return tied


def _immovable(path: Path, joint: str, what: str, reason: str) -> InputError:
    return InputError(
        f"robot file {path}: joint {joint!r} cannot be {what}: {reason}. Name the joints to move; "
        "the other joints keep their positions",
        path=str(path),
        joint=joint,
        reason=reason,
    )  # fmt: skip


def _make_revolute(joint: ET.Element) -> list[str]:
    """Make a continuous joint revolute without limits; return its missing limit attributes."""
    joint.set("type", "revolute")
    limit = joint.find("limit")
    if limit is None:
        limit = ET.SubElement(joint, "limit")
    missing = [attribute for attribute in ("velocity", "effort") if attribute not in limit.attrib]
    for attribute in missing:
        limit.set(attribute, "0")
    limit.set("lower", str(-ENDLESS))
    limit.set("upper", str(ENDLESS))
    return missing


def limits_of(
    model: pin.Model, acceleration: ArrayLike, jerk: ArrayLike | None = None, *, torque: bool = True
) -> Limits:
    """Combine a model's velocity and torque limits with acceleration and jerk limits.

    Args:
        model: Pinocchio's model; its limits are the URDF's. A limit of 0 is used as such.
        acceleration: (dof,), or one value for all joints [rad/s^2].
        jerk: (dof,), or one value for all joints [rad/s^3]; None for no limit.
        torque: Whether torques are limited.

    Raises:
        InputError: A limit is negative, not finite or missing in the URDF; names the joint.
    """
    instance("model", model, pin.Model, "read_machine")
    truth("torque", torque)
    names = tuple(model.names)[1:]

    def checked(what: str, values: ArrayLike) -> FloatArray:
        try:
            array = readonly(np.broadcast_to(as_array(values).astype(np.float64), (model.nv,)))
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError(f"{what}: expected one number, or {model.nv}", option=what) from error
        for name, value in zip(names, array, strict=False):
            if value == np.inf:
                raise InputError(f"joint {name!r} has no {what} limit; the motion requires one", joint=name)
            if not (np.isfinite(value) and value >= 0.0):
                raise InputError(f"joint {name!r}: its {what} limit is {value:g}, expected a number >= 0", joint=name)
        return array

    return Limits(
        velocity=checked("velocity", model.velocityLimit),
        acceleration=checked("acceleration", acceleration),
        torque=checked("torque", model.effortLimit) if torque else None,
        jerk=None if jerk is None else checked("jerk", jerk),
    )
