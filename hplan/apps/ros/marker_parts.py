"""Parts of a `visualization_msgs/msg/Marker`: head, pose, colour, points, sphere."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from hplan.apps.ros.message_times import message_time
from hplan.apps.ros.transforms import quaternion, xyz
from hplan.base.arrays import FloatArray

Marker: TypeAlias = dict[str, Any]

#: Constants of the message: marker types and actions.
CUBE, _SPHERE, CYLINDER, LINE_STRIP, LINE_LIST, SPHERE_LIST, TEXT, TRIANGLES = 1, 2, 3, 4, 5, 7, 9, 11
ADD, DELETE, DELETE_ALL = 0, 2, 3


def head(*, frame_id: str, ns: str, number: int) -> Marker:
    """Fields common to all markers.

    The time is 0, so that a marker follows its frame.

    Args:
        frame_id: Frame of the marker.
        ns: Namespace of the marker.
        number: Number in the namespace; a marker with the same number replaces the previous one.
    """
    return {
        "header": {"stamp": message_time(0), "frame_id": frame_id},
        "ns": ns,
        "id": number,
        "action": ADD,
        "frame_locked": True,
    }


def color(rgb: int, opacity: float = 1.0) -> dict[str, float]:
    """Convert a colour such as 0xFF8800 to a `std_msgs/msg/ColorRGBA`.

    Examples:
        >>> color(0xFF0000, 0.5)
        {'r': 1.0, 'g': 0.0, 'b': 0.0, 'a': 0.5}
    """
    return dict(zip("rgb", (part / 255.0 for part in rgb.to_bytes(3)), strict=True)) | {"a": opacity}


def pose(position: ArrayLike = (0.0, 0.0, 0.0), rotation: ArrayLike | None = None) -> dict[str, Any]:
    """Create a `geometry_msgs/msg/Pose`.

    Args:
        position: (3,) position [m].
        rotation: (3, 3) rotation matrix; None for the identity.
    """
    return {"position": xyz(position), "orientation": quaternion(np.eye(3) if rotation is None else rotation)}


def points(places: ArrayLike) -> list[dict[str, float]]:
    """Convert (n, 3) points to `geometry_msgs/msg/Point`s [m]."""
    return [{"x": x, "y": y, "z": z} for x, y, z in np.asarray(places, dtype=np.float64).tolist()]


def ball(center: Sequence[float] | FloatArray, radius: float) -> Marker:
    """Shape and pose of a sphere marker: (3,) centre, radius [m]."""
    return {"type": _SPHERE, "pose": pose(center), "scale": xyz((2.0 * radius,) * 3)}
