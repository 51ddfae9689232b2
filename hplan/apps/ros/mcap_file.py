"""MCAP files of certified motions, for Foxglove, RViz and `ros2 bag`.

The messages are ROS 2 messages:

| topic | type | when |
|---|---|---|
| `/robot_description` | `std_msgs/msg/String` | once, latched |
| `/tf_static`, `/tf` | `tf2_msgs/msg/TFMessage` | once, latched; with every joint state |
| `/joint_trajectory` | `trajectory_msgs/msg/JointTrajectory` | once, the whole motion |
| `/joint_states` | `sensor_msgs/msg/JointState` | at the requested rate |
| `/scene` | `visualization_msgs/msg/MarkerArray` | once, latched; when a fruit is picked or released |
| `/certificate` | `visualization_msgs/msg/MarkerArray` | once, latched: the tool's path, the certificate |
| `/nearest` | `visualization_msgs/msg/MarkerArray` | the nearest pair, with every joint state |
| `/clearance` | `std_msgs/msg/Float64` | certified clearance [m], with every joint state |

Latched messages are kept for late subscribers (transient local durability). In a sequence of motions the messages sent
once are repeated at the start of each motion, except for the robot and its static transforms; markers of the previous
motion are deleted.

rosbags writes the file, so that its metadata tells `ros2 bag play` which topics are latched.
"""

from __future__ import annotations

import heapq
import math
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, pairwise
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
import pinocchio as pin

from hplan.apps.ros import marked_motion as motion
from hplan.apps.ros import marked_scene as mark
from hplan.apps.ros.joint_messages import to_joint_state, to_joint_trajectory
from hplan.apps.ros.marked_scene import Marker, moving_frame, scene_markers
from hplan.apps.ros.transforms import SECOND_NS, LinkFrames, message_time, robot_description, time_ns, transform_message
from hplan.apps.view.playback import Playback, playable
from hplan.apps.view.scenery import picks
from hplan.base.arguments import check_between, file_path
from hplan.base.arrays import FloatArray, IntArray
from hplan.base.files import replace_file
from hplan.base.lazy_import import extra
from hplan.certificate.retimed_certificate import CertifiedMotion
from hplan.errors import InputError
from hplan.robot.model import Robot
from hplan.scene.model import Scene

if TYPE_CHECKING:
    from hplan.apps.view.playback import Shown
    from hplan.certificate.certificate import Certificate


class Message(NamedTuple):
    """A message on a topic.

    Attributes:
        topic: Name of the topic.
        time_ns: Time of sending [ns].
        content: Fields of the message; omitted fields are zero or empty.
    """

    topic: str
    time_ns: int
    content: Mapping[str, Any]


def import_rosbags() -> tuple[ModuleType, ModuleType, ModuleType]:
    """Import the modules `rosbags.interfaces`, `rosbags.rosbag2` and `rosbags.typesys`.

    Raises:
        InputError: rosbags is not installed.
    """
    with extra("ros", "an MCAP file needs rosbags"):
        import rosbags.interfaces
        import rosbags.rosbag2
        import rosbags.typesys
    return rosbags.interfaces, rosbags.rosbag2, rosbags.typesys


def write_bag(path: Path, topics: Mapping[str, tuple[str, int]], messages: Iterable[Message]) -> Path:
    """Write an MCAP file, completely or not at all.

    Args:
        path: The file; an existing one is replaced.
        topics: For each topic its message type, and the number of messages kept for late subscribers (transient local
            durability; 0 for volatile).
        messages: The messages, in order of time.

    Returns:
        The path of the file.

    Raises:
        InputError: rosbags is not installed, or a message has a field that its type lacks.
        OutputError: The file cannot be written.
    """
    interfaces, bags, typesys = import_rosbags()
    # rosbags writes a folder that holds a file of the folder's name.
    with replace_file(path) as new, tempfile.TemporaryDirectory(dir=new.parent, prefix=".hplan-") as folder:
        store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
        encoder = _Encoder(store)
        bag = Path(folder, "motion")
        with bags.Writer(bag, version=9, storage_plugin=bags.StoragePlugin.MCAP) as writer:
            open_topics = {
                topic: (
                    kind,
                    writer.add_connection(
                        topic, kind, typestore=store, offered_qos_profiles=[_offer(interfaces, kept)]
                    ),
                )
                for topic, (kind, kept) in topics.items()
            }
            for message in messages:
                kind, connection = open_topics[message.topic]
                writer.write(
                    connection, message.time_ns, store.serialize_cdr(encoder.message(kind, message.content), kind)
                )
        (written,) = bag.glob("*.mcap")
        written.replace(new)
    return path


def _offer(interfaces: ModuleType, kept: int) -> Any:
    """Quality of service of a reliable topic.

    It keeps `kept` messages for late subscribers (transient local durability), or is volatile if that is 0.
    """
    durability = interfaces.QosDurability
    never = interfaces.QosTime(2147483647, 4294967295)
    return interfaces.Qos(
        history=interfaces.QosHistory.KEEP_LAST,
        depth=kept or 10,
        reliability=interfaces.QosReliability.RELIABLE,
        durability=durability.TRANSIENT_LOCAL if kept else durability.VOLATILE,
        deadline=never,
        lifespan=never,
        liveliness=interfaces.QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=never,
        avoid_ros_namespace_conventions=False,
    )


