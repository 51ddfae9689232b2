"""Transforms between frames, from `tf2_msgs/msg/TFMessage` messages: a small tf2 without ROS."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import pinocchio as pin

from hplan.apps.ros.fields import fields_of
from hplan.apps.ros.moveit_scene import pose
from hplan.errors import SceneError


class _Stamped(NamedTuple):
    time_s: float
    parent: str
    transform: Mapping[str, Any]


class FrameTree:
    """Latest transforms of each frame to its parent; of several, the nearest in time counts.

    Examples:
        >>> shift, turn = {"x": 1.0, "y": 0.0, "z": 0.0}, {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
        >>> transform = {"translation": shift, "rotation": turn}
        >>> tree = FrameTree()
        >>> stamped = {"header": {"frame_id": "base"}, "child_frame_id": "camera", "transform": transform}
        >>> tree.see([stamped], is_static=True)
        >>> tree.pose("base", "camera", 0.0).translation.tolist()
        [1.0, 0.0, 0.0]
    """

    def __init__(self, *, keep_s: float = 10.0, tolerance_s: float = math.inf) -> None:
        """Start without frames.

        Args:
            keep_s: Transforms are kept this long after newer ones [s].
            tolerance_s: Maximum difference between the times of a transform and of the request [s].
        """
        self._keep_s, self._tolerance_s = keep_s, tolerance_s
        self._known: dict[str, deque[_Stamped]] = {}

    def see(self, transforms: Iterable[Any], *, is_static: bool) -> None:
        """Take `geometry_msgs/msg/TransformStamped` messages: objects of rclpy or rosbags, or dicts."""
        for item in transforms:
            fields = fields_of(item)
            header, child = fields_of(fields["header"]), plain_frame(fields["child_frame_id"])
            time_s = math.nan if is_static else stamp_seconds(header["stamp"])
            known = self._known.setdefault(child, deque())
            if is_static:
                known.clear()
            known.append(_Stamped(time_s, plain_frame(header["frame_id"]), fields_of(fields["transform"])))
            while known[0].time_s < time_s - self._keep_s:
                known.popleft()

    def pose(self, base: str, frame: str, at_s: float) -> pin.SE3:
        """Pose of a frame in the base frame at a time.

        Raises:
            SceneError: No transforms connect them, one is malformed, or one is too old.
        """
        base, frame = plain_frame(base), plain_frame(frame)
        ways = self._way_up(base, at_s), self._way_up(frame, at_s)
        common = next((root for root in ways[1] if root in ways[0]), None)
        if common is None:
            parents = {each.parent for known in self._known.values() for each in known}
            names = ", ".join(sorted({*self._known, *parents})) or "none"
            reason = f"no transforms lead from {frame!r} to {base!r} (frames: {names})"
            raise SceneError(reason, value=frame)
        place: pin.SE3 = ways[0][common].inverse() * ways[1][common]
        return place

    def _way_up(self, frame: str, at_s: float) -> Mapping[str, pin.SE3]:
        """Poses of a frame in itself and in all frames above it."""
        place, found = pin.SE3.Identity(), {frame: pin.SE3.Identity()}
        while frame in self._known:
            # A static transform has no time; comparisons with it are false.
            nearest = min(self._known[frame], key=lambda each: abs(each.time_s - at_s))
            if abs(nearest.time_s - at_s) > self._tolerance_s:
                off_s = nearest.time_s - at_s
                raise SceneError(f"the nearest transform of {frame!r} is {off_s:+.3f} s from the message", value=frame)
            shift, turn = (fields_of(nearest.transform[key]) for key in ("translation", "rotation"))
            try:
                place = pose([shift[axis] for axis in "xyz"], [turn[axis] for axis in "xyzw"]) * place
            except ValueError as error:
                raise SceneError(f"transform of {frame!r}: {error}") from error
            if nearest.parent in found:
                raise SceneError(f"frame {frame!r} is its own parent")
            frame, found[nearest.parent] = nearest.parent, place
        return found


def plain_frame(frame: str) -> str:
    """Frame name without the leading slash of ROS 1."""
    return frame.removeprefix("/")


def stamp_seconds(stamp: Any) -> float:
    """A `Time` message in seconds, for comparisons."""
    fields = fields_of(stamp)
    return float(fields["sec"]) + 1e-9 * float(fields["nanosec"])
