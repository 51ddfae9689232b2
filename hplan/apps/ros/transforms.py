"""Link transforms (`tf2_msgs/msg/TFMessage`) and URDF text of a robot; times of messages.

As published by ROS's `robot_state_publisher`, there is one transform from each link's parent to the link.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any, Final

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.apps.ros.fields import fields_of, is_message
from hplan.base.arguments import check_between, instance
from hplan.base.arrays import FloatArray
from hplan.errors import InputError, RobotFileError
from hplan.robot.model import Robot

#: Nanoseconds in a second.
SECOND_NS: Final = 1_000_000_000


def time_ns(option: str, seconds: Any) -> int:
    """Convert seconds to the nearest whole nanoseconds, without intermediate rounding.

    Args:
        option: Name of the value, for the error.
        seconds: The time [s].

    Raises:
        OptionError: `seconds` is not a number in [0, 2^31 - 1], the range of a message's time.

    Examples:
        >>> time_ns("stamp_s", 0.1)
        100000000
    """
    # A message has its seconds in a signed 32-bit integer.
    latest_s = 2.0**31 - 1.0
    numerator, denominator = check_between(option, seconds, 0.0, latest_s).as_integer_ratio()
    whole, rest = divmod(numerator * SECOND_NS, denominator)
    # To even, as `round` does.
    return whole + (2 * rest > denominator or (2 * rest == denominator and whole % 2 == 1))


def times_ns(option: str, seconds: FloatArray) -> list[int]:
    """Convert increasing times as `time_ns` does, in one array operation.

    Raises:
        OptionError: As `time_ns`.

    Examples:
        >>> times_ns("time", np.array([0.0, 0.1]))
        [0, 100000000]
    """
    for end in seconds[[0, -1]].tolist():
        time_ns(option, end)
    # The difference is exact and the product correct to 1e-7 ns, which decides unless it is near a half.
    whole = np.floor(seconds)
    rest = (seconds - whole) * SECOND_NS
    found = whole.astype(np.int64) * SECOND_NS + np.rint(rest).astype(np.int64)
    for row in np.flatnonzero(np.abs(rest - np.floor(rest) - 0.5) < 1e-6).tolist():
        found[row] = time_ns(option, float(seconds[row]))
    exact: list[int] = found.tolist()
    return exact


def message_time(nanoseconds: int) -> dict[str, int]:
    """Convert nanoseconds to a `builtin_interfaces/msg/Time` or `Duration`.

    Examples:
        >>> message_time(1_500_000_000)
        {'sec': 1, 'nanosec': 500000000}
    """
    sec, nanosec = divmod(nanoseconds, SECOND_NS)
    return {"sec": sec, "nanosec": nanosec}


def seconds_of(where: str, content: Any) -> float:
    """Convert a `Time` or `Duration` message to seconds.

    Args:
        where: Place of the value in the message, for the error.
        content: The message, an object or a dict.

    Raises:
        InputError: `content` is not a valid time with `sec` and `nanosec`; names its place.

    Examples:
        >>> seconds_of("header.stamp", {"sec": 1, "nanosec": 500_000_000})
        1.5
    """
    parts, fields = [], fields_of(content) if is_message(content) else {}
    for key, most in (("sec", 2**31 - 1), ("nanosec", SECOND_NS - 1)):
        value = fields.get(key)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most:
            raise InputError(
                f"{where}: expected sec and nanosec, whole numbers with nanosec below 1e9; got {content!r}"
            )
        parts.append(value)
    return float(parts[0] + Fraction(parts[1], SECOND_NS))


def robot_description(robot: Robot) -> str:
    """URDF of a robot, for the topic `/robot_description`.

    Raises:
        RobotFileError: The URDF file can no longer be read.
        OptionError: `robot` is not a robot.

    Examples:
        >>> from hplan import load_robot
        >>> "<robot name=" in robot_description(load_robot())
        True
    """
    instance("robot", robot, Robot, "load_robot")
    if robot.urdf_text is not None:
        return robot.urdf_text
    try:
        return robot.urdf_path.read_text(encoding="utf-8")
    except OSError as error:
        raise RobotFileError(robot.urdf_path, error.strerror or str(error)) from error


class LinkFrames:
    """Poses of a robot's links in the frames of their parents.

    Attributes:
        root: Name of the root link.
        moving: (link, parent) names of the links that a joint moves relative to their parent.
        fixed: (link, parent) names of all other links except the root.
    """

    def __init__(self, robot: Robot) -> None:
        self._model = robot.model
        self._data = robot.model.createData()
        frames = robot.model.frames.tolist()
        self._numbers = {frame.name: number for number, frame in enumerate(frames) if frame.type == pin.FrameType.BODY}
        parents = {}
        for name, number in self._numbers.items():
            above = frames[number].parentFrame
            while above and frames[above].type != pin.FrameType.BODY:
                above = frames[above].parentFrame
            if above:
                parents[name] = above
        (self.root,) = self._numbers.keys() - parents.keys()
        joints = {name: frames[number].parentJoint for name, number in self._numbers.items()}
        pairs = [(name, frames[above].name) for name, above in parents.items()]
        self.moving = tuple(pair for pair in pairs if joints[pair[0]] != joints[pair[1]])
        self.fixed = tuple(pair for pair in pairs if joints[pair[0]] == joints[pair[1]])

    def place(self, q: ArrayLike) -> None:
        """Set the configuration, (dof,) [rad, or m if prismatic]."""
        pin.framesForwardKinematics(self._model, self._data, np.asarray(q, dtype=np.float64))

    def pose(self, link: str) -> pin.SE3:
        """Pose of a link in the root's frame."""
        found: pin.SE3 = self._data.oMf[self._numbers[self.root]].actInv(self._data.oMf[self._numbers[link]])
        return found

    def message(self, pairs: tuple[tuple[str, str], ...], stamp_ns: int) -> dict[str, Any]:
        """Create a `tf2_msgs/msg/TFMessage` for the current configuration.

        Args:
            pairs: (link, parent) names, for example `moving`.
            stamp_ns: Time of the transforms [ns].
        """
        places = [(link, parent, self.pose(parent).actInv(self.pose(link))) for link, parent in pairs]
        return {
            "transforms": [
                transform_message(parent, link, place.rotation, place.translation, stamp_ns)
                for link, parent, place in places
            ]
        }


def transform_message(
    parent: str, child: str, rotation: ArrayLike, translation: ArrayLike, stamp_ns: int
) -> dict[str, Any]:
    """Create a `geometry_msgs/msg/TransformStamped`.

    Args:
        parent: Frame of the transform.
        child: Frame that is located.
        rotation: (3, 3) rotation of the child in the parent's frame.
        translation: (3,) origin of the child in the parent's frame [m].
        stamp_ns: Time of the transform [ns].
    """
    return {
        "header": {"stamp": message_time(stamp_ns), "frame_id": parent},
        "child_frame_id": child,
        "transform": {"translation": xyz(translation), "rotation": quaternion(rotation)},
    }


def xyz(point: ArrayLike) -> dict[str, float]:
    """Convert (3,) numbers to a `geometry_msgs/msg/Point` or `Vector3`."""
    return dict(zip("xyz", np.asarray(point, dtype=np.float64).tolist(), strict=True))


def quaternion(rotation: ArrayLike) -> dict[str, float]:
    """Convert a (3, 3) rotation matrix to a `geometry_msgs/msg/Quaternion`."""
    turn = pin.Quaternion(np.asarray(rotation, dtype=np.float64)).normalized()
    return {"x": turn.x, "y": turn.y, "z": turn.z, "w": turn.w}