class _Encoder:
    """Converts dicts to the message objects that rosbags encodes."""

    def __init__(self, store: Any) -> None:
        self._store = store

    def message(self, kind: str, content: Mapping[str, Any]) -> Any:
        """Convert a dict to a message object of type `kind`."""
        fields = dict(self._store.fielddefs[kind][1])
        unknown = content.keys() - fields.keys()
        if unknown:
            raise InputError(f"{kind} has no field {sorted(unknown)[0]!r}", kind=kind)
        values = {name: self._value(field, content.get(name)) for name, field in fields.items()}
        return self._store.types[kind](**values)

    def _value(self, field: Any, value: Any) -> Any:
        """Convert the value of a field; None gives zero or empty."""
        node, what = field
        if node.name == "NAME":
            return self.message(what, {} if value is None else value)
        if node.name == "BASE":
            return value if value is not None else "" if what[0] == "string" else np.dtype(what[0]).type(0).item()
        (inner, kind), _ = what
        items = [] if value is None else value
        if inner.name == "NAME":
            return [self.message(kind, item) for item in items]
        return list(items) if kind[0] == "string" else np.array(items, dtype=kind[0])


#: Message type of each topic, and number of messages kept for late subscribers.
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
    """Write a motion, or a sequence of motions, as an MCAP file.

    Args:
        result: A plan, stop, tour or multi-arm motion, or a sequence of them for the same robot. Each motion takes over
            from the previous one at its `begins_s`, and a stop where it leaves the previous motion (`parts_s`). A
            motion without a later `begins_s` follows the end of the previous one.
        file: The file; replaced completely or not at all. Its name should end in `.mcap`.
        rate_hz: Rate of joint states and transforms [Hz]; at most the rate of the trajectory's samples.
        stamp_s: Start time of the motion [s]. It should not be 0, which ROS interprets as the latest available time.

    Returns:
        The path of the file.

    Raises:
        InputError: rosbags is not installed (the extra `ros`), or the sequence is empty or has different robots.
        OptionError: `result` is not a result, `rate_hz` is not in [1e-3, 1e5], or a time cannot be represented in a
            message.
        OutputError: The file cannot be written.
    """
    check_between("rate_hz", rate_hz, 1e-3, 1e5)
    time_ns("stamp_s", stamp_s)
    results = list(result) if isinstance(result, Sequence) else [result]
    played = [playable(each) for each in results]
    joints = [robot.joint_names for robot, _, _ in played]
    if not joints or any(names != joints[0] for names in joints):
        raise InputError("expected one or more motions of the same robot", motions=len(joints))
    spans = _spans(results, [playback.trajectory.duration for _, _, playback in played])
    recordings = [
        _Recording(*each, rate_hz, time_ns("stamp_s", stamp_s + begin), span, is_first=number == 0)
        for number, (each, (begin, span)) in enumerate(zip(played, spans, strict=True))
    ]
    messages = chain.from_iterable(recording.messages() for recording in recordings)
    return write_bag(file_path("file", file), TOPICS, messages)


def _spans(results: Sequence[Shown], durations: Sequence[float]) -> list[tuple[float, tuple[float, float]]]:
    """Start time and played interval of each motion in a sequence [s].

    Start times are relative to the first motion; the interval (begin, end) is in the motion's own time.
    """
    begins, firsts = [0.0], [0.0]
    clocks = [own if isinstance(own := getattr(each, "begins_s", 0.0), float) else 0.0 for each in results]
    for (before, own), duration, result in zip(pairwise(clocks), durations, results[1:], strict=False):
        stops = own == before and isinstance(result, CertifiedMotion)  # on the previous motion's path and clock
        firsts.append(result.parts_s if isinstance(result, CertifiedMotion) and stops else 0.0)
        begins.append(begins[-1] + (0.0 if stops else own - before if own > before else duration))
    ends = [begin + first - before for before, begin, first in zip(begins, begins[1:], firsts[1:], strict=False)]
    return list(zip(begins, zip(firsts, [*ends, math.inf], strict=True), strict=True))


class _Recording:
    """Generates the messages of one motion in order of time.

    `span_s` is the played interval of the motion's own time [s].
    """

    def __init__(
        self, robot: Robot, scene: Scene, playback: Playback, rate_hz: float, begin_ns: int,
        span_s: tuple[float, float], *, is_first: bool,
    ) -> None:  # fmt: skip
        self.robot, self.scene, self.playback, self.trajectory = robot, scene, playback, playback.trajectory
        self.certificate = cast("Certificate", playback.certificate)  # results have one
        self.begin_ns, self.span_s, self.is_first = begin_ns, span_s, is_first
        self.frames = LinkFrames(robot)
        rows = _sample_indices(self.trajectory.time, rate_hz)
        times = self.trajectory.time[rows]
        self.rows = rows[(times >= span_s[0]) & (times < span_s[1])]

    def messages(self) -> Iterator[Message]:
        """Generate all messages."""
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
                transform_message(frames.root, moving_frame(name), place.rotation, place.translation, now)
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


def _sample_indices(time: FloatArray, rate_hz: float) -> IntArray:
    """Indices of samples at about `rate_hz`, the first and last included."""
    ticks = np.arange(0.0, time[-1], 1.0 / rate_hz)
    return np.unique([*np.searchsorted(time, ticks), len(time) - 1])
