"""Times waypoints of any robot's URDF: the fastest motion with rounded corners.

The path is made by `hplan.trajectory.corner_rounding`. For prismatic joints, radians mean metres; the columns of their
files are named accordingly.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.base.arguments import file_path, instance, list_of, number, truth
from hplan.base.arrays import FloatArray, Record, as_array, readonly
from hplan.base.csv_file import CsvFile
from hplan.base.units import joint_unit
from hplan.errors import InputError, JointLimitError, RobotFileError, TimingError
from hplan.robot.dynamics import joints_that_slide
from hplan.robot.files import robot_files
from hplan.robot.limits import Limits
from hplan.robot.urdf_adaptation import fix_joint, standing_values
from hplan.robot.urdf_check import check_models
from hplan.robot.urdf_file import read_urdf
from hplan.robot.urdf_xml import read_urdf_xml
from hplan.trajectory import retime as timing
from hplan.trajectory.corner_rounding import as_waypoints, rounded_path
from hplan.trajectory.speed_profile import EMPTY_PATH
from hplan.trajectory.spline import SplinePath
from hplan.trajectory.trajectory import Trajectory

#: Default deviation from the polyline at its corners [rad].
DEVIATION = math.radians(1.0)

#: Minimum and maximum number of grid points for half of a rounded corner; many corners share `_MOST_POINTS`.
_CORNER_POINTS, _MOST_POINTS = (10, 100), 60_000

#: A joint that uses at least this fraction of a limit counts as limiting the motion.
AT_LIMIT = 0.99

#: Position limit that represents a continuous joint's endless range [rad].
ENDLESS = 1e9


def read_kinematics(
    path: Path | str, joints: Sequence[str] | None = None, *, hold: Mapping[str, float] | None = None
) -> tuple[pin.Model, dict[str, float | None]]:
    """Read moving joints and inertia of a robot's URDF, without geometry.

    Revolute, prismatic and continuous joints can move. A continuous joint becomes a revolute one without limits: its
    angles count beyond a whole turn. Joints with several coordinates, and joints that mimic another or are mimicked,
    cannot move.

    Args:
        path: URDF file, or the name of a robot as for `load_robot`.
        joints: Names of the moving joints; None for all joints that neither mimic another nor are mimicked.
        hold: Positions of joints that do not move [rad, m]. Other fixed joints are at 0, or at the limit nearest to 0.

    Returns:
        Pinocchio's model of the moving joints, with nq = nv and inf for a limit that the URDF lacks; and the positions
        of the other joints by name [rad, m], None for joints with several coordinates, which are at their neutral
        position.

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
    # Each joint that mimics or is mimicked, and its counterpart.
    tied: dict[str, str] = {}
    for follower, joint in elements.items():
        for mimic in joint.element.findall("mimic"):
            leader = str(mimic.get("joint"))
            tied[follower] = leader
            tied.setdefault(leader, follower)
    moving = [name for name in elements if name not in tied] if joints is None else list(joints)
    movable = ("revolute", "prismatic", "continuous")
    for name in [*moving, *hold]:
        if name not in elements:
            raise InputError(f"robot file {path}: there is no moving joint {name!r}", path=str(path), joint=name)
        kind, reason = elements[name].kind, ""
        if name in tied and name in moving:
            reason = f"moved: it and {tied[name]!r} move as one (mimic)"
        elif kind not in movable:
            reason = f"moved or held: it is {kind}; only revolute, prismatic and continuous joints can"
        if reason:
            advice = "Name the joints to move; the other joints keep their positions"
            words = f"robot file {path}: joint {name!r} cannot be {reason}. {advice}"
            raise InputError(words, path=str(path), joint=name, reason=reason.partition(": ")[2])
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
    missing |= {name: list(root.assumed[name]) for name in moving if name in root.assumed}
    for name, attributes in missing.items():
        for attribute in attributes:
            limit = model.velocityLimit if attribute == "velocity" else model.effortLimit
            limit[model.joints[model.getJointId(name)].idx_v] = np.inf
    return model, held


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
    instance("model", model, pin.Model, "read_kinematics")
    truth("torque", torque)
    names = tuple(model.names)[1:]

    def check_values(what: str, values: ArrayLike) -> FloatArray:
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
        velocity=check_values("velocity", model.velocityLimit),
        acceleration=check_values("acceleration", acceleration),
        torque=check_values("torque", model.effortLimit) if torque else None,
        jerk=None if jerk is None else check_values("jerk", jerk),
    )


