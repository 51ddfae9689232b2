"""Markers (`visualization_msgs/msg/Marker`) of a scene's obstacles and fruits.

Obstacles are coloured by their material. Marker numbers follow the order in the scene, so that a marker sent again
replaces the previous one.
"""

from __future__ import annotations

import coal

from hplan.apps.ros import marker_parts as mark
from hplan.apps.ros.marker_parts import Marker
from hplan.apps.ros.transforms import xyz
from hplan.apps.view.scenery import FRUIT_COLOR, GOAL_FRUIT_COLOR, look_of
from hplan.base.arguments import instance, text
from hplan.base.arrays import FloatArray
from hplan.collision.coal_shapes import solid_shape
from hplan.scene.model import Fruit, Scene
from hplan.scene.obstacles import Box, Capsule, Cylinder, Obstacle, PointCloud, Sphere

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
        for marker in _parts(obstacle):
            head = mark.head(frame_id=frame_of(scene, obstacle, frame_id), ns=_OBSTACLES, number=len(markers))
            markers.append(head | marker | {"color": mark.color(look.color, look.opacity)})
    goal = scene.goal.fruit
    hanging = [(fruit, frame_of(scene, fruit, frame_id)) for fruit in scene.fruits]
    return [*markers, *(fruit_marker(scene, fruit, frame, is_goal=fruit.name == goal) for fruit, frame in hanging)]


def frame_of(scene: Scene, item: Obstacle | Fruit, frame_id: str) -> str:
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
        mark.ball(fruit.center, fruit.radius)
        | mark.head(frame_id=frame_id, ns=FRUITS, number=number)
        | {"color": mark.color(GOAL_FRUIT_COLOR if is_goal else FRUIT_COLOR)}
    )


def _parts(obstacle: Obstacle) -> list[Marker]:
    """Shapes and poses of the markers that form an obstacle."""
    if isinstance(obstacle, PointCloud):
        return [_balls(solid.core, solid.rounding) for solid in obstacle.solids]
    if not isinstance(obstacle, Sphere | Capsule | Cylinder | Box):
        vertices, faces = obstacle.surface
        corners = mark.points(vertices[faces].reshape(-1, 3))
        return [{"type": mark.TRIANGLES, "pose": mark.pose(), "scale": xyz((1.0, 1.0, 1.0)), "points": corners}]
    placed = solid_shape(obstacle)
    shape, pose = placed.geometry, mark.pose(placed.placement.translation, placed.placement.rotation)
    if isinstance(shape, coal.Sphere):
        return [mark.ball(placed.placement.translation, shape.radius)]
    if isinstance(shape, coal.Box):
        return [{"type": mark.CUBE, "pose": pose, "scale": xyz(2.0 * shape.halfSide)}]
    wide, length = 2.0 * shape.radius, 2.0 * shape.halfLength
    wall = {"type": mark.CYLINDER, "pose": pose, "scale": xyz((wide, wide, length))}
    if not isinstance(obstacle, Capsule):
        return [wall]
    balls = [mark.ball(end, shape.radius) for end in (obstacle.start, obstacle.end)]
    return [wall, *balls] if length else balls[:1]


def _balls(centers: FloatArray, radius: float) -> Marker:
    # Draw at most 20,000 balls of a cloud: every k-th one of a larger cloud.
    some = mark.points(centers[:: -(-len(centers) // 20_000)])
    return {"type": mark.SPHERE_LIST, "pose": mark.pose(), "scale": xyz((2.0 * radius,) * 3), "points": some}
