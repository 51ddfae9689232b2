"""Readers of ROS files for `kind: import` in scene files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hplan.apps.ros.bag_cloud import read_bag_cloud
from hplan.apps.ros.moveit_scene import read_moveit_scene
from hplan.apps.ros.octomap import read_octomap
from hplan.apps.ros.planning_scene import read_planning_scene
from hplan.scene.imports import READERS, Reader
from hplan.scene.obstacles import Obstacle


def _with_prefix(read: Reader) -> Reader:
    """A reader that takes the prefix of its names as `name`."""

    def reader(path: Path, *, name: str = "", **options: Any) -> tuple[Obstacle, ...]:
        return read(path, prefix=f"{name} " if name else "", **options)

    return reader


def _cloud(path: Path, **options: Any) -> tuple[Obstacle, ...]:
    return (read_bag_cloud(path, **options),)


_PLACE = ("name", "position", "rpy_deg")

for _suffixes, _reader in (
    ((".scene",), (_with_prefix(read_moveit_scene), _PLACE)),
    ((".yaml", ".yml", ".json"), (_with_prefix(read_planning_scene), _PLACE)),
    ((".bt", ".ot"), (read_octomap, (*_PLACE, "depth"))),
    (("", ".mcap", ".db3", ".bag"), (_cloud, (*_PLACE, "radius", "topic", "time_s", "frame"))),
):
    READERS.update(dict.fromkeys(_suffixes, _reader))
