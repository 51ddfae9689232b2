"""Scenes: obstacles, fruit, start and goal as immutable data; YAML files.

Meshes and point clouds become convex solids. This package knows no robot; `orchard` generates scenes of trees with
fruit.

Examples:
    >>> from hplan.scene import Goal, Scene, Sphere, Start
    >>> apple = Sphere(name="apple", center=(1.0, 0.0, 1.5), radius=0.04)
    >>> start = Start(joints_deg=(0.0, 90.0, 90.0, 90.0))
    >>> scene = Scene(name="one apple", start=start, goal=Goal(position=(1.2, 0.0, 1.6)), obstacles=(apple,))
    >>> [obstacle.name for obstacle in scene.obstacles]
    ['apple']
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hplan.base.lazy_import import lazy_names

if TYPE_CHECKING:
    from hplan.scene.attached import Attached
    from hplan.scene.file import default_scene_path, dump_scene, load_scene, parse_scene, save_scene
    from hplan.scene.fruit import Fruit
    from hplan.scene.model import FORMAT, Goal, Scene, Start, with_limbs
    from hplan.scene.obstacles import Box, Capsule, Cylinder, Mesh, Obstacle, PointCloud, Sphere
    from hplan.scene.steps import Step
    from hplan.scene.tracks import Drift, Sway, Track
    from hplan.scene.upright import Upright
    from hplan.scene.wood import LimbLimits, Wood

__all__ = [
    "FORMAT",
    "Attached",
    "Box",
    "Capsule",
    "Cylinder",
    "Drift",
    "Fruit",
    "Goal",
    "LimbLimits",
    "Mesh",
    "Obstacle",
    "PointCloud",
    "Scene",
    "Sphere",
    "Start",
    "Step",
    "Sway",
    "Track",
    "Upright",
    "Wood",
    "default_scene_path",
    "dump_scene",
    "load_scene",
    "parse_scene",
    "save_scene",
    "with_limbs",
]

__getattr__ = lazy_names(
    __name__,
    {
        "hplan.scene.attached": "Attached",
        "hplan.scene.file": "default_scene_path dump_scene load_scene parse_scene save_scene",
        "hplan.scene.fruit": "Fruit",
        "hplan.scene.model": "FORMAT Goal Scene Start with_limbs",
        "hplan.scene.obstacles": "Box Capsule Cylinder Mesh Obstacle PointCloud Sphere",
        "hplan.scene.steps": "Step",
        "hplan.scene.tracks": "Drift Sway Track",
        "hplan.scene.upright": "Upright",
        "hplan.scene.wood": "LimbLimits Wood",
    },
)