def read_waypoints(path: Path | str, joint_names: Sequence[str], slides: Sequence[bool] = ()) -> FloatArray:
    """Read (n, dof) waypoints from a CSV file, n >= 1.

    The file has a header and one line per waypoint. A joint's column is `NAME` or `NAME_pos_rad`, in radians, or
    `NAME_pos_m`, in metres, if the joint is prismatic; columns may be in any order. Other columns and empty lines are
    ignored. A trajectory written by hplan can be read as well.

    Args:
        path: The file.
        joint_names: Names of the `dof` joints, in the order of the result.
        slides: Whether each joint is prismatic; empty if none is.

    Raises:
        InputError: The file is missing or unreadable, a joint has no column or two, a line has another length, a value
            is not a finite number, or there is no waypoint; names the line.
    """
    joint_names = list_of("joint_names", joint_names, str, "names")

    file = CsvFile.read(path, "waypoint", "waypoint", blank=True)
    header = [name.strip() for name in file.header]
    if not header:
        raise file.fault(1, "expected a header with the names of the joints")
    columns = []
    for joint, slide in zip(joint_names, slides or [False] * len(joint_names), strict=True):
        own = f"{joint}_{joint_unit(slide).columns[0]}"
        found = [index for index, name in enumerate(header) if name in (joint, own)]
        if len(found) != 1:
            how = "two columns" if found else f"no column; expected {own} or {joint}"
            raise file.fault(file.first, f"joint {joint!r} has {how} (the columns are {', '.join(header)})")
        columns.append(found[0])
    return readonly([values for _, _, values in file.number_rows(columns)])


def time_waypoints(
    model: pin.Model,
    waypoints: ArrayLike,
    limits: Limits,
    *,
    deviation_rad: float = DEVIATION,
    rate_hz: float = 250.0,
    speed: float = 1.0,
) -> Trajectory:
    """Fastest rest-to-rest motion through waypoints, with corners rounded by `rounded_path`.

    The samples are averages of the motion along the path over a period h (`hplan.trajectory.retime`). They are off the
    path by less than a h^2 / 6 for each joint (a: acceleration; 3e-6 rad for 1 rad/s^2 at 250 Hz), and by more with
    jerk limits. They stay in the convex hull of the waypoints.

    Args:
        model: Pinocchio's model; all its joints have one coordinate (as from `read_kinematics`).
        waypoints: (n, dof) configurations within the joint limits; equal ones are an empty motion.
        limits: Limits of the motion, as from `limits_of`.
        deviation_rad: Maximum distance between path and polyline, Euclidean norm; at least 1e-4.
        rate_hz: Samples per second.
        speed: Fraction of full speed, in (0, 1].

    Raises:
        InputError: A joint has several coordinates, or `waypoints` is not an (n, dof) array of finite numbers.
        JointLimitError: A waypoint is outside the joint limits (by more than 1e-9 rad); waypoints are counted from 1.
        OptionError: The deviation, rate or speed is out of range.
        TimingError: No motion within the limits exists; names the joint and the cause.
    """
    instance("model", model, pin.Model, "read_kinematics")
    instance("limits", limits, Limits, "limits_of")
    names = tuple(model.names)[1:]
    for name, joint in zip(names, tuple(model.joints)[1:], strict=True):
        if (joint.nq, joint.nv) != (1, 1):
            raise InputError(
                f"joint {name!r} ({joint.shortname()}) has {joint.nq} coordinates and {joint.nv} velocities; only "
                "joints with one of each can be timed. hplan.trajectory.read_kinematics converts continuous joints",
                joint=name,
            )
    points = as_waypoints(waypoints)
    if points.shape[1] != len(names):
        raise InputError(f"waypoints: {points.shape[1]} values each, expected {len(names)} ({', '.join(names)})")
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    outside = (points < lower - 1e-9) | (points > upper + 1e-9)
    for place, joint in np.argwhere(outside)[:1]:
        value = float(points[place, joint])
        slides, ends = joints_that_slide(model)[joint], (float(lower[joint]), float(upper[joint]))
        raise JointLimitError(f"waypoint {place + 1}", names[joint], value, *ends, joint_unit(slides).position)
    points = np.clip(points, lower, upper)
    if limits.torque is not None:
        for joint in np.flatnonzero((np.ptp(points, axis=0) >= EMPTY_PATH) & ~(limits.torque > 0.0)):
            raise TimingError(
                f"joint {names[joint]!r} must move, but its torque limit is {limits.torque[joint]:g}",
                joint=names[joint],
                cause="torque limit of zero",
            )
    path = rounded_path(points, deviation_rad)
    return timing.time_path(path, model, limits.scale(speed), rate_hz=rate_hz, grid=corner_grid(path))


