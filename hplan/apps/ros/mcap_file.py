"""Certified motions as an MCAP file of ROS 2 messages, for Foxglove, RViz and `ros2 bag`.

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

Of a run of several motions what is said once is said as each begins, but for the robot, and what stood before is gone.

The file is one that rosbags writes, so that `ros2 bag play` finds in it what is to be kept.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Sequence
from itertools import chain, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pinocchio as pin

from hplan.apps.ros import marked_motion as motion
from hplan.apps.ros import marker_parts as mark
from hplan.apps.ros.bag_writer import Message, write_bag
from hplan.apps.ros.joint_messages import to_joint_state, to_joint_trajectory
from hplan.apps.ros.marked_scene import moving_frame, scene_markers
from hplan.apps.ros.marker_parts import Marker
from hplan.apps.ros.message_times import SECOND_NS, message_time, time_ns
from hplan.apps.ros.transforms import LinkFrames, robot_description, transform
from hplan.apps.view.playback import Playback, playable
from hplan.apps.view.scenery import picks
from hplan.base.arguments import between, file_path
from hplan.base.arrays import FloatArray, IntArray
from hplan.certificate.retimed_certificate import CertifiedMotion
from hplan.errors import InputError
from hplan.robot.model import Robot
from hplan.scene.model import Scene

if TYPE_CHECKING:
    from hplan.apps.view.playback import Shown
    from hplan.certificate.certificate import Certificate

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
    result: Shown | Sequence[Shown], file: Path | str, *, rate_hz: float = 100.0, stamp_s: float = 1.0
) -> Path:
    """Write a motion, or a run of motions, as an MCAP file.

    Args:
        result: A plan, a stop, a tour, a motion of several arms; or several of them in turn, all of one robot. Each
            takes over at its `begins_s` from the one before, a stop where it leaves that one's; others follow.
        file: The file; replaced whole or not at all. Its name should end in `.mcap`.
        rate_hz: Joint states and transforms a second, as far as the trajectory has rows.
        stamp_s: When the motion begins [s]; not 0, which ROS takes for the latest there is.

    Raises:
        InputError: rosbags is not installed (the extra `ros`).
        InputError: A run of motions of different robots, or of none.
        OptionError: Something else than a result, a rate that is not positive, a time that no message can hold.
        OutputError: The file cannot be written.
    """
    between("rate_hz", rate_hz, 1e-3, 1e5)
    time_ns("stamp_s", stamp_s)
    results = list(result) if isinstance(result, Sequence) else [result]
    played = [playable(each) for each in results]
    joints = [robot.joint_names for robot, _, _ in played]
    if not joints or any(names != joints[0] for names in joints):
        raise InputError("a run is of motions of one robot, and of one motion at least", motions=len(joints))
    spans = _spans(results, [playback.trajectory.duration for _, _, playback in played])
    recordings = [
        _Recording(*each, rate_hz, time_ns("stamp_s", stamp_s + begin), span, is_first=number == 0)
        for number, (each, (begin, span)) in enumerate(zip(played, spans, strict=True))
    ]
    messages = chain.from_iterable(recording.messages() for recording in recordings)
    return write_bag(file_path("file", file), TOPICS, messages)


def _spans(results: Sequence[Shown], durations: Sequence[float]) -> list[tuple[float, tuple[float, float]]]:
    """When each motion of a run begins, counted from the first, and from when to when of its own time it runs [s]."""
    begins, firsts = [0.0], [0.0]
    clocks = [own if isinstance(own := getattr(each, "begins_s", 0.0), float) else 0.0 for each in results]
    for (before, own), duration, result in zip(pairwise(clocks), durations, results[1:], strict=False):
        stops = own == before and isinstance(result, CertifiedMotion)  # on the path of the one before, by its clock
        firsts.append(result.parts_s if isinstance(result, CertifiedMotion) and stops else 0.0)
        begins.append(begins[-1] + (0.0 if stops else own - before if own > before else duration))
    ends = [begin + first - before for before, begin, first in zip(begins, begins[1:], firsts[1:], strict=False)]
    return list(zip(begins, zip(firsts, [*ends, math.inf], strict=True), strict=True))


class _Recording:
    """The messages of a motion, in the order of their times, from when to when it runs [s]."""

    def __init__(
        self, robot: Robot, scene: Scene, playback: Playback, rate_hz: float, begin_ns: int,
        span_s: tuple[float, float], *, is_first: bool,
    ) -> None:  # fmt: skip
        self.robot, self.scene, self.playback, self.trajectory = robot, scene, playback, playback.trajectory
        self.certificate = cast("Certificate", playback.certificate)  # results have one
        self.begin_ns, self.span_s, self.is_first = begin_ns, span_s, is_first
        self.frames = LinkFrames(robot)
        rows = _rows(self.trajectory.time, rate_hz)
        times = self.trajectory.time[rows]
        self.rows = rows[(times >= span_s[0]) & (times < span_s[1])]

    def messages(self) -> Iterator[Message]:
        """All of them."""
        yield from self._at_first()
        yield from heapq.merge(self._fruits(), self._samples(), key=lambda message: message.time_ns)

    def _at_first(self) -> Iterator[Message]:
        robot, frames, trajectory = self.robot, self.frames, self.trajectory
        begin = self.begin_ns + time_ns("time", self.span_s[0])
        frames.place(trajectory.position[self.rows[0]])
        positions = trajectory.position[self.rows]
        shown = motion.path_marker(robot, positions, frames.root)
        words = motion.words_marker(robot, positions, self.certificate, frames.root)
        cleared = (
            [] if self.is_first else [mark.head(frame_id=frames.root, ns="", number=0) | {"action": mark.DELETE_ALL}]
        )
        contents: dict[str, Any] = {
            "/robot_description": {"data": robot_description(robot)},
            "/tf_static": frames.message(frames.fixed, begin),
            "/scene": self._markers([*cleared, *scene_markers(self.scene, frames.root)], begin),
            "/certificate": self._markers([shown, words], begin),
            "/joint_trajectory": to_joint_trajectory(
                trajectory, frame_id=frames.root, stamp_s=self.begin_ns / SECOND_NS
            ),
        }
        kept = contents if self.is_first else {topic: contents[topic] for topic in list(contents)[2:]}
        yield from (Message(topic, begin, content) for topic, content in kept.items())

    def _samples(self) -> Iterator[Message]:
        trajectory, frames = self.trajectory, self.frames
        pairs = motion.NearestPairs(self.robot, self.scene, self.certificate, frames.root)
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
        taken = picks(self.scene, self.playback)
        events = motion.fruit_events(self.robot, self.scene, self.trajectory, taken)
        for clock, marker in ((clock, marker) for clock, marker in events if self.span_s[0] <= clock < self.span_s[1]):
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
