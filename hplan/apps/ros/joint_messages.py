"""Motions as messages of joints: `trajectory_msgs/msg/JointTrajectory` and `sensor_msgs/msg/JointState`.

A message is a plain dict with the fields of its definition, lists and numbers in it, ready for JSON, or for
`rosidl_runtime_py.set_message_fields` where ROS is.

`joint_trajectory_controller` chooses the curve between two points by their fields: a quintic for accelerations, a cubic
for velocities alone, a straight line for positions alone. So a message has those fields that make the controller run
the curve of `Trajectory.interpolation`, which the certificate is about; hplan's own have positions and velocities.
"""

from __future__ import annotations

import json
from array import array
from collections.abc import Mapping, Sequence, Set, Sized
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

import numpy as np
import yaml

from hplan.apps.ros.message_times import message_time, seconds_of, time_ns
from hplan.base.arguments import file_path, instance, list_of, one_of, truth, whole
from hplan.base.arrays import FloatArray, numbers
from hplan.base.files import write_text
from hplan.certificate.certificate import REST
from hplan.errors import InputError, OptionError
from hplan.robot.model import Robot
from hplan.trajectory.cubics import Interpolation
from hplan.trajectory.trajectory import Trajectory

#: Fields of a point for each array of a trajectory.
_FIELDS = {"positions": "position", "velocities": "velocity", "accelerations": "acceleration", "effort": "torque"}

#: Fields by which a controller chooses each curve between points.
_FIELDS_OF: dict[Interpolation, tuple[str, ...]] = {
    "linear": ("positions",),
    "cubic": ("positions", "velocities"),
    "quintic": ("positions", "velocities", "accelerations"),
}