def corner_grid(path: SplinePath) -> FloatArray:
    """Path parameters for a `rounded_path`: many in each corner, few in between.

    The number per corner does not depend on its length. In a corner the joints that reverse pass a point where path
    acceleration does not move them; on a coarse grid toppra lets it jump up and down there, and timing would slow the
    whole motion down to remove that.
    """
    breaks = instance("path", path, SplinePath, "rounded_path").breaks
    corners = (len(breaks) - 2) // 3
    each = _MOST_POINTS // (3 * max(corners, 1))
    even = np.linspace(0.0, 1.0, int(np.clip(each, *_CORNER_POINTS)) + 1)
    # Between corners, and from and to rest, the grid is dense at the ends; without corners it has as many points as for
    # any path.
    straight_points = (10, 60)
    count = int(np.clip(each, *straight_points)) if corners else timing.GRID_POINTS
    eased = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, count)))
    # Pieces come in threes: straight, into the corner, out of it.
    parts = [
        low + (high - low) * (eased if piece % 3 == 0 else even)[:-1]
        for piece, (low, high) in enumerate(pairwise(breaks))
    ]
    return np.concatenate([*parts, breaks[-1:]])


@dataclass(frozen=True, eq=False)
class LimitShares(Record):
    """Use of each joint's limits, as fractions.

    Attributes:
        velocity: (dof,) maximum |velocity| / limit.
        acceleration: (dof,) maximum |acceleration| / limit.
        torque: (dof,) maximum |torque| / limit; None if torque is not limited.
        jerk: (dof,) maximum change of acceleration from sample to sample / limit; None if jerk is not limited.
        binding: (dof,) fraction of the samples in which the joint uses `AT_LIMIT` or more of some limit other than
            jerk.
        bound: Fraction of the samples in which any joint does.
    """

    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray | None
    jerk: FloatArray | None
    binding: FloatArray
    bound: float


def limit_shares(trajectory: Trajectory, limits: Limits) -> LimitShares:
    """Compute the use of limits in a trajectory's samples.

    A joint at rest may have limits of zero.

    Args:
        trajectory: The motion.
        limits: (dof,) limits; scale them like the motion, so that `binding` refers to its reduced limits.

    Examples:
        >>> motion = Trajectory(("q1",), [0.0, 2.0], [[0.0], [1.0]], [[0.0], [0.0]], [[0.0], [0.0]], [[0.0], [0.0]])
        >>> limit_shares(motion, Limits(np.ones(1), np.ones(1))).bound
        0.0
    """
    instance("trajectory", trajectory, Trajectory, "time_waypoints")
    instance("limits", limits, Limits, "limits_of")

    def fractions(values: FloatArray, limit: FloatArray) -> FloatArray:
        size = np.abs(values)
        return np.where(size <= 1e-9, 0.0, size / np.maximum(limit, 1e-12))

    rows = [fractions(trajectory.velocity, limits.velocity), fractions(trajectory.acceleration, limits.acceleration)]
    if limits.torque is not None:
        rows.append(fractions(trajectory.torque, limits.torque))
    largest = [readonly(row.max(axis=0)) for row in rows]
    at_limit = np.max(rows, axis=0) >= AT_LIMIT
    jerk = None
    if limits.jerk is not None:
        change = np.diff(trajectory.acceleration, axis=0) / np.diff(trajectory.time)[:, None]
        jerk = readonly(fractions(change, limits.jerk).max(axis=0, initial=0.0))
    return LimitShares(
        velocity=largest[0],
        acceleration=largest[1],
        torque=largest[2] if len(largest) > 2 else None,
        jerk=jerk,
        binding=readonly(at_limit.mean(axis=0)),
        bound=float(at_limit.any(axis=1).mean()),
    )
