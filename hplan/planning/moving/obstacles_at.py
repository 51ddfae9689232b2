"""Static scenes that approximate a scene with moving obstacles."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.scene.model import Fruit, Scene
from hplan.scene.obstacle_kind import moved
from hplan.scene.obstacles import AnyObstacle, Sphere

#: Maximum displacement between consecutive poses of one obstacle [m], and the maximum number of poses.
APART_M: Final = 0.03
_MOST_POSES: Final = 24


def without_moving(scene: Scene) -> Scene:
    """The scene without its moving obstacles.

    On a moving base: the other obstacles, at their initial poses.
    """
    at_first = scene.at(0.0)
    kept = {item.name for item in (*scene.obstacles, *scene.fruits) if item.track is None}
    return at_first.copy_unchecked(
        {
            "obstacles": tuple(item for item in at_first.obstacles if item.name in kept),
            "fruits": tuple(item for item in at_first.fruits if item.name in kept),
        }
    )


def among_poses(scene: Scene, from_s: float, to_s: float) -> Scene:
    """The scene with moving obstacles at all their poses within an interval.

    Consecutive poses are close to each other (`APART_M`).

    Args:
        from_s: Start of the interval [s].
        to_s: End of the interval [s].
    """
    moving = set(scene.poses_at([from_s]))
    still_fruits = tuple(fruit for fruit in scene.fruits if fruit.name not in moving)
    fruits = tuple(fruit for fruit in scene.fruits if fruit.name in moving)
    obstacles: list[AnyObstacle] = [item for item in scene.obstacles if item.name not in moving]
    items = [*(item for item in scene.obstacles if item.name in moving), *(_ball(fruit) for fruit in fruits)]
    clock = np.linspace(from_s, to_s, _MOST_POSES)
    poses = scene.poses_at(clock)
    for item in items:
        rotations, shifts = poses[item.name]
        points = _points(item)
        places = points @ np.swapaxes(rotations, 1, 2) + shifts[:, None]
        steps = np.linalg.norm(np.diff(places, axis=0), axis=2).max(axis=1)
        for number in _apart(steps):
            name = f"{item.name} at {clock[number]:.3f} s"
            update = moved(item, rotations[number], shifts[number])
            obstacles.append(item.copy_unchecked(update | {"name": name}))
    return scene.copy_unchecked({"obstacles": tuple(obstacles), "fruits": still_fruits, "base_track": None})


def _apart(steps: FloatArray) -> Iterator[int]:
    """Choose poses: the first, the last, and few close ones between them."""
    gone = math.inf
    for number, step in enumerate([0.0, *steps.tolist()]):
        following = float(steps[number]) if number < len(steps) else math.inf
        gone += step
        if gone + following > APART_M and (gone > 0.0 or number == 0):
            gone = 0.0
            yield number


def _ball(fruit: Fruit) -> Sphere:
    """A fruit as an obstacle."""
    keys = ("name", "center", "radius", "sigma", "track", "sway", "yields")
    return Sphere(**{key: getattr(fruit, key) for key in keys})


def _points(item: AnyObstacle) -> FloatArray:
    """(k, 3) core points of an obstacle, to measure its travel."""
    return np.concatenate([solid.core for solid in item.solids])
