"""Commands of meshcat's viewer, as plain dictionaries: objects, poses, properties, and what moves.

A node of the viewer is named by a path; what is set on it holds for all below it. Times of tracks are seconds, and all
tracks of a page end together, so that its parts start again together.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import ArrayLike

from hplan.apps.view import three_js as three
from hplan.apps.view.three_js import Body, Json
from hplan.base.arrays import FloatArray

#: Path of the node that holds all.
ROOT = "/hplan"


def set_object(path: str, body: Body | Json) -> Json:
    """Put an object at a node."""
    return {"type": "set_object", "path": path, "object": body.json() if isinstance(body, Body) else body}


def set_transform(path: str, matrix: FloatArray) -> Json:
    """Place a node in its parent's frame by a (4, 4) matrix."""
    return {"type": "set_transform", "path": path, "matrix": three.numbers(matrix.T)}


def set_property(path: str, name: str, value: Any) -> Json:
    """Set a property of a node."""
    return {"type": "set_property", "path": path, "property": name, "value": value}


def node(kind: str, name: str) -> str:
    """A path element: the kind keeps names like `constructor` apart from JavaScript's own, a slash would part it."""
    return f"{kind} {name}".replace("/", "∕")  # noqa: RUF001


def turning(times: ArrayLike, turns: ArrayLike) -> Json:
    """A node turns: (k,) times, (k, 4) quaternions x, y, z, w."""
    return _track(".quaternion", "quaternion", times, three.numbers(turns))


def moving(times: ArrayLike, places: ArrayLike) -> Json:
    """A node moves in its parent's frame: (k,) times, (k, 3) places [m]."""
    return _track(".position", "vector", times, three.numbers(places))


def showing(since: float, until: float, end: float) -> Json:
    """A node is seen from `since` on, and before `until`, of a motion that ends at `end`."""
    times = sorted({0.0, end, *(time for time in (since, until) if 0.0 < time < end)})
    return _track(".visible", "bool", times, [since <= time < until for time in times])


def clip(path: str, *tracks: Json) -> Json:
    """Tracks of a node over time."""
    return {"path": path, "clip": {"name": "motion", "fps": 1, "tracks": list(tracks)}}


def animation(clips: Sequence[Json]) -> Json:
    """Play all clips, again and again."""
    # The viewer takes no "for ever"; this is years.
    options = {"play": True, "repetitions": 1_000_000_000}
    return {"type": "set_animation", "path": "", "animations": list(clips), "options": options}


def _track(name: str, kind: str, times: ArrayLike, values: Sequence[Any]) -> Json:
    return {"name": name, "type": kind, "times": three.numbers(times), "values": list(values)}
