"""Conversion of motions to and from `JointTrajectory` and `JointState` messages.

A written message (`trajectory_msgs/msg/JointTrajectory`, `sensor_msgs/msg/JointState`) is a plain dict with the fields
of its definition, made of lists and numbers. It is ready for JSON and, with ROS, for `hplan.apps.ros.to_message`, which
makes it an object. Readers take objects of rclpy and rosbags, dicts and files.

`joint_trajectory_controller` chooses the curve between two points by their fields: a quintic if they have
accelerations, a cubic if they have velocities only, a straight line if they have positions only. A message therefore
has exactly the fields that make the controller run the certified curve, `Trajectory.interpolation`. Messages of hplan's
own motions have positions and velocities.
"""

from __future__ import annotations

import json
from array import array
from collections.abc import Iterator, Mapping, Sequence, Set, Sized
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

import numpy as np
import yaml

from hplan.apps.ros.fields import are_messages, column, fields_of, is_message, read_message, stack_rows
from hplan.apps.ros.transforms import SECOND_NS, message_time, seconds_of, time_ns, times_ns
from hplan.base.arguments import check_integer, file_path, instance, list_between, list_of, one_of, truth
from hplan.base.arrays import FloatArray, numbers
from hplan.base.files import write_text
from hplan.base.units import FARTHEST_JOINT
from hplan.certificate.goal_contact import REST
from hplan.errors import InputError, OptionError
from hplan.robot.model import Robot
from hplan.trajectory.cubics import Interpolation
from hplan.trajectory.trajectory import Trajectory

#: Fields of a message's points and the corresponding arrays of a trajectory.
_FIELDS = {"positions": "position", "velocities": "velocity", "accelerations": "acceleration", "effort": "torque"}

#: Fields of the points that make a controller choose each curve.
_FIELDS_OF: dict[Interpolation, tuple[str, ...]] = {
    "linear": ("positions",),
    "cubic": ("positions", "velocities"),
    "quintic": ("positions", "velocities", "accelerations"),
}


def to_joint_trajectory(
    trajectory: Trajectory, *, prefix: str = "", frame_id: str = "", stamp_s: float = 0.0, effort: bool = False
) -> dict[str, Any]:
    """Convert a motion to a `trajectory_msgs/msg/JointTrajectory` for `joint_trajectory_controller`.

    Args:
        trajectory: The motion; each sample becomes a point.
        prefix: Prepended to every joint name, for example "left_".
        frame_id: Frame in the header.
        stamp_s: Time of the first sample on the controller's clock [s]; 0 to start on receipt.
        effort: Include torques. Controllers without an effort interface refuse such goals.

    Raises:
        OptionError: An argument of another type, or a time that a message cannot represent. Also `stamp_s` of 0 for a
            stop, a splice or another motion that takes over from a running one: a controller that started it on receipt
            would send the arm back.
        InputError: Two samples are within a nanosecond.
    """
    instance("trajectory", trajectory, Trajectory, "plan or read_csv")
    stamp_ns = time_ns("stamp_s", stamp_s)
    if stamp_ns == 0 and _needs_stamp(trajectory):
        raise OptionError(
            "stamp_s",
            stamp_s,
            "the time of the first sample on the controller's clock, such as the result's begins_s, and not 0, the "
            "time of receipt: the motion takes over from a running one, and a controller that begins it on receipt "
            "would send the arm back. For a motion that began at 0, send trajectory.cut_before(row) with the time of "
            "that sample",
        )
    header = _header(frame_id, stamp_ns)
    given = (*_FIELDS_OF[trajectory.interpolation], *(["effort"] if truth("effort", effort) else []))
    fields = {field: name for field, name in _FIELDS.items() if field in given}
    left_out: dict[str, list[float]] = {field: [] for field in _FIELDS if field not in given}
    times = times_ns("time", trajectory.time)
    for row, (first, second) in enumerate(pairwise(times), start=1):
        if first == second:
            raise InputError(f"sample {row} of the trajectory is within a nanosecond of the one before it", row=row)
    rows = zip(*(getattr(trajectory, name).tolist() for name in fields.values()), strict=True)
    return {
        "header": header,
        "joint_names": _joint_names_of(trajectory, prefix),
        "points": [
            {
                **dict(zip(fields, row, strict=True)),
                **left_out,
                "time_from_start": message_time(time),
            }
            for row, time in zip(rows, times, strict=True)
        ],
    }


