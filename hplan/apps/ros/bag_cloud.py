"""Point clouds from rosbags (ROS 2: a folder, `.mcap`, `.db3`; ROS 1: `.bag`); needs the extra `ros`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import pinocchio as pin

from hplan.apps.ros.fields import fields_of, read_message
from hplan.apps.ros.frame_tree import FrameTree, plain_frame, stamp_seconds
from hplan.apps.ros.moveit_scene import planning_frame
from hplan.base.arguments import file_path, number, text
from hplan.base.arrays import FloatArray
from hplan.base.files import note_input
from hplan.base.lazy_import import extra
from hplan.errors import OptionError, SceneError
from hplan.scene.limits import Vector
from hplan.scene.obstacles import PointCloud

#: Type of clouds and of transforms, in ROS 1 and 2.
_CLOUD: Final = "sensor_msgs/msg/PointCloud2"
_TRANSFORMS: Final = "tf2_msgs/msg/TFMessage"

#: Attributes of a cloud message.
_CLOUD_FIELDS: Final = ("is_bigendian", "fields", "width", "height", "point_step", "row_step", "data")

#: Formats of the coordinates by `PointField.datatype`.
_FORMATS: Final = {7: "f4", 8: "f8"}


def cloud_points(message: Any) -> FloatArray:
    """(n, 3) points of a `sensor_msgs/msg/PointCloud2` in its frame [m]; NaN without a return.

    Args:
        message: An object of rclpy or rosbags, a dict, or a YAML or JSON file of `ros2 topic echo --full-length`.

    Raises:
        SceneError: The message has no float fields x, y and z, or its data do not fit its size; or the file is missing
            or malformed.
        OptionError: It is no message, or lacks a field.
    """
    content, _ = read_message(message, SceneError)
    missing = [name for name in _CLOUD_FIELDS if name not in content]
    if missing:
        expected = f"a PointCloud2 with attributes {', '.join(_CLOUD_FIELDS)}"
        raise OptionError("message", message, f"{expected}; {', '.join(missing)} is missing")
    order = ">" if content["is_bigendian"] else "<"
    width, height, step, row_step = (content[name] for name in ("width", "height", "point_step", "row_step"))
    declared = [fields_of(field) for field in content["fields"]]
    fields = {field["name"]: (field["offset"], _FORMATS.get(field["datatype"])) for field in declared}
    missing = [axis for axis in "xyz" if fields.get(axis, (0, None))[1] is None]
    if missing:
        raise SceneError(f"expected fields x, y and z of float32 or float64, got {', '.join(fields) or 'none'}")
    formats, offsets = [f"{order}{fields[axis][1]}" for axis in "xyz"], [fields[axis][0] for axis in "xyz"]
    data = content["data"]
    try:
        kind = np.dtype({"names": [*"xyz"], "formats": formats, "offsets": offsets, "itemsize": step})
        rows = np.frombuffer(bytes(data) if isinstance(data, list | tuple) else data, np.uint8)
        rows = rows.reshape(height, row_step)
        points = np.ascontiguousarray(rows[:, : width * step]).reshape(-1).view(kind)
    except ValueError as error:
        raise SceneError(f"the data do not fit width, height and steps of the cloud: {error}") from error
    found = np.empty((len(points), 3))
    for column, axis in enumerate("xyz"):
        found[:, column] = points[axis]
    return found


def read_bag_cloud(
    path: Path | str,
    *,
    radius: float,
    topic: str | None = None,
    time_s: float = 0.0,
    frame: str = "base_link",
    name: str = "cloud",
    position: Vector | None = None,
    rpy_deg: Vector | None = None,
) -> PointCloud:
    """Read one cloud of a rosbag as an obstacle.

    Points that are not finite are left out; those of the arm itself are not (`hplan.Planner.set_cloud` removes them).

    Args:
        path: A bag: a folder or `.mcap` or `.db3` file of ROS 2, a `.bag` file of ROS 1.
        radius: Radius of the ball about each point [m].
        topic: Topic of the clouds; None for the only one.
        time_s: The first cloud at or after this time since the start of the bag is read [s].
        frame: Frame of the base. Unless the cloud is in it, or its pose is given, the bag's transforms lead to it.
        name: Name of the obstacle.
        position: Position of the cloud's frame in `base_link` [m]; with it or `rpy_deg` no transforms are used.
        rpy_deg: Orientation of the cloud's frame: roll, pitch and yaw about fixed axes [deg].

    Raises:
        SceneError: The bag is missing or malformed, has no such topic or cloud, or no transforms between the frames.
        OptionError: An option of the wrong type or range.
        InputError: rosbags is not installed.
    """
    path = file_path("path", path)
    number("radius", radius, "a number of metres > 0", lambda value: value > 0.0)
    number("time_s", time_s, "a number of seconds >= 0", lambda value: value >= 0.0)
    text("name", name, "the name of the obstacle")
    text("frame", frame, "the frame of the base")
    if topic is not None:
        text("topic", topic, "the name of a topic")
    here = (0.0, 0.0, 0.0)
    given = planning_frame(here if position is None else position, here if rpy_deg is None else rpy_deg, name, "refuse")
    with _open_bag(path) as bag:
        cloud = _find_cloud(bag, path, topic, time_s)
        points = cloud_points(cloud)
        points = points[np.isfinite(points).all(axis=1)]
        if not len(points):
            raise SceneError("the cloud has no finite points", path=path)
        own, place = plain_frame(cloud.header.frame_id), given
        if position is None and rpy_deg is None and own != plain_frame(frame):
            try:
                place = _pose_in_bag(bag, frame, own, stamp_seconds(cloud.header.stamp))
            except SceneError as error:
                reason = f"{error.reason}; give position and rpy_deg" if error.value == own else error.reason
                raise SceneError(reason, path=path, value=error.value) from error
    return PointCloud.from_points(name, points @ place.rotation.T + place.translation, radius)


@contextmanager
def _open_bag(path: Path) -> Iterator[Any]:
    """Open a bag for reading.

    Raises:
        SceneError: It cannot be read.
    """
    with extra("ros", "bags need rosbags"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    store = get_typestore(Stores.ROS1_NOETIC if path.suffix == ".bag" else Stores.ROS2_JAZZY)
    try:
        with AnyReader([path], default_typestore=store) as bag:
            note_input(path)
            yield bag
    except SceneError:
        raise
    except FileNotFoundError as error:
        reason = "it is not the folder of a bag" if path.is_dir() else "No such file or directory"
        raise SceneError(reason, path=path) from error
    except Exception as error:  # the readers of the formats raise errors of many kinds
        raise SceneError(f"the bag cannot be read: {error}", path=path) from error


def _find_cloud(bag: Any, path: Path, topic: str | None, time_s: float) -> Any:
    """The first cloud of a topic at or after a time since the start of the bag [s]."""
    found = {each.topic: each for each in sorted(bag.connections, key=lambda one: one.topic) if each.msgtype == _CLOUD}
    if topic is None and len(found) != 1:
        reason = f"expected a topic, one of {', '.join(found)}" if found else f"it has no topic of type {_CLOUD}"
        raise SceneError(reason, path=path)
    if topic is not None and topic not in found:
        known = ", ".join(found) or "none"
        raise SceneError(f"expected a topic of type {_CLOUD} ({known}), got {topic!r}", path=path, value=topic)
    chosen = next(iter(found.values())) if topic is None else found[topic]
    start = bag.start_time + round(1e9 * time_s)
    for connection, _, data in bag.messages([chosen], start=start):
        return bag.deserialize(data, connection.msgtype)
    long_s = 1e-9 * (bag.end_time - bag.start_time)
    raise SceneError(f"no cloud of {chosen.topic} at or after {time_s:g} s; the bag is {long_s:.6g} s long", path=path)


def _pose_in_bag(bag: Any, base: str, frame: str, at_s: float) -> pin.SE3:
    """Pose of a frame in the base frame, from the bag's transforms nearest in time.

    Raises:
        SceneError: No transforms connect them, or one is malformed.
    """
    tree = FrameTree(keep_s=math.inf)
    for connection, _, data in bag.messages([each for each in bag.connections if each.msgtype == _TRANSFORMS]):
        is_static = connection.topic.endswith("tf_static")
        tree.see(bag.deserialize(data, connection.msgtype).transforms, is_static=is_static)
    return tree.pose(base, frame, at_s)
