"""Motions as messages of joints: `trajectory_msgs/msg/JointTrajectory` and `sensor_msgs/msg/JointState`.

A message is a plain dict with the fields of its definition, lists and numbers in it, ready for JSON, or for
`rosidl_runtime_py.set_message_fields` where ROS is.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence, Sized
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hplan.apps.ros.message_times import message_time, seconds_of, time_ns
from hplan.base.arguments import file_path, instance, list_of, truth, whole
from hplan.base.arrays import FloatArray, numbers
from hplan.base.files import write_text
from hplan.errors import InputError, OptionError
from hplan.robot.model import Robot
from hplan.trajectory.trajectory import Trajectory

#: Fields of a point for each array of a trajectory.
_FIELDS = {"positions": "position", "velocities": "velocity", "accelerations": "acceleration", "effort": "torque"}


def to_joint_trajectory(
    trajectory: Trajectory, *, prefix: str = "", frame_id: str = "", stamp_s: float = 0.0, effort: bool = True
) -> dict[str, Any]:
    """The motion as a `trajectory_msgs/msg/JointTrajectory`, as `joint_trajectory_controller` takes it.

    Args:
        trajectory: The motion; each row becomes a point.
        prefix: Put before every joint's name, such as "left_".
        stamp_s: When the motion begins [s]; 0 for as soon as it is received.
        effort: False leaves the torques out, for controllers that take none.

    Raises:
        OptionError: Text where none belongs, or a time that no message can hold.
        InputError: Two rows within a nanosecond.
    """
    instance("trajectory", trajectory, Trajectory, "plan or read_csv")
    header = _header(frame_id, time_ns("stamp_s", stamp_s))
    fields = {field: name for field, name in _FIELDS.items() if truth("effort", effort) or field != "effort"}
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
                **({} if effort else {"effort": []}),
                "time_from_start": message_time(time),
            }
            for row, time in zip(rows, times, strict=True)
        ],
    }


def write_joint_trajectory(trajectory: Trajectory, file: Path | str, **options: Any) -> Path:
    """Write the message of `to_joint_trajectory` as YAML, or as JSON where the file's name ends in `.json`.

    `ros2 topic pub --once TOPIC trajectory_msgs/msg/JointTrajectory "$(cat FILE)"` sends either.

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


def from_joint_trajectory(message: Mapping[str, Any], *, prefix: str = "", robot: Robot | None = None) -> Trajectory:
    """A motion out of a `trajectory_msgs/msg/JointTrajectory`, whoever wrote it; `certify` can then judge it.

    Args:
        message: The message as a dict; its first point is at time 0.
        prefix: What stands before every joint's name, and is taken off.
        robot: Gives the order of the joints, and the torques where the points have none.

    Raises:
        InputError: A field is missing or of another kind, lists differ in length, times do not increase from 0; points
            without velocities or accelerations, or, without a robot, without efforts; other joints than the robot's.
        OptionError: The message is no dict, the prefix no text.
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
    efforts = [point.get("effort", ()) for point in points]
    arrays = {name: _array(points, field, len(names))[:, order] for field, name in _FIELDS.items() if field != "effort"}
    if robot is not None and all(isinstance(effort, Sized) and len(effort) == 0 for effort in efforts):
        arrays["torque"] = robot.dynamics.torques(*arrays.values())
    else:
        arrays["torque"] = _array(points, "effort", len(names))[:, order]
    slides = () if robot is None else robot.slides
    return Trajectory(tuple(names[index] for index in order), time, slides=slides, **arrays)


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
        if not isinstance(row, (list, tuple, np.ndarray)) or len(row) != joints:
            count = f"{len(row)} numbers" if isinstance(row, (list, tuple, np.ndarray)) else repr(row)
            raise InputError(
                f"points[{index}].{field} has {count}, expected one for each of {joints} joints",
                point=index,
                field=field,
            )
        rows.append(row)
    return numbers(field, rows, (len(points), joints))