def write_joint_trajectory(trajectory: Trajectory, file: Path | str, **options: Any) -> Path:
    """Write the message of `to_joint_trajectory` as YAML or JSON.

    The format is JSON if the file's name ends in `.json`. `ros2 topic pub --once --stdin TOPIC
    trajectory_msgs/msg/JointTrajectory < FILE` sends either format (ROS 2 Jazzy and later). As a command-line argument
    the message would be too long for most shells.

    Args:
        trajectory: The motion.
        file: The file; replaced completely or not at all.
        options: Keyword arguments of `to_joint_trajectory`.

    Returns:
        The path of the file.

    Raises:
        HplanError: The motion has no message (`to_joint_trajectory`).
        OutputError: The file cannot be written.
    """
    path, message = file_path("file", file), to_joint_trajectory(trajectory, **options)
    if path.suffix.lower() == ".json":
        return write_text(path, json.dumps(message))
    return write_text(path, yaml.safe_dump(message, sort_keys=False, default_flow_style=None))


def to_joint_state(
    trajectory: Trajectory, row: int, *, prefix: str = "", frame_id: str = "", stamp_s: float = 0.0
) -> dict[str, Any]:
    """Convert one sample of a motion to a `sensor_msgs/msg/JointState`.

    Args:
        trajectory: The motion.
        row: Index of the sample.
        prefix: Prepended to every joint name.
        frame_id: Frame in the header.
        stamp_s: Start time of the motion [s]; the sample's own time is added.

    Raises:
        OptionError: The sample does not exist, an argument is of another type, or a time cannot be represented in a
            message.
    """
    instance("trajectory", trajectory, Trajectory, "plan or read_csv")
    row = check_integer("row", row, 0, trajectory.samples - 1)
    stamp = time_ns("stamp_s", stamp_s) + time_ns("time", float(trajectory.time[row]))
    return {
        "header": _header(frame_id, stamp),
        "name": _joint_names_of(trajectory, prefix),
        "position": trajectory.position[row].tolist(),
        "velocity": trajectory.velocity[row].tolist(),
        "effort": trajectory.torque[row].tolist(),
    }


def from_joint_trajectory(
    message: Any,
    *,
    prefix: str = "",
    robot: Robot | None = None,
    interpolation: Interpolation | None = None,
    rest: Mapping[str, float] | None = None,
) -> Trajectory:
    """Convert a `trajectory_msgs/msg/JointTrajectory` to a trajectory, for example to certify it.

    Args:
        message: The message from any planner; its first point is at time 0. An object of rclpy or rosbags, a dict, or a
            YAML or JSON file. Also a message that contains it: `moveit_msgs/msg/RobotTrajectory`, a `DisplayTrajectory`
            of one motion, or a `FollowJointTrajectory` goal.
        prefix: Prefix to remove from every joint name.
        robot: Robot that defines the order of the joints, and whose inverse dynamics gives the torques if the points
            have no efforts. None keeps the order of the message.
        interpolation: The curve that the controller runs between the points. None for the curve that
            `joint_trajectory_controller` chooses: `quintic` for points with accelerations, `cubic` for points with
            velocities only, `linear` for points with positions only.
        rest: Positions of joints of the robot that the message does not move, by name [rad, m if prismatic]. None if
            the message has all of them.

    Raises:
        InputError: A field is missing or of another kind, lists differ in length, times do not increase from 0; points
            lack a field that other points have or that the interpolation requires; without a robot, points lack
            efforts; the joints are not the robot's; the message has several motions or moves multi-DOF joints; or the
            file is missing or malformed.
        OptionError: The message is no message, the prefix is not text, or the interpolation is unknown.

    Examples:
        >>> points = [
        ...     {"positions": [0.0], "effort": [0.0], "time_from_start": {"sec": 0, "nanosec": 0}},
        ...     {"positions": [0.5], "effort": [0.0], "time_from_start": {"sec": 2, "nanosec": 0}},
        ... ]
        >>> motion = from_joint_trajectory({"joint_names": ["left_elbow"], "points": points}, prefix="left_")
        >>> motion.joint_names, motion.interpolation, motion.duration
        (('elbow',), 'linear', 2.0)
    """
    parts = joint_trajectories(message)
    if len(parts) != 1:
        raise InputError(
            f"the message has {len(parts)} motions, expected one; `joint_trajectories` returns each", motions=len(parts)
        )
    content = parts[0]
    names = tuple(name.removeprefix(_cell_text("prefix", prefix)) for name in _list(content, "joint_names", str))
    points = content.get("points")
    if not isinstance(points, list | tuple) or not points or not are_messages(points):
        points = _list(content, "points", Mapping)
    columns = {field: column(points, field) for field in _FIELDS}
    given = {field for field, rows in columns.items() if not _are_empty(rows)}
    curve = _curve_of(given, interpolation)
    count = len(points)
    arrays = {
        _FIELDS[field]: _array(columns[field], field, len(names))
        for field in _FIELDS
        if field in given or field in _FIELDS_OF[curve] or (field == "effort" and robot is None)
    }
    if robot is not None and rest:
        still = [name for name in instance("robot", robot, Robot, "load_robot").joint_names if name not in names]
        names, arrays = _with_rest(names, arrays, {name: rest[name] for name in still if name in rest})
    order = _order(names, robot)
    arrays = {name: rows[:, order] for name, rows in arrays.items()}
    joints, slides = tuple(names[index] for index in order), () if robot is None else robot.slides
    zero = np.zeros((count, len(order)))
    velocity, acceleration, torque = (arrays.get(name, zero) for name in ("velocity", "acceleration", "torque"))
    motion = Trajectory(joints, _times(points), arrays["position"], velocity, acceleration, torque, slides, curve)
    return _filled_in(motion, arrays.keys(), robot)


