"""Parts of a `visualization_msgs/msg/Marker`: its head, poses, colours, points, balls."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from hplan.apps.ros.message_times import message_time
from hplan.apps.ros.transforms import quaternion, xyz
from hplan.base.arrays import FloatArray

Marker: TypeAlias = dict[str, Any]

#: Kinds of markers, and what is done with one.
CUBE, _SPHERE, CYLINDER, LINE_STRIP, LINE_LIST, SPHERE_LIST, TEXT, TRIANGLES = 1, 2, 3, 4, 5, 7, 9, 11
ADD, DELETE, DELETE_ALL = 0, 2, 3


def head(*, frame_id: str, ns: str, number: int) -> Marker:
    """What every marker has; at time 0 it stays where its frame is."""
    return {
        "header": {"stamp": message_time(0), "frame_id": frame_id},
        "ns": ns,
        "id": number,
        "action": ADD,
        "frame_locked": True,
    }


def color(rgb: int, opacity: float = 1.0) -> dict[str, float]:
    """A `std_msgs/msg/ColorRGBA` of a number such as 0xFF8800."""
    return dict(zip("rgb", (part / 255.0 for part in rgb.to_bytes(3)), strict=True)) | {"a": opacity}


def pose(position: ArrayLike = (0.0, 0.0, 0.0), rotation: ArrayLike | None = None) -> dict[str, Any]:
    """A `geometry_msgs/msg/Pose`."""
    return {"position": xyz(position), "orientation": quaternion(np.eye(3) if rotation is None else rotation)}


def points(places: ArrayLike) -> list[dict[str, float]]:
    """(n, 3) points as `geometry_msgs/msg/Point`s."""
    return [{"x": x, "y": y, "z": z} for x, y, z in np.asarray(places, dtype=np.float64).tolist()]


def ball(center: Sequence[float] | FloatArray, radius: float) -> Marker:
    """A ball."""
    return {"type": _SPHERE, "pose": pose(center), "scale": xyz((2.0 * radius,) * 3)}
