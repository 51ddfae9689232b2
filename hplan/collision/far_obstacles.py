"""Detection of implausibly far obstacles and large held objects, whose lengths are probably in millimetres."""

from __future__ import annotations

import warnings
from typing import Final

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.collision.motion_coefficients import workspace_ball
from hplan.errors import FarObstacleWarning
from hplan.robot.model import Robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Scene
from hplan.scene.obstacles import AnyObstacle, Mesh, PointCloud

#: A scene is suspicious if all of it is farther than this multiple of the arm's maximum extent; a single mesh or cloud
#: is suspicious if all of it is farther than this distance [m].
_MANY_REACHES: Final = 10.0
_FAR_M: Final = 100.0


def far_obstacles(robot: Robot, scene: Scene) -> tuple[str, ...]:
    """Names of the obstacles and fruits implausibly far from the arm.

    These are all of them if nothing is within ten times the arm's maximum extent, and each mesh or point cloud that is
    farther than 100 m. Scenes with tracks are not checked.
    """
    if scene.moves:
        return ()
    *centre, reach = workspace_ball(robot).tolist()
    items = (*scene.obstacles, *scene.fruits)
    if all(_is_beyond(item, np.array(centre), _MANY_REACHES * reach) for item in items):
        return tuple(item.name for item in items)
    shapes = (item for item in scene.obstacles if isinstance(item, Mesh | PointCloud))
    return tuple(item.name for item in shapes if _is_beyond(item, np.array(centre), _FAR_M))


def large_object(robot: Robot, scene: Scene) -> tuple[str, float] | None:
    """Name and size [m] of the first held object that is larger than the arm's maximum extent; None without one."""
    reach = float(workspace_ball(robot.bare)[3])
    for held in scene.attached:
        corners = np.concatenate([solid.core for solid in held.object.solids])
        size = float(np.ptp(corners, axis=0).max()) + 2.0 * max(solid.rounding for solid in held.object.solids)
        if size > 2.0 * reach:
            return held.object.name, size
    return None


def warn_of_far_obstacles(robot: Robot, scene: Scene) -> None:
    """Warn if the scene has obstacles implausibly far from the arm, or large objects in its hand.

    Warns:
        FarObstacleWarning: An obstacle or fruit is implausibly far from the arm, or a held object larger than the arm;
            the warning names the first one.
    """
    large = large_object(robot, scene)
    if large is not None:
        name, size = large
        warnings.warn(
            f"scene {scene.name!r}: held object {name!r} is {size:.4g} m large; are the lengths in millimetres? "
            "hplan expects metres",
            FarObstacleWarning,
            stacklevel=2,
        )
    names = far_obstacles(robot, scene)
    if names:
        others = f" and {len(names) - 1} more are" if names[1:] else " is"
        warnings.warn(
            f"scene {scene.name!r}: obstacle {names[0]!r}{others} far out of reach; are the lengths in millimetres? "
            "hplan expects metres",
            FarObstacleWarning,
            stacklevel=2,
        )


def _is_beyond(item: AnyObstacle | Fruit, centre: FloatArray, distance_m: float) -> bool:
    """True if an item is entirely beyond a distance from a point."""
    if isinstance(item, Fruit):
        return float(np.linalg.norm(np.array(item.center) - centre)) - item.radius > distance_m
    if isinstance(item, PointCloud):
        # In most clouds near the arm, the first point is near.
        first, rounded = np.linalg.norm(item.points[0] - centre), distance_m + item.radius
        return bool(first > rounded and (np.linalg.norm(item.points - centre, axis=1) > rounded).all())
    if isinstance(item, Mesh):
        return _is_hull_beyond(item.surface[0] - centre, distance_m)
    return all(_is_hull_beyond(solid.core - centre, distance_m + solid.rounding) for solid in item.solids)


def _is_hull_beyond(corners: FloatArray, distance_m: float) -> bool:
    """True if a hull is verified beyond a distance from the origin.

    The hull has (n, 3) corners. A separating plane proves it (Gilbert 1966); False after 100 iterations without one.
    """
    nearest = corners[0]
    for _ in range(100):
        length = float(np.linalg.norm(nearest))
        if length <= distance_m:
            return False
        along = corners @ nearest
        if along.min() > distance_m * length:  # A plane separates the hull from the ball.
            return True
        step = corners[along.argmin()] - nearest
        squared = float(step @ step)
        if squared == 0.0:
            return False
        nearest = nearest + min(1.0, max(0.0, -float(nearest @ step) / squared)) * step
    return False
