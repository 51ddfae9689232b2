"""Commands of meshcat's viewer as plain dictionaries: objects, poses, properties, animations.

A path identifies a node of the viewer; settings of a node apply to all nodes below it. Times of tracks are in seconds.
All tracks of a page end at the same time, so that its parts restart together.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import ArrayLike

from hplan.apps.view import three_js as three
from hplan.apps.view.three_js import Body, Json
from hplan.base.arrays import FloatArray

#: Path of the root node.
ROOT = "/hplan"


def set_object(path: str, body: Body | Json) -> Json:
    """Set the object of a node."""
    return {"type": "set_object", "path": path, "object": body.json() if isinstance(body, Body) else body}


def set_transform(path: str, matrix: FloatArray) -> Json:
    """Set the (4, 4) pose of a node in its parent's frame."""
    return {"type": "set_transform", "path": path, "matrix": three.flatten_numbers(matrix.T)}


def set_property(path: str, name: str, value: Any) -> Json:
    """Set a property of a node."""
    return {"type": "set_property", "path": path, "property": name, "value": value}


def node(kind: str, name: str) -> str:
    """Path element of a node of some kind and name.

    The kind prevents clashes of names like `constructor` with JavaScript's own. A slash, which separates path elements,
    is replaced by a similar character.
    """
    return f"{kind} {name}".replace("/", "∕")  # noqa: RUF001


def rotation_track(times: ArrayLike, turns: ArrayLike) -> Json:
    """Rotation track of a node.

    Args:
        times: (k,) times of the keyframes [s].
        turns: (k, 4) quaternions (x, y, z, w) in the parent's frame.
    """
    return _track(".quaternion", "quaternion", times, three.flatten_numbers(turns))


def translation_track(times: ArrayLike, places: ArrayLike) -> Json:
    """Translation track of a node.

    Args:
        times: (k,) times of the keyframes [s].
        places: (k, 3) positions in the parent's frame [m].
    """
    return _track(".position", "vector", times, three.flatten_numbers(places))


def visibility_track(since: float, until: float, end: float) -> Json:
    """Visibility track: a node is visible in [since, until).

    Args:
        since: Time when the node appears [s].
        until: Time when it disappears [s].
        end: End of the animation [s].
    """
    times = sorted({0.0, end, *(time for time in (since, until) if 0.0 < time < end)})
    return _track(".visible", "bool", times, [since <= time < until for time in times])


def clip(path: str, *tracks: Json) -> Json:
    """Animation clip: the tracks of one node."""
    return {"path": path, "clip": {"name": "motion", "fps": 1, "tracks": list(tracks)}}


def animation(clips: Sequence[Json]) -> Json:
    """Command that plays all clips repeatedly."""
    # The viewer has no infinite repetition; this number lasts for years.
    options = {"play": True, "repetitions": 1_000_000_000}
    return {"type": "set_animation", "path": "", "animations": list(clips), "options": options}


def _track(name: str, kind: str, times: ArrayLike, values: Sequence[Any]) -> Json:
    return {"name": name, "type": kind, "times": three.flatten_numbers(times), "values": list(values)}
