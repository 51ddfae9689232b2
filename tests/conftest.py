from __future__ import annotations

import pytest

from hplan.robot import Robot, load_robot
from hplan.scene import Scene
from hplan.scene_file import load_scene


@pytest.fixture(scope="session")
def robot() -> Robot:
    """The harvester that ships with hplan."""
    return load_robot()


@pytest.fixture(scope="session")
def scene() -> Scene:
    """The reference scene, Table 1 of the paper."""
    return load_scene()