def to_joint_trajectory(
    trajectory: Trajectory, *, prefix: str = "", frame_id: str = "", stamp_s: float = 0.0, effort: bool = False
) -> dict[str, Any]:
    """The motion as a `trajectory_msgs/msg/JointTrajectory`, as `joint_trajectory_controller` takes it.

    Args:
        trajectory: The motion; each row becomes a point.
        prefix: Put before every joint's name, such as "left_".
        stamp_s: When the first row is, by the controller's clock [s]; 0 for as soon as the message is received.
        effort: Whether to give torques; controllers without an effort interface refuse such goals.

    Raises:
        OptionError: Text where none belongs, or a time that no message can hold; no `stamp_s` of a stop, a splice or
            any other motion that takes over from a running one: begun on receipt it would send the arm back.
        InputError: Two rows within a nanosecond.
    """
    instance("trajectory", trajectory, Trajectory, "plan or read_csv")
    stamp_ns = time_ns("stamp_s", stamp_s)
    if stamp_ns == 0 and _needs_stamp(trajectory):
        raise OptionError(
            "stamp_s",
            stamp_s,
            "the time of the first row by the controller's clock, such as the result's begins_s, and not 0, which is "
            "the time of receipt: the motion takes over from a running one, and a controller that begins it on receipt "
            "would send the arm back. Of a motion that began at 0, send trajectory.since(row) with the time of that "
            "row",
        )
    header = _header(frame_id, stamp_ns)
    given = (*_FIELDS_OF[trajectory.interpolation], *(["effort"] if truth("effort", effort) else []))
    fields = {field: name for field, name in _FIELDS.items() if field in given}
    left_out: dict[str, list[float]] = {field: [] for field in _FIELDS if field not in given}
    times = [time_ns("time", time) for time in trajectory.time.tolist()]
    for row, (first, second) in enumerate(pairwise(times), start=1):
        if first == second:
            raise InputError(f"row {row} of the trajectory comes within a nanosecond of the one before it", row=row)
    rows = zip(*(getattr(trajectory, name).tolist() for name in fields.values()), strict=True)
    return {
        "header": header,
        "joint_names": _names(trajectory, prefix),
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
    """Write the message of `to_joint_trajectory` as YAML, or as JSON if the file's name ends in `.json`.

    `ros2 topic pub --once --stdin TOPIC trajectory_msgs/msg/JointTrajectory < FILE` sends either (ROS 2 Jazzy and
    later). As an argument of a command the message would be too long for most shells.

    Args:
        file: The file; replaced whole or not at all.
        options: As of `to_joint_trajectory`.

    Raises:
        HplanError: As `to_joint_trajectory`.
        OutputError: The file cannot be written.
    """
    path, message = file_path("file", file), to_joint_trajectory(trajectory, **options)
    if path.suffix.lower() == ".json":
        return write_text(path, json.dumps(message))
    return write_text(path, yaml.safe_dump(message, sort_keys=False, default_flow_style=None))


def to_joint_state(
    trajectory: Trajectory, row: int, *, prefix: str = "", frame_id: str = "", stamp_s: float = 0.0
) -> dict[str, Any]:
    """A row of the motion as a `sensor_msgs/msg/JointState`.

    Args:
        prefix: Put before every joint's name.
        stamp_s: When the motion begins [s]; the row's own time is added.

    Raises:
        OptionError: No such row, text where none belongs, or a time that no message can hold.
    """
    instance("trajectory", trajectory, Trajectory, "plan or read_csv")
    row = whole("row", row, 0, trajectory.samples - 1)
    stamp = time_ns("stamp_s", stamp_s) + time_ns("time", float(trajectory.time[row]))
    return {
        "header": _header(frame_id, stamp),
        "name": _names(trajectory, prefix),
        "position": trajectory.position[row].tolist(),
        "velocity": trajectory.velocity[row].tolist(),
        "effort": trajectory.torque[row].tolist(),
    }


def from_joint_trajectory(
    message: Mapping[str, Any],
    *,
    prefix: str = "",
    robot: Robot | None = None,
    interpolation: Interpolation | None = None,
) -> Trajectory:
    """A motion out of a `trajectory_msgs/msg/JointTrajectory`, whoever wrote it; `certify` can then judge it.

    Args:
        message: The message as a dict; its first point is at time 0.
        prefix: What stands before every joint's name, and is taken off.
        robot: Gives the order of the joints, and the torques if the points have none.
        interpolation: The curve that the controller runs between the points. None takes the one that
            `joint_trajectory_controller` chooses: `quintic` for points with accelerations, `cubic` with velocities
            alone, `linear` with positions alone.

    Raises:
        InputError: A field is missing or of another kind, lists differ in length, times do not increase from 0; points
            without a field that other points have, or that the interpolation needs; without a robot, points without
            efforts; other joints than the robot's.
        OptionError: The message is no dict, the prefix no text, or there is no such interpolation.
    """
    if not isinstance(message, Mapping):
        raise OptionError("message", message, "a dict of a JointTrajectory")
    names = tuple(name.removeprefix(_text("prefix", prefix)) for name in _list(message, "joint_names", str))
    points = _list(message, "points", Mapping)
    order = _order(names, robot)
    time = np.array(
        [
            seconds_of(f"points[{index}].time_from_start", point.get("time_from_start"))
            for index, point in enumerate(points)
        ]
    )
    given = {field for field in _FIELDS if any(not _is_empty(point.get(field, ())) for point in points)}
    curve = _curve_of(given, interpolation)
    arrays = {
        _FIELDS[field]: _array(points, field, len(names))[:, order]
        for field in _FIELDS
        if field in given or field in _FIELDS_OF[curve] or (field == "effort" and robot is None)
    }
    joints, slides = tuple(names[index] for index in order), () if robot is None else robot.slides
    zero = np.zeros_like(arrays["position"])
    velocity, acceleration, torque = (arrays.get(name, zero) for name in ("velocity", "acceleration", "torque"))
    motion = Trajectory(joints, time, arrays["position"], velocity, acceleration, torque, slides, curve)
    return _filled_in(motion, arrays.keys(), robot)


def _curve_of(given: Set[str], interpolation: Interpolation | None) -> Interpolation:
    """The curve that a controller runs between points with some fields.

    Raises:
        InputError: There are accelerations without velocities.
        OptionError: There is no such interpolation.
    """
    if interpolation is not None:
        one_of("interpolation", interpolation, get_args(Interpolation))
        return interpolation
    if "accelerations" in given and "velocities" not in given:
        raise InputError(
            "points have accelerations but no velocities: joint_trajectory_controller runs no curve of those"
        )
    curves: tuple[Interpolation, ...] = ("quintic", "cubic", "linear")
    return next(curve for curve in curves if set(_FIELDS_OF[curve]) <= given | {"positions"})


def _filled_in(motion: Trajectory, given: Set[str], robot: Robot | None) -> Trajectory:
    """The motion with the velocities and accelerations that its curve has at the rows, and inverse dynamics.

    At a row with a jump they are those after it; at the last one, of a straight line, rest.
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
    """True if the arm is in motion when the trajectory begins, or before that."""
    if trajectory.takes_over_s is not None:
        return True
    # The velocity of straight lines jumps at their first row, from rest.
    moving = trajectory.interpolation != "linear" and np.abs(trajectory.velocity[0]).max(initial=0.0) > REST
    return bool(moving)


def _is_empty(row: Any) -> bool:
    """True for a list without numbers."""
    return isinstance(row, Sized) and len(row) == 0


def _header(frame_id: str, stamp_ns: int) -> dict[str, Any]:
    return {"stamp": message_time(stamp_ns), "frame_id": _text("frame_id", frame_id)}


def _names(trajectory: Trajectory, prefix: str) -> list[str]:
    return [_text("prefix", prefix) + name for name in trajectory.joint_names]


def _text(option: str, value: str) -> str:
    if not isinstance(value, str):
        raise OptionError(option, value, "text")
    return value


def _list(message: Mapping[str, Any], key: str, kind: Any) -> tuple[Any, ...]:
    """A list of a message, not empty."""
    if key not in message:
        raise InputError(f"the message has no {key}; expected a JointTrajectory", key=key)
    items = list_of(key, message[key], kind, "names" if kind is str else "points")
    if not items:
        raise InputError(f"{key} of the message is empty", key=key)
    return items


def _order(names: Sequence[str], robot: Robot | None) -> list[int]:
    """Which of the message's joints each of the robot's is."""
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


def _array(points: Sequence[Mapping[str, Any]], field: str, joints: int) -> FloatArray:
    """(points, joints) numbers of one field."""
    rows = []
    for index, point in enumerate(points):
        row = point.get(field, ())
        if not isinstance(row, list | tuple | array | np.ndarray) or len(row) != joints:
            count = f"{len(row)} numbers" if isinstance(row, list | tuple | array | np.ndarray) else repr(row)
            raise InputError(
                f"points[{index}].{field} has {count}, expected one for each of {joints} joints",
                point=index,
                field=field,
            )
        rows.append(row)
    return numbers(field, rows, (len(points), joints))
