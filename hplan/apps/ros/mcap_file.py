"""A certified motion as an MCAP file of ROS 2 messages, for Foxglove, RViz and `ros2 bag`.

| topic | type | when |
|---|---|---|
| `/robot_description` | `std_msgs/msg/String` | once, kept for those who come later |
| `/tf_static`, `/tf` | `tf2_msgs/msg/TFMessage` | once and kept; with every joint state |
| `/joint_trajectory` | `trajectory_msgs/msg/JointTrajectory` | once, the whole motion |
| `/joint_states` | `sensor_msgs/msg/JointState` | at the rate asked for |
| `/scene` | `visualization_msgs/msg/MarkerArray` | once and kept, and where a fruit is taken or let go |
| `/certificate` | `visualization_msgs/msg/MarkerArray` | once and kept: the tool's path, what is certified |
| `/nearest` | `visualization_msgs/msg/MarkerArray` | the nearest pair, with every joint state |
| `/clearance` | `std_msgs/msg/Float64` | certain clearance [m], with every joint state |

The file is one that rosbags writes, so that `ros2 bag play` finds in it what is to be kept.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from hplan.apps.ros import marked_motion as motion
from hplan.apps.ros.bag_writer import Message, write_bag
from hplan.apps.ros.joint_messages import to_joint_state, to_joint_trajectory
from hplan.apps.ros.marked_scene import moving_frame, scene_markers
from hplan.apps.ros.marker_parts import Marker
from hplan.apps.ros.message_times import SECOND_NS, message_time, time_ns
from hplan.apps.ros.transforms import LinkFrames, robot_description, transform
from hplan.apps.view.playback import Playback
from hplan.apps.view.scenery import picks
from hplan.base.arguments import between, file_path
from hplan.base.arrays import FloatArray, IntArray
from hplan.errors import OptionError
from hplan.planning.result import PlanResult
from hplan.tour.result import TourResult

#: Types of the topics, and how many messages of each are kept for those who come later.
TOPICS = {
    "/robot_description": ("std_msgs/msg/String", 1),
    "/tf_static": ("tf2_msgs/msg/TFMessage", 1),
    "/scene": ("visualization_msgs/msg/MarkerArray", 1000),
    "/certificate": ("visualization_msgs/msg/MarkerArray", 1),
    "/joint_trajectory": ("trajectory_msgs/msg/JointTrajectory", 0),
    "/joint_states": ("sensor_msgs/msg/JointState", 0),
    "/tf": ("tf2_msgs/msg/TFMessage", 0),
    "/nearest": ("visualization_msgs/msg/MarkerArray", 0),
    "/clearance": ("std_msgs/msg/Float64", 0),
}


def write_mcap(
    result: PlanResult | TourResult, file: Path | str, *, rate_hz: float = 100.0, stamp_s: float = 1.0
) -> Path:
    """Write a plan or a tour as an MCAP file.

    Args:
        result: What `plan` or `plan_tour` gave.
        file: The file; replaced whole or not at all. Its name should end in `.mcap`.
        rate_hz: Joint states and transforms a second, as far as the trajectory has rows.
        stamp_s: When the motion begins [s]; not 0, which ROS takes for the latest there is.

    Raises:
        InputError: rosbags is not installed (the extra `ros`).
        OptionError: Something else than a result, a rate that is not positive, a time that no message can hold.
        OutputError: The file cannot be written.
    """
    if not isinstance(result, (PlanResult, TourResult)):
        raise OptionError("result", result, "a PlanResult or a TourResult")
    between("rate_hz", rate_hz, 1e-3, 1e5)
    begin = time_ns("stamp_s", stamp_s)
    recording = _Recording(result, rate_hz, begin)
    return write_bag(file_path("file", file), TOPICS, recording.messages())


class _Recording:
    """The messages of a result, in the order of their times."""

    def __init__(self, result: PlanResult | TourResult, rate_hz: float, begin_ns: int) -> None:
        self.result, self.robot, self.scene, self.begin_ns = result, result.robot, result.scene, begin_ns
        self.frames = LinkFrames(self.robot)
        self.rows = _rows(result.trajectory.time, rate_hz)

    def messages(self) -> Iterator[Message]:
        """All of them."""
        yield from self._at_first()
        yield from heapq.merge(self._fruits(), self._samples(), key=lambda message: message.time_ns)

    def _at_first(self) -> Iterator[Message]:
        robot, frames, begin, trajectory = self.robot, self.frames, self.begin_ns, self.result.trajectory
        frames.place(trajectory.position[0])
        positions = trajectory.position[self.rows]
        shown = motion.path_marker(robot, positions, frames.root)
        words = motion.words_marker(robot, positions, self.result.certificate, frames.root)
        contents: dict[str, Any] = {
            "/robot_description": {"data": robot_description(robot)},
            "/tf_static": frames.message(frames.fixed, begin),
            "/scene": self._markers(scene_markers(self.scene, frames.root), begin),
            "/certificate": self._markers([shown, words], begin),
            "/joint_trajectory": to_joint_trajectory(trajectory, frame_id=frames.root, stamp_s=begin / SECOND_NS),
        }
        yield from (Message(topic, begin, content) for topic, content in contents.items())

    def _samples(self) -> Iterator[Message]:
        trajectory, frames = self.result.trajectory, self.frames
        pairs = motion.NearestPairs(self.robot, self.scene, self.result.certificate, frames.root)
        moving = self.scene.poses_at(trajectory.time[self.rows])
        for index, row in enumerate(self.rows.tolist()):
            clock, q = float(trajectory.time[row]), trajectory.position[row]
            now = self.begin_ns + time_ns("time", clock)
            state = to_joint_state(trajectory, row, frame_id=frames.root, stamp_s=self.begin_ns / SECOND_NS)
            yield Message("/joint_states", now, state)
            frames.place(q)
            links = frames.message(frames.moving, now)["transforms"]
            moved = {name: pin.SE3(turns[index], shifts[index]) for name, (turns, shifts) in moving.items()}
            others = [
                transform(frames.root, moving_frame(name), place.rotation, place.translation, now)
                for name, place in moved.items()
            ]
            yield Message("/tf", now, {"transforms": [*links, *others]})
            yield Message("/nearest", now, self._markers([pairs.marker(clock, q, moved)], now))
            clearance = pairs.clearance_m(clock)
            if clearance is not None:
                yield Message("/clearance", now, {"data": clearance})

    def _fruits(self) -> Iterator[Message]:
        taken = picks(self.scene, Playback.of(self.result))
        events = motion.fruit_events(self.robot, self.scene, self.result.trajectory, taken)
        for clock, marker in events:
            now = self.begin_ns + time_ns("time", clock)
            yield Message("/scene", now, self._markers([marker], now))

    @staticmethod
    def _markers(markers: list[Marker], stamp_ns: int) -> dict[str, Any]:
        stamp = message_time(stamp_ns)
        return {"markers": [marker | {"header": marker["header"] | {"stamp": stamp}} for marker in markers]}


def _rows(time: FloatArray, rate_hz: float) -> IntArray:
    """Rows of a trajectory, about as many a second, the first and the last among them."""
    ticks = np.arange(0.0, time[-1], 1.0 / rate_hz)
    return np.unique([*np.searchsorted(time, ticks), len(time) - 1])