def joint_trajectories(message: Any) -> tuple[Mapping[str, Any], ...]:
    """The `JointTrajectory` messages in a message, in order, as mappings of their fields.

    Args:
        message: A `JointTrajectory`, `RobotTrajectory`, `DisplayTrajectory` or `FollowJointTrajectory` goal: an object
            of rclpy or rosbags, a dict, or a YAML or JSON file.

    Raises:
        InputError: A `RobotTrajectory` moves multi-DOF joints, a part is no message, or the file is missing or
            malformed.
        OptionError: `message` is no message.

    Examples:
        >>> part = {"joint_names": ["elbow"], "points": []}
        >>> joint_trajectories({"trajectory": [{"joint_trajectory": part}]}) == (part,)
        True
    """
    if not is_message(message) and not isinstance(message, str | Path):
        raise OptionError("message", message, "a JointTrajectory, as an object, a dict or a file")
    content, _ = read_message(message)
    return tuple(_iterate_parts(content))


def _iterate_parts(content: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    if "joint_trajectory" in content:
        moved = fields_of(content.get("multi_dof_joint_trajectory") or {})
        if len(moved.get("points", ())):
            names = ", ".join(moved.get("joint_names", ()))
            raise InputError(f"the trajectory moves multi-DOF joints ({names}), which hplan does not model")
        content = _part(content["joint_trajectory"], "joint_trajectory")
    inner = content.get("trajectory")
    if inner is None:
        yield content
    else:
        for part in inner if isinstance(inner, list | tuple) else [inner]:
            yield from _iterate_parts(_part(part, "trajectory"))


def _part(content: Any, where: str) -> Mapping[str, Any]:
    if not is_message(content):
        raise InputError(f"{where}: expected a message, got {content!r}", key=where)
    return fields_of(content)


def _with_rest(
    names: tuple[str, ...], arrays: Mapping[str, FloatArray], rest: Mapping[str, float]
) -> tuple[tuple[str, ...], dict[str, FloatArray]]:
    """Names and arrays with additional joints at rest."""
    held = list_between("rest", list(rest.values()), -FARTHEST_JOINT, FARTHEST_JOINT) if rest else ()
    found = {}
    for name, rows in arrays.items():
        values = np.array(held) if name == "position" else np.zeros(len(held))
        found[name] = np.hstack([rows, np.broadcast_to(values, (len(rows), len(held)))])
    return (*names, *rest), found


def _times(points: Sequence[Any]) -> FloatArray:
    """(n,) times of the points [s]."""
    stamps = column(points, "time_from_start")
    whole, parts = (column(stamps, key) if are_messages(stamps) else [None] for key in ("sec", "nanosec"))
    if {*map(type, whole), *map(type, parts)} == {int}:
        seconds, rest = np.array(whole), np.array(parts)
        # Exact in doubles, and the division rounds once.
        exact = 2**53 // SECOND_NS - 1
        if ((seconds >= 0) & (seconds <= exact) & (rest >= 0) & (rest < SECOND_NS)).all():
            found: FloatArray = (seconds * SECOND_NS + rest) / SECOND_NS
            return found
    places = (f"points[{index}].time_from_start" for index in range(len(points)))
    return np.array([seconds_of(where, stamp) for where, stamp in zip(places, stamps, strict=True)])


def _curve_of(given: Set[str], interpolation: Interpolation | None) -> Interpolation:
    """Curve that a controller runs between points with these fields.

    Args:
        given: Fields of the points that have numbers.
        interpolation: The curve to use; None for the controller's choice.

    Raises:
        InputError: The points have accelerations but no velocities.
        OptionError: The interpolation is unknown.
    """
    if interpolation is not None:
        one_of("interpolation", interpolation, get_args(Interpolation))
        return interpolation
    if "accelerations" in given and "velocities" not in given:
        raise InputError(
            "points have accelerations but no velocities: joint_trajectory_controller cannot interpolate them"
        )
    curves: tuple[Interpolation, ...] = ("quintic", "cubic", "linear")
    return next(curve for curve in curves if set(_FIELDS_OF[curve]) <= given | {"positions"})


def _filled_in(motion: Trajectory, given: Set[str], robot: Robot | None) -> Trajectory:
    """Fill in missing velocities, accelerations and torques of a motion.

    Velocities and accelerations are the derivatives of the curve at the samples. At a jump it is the value after it;
    the last velocity of straight lines is zero. Torques are inverse dynamics, if a robot is given.

    Args:
        motion: The motion, with zeros for the missing arrays.
        given: Names of the arrays that the message has.
        robot: The robot; None to leave the torques as they are.
    """
    bezier, duration = motion.segments
    degree, h = bezier.shape[1] - 1.0, duration[:, None]
    steps, bends = np.diff(bezier, axis=1), np.diff(bezier, n=2, axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        velocity = degree * steps[:, 0] / h
        push = np.vstack([bends[:, 0] / h**2, bends[-1:, -1] / h[-1] ** 2]) * degree * (degree - 1.0)
    if motion.samples > 1 and "velocity" not in given:
        motion = replace(motion, velocity=np.vstack([velocity, np.zeros((1, velocity.shape[1]))]))
    if motion.samples > 1 and "acceleration" not in given and motion.interpolation == "cubic":
        motion = replace(motion, acceleration=push)
    if robot is None or "torque" in given:
        return motion
    return replace(motion, torque=robot.dynamics.torques(motion.position, motion.velocity, motion.acceleration))


def _needs_stamp(trajectory: Trajectory) -> bool:
    """True if the trajectory takes over from a running motion.

    It is marked so (`takes_over_s`), or begins with a nonzero velocity.
    """
    if trajectory.takes_over_s is not None:
        return True
    # Straight lines start from rest: their velocity jumps at the first sample.
    moving = trajectory.interpolation != "linear" and np.abs(trajectory.velocity[0]).max(initial=0.0) > REST
    return bool(moving)


def _are_empty(rows: Sequence[Any]) -> bool:
    """True if all rows are empty lists or None."""
    if {*map(type, rows)} == {array}:
        return not any(map(len, rows))
    return all(row is None or (isinstance(row, Sized) and len(row) == 0) for row in rows)


def _header(frame_id: str, stamp_ns: int) -> dict[str, Any]:
    return {"stamp": message_time(stamp_ns), "frame_id": _cell_text("frame_id", frame_id)}


def _joint_names_of(trajectory: Trajectory, prefix: str) -> list[str]:
    return [_cell_text("prefix", prefix) + name for name in trajectory.joint_names]


def _cell_text(option: str, value: str) -> str:
    if not isinstance(value, str):
        raise OptionError(option, value, "text")
    return value


def _list(message: Mapping[str, Any], key: str, kind: Any) -> tuple[Any, ...]:
    """Return a non-empty list of a message."""
    if key not in message:
        raise InputError(f"the message has no {key}; expected a JointTrajectory", key=key)
    items = list_of(key, message[key], kind, "names" if kind is str else "points")
    if not items:
        raise InputError(f"{key} of the message is empty", key=key)
    return items


def _order(names: Sequence[str], robot: Robot | None) -> list[int]:
    """Index in the message of each of the robot's joints."""
    if robot is None:
        return list(range(len(names)))
    expected = instance("robot", robot, Robot, "load_robot").joint_names
    if sorted(names) != sorted(expected):
        raise InputError(
            f"the message moves {', '.join(names)}; the joints of {robot.name!r} are {', '.join(expected)}",
            expected=list(expected),
            got=list(names),
        )
    return [names.index(name) for name in expected]


def _array(rows: Sequence[Any], field: str, joints: int) -> FloatArray:
    """(points, joints) values of one field."""
    found = stack_rows(rows)
    if found is None or found.shape[1] != joints:
        for index, row in enumerate(rows):
            row = () if row is None else row
            if not isinstance(row, list | tuple | array | np.ndarray) or len(row) != joints:
                count = f"{len(row)} numbers" if isinstance(row, list | tuple | array | np.ndarray) else repr(row)
                raise InputError(
                    f"points[{index}].{field} has {count}, expected one for each of {joints} joints",
                    point=index,
                    field=field,
                )
    return numbers(field, rows if found is None else found, (len(rows), joints))
