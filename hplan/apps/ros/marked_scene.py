"""Markers (`visualization_msgs/msg/Marker`) of a scene's obstacles and fruits.

Obstacles are coloured by their material. Marker numbers follow the order in the scene, so that a marker sent again
replaces the previous one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import coal
import numpy as np
from numpy.typing import ArrayLike

from hplan.apps.ros.transforms import message_time, quaternion, xyz
from hplan.apps.view.scenery import FRUIT_COLOR, GOAL_FRUIT_COLOR, look_of
from hplan.base.arguments import instance, text
from hplan.base.arrays import FloatArray
from hplan.collision.coal_shapes import solid_shape
from hplan.scene.fruit import Fruit
from hplan.scene.model import Scene
from hplan.scene.obstacles import Box, Capsule, Cylinder, Obstacle, PointCloud, Sphere

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


#: Namespaces of markers.
_OBSTACLES, FRUITS = "obstacles", "fruits"


def scene_markers(scene: Scene, frame_id: str = "base_link") -> list[Marker]:
    """Markers of a scene, for the `markers` of a `visualization_msgs/msg/MarkerArray`.

    Each moving obstacle or fruit has its own frame `obstacle/NAME`, in which its marker has the pose listed in the
    scene. `scene.poses_at` gives the pose of that frame over time.

    Args:
        scene: The scene.
        frame_id: Frame of everything that does not move.

    Raises:
        OptionError: `scene` is not a scene, or `frame_id` is not text.

    Examples:
        >>> from hplan.scene import load_scene
        >>> markers = scene_markers(load_scene("table-1"))
        >>> markers[0]["ns"], markers[0]["header"]["frame_id"]
        ('obstacles', 'base_link')
    """
    instance("scene", scene, Scene, "load_scene")
    text("frame_id", frame_id)
    markers = list[Marker]()
    for obstacle in scene.obstacles:
        look = look_of(obstacle.name)
        for marker in _marker_parts_of(obstacle):
            top = head(frame_id=frame_of_obstacle(scene, obstacle, frame_id), ns=_OBSTACLES, number=len(markers))
            markers.append(top | marker | {"color": color(look.color, look.opacity)})
    goal = scene.goal.fruit
    hanging = [(fruit, frame_of_obstacle(scene, fruit, frame_id)) for fruit in scene.fruits]
    return [*markers, *(fruit_marker(scene, fruit, frame, is_goal=fruit.name == goal) for fruit, frame in hanging)]


def frame_of_obstacle(scene: Scene, item: Obstacle | Fruit, frame_id: str) -> str:
    """Frame of an obstacle or fruit.

    It is the item's own frame if the item or the base moves, else `frame_id`.
    """
    return frame_id if item.track is None and scene.base_track is None else moving_frame(item.name)


def moving_frame(name: str) -> str:
    """Frame name of a moving obstacle or fruit."""
    return f"obstacle/{name}"


def fruit_marker(scene: Scene, fruit: Fruit, frame_id: str, *, is_goal: bool) -> Marker:
    """Marker of a fruit at its place on the tree."""
    number = scene.fruits.index(fruit)
    return (
        ball(fruit.center, fruit.radius)
        | head(frame_id=frame_id, ns=FRUITS, number=number)
        | {"color": color(GOAL_FRUIT_COLOR if is_goal else FRUIT_COLOR)}
    )


def _marker_parts_of(obstacle: Obstacle) -> list[Marker]:
    """Shapes and poses of the markers that form an obstacle."""
    if isinstance(obstacle, PointCloud):
        return [_balls(solid.core, solid.rounding) for solid in obstacle.solids]
    if not isinstance(obstacle, Sphere | Capsule | Cylinder | Box):
        vertices, faces = obstacle.surface
        corners = points(vertices[faces].reshape(-1, 3))
        return [{"type": TRIANGLES, "pose": pose(), "scale": xyz((1.0, 1.0, 1.0)), "points": corners}]
    placed = solid_shape(obstacle)
    shape, place = placed.geometry, pose(placed.placement.translation, placed.placement.rotation)
    if isinstance(shape, coal.Sphere):
        return [ball(placed.placement.translation, shape.radius)]
    if isinstance(shape, coal.Box):
        return [{"type": CUBE, "pose": place, "scale": xyz(2.0 * shape.halfSide)}]
    wide, length = 2.0 * shape.radius, 2.0 * shape.halfLength
    wall = {"type": CYLINDER, "pose": place, "scale": xyz((wide, wide, length))}
    if not isinstance(obstacle, Capsule):
        return [wall]
    balls = [ball(end, shape.radius) for end in (obstacle.start, obstacle.end)]
    return [wall, *balls] if length else balls[:1]


def _balls(centers: FloatArray, radius: float) -> Marker:
    # Draw at most 20,000 balls of a cloud: every k-th one of a larger cloud.
    some = points(centers[:: -(-len(centers) // 20_000)])
    return {"type": SPHERE_LIST, "pose": pose(), "scale": xyz((2.0 * radius,) * 3), "points": some}
