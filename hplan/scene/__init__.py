"""Scenes: obstacles, fruit, start and goal as frozen data; their YAML files; meshes and point clouds as convex solids.

Knows no robot; `orchard` makes scenes of trees and their fruit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hplan.base.lazy_import import lazy_names

if TYPE_CHECKING:
    from hplan.scene.file import default_scene_path, dump_scene, load_scene, parse_scene, save_scene
    from hplan.scene.model import FORMAT, Fruit, Goal, Scene, Start
    from hplan.scene.obstacles import Box, Capsule, Cylinder, Mesh, Obstacle, PointCloud, Sphere
    from hplan.scene.tracks import Sway, Track

__all__ = [
    "FORMAT",
    "Box",
    "Capsule",
    "Cylinder",
    "Fruit",
    "Goal",
    "Mesh",
    "Obstacle",
    "PointCloud",
    "Scene",
    "Sphere",
    "Start",
    "Sway",
    "Track",
    "default_scene_path",
    "dump_scene",
    "load_scene",
    "parse_scene",
    "save_scene",
]

__getattr__ = lazy_names(
    __name__,
    {
        "hplan.scene.file": "default_scene_path dump_scene load_scene parse_scene save_scene",
        "hplan.scene.model": "FORMAT Fruit Goal Scene Start",
        "hplan.scene.obstacles": "Box Capsule Cylinder Mesh Obstacle PointCloud Sphere",
        "hplan.scene.tracks": "Sway Track",
    },
)
