"""The links of a robot as a tree of frames, for `tf2_msgs/msg/TFMessage`, and the URDF that names them.

What `robot_state_publisher` does where ROS is: a transform from each link's parent to the link.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.apps.ros.message_times import message_time
from hplan.base.arguments import instance
from hplan.errors import RobotFileError
from hplan.robot.model import Robot


def robot_description(robot: Robot) -> str:
    """The URDF that the robot was built from, as the topic `/robot_description` has it.

    Raises:
        RobotFileError: Its file cannot be read any more.
        OptionError: It is no robot.
    """
    instance("robot", robot, Robot, "load_robot")
    if robot.urdf_text is not None:
        return robot.urdf_text
    try:
        return robot.urdf_path.read_text(encoding="utf-8")
    except OSError as error:
        raise RobotFileError(robot.urdf_path, error.strerror or str(error)) from error


class LinkFrames:
    """Places of a robot's links, each in the frame of its parent.

    Attributes:
        root: Name of the link that everything is placed in.
        moving: (link, parent) names of the links that joints move.
        fixed: (link, parent) names of the others, the root left out.
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
        """Put the robot into a configuration, (dof,)."""
        pin.framesForwardKinematics(self._model, self._data, np.asarray(q, dtype=np.float64))

    def pose(self, link: str) -> pin.SE3:
        """Where a link is, in the root's frame."""
        found: pin.SE3 = self._data.oMf[self._numbers[self.root]].actInv(self._data.oMf[self._numbers[link]])
        return found

    def message(self, pairs: tuple[tuple[str, str], ...], stamp_ns: int) -> dict[str, Any]:
        """A `tf2_msgs/msg/TFMessage` of some links in their parents' frames, as the robot was last placed."""
        places = [(link, parent, self.pose(parent).actInv(self.pose(link))) for link, parent in pairs]
        return {
            "transforms": [
                transform(parent, link, place.rotation, place.translation, stamp_ns) for link, parent, place in places
            ]
        }


def transform(parent: str, child: str, rotation: ArrayLike, translation: ArrayLike, stamp_ns: int) -> dict[str, Any]:
    """A `geometry_msgs/msg/TransformStamped`."""
    return {
        "header": {"stamp": message_time(stamp_ns), "frame_id": parent},
        "child_frame_id": child,
        "transform": {"translation": xyz(translation), "rotation": quaternion(rotation)},
    }


def xyz(point: ArrayLike) -> dict[str, float]:
    """A `geometry_msgs/msg/Point` or `Vector3` of three numbers."""
    return dict(zip("xyz", np.asarray(point, dtype=np.float64).tolist(), strict=True))


def quaternion(rotation: ArrayLike) -> dict[str, float]:
    """A `geometry_msgs/msg/Quaternion` of a (3, 3) rotation."""
    turn = pin.Quaternion(np.asarray(rotation, dtype=np.float64)).normalized()
    return {"x": turn.x, "y": turn.y, "z": turn.z, "w": turn.w}
